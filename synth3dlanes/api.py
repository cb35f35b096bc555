"""The functions of `import synth3dlanes` (docs/api.md).

No function loads Blender into this process: `generate_dataset` and `render`, in renderer.py, start worker processes for
it.
"""

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from synth3dlanes.dataset.description import is_lifted
from synth3dlanes.dataset.format import (
    IMAGE_FORMATS,
)
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import merge as _merge
from synth3dlanes.dataset.rearrange import split_dataset as _split
from synth3dlanes.dataset.scenes import load_scene as _load_scene
from synth3dlanes.dataset.scenes import provenance_of, read_scene
from synth3dlanes.dataset.splits import data_set_name, evenly_spaced, one_reader, readers, split_name
from synth3dlanes.draw.like import read_like
from synth3dlanes.draw.on_map import MapPlace, place_on_map
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.draw.sample import sample_scene as _sample_scene
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.summary import ExportSummary
from synth3dlanes.labels.labels import Labels
from synth3dlanes.params.camera_files import load_camera as _load_camera
from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import Params
from synth3dlanes.params.params import load_params as _load_params
from synth3dlanes.params.params_text import contradictions
from synth3dlanes.params.rig_files import load_rig as _load_rig
from synth3dlanes.params.shots import Shots, clips
from synth3dlanes.production.condition import Condition
from synth3dlanes.production.events import Event
from synth3dlanes.production.given_scenes import drawn
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.production.tally import RunReport
from synth3dlanes.production.user_assets import open_library
from synth3dlanes.recorded.drives.checks import drive_findings
from synth3dlanes.recorded.drives.drive import Drive
from synth3dlanes.recorded.drives.open import open_drive as _open_drive
from synth3dlanes.recorded.lift.precision import Precision
from synth3dlanes.recorded.lift.write import LiftReport, lift_to
from synth3dlanes.renderer import STANDARD, one_of, render_settings, several
from synth3dlanes.scene import scene as scene_format
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Library
from synth3dlanes.scene.change import change_scene as _change_scene
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import MAX_SEED, N_SCENE_NUMBERS, SPLIT_NAME, TRIES
from synth3dlanes.system.arguments import checked
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import write
from synth3dlanes.system.schema import shown
from synth3dlanes.truth.ground_truth import ground_truth

if TYPE_CHECKING:
    # Loaded by the functions that return them: figures and checks take a second.
    import synth3dlanes.figures.stats
    import synth3dlanes.formats.format
    import synth3dlanes.formats.verify
    import synth3dlanes.validate.report


# Far more than any machine has cores.
MAX_WORKERS = 10_000


@checked
def open_assets(folder: str | Path) -> Library:
    """Check a folder of your own cars, trees, textures and skies (docs/assets.md). The result is the `assets` argument
    of other functions.

    Issues a Python warning for each file that is usable but unusual. Raises InputError with a line for every problem,
    and where Blender is not installed.
    """
    library, found = open_library(Path(folder))
    for warning in found:
        warnings.warn(f"{folder}: {warning}", stacklevel=2)
    return library


@checked
def load_params(
    source: str | Path = "appendix_i", overrides: str | Sequence[str] = (), assets: Library = BUILT_IN
) -> Params:
    """Read a preset (by name) or a YAML file, then apply overrides such as `cars.n=3`.

    Values of your own come before those of weather and time of day; issues a Python warning for each that does not fit
    them, as a high sun at night. Raises InputError with a line for every problem.
    """
    params = _load_params(str(source), several(overrides), assets.assets)
    for line in contradictions(params):
        warnings.warn(line, stacklevel=2)
    return params


@checked
def load_camera(source: str | Path) -> CameraSpec:
    """Read a camera (docs/camera.md): a YAML file of ours, a calibration file of OpenCV or Kalibr, or the name of a
    ready camera.

    Raises InputError with a line for every problem.
    """
    return _load_camera(str(source))


@checked
def load_rig(source: str | Path) -> tuple[CameraSpec, ...]:
    """Read the cameras of a rig (docs/camera.md): a YAML file, or the name of a ready rig.

    Raises InputError with a line for every problem.
    """
    return _load_rig(str(source))


@checked
def sample_scene(
    params: Params,
    *,
    seed: int = 0,
    split: str = "train",
    index: int = 0,
    camera: CameraSpec | None = None,
    rig: Sequence[CameraSpec] = (),
    frames: int = 1,
    fps: float = 10.0,
    map: str | Path | None = None,
    at: str = "",
    assets: Library = BUILT_IN,
) -> Scene:
    """Draw the scene of sample `index` of a split. Equal arguments give equal scenes.

    `camera`, or the cameras of a `rig`, replace the camera of the parameters. With `frames` above 1, samples are frames
    of clips at `fps` frames per second. `map` is an OpenDRIVE or Lanelet2 file whose roads the scene is on, `at` the
    host's place there as ROAD:s:lane, in place of a random one (docs/maps.md). Raises InputError for a wrong argument,
    and if there is no room for the least number of cars or trees in their ranges; FormatError for a map that cannot be
    read.
    """
    _within(0, MAX_SEED, seed=seed)
    _within(0, N_SCENE_NUMBERS - 1, index=index)
    _named(split=split)
    shots, place = _shots(camera, rig, frames, fps), _map_place(map, at)
    scenes = Scenes(params, seed, split, assets=assets.assets, shots=shots, map=place)
    return _sample_scene(scenes, index)


@checked
def change_scene(scene: Scene, changes: str | Sequence[str]) -> Scene:
    """Return a copy of the scene with changes such as `light.sun_azimuth_deg=200`, `cars.0.lane=2` or `cars=[]`.

    The keys are those of `scene.json`; an angle may be given in degrees. Raises InputError with a line for every
    problem.
    """
    return _change_scene(scene, several(changes))


@checked
def load_scene(path: str | Path) -> Scene:
    """Read a `scene.json`; raise FormatError with a line for every problem."""
    return _load_scene(Path(path))


@checked
def save_scene(scene: Scene, path: str | Path) -> None:
    """Write a `scene.json` file, which `load_scene` and `synth3dlanes render` read."""
    _file(path=path)
    write(Path(path), f"{scene_format.to_json(scene)}\n".encode())


@checked
def label(scene: Scene) -> Labels:
    """Compute the exact labels of a scene without rendering it. `object_visible` is None, because only `render`
    computes it."""
    return ground_truth(scene)


@checked
def generate_dataset(
    params: Params,
    out: str | Path,
    *,
    n: int,
    seed: int = 0,
    split: str = "train",
    frames: int = 1,
    fps: float = 10.0,
    samples: int = STANDARD,
    passes: str | Sequence[str] = (),
    lidar: str | Path | None = None,
    image_format: str = "jpg",
    device: str = "auto",
    workers: int = 0,
    camera: CameraSpec | None = None,
    rig: Sequence[CameraSpec] = (),
    map: str | Path | None = None,
    at: str = "",
    like: Sequence[Scene] = (),
    spreads: str | Sequence[str] = (),
    where: str = "",
    tries: int = TRIES,
    assets: Library = BUILT_IN,
    notify: Callable[[Event], None] | None = None,
) -> RunReport:
    """Make samples 0 to n - 1 of a split in `out`, a folder or a URL. Samples that are already there are kept.

    With `frames` above 1, samples are frames of clips at `fps` frames per second: the first clip is samples 0 to frames
    - 1. `map` is an OpenDRIVE or Lanelet2 file whose roads the scenes are on, `at` one place there for all of them, as
    ROAD:s:lane (docs/maps.md). With `like`, scenes that were drawn from the same parameters, every new scene is drawn
    near one of these; `spreads` sets how near, as shares of the parameters' ranges: `0.1` for all parameters, or
    `camera.pitch_deg=0.4` for one (docs/like.md). With `where`, a query on the columns of the index, every sample shows
    the first of at most `tries` scenes drawn for it that fits (docs/recipes.md). `workers` is the number of processes,
    0 for one per core. `notify` is called with every event of the run; `event.message` is a line of text.

    Raises InputError, FormatError, MissingPackageError or DiskFullError if the run cannot start. A later problem does
    not raise: see `problem`, `done` and `asked` of the result.
    """
    _within(0, MAX_SEED, seed=seed)
    settings = render_settings(samples, passes, device)
    shots = _shots(camera, rig, frames, fps)
    if lidar is not None:
        settings = replace(settings, passes=(*settings.passes, "lidar"))
        shots = shots.model_copy(update={"lidar": load_lidar(str(lidar))})
    image_format = one_of("image_format", image_format, IMAGE_FORMATS)
    if like and map is not None:
        raise InputError("map: expected none beside like")
    if like and where:
        raise InputError("where: expected none beside like")
    if spreads and not like:
        raise InputError("spreads: expected none without scenes to be like")
    near = None
    if like:
        near = read_like(drawn(like, params, assets.assets, "like", bool(shots.cameras)), several(spreads))
    scenes = Scenes(params, seed, split, assets=assets.assets, shots=shots, like=near, map=_map_place(map, at))
    condition = Condition(where, tries) if where else None
    if condition is not None:
        condition.probe(scenes)
    recipe = Recipe(scenes, settings, image_format, assets, where=condition)
    plan = Plan(out, n, recipe, workers)
    return generate(plan, notify or (lambda event: None))


@checked
def open_dataset(place: str | Path, split: str = "train") -> Reader:
    """Open a split of a data set, in a folder or at a URL. Raises FormatError where there is none."""
    return Reader(f"{str(place).rstrip('/')}/{split}")


@checked
def export_dataset(
    source: str | Path,
    out: str | Path,
    format_name: str,
    *,
    size_px: tuple[int, int] | None = None,
    cameras: str | Sequence[str] = (),
    workers: int = 1,
) -> ExportSummary:
    """Write a data set, a split or a sample (`DIR/train:00000017`) in a format of the command `export`. Returns a
    summary of what was written.

    `out` is a new folder, or the folder of an earlier export of the same data, whose frames are kept. `size_px` is
    (width, height) of the images, by default that of the format. `cameras` are names of cameras of a rig; by default
    those that look ahead, or all cameras for formats that keep images unchanged. `workers` is the number of processes,
    0 for one per core. Raises InputError for a wrong argument, and for a format, a size or a camera that does not
    exist. `Export(...).write` does the same and reports its progress.
    """
    return Export(str(source), Path(out), format_name, size_px, tuple(several(cameras))).write(workers)


@checked
def verify_export(export: Export, *, most_frames: int = 500) -> "tuple[synth3dlanes.formats.verify.Verification, ...]":
    """Read a finished export back and compare at most the first `most_frames` frames of each of its lists with the
    labels of its data set: how far the lines are, and the `problems`, a line each. Raises FormatError for a file that
    cannot be read."""
    from synth3dlanes.formats.verify import verify

    _at_least(1, most_frames=most_frames)
    return verify(export, most_frames)


@checked
def score_predictions(
    export: str | Path, format_name: str, predictions: str | Path
) -> "tuple[synth3dlanes.formats.format.Rates, ...]":
    """Score predictions, a file or folder as the benchmark of this format takes it, for an export, by the benchmark's
    rule; return its rates for each list that they are for (docs/exports.md). Raises InputError for a format without
    one, FormatError for predictions that cannot be read or that lack a frame."""
    from synth3dlanes.formats.scoring import score_predictions

    return score_predictions(Path(export), format_name, Path(predictions))


@checked
def split_dataset(
    source: str | Path, out: str | Path, shares: Mapping[str, float] | None = None, *, seed: int = 0
) -> dict[str, int]:
    """Divide a split at random into new splits, in a new data set `out`. Returns the number of samples of each new
    split.

    `source` is a split, or a data set with one split. The frames of a clip stay together. `shares` maps the names of
    the new splits to their shares, by default train 0.8, val 0.1, test 0.1.
    """
    _within(0, MAX_SEED, seed=seed)
    wanted = {"train": 0.8, "val": 0.1, "test": 0.1} if shares is None else shares
    return _split(one_reader(str(source)), wanted, seed, str(out))


@checked
def merge_datasets(sources: Sequence[str | Path], out: str | Path) -> dict[str, int]:
    """Merge data sets of one recipe, such as parts made on several machines. Returns the number of samples of each
    split.

    Samples keep their numbers. Raises InputError if two data sets have a sample of the same number.
    """
    return _merge([str(source) for source in sources], str(out))


@checked
def open_drive(
    source: str | Path,
    *,
    camera: str = "",
    lanes: str | Path = "",
    marked: str | Path = "",
    review: str | Path = "",
) -> Drive:
    """Open a real drive (docs/lift.md): a folder of KITTI or Argoverse 2, a file `drive.yaml`, or a clip of a data set
    with a lidar (`DIR/train:0`). Its frames are read when they are asked for.

    `camera` names one of its cameras; `lanes` is a file of 2D lanes of its images, `marked` one of lanes marked in its
    top view, `review` one of verdicts on what was lifted of it before. Raises InputError for anything else, FormatError
    for a file that cannot be read.
    """
    return _open_drive(str(source), camera, str(lanes), str(marked), str(review))


@checked
def check_drive(drive: Drive) -> None:
    """Check the times, poses, points and 2D lanes of a drive against each other: wrong units, mirrored axes, sensors or
    clocks that do not fit. Raises InputError with a line for every problem."""
    problems = drive_findings(drive)
    if problems:
        raise InputError(*problems)


@checked
def lift_drive(
    drive: Drive,
    out: str | Path,
    *,
    split: str = "train",
    precision: Mapping[str, float] | None = None,
    around: int = 50,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> LiftReport:
    """Lift the lanes of a drive into 3D (docs/lift.md): a data set `out` with its images and their measured lanes,
    whose labels say how certain each point is.

    `precision` is how exact the drive is, as standard deviations by name: `lanes_px`, `pose_m`, `pose_deg`,
    `calibration_m`, `calibration_deg`, `marked_m`. Each frame is lifted with the scans and lanes of `around` frames
    before and after it. `progress` is called with (frames done, all frames). Raises InputError where points, poses and
    lanes do not fit each other.
    """
    _at_least(1, around=around)
    _named(split=split)
    return lift_to(drive, out, split, Precision.of(precision or {}), around, progress)


@checked
def validate_dataset(
    place: str | Path,
    *,
    workers: int = 0,
    limit: int | None = None,
    rerender: int = 0,
    assets: Library = BUILT_IN,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> "synth3dlanes.validate.report.ValidationReport":
    """Check every file and sample of a data set or a split, and compare its labels with its images (docs/validate.md).

    `limit` checks only the first samples of every split. `rerender` is the number of samples that are made again and
    compared with those in the data set. `workers` is the number of processes, 0 for one per core. `problems` of the
    result has a line for each fault, and PLACE/validation a picture of each sample that failed. Raises InputError where
    there is no data set, and where samples cannot be made again on this machine.
    """
    from synth3dlanes.validate.run import validate

    _within(0, MAX_WORKERS, workers=workers)
    return validate(place, workers, limit, progress, rerender, assets)


@checked
def dataset_stats(
    source: str | Path | Params, *, n: int = 2000, seed: int = 0, assets: Library = BUILT_IN
) -> "synth3dlanes.figures.stats.Statistics":
    """Compute statistics of at most `n` samples, evenly spaced, of a data set or a split: of their scenes, if they have
    any, and their labels. Given parameters, draw `n` scenes and compute statistics of these, without labels.

    `document()` of the result returns JSON values.
    """
    from synth3dlanes.figures.stats import NO_SCENES, Statistics, label_statistics, scene_statistics

    _at_least(1, n=n)
    if isinstance(source, Params):
        scenes = Scenes(source, seed, assets=assets.assets)
        return Statistics(scene_statistics((_sample_scene(scenes, index) for index in range(n)), source))
    found = readers(str(source))
    labels = label_statistics(reader.labels(i) for reader, i in evenly_spaced(found, n))
    if is_lifted(found[0].description):
        return Statistics(NO_SCENES, labels)
    origin = provenance_of(found[0])
    shown = (read_scene(reader, i) for reader, i in evenly_spaced(found, n, is_once_a_scene=True))
    return Statistics(scene_statistics(shown, origin.params, bool(origin.shots.cameras)), labels)


@checked
def report_dataset(place: str | Path, path: str | Path, *, n: int = 2000, samples: int = 12) -> None:
    """Write an HTML page about a data set or a split: `samples` samples with their lanes, and statistics of at most `n`
    scenes. The page is one file and loads no other."""
    from synth3dlanes.figures.page import report_page

    _at_least(1, samples=samples)
    _file(path=path)
    stats, found = dataset_stats(place, n=n), readers(str(place))
    assert stats.labels is not None, "a data set has labels"
    shown = [
        (
            f"{split_name(reader)}:{reader.key(i)}",
            None if is_lifted(reader.description) else read_scene(reader, i),
            reader.labels(i),
            reader.image(i),
        )
        for reader, i in evenly_spaced(found, samples)
    ]
    write(Path(path), report_page(data_set_name(found[0]), shown, stats.scenes, stats.labels).encode())


def _shots(camera: CameraSpec | None, rig: Sequence[CameraSpec], frames: int, fps: float) -> Shots:
    if camera is not None and rig:
        raise InputError("camera: expected none beside a rig")
    return clips(frames, fps, tuple(rig) if camera is None else (camera,))


def _map_place(file: str | Path | None, at: str) -> MapPlace | None:
    if file is not None:
        return place_on_map(Path(file), at)
    if at:
        raise InputError(f"at: expected none without a map, got {at!r}")
    return None


def _at_least(least: int, **arguments: int) -> None:
    for name, value in arguments.items():
        if value < least:
            raise InputError(f"{name}: expected {least} or more, got {value}")


def _file(**arguments: str | Path) -> None:
    for name, value in arguments.items():
        if not Path(value).name:
            raise InputError(f"{name}: expected the path of a file, got {shown(str(value))}")


def _named(**arguments: str) -> None:
    for name, value in arguments.items():
        if re.fullmatch(SPLIT_NAME, value) is None:
            raise InputError(f"{name}: expected letters, digits, - and _, got {shown(value)}")


def _within(least: int, most: int, **arguments: int) -> None:
    for name, value in arguments.items():
        if not least <= value <= most:
            raise InputError(f"{name}: expected {least} to {most}, got {value}")
