"""The functions of `import synth3dlanes` (docs/api.md).

No function loads Blender into this process: `generate_dataset` and `render`, in renderer.py, start worker processes for
it.
"""

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synth3dlanes.dataset.description import is_lifted
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import merge as _merge
from synth3dlanes.dataset.rearrange import split_dataset as _split
from synth3dlanes.dataset.scenes import load_scene as _load_scene
from synth3dlanes.dataset.scenes import provenance_of, read_scene
from synth3dlanes.dataset.splits import data_set_name, evenly_spaced, one_reader, readers, split_name
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.draw.sample import sample_scene as _sample_scene
from synth3dlanes.formats.export import Export, ExportSummary
from synth3dlanes.labels.labels import Labels
from synth3dlanes.params.camera_files import load_camera as _load_camera
from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.params import Params
from synth3dlanes.params.params import load_params as _load_params
from synth3dlanes.params.params_text import contradictions
from synth3dlanes.params.rig_files import load_rig as _load_rig
from synth3dlanes.production.events import Event
from synth3dlanes.production.job import Job, make
from synth3dlanes.production.job import load_job as _load_job
from synth3dlanes.production.job import save_job as _save_job
from synth3dlanes.production.tally import RunReport
from synth3dlanes.production.user_assets import open_library
from synth3dlanes.recorded.drives.checks import drive_findings
from synth3dlanes.recorded.drives.drive import Drive
from synth3dlanes.recorded.drives.open import open_drive as _open_drive
from synth3dlanes.recorded.lift.precision import Precision
from synth3dlanes.recorded.lift.write import LiftReport, lift_to
from synth3dlanes.renderer import several
from synth3dlanes.scene import scene as scene_format
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Library
from synth3dlanes.scene.change import change_scene as _change_scene
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import MAX_SEED, N_SCENE_NUMBERS, SPLIT_NAME
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

    Values of your own take precedence over values that follow from weather and time of day; a value that does not fit
    these, such as a high sun at night, issues a Python warning. Raises InputError with a line for every problem.
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
def sample_scene(job: Job | Params | None = None, *, index: int = 0, **fields: Any) -> Scene:
    """Draw the scene of sample `index` of a job's (first) split. Equal arguments give equal scenes.

    In place of a job, its fields may be given, as `sample_scene(params, seed=3, map="town.xodr")`. Raises InputError
    for a wrong argument, and if there is no room for the least number of cars or trees in their ranges; FormatError for
    a map that cannot be read.
    """
    _within(0, N_SCENE_NUMBERS - 1, index=index)
    return _job(job, fields).recipe(_warn).scene(index)


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
    job: Job | Params | None = None,
    out: str | Path | None = None,
    *,
    notify: Callable[[Event], None] | None = None,
    **fields: Any,
) -> RunReport:
    """Make the samples that a job asks for in its folder or at its URL. Samples that are already there are kept.

    In place of a job, its fields may be given, as `generate_dataset(params, "data", n=1000, seed=3)`. `notify` is
    called with every event of the run; `event.message` is a line of text.

    Raises InputError, FormatError, MissingPackageError or DiskFullError if the run cannot start. A later problem does
    not raise: see `problem`, `done` and `asked` of the result.
    """
    asked = _job(job, fields if out is None else {"out": out, **fields})
    return make(asked, notify or (lambda event: None), _warn)


@checked
def load_job(path: str | Path) -> Job:
    """Read a job from a YAML file, or from the `dataset.json` of a data set that `generate` made (docs/jobs.md).

    Raises InputError or FormatError with a line for every problem.
    """
    return _load_job(Path(path))


@checked
def save_job(job: Job, path: str | Path) -> None:
    """Write a job as a YAML file, which `load_job` and `synth3dlanes generate` read."""
    _file(path=path)
    _save_job(job, Path(path))


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
    (width, height) of the images, by default the format's. `cameras` are names of cameras of a rig, by default the
    cameras that look ahead, or all cameras for formats that keep images unchanged. `workers` is the number of
    processes, 0 for one per core. Raises InputError for a wrong argument, and for a format, a size or a camera that
    does not exist. `Export(...).write` does the same and reports its progress.
    """
    return Export(source, out, format_name, size_px, cameras).write(workers)


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
    """Compute statistics of the labels, and of the scenes if there are any, of at most `n` samples of a data set or a
    split, evenly spaced. Given parameters, draw `n` scenes and compute their statistics, without labels.

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


def _job(job: Job | Params | None, fields: dict[str, Any]) -> Job:
    beside = fields.keys() if isinstance(job, Job) else fields.keys() & {"params"} if job is not None else ()
    if beside:
        raise InputError(*(f"{name}: expected none beside job" for name in beside))
    return job if isinstance(job, Job) else Job(**{"params": job, **fields})


def _warn(line: str) -> None:
    warnings.warn(line, stacklevel=4)


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
