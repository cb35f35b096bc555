"""Validate a dataset: shards, then samples, in parallel. Results have constant size per sample."""

import hashlib
import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from synth3dlanes.assets.catalogue import BUILT_IN, Library
from synth3dlanes.dataset.address import connect, splits_near, translate_store_errors
from synth3dlanes.dataset.description import DESCRIPTION, Description, data_set_of, parse_description, recipe_text
from synth3dlanes.dataset.format import SCENE
from synth3dlanes.errors import FormatError, InputError
from synth3dlanes.geometry import height_map
from synth3dlanes.geometry.camera import rays_of_pixels
from synth3dlanes.ground_truth import label
from synth3dlanes.labels import Labels
from synth3dlanes.scene import Scene
from synth3dlanes.sensors.sweep import Sweep
from synth3dlanes.validate.alignment import check_alignment
from synth3dlanes.validate.bodies import may_show_cars
from synth3dlanes.validate.colours import check_colours
from synth3dlanes.validate.contents import read_contents
from synth3dlanes.validate.documents import some
from synth3dlanes.validate.findings import Finding, Measure, Problem, Signed
from synth3dlanes.validate.frame import check_frame
from synth3dlanes.validate.ground_contact import check_ground_contact
from synth3dlanes.validate.hills import check_hills
from synth3dlanes.validate.host import check_host
from synth3dlanes.validate.ids import prove_ids
from synth3dlanes.validate.image_proof import prove_image
from synth3dlanes.validate.integrity import Entry, check_presence, check_row, check_shard, read_sample
from synth3dlanes.validate.lidar import prove_lidar
from synth3dlanes.validate.made_again import how_to_make, make_again, some_of
from synth3dlanes.validate.normals import check_normals
from synth3dlanes.validate.obstacles import check_objects
from synth3dlanes.validate.origin import Origin, drawn_otherwise, made_otherwise, read_origin
from synth3dlanes.validate.paint import Paint
from synth3dlanes.validate.passes_proof import Passes, prove_passes
from synth3dlanes.validate.pavement import prove_pavement
from synth3dlanes.validate.pictures import Picture, draw, remove_pictures, save_picture
from synth3dlanes.validate.report import Report
from synth3dlanes.validate.roadside import check_roadside
from synth3dlanes.validate.sharpness import check_sharpness
from synth3dlanes.validate.signed import signed_values
from synth3dlanes.validate.structure import check_shape, check_values, points_to_pixels
from synth3dlanes.validate.symbols import prove_symbols
from synth3dlanes.world import World, resolve

# Exceptions of geometry computed from invalid scenes or labels. Samples of a correct data set raise none.
NO_GEOMETRY = (
    ArithmeticError, AssertionError, LookupError, MemoryError, RuntimeError, RuntimeWarning, StopIteration, ValueError
)  # fmt: skip

# Another process starts in the time that so many samples take.
SAMPLES_A_START = 8
# Coarser JPEG has no detail of single pixels, nor has dense fog; after civil twilight edges beyond the headlights are
# not seen.
SHARP_JPEG, FOG_M, DARK_RAD = 90, 150.0, 1.68
# Sine of the yaw from which on motion blur runs across the image.
ASIDE = 0.3

Map = Callable[..., Iterator[Any]]


class Proved(NamedTuple):
    """The findings and measured values of one check of a sample."""

    findings: Sequence[Finding] = ()
    measures: Sequence[Measure] = ()
    signed: Sequence[Signed] = ()


class Checked(NamedTuple):
    """The results of one sample. `digest` is that of its world, independent of split, seed and index; `redrawn` says
    how the scene differs from the one that dataset.json draws ("" if it does not)."""

    name: str
    digest: str
    redrawn: str
    findings: Sequence[Finding]
    measures: Sequence[Measure] = ()
    signed: Sequence[Signed] = ()


def validate(
    place: str | Path,
    workers: int,
    limit: int | None,
    progress: Callable[[int, int], None],
    rerender: int = 0,
    library: Library = BUILT_IN,
) -> Report:
    """Check all shards of a dataset or of one split (a folder or a URL) and its samples, or the first `limit` samples
    of every split.

    Writes an overlay picture of each sample that fails to PLACE/validation. `progress` is called with (samples done,
    total). `rerender` samples, chosen at random, are made again and compared, with the `library` that they were made
    with. Raises InputError if there is no folder at `place` or it cannot be made again by this version or library,
    FormatError if its store cannot be read, MissingPackageError without Blender to make samples again.
    """
    place, only = _data_set(str(place).rstrip("/"))
    report = Report()
    try:
        document = _read_description(place)
        description = Description.model_validate(document)
    except FormatError as error:
        lines = [line.removeprefix(f"{DESCRIPTION}: ") for line in str(error).splitlines()]
        report.problems.append(Problem(DESCRIPTION, "", some(lines)))
        return report
    try:
        origin = read_origin(document)
    except FormatError as error:
        report.problems.append(Problem(DESCRIPTION, "", str(error)))
        origin = None
    making = how_to_make(description, origin, library) if rerender else None
    remove_pictures(place)
    n = sum(min(split.n, split.n if limit is None else limit) for split in description.splits.values())
    with _mapping(workers, n) as run:
        entries, recipes = _check_shards(place, only, run, description, report)
        todo = [entry for split in entries.values() for entry in split[:limit]]
        chosen = some_of(todo, rerender, description.seed)
        redrawn: dict[str, str] = {}
        total = len(todo) + len(chosen)
        progress(0, total)
        for done, checked in enumerate(run(partial(check_sample, place, origin, description), todo), start=1):
            report.sample(checked.name, checked.digest, checked.findings, checked.measures, checked.signed)
            redrawn |= {checked.name: checked.redrawn} if checked.redrawn else {}
            progress(done, total)
    if making is not None:
        for done, again in enumerate(make_again(making, chosen, workers), start=len(todo) + 1):
            report.made_again[again.name] = again.verdict
            report.problems += [Problem(again.name, "", fault) for fault in again.faults]
            progress(done, total)
    recipe = recipe_text(document)
    report.problems += made_otherwise(recipes, recipe)
    report.problems += drawn_otherwise(redrawn, len(todo), description.generator, recipes, recipe)
    report.judge()
    return report


def _data_set(place: str) -> tuple[str, str]:
    """The data set that is named, and the one split of it that is, with a slash; "" for all."""
    try:
        root, only = data_set_of(place)
    except FormatError:
        # What is missing there is a problem of the report.
        return place, ""
    return root, f"{only}/" if only else ""


def _read_description(place: str) -> dict[str, Any]:
    """The contents of dataset.json; raise FormatError if it is missing or invalid, InputError if `place` is missing."""
    files, root = connect(place)
    with translate_store_errors(place):
        if not files.isdir(root):
            raise InputError(f"{place}: expected a data set or one of its splits, got no folder{splits_near(place)}")
        if not files.exists(f"{root}/{DESCRIPTION}"):
            raise FormatError("expected the description of a data set, got no file")
        return parse_description(files.cat_file(f"{root}/{DESCRIPTION}"), DESCRIPTION)


def _shards(place: str) -> list[str]:
    """The index paths of all shards, including those whose index is missing."""
    files, root = connect(place)
    with translate_store_errors(place):
        names = [str(path).removeprefix(root).lstrip("/") for path in files.find(root, maxdepth=2)]
    stems = {name.rpartition(".")[0] for name in names if name.count("/") == 1 and name.endswith((".tar", ".parquet"))}
    return [f"{place}/{stem}.parquet" for stem in sorted(stems)]


def _check_shards(
    place: str, only: str, run: Map, description: Description, report: Report
) -> tuple[dict[str, list[Entry]], dict[str, str]]:
    """The readable samples of every split (of one, if it is named), in order, and the recipes of all shards by shard
    name."""
    parquets = [parquet for parquet in _shards(place) if parquet.startswith(f"{place}/{only}")]
    splits = [only.rstrip("/")] if only else list(description.splits)
    entries: dict[str, list[Entry]] = {split: [] for split in splits}
    indices: dict[str, set[int]] = {split: set() for split in splits}
    recipes = {}
    check = partial(check_shard, names=description.names, shard_size=description.shard_size)
    for parquet, shard in zip(parquets, run(check, parquets), strict=True):
        name = parquet.removeprefix(f"{place}/").removesuffix(".parquet")
        split = name.partition("/")[0]
        report.problems += shard.problems
        entries.setdefault(split, []).extend(shard.entries)
        indices.setdefault(split, set()).update(shard.indices)
        recipes[name] = shard.recipe
    for split, found in indices.items():
        n = description.splits[split].n if split in description.splits else 0
        report.problems += check_presence(split, n, found)
    return entries, recipes


def check_sample(place: str, origin: Origin | None, description: Description, entry: Entry) -> Checked:
    """All findings of one sample; saves its picture if there are any. Without `origin` its scene is not drawn again."""
    members, fault = read_sample(entry)
    (scene, labels, image, passes, sweep), unread = read_contents(members)
    findings = [*([Finding("", fault)] if fault else []), *unread]
    digest = "" if scene is None else world_digest(scene)
    redrawn = "" if scene is None or origin is None else origin.fault(scene, entry.split, entry.index)
    if scene is None or labels is None or image is None or passes is None:
        return Checked(entry.name, digest, redrawn, findings)
    misshapen = [*_pictures(scene, description, image, passes), *check_shape(scene, labels)]
    proved = [] if misshapen else list(_prove(entry, resolve(scene), labels, image, passes, sweep))
    findings += [*misshapen, *(finding for proof in proved for finding in proof.findings)]
    if findings:
        save_picture(place, entry.name.replace(":", "-"), image if misshapen else draw(image, labels))
    measures = [measure for proof in proved for measure in proof.measures]
    return Checked(
        entry.name, digest, redrawn, findings, measures, [value for proof in proved for value in proof.signed]
    )


def _prove(
    entry: Entry, world: World, labels: Labels, image: Picture, passes: Passes, sweep: Sweep | None
) -> Iterator[Proved]:
    """Run every check. A scene without valid geometry, or a check that fails with an error, is a finding."""
    try:
        truth, paint = label(world, world.view), Paint(world)
    except NO_GEOMETRY as error:
        found = f"{type(error).__name__} {error}"
        yield Proved([Finding("", f"{SCENE}: expected a world whose lanes can be computed, got {found}")])
        return
    for name, proof in _proofs(entry, paint, truth, labels, image, passes, sweep).items():
        try:
            yield proof()
        except NO_GEOMETRY as error:
            yield Proved([Finding("", f"{name}: the check failed with {type(error).__name__}: {error}")])


def _proofs(
    entry: Entry, paint: Paint, truth: Labels, labels: Labels, image: Picture, passes: Passes, sweep: Sweep | None
) -> dict[str, Callable[[], Proved]]:
    """The checks of a sample by name: first those of index, scene and labels, then those of pixels."""
    world, scene = paint.world, paint.world.scene
    is_lit = scene.light.sun_zenith_rad < DARK_RAD
    is_smeared = scene.sensor.motion_blur_m > 0 and abs(np.sin(scene.camera.yaw_rad)) > ASIDE
    is_sharp = paint.shows and is_lit and not is_smeared
    is_clear = scene.sensor.jpeg_quality >= SHARP_JPEG and scene.air.visibility_m >= FOG_M
    # Clouds are soft, and the back of a van is smooth.
    has_detail = is_clear and any(lane.visible.any() for lane in labels.lanes)
    of_cars = partial(may_show_cars, world, labels.camera, within_m=math.inf)
    proofs = {
        "index": lambda: Proved([*check_row(entry, world.scene, labels)]),
        "labels": lambda: Proved([*check_values(world.scene, truth, labels)]),
        "host": lambda: Proved([*check_host(world, labels)]),
        "object_visible": lambda: Proved([*check_objects(world, labels)]),
        "roadside": lambda: Proved([*check_roadside(world)]),
        "frame": lambda: Proved(*check_frame(image, passes, of_cars)),
        "standing": lambda: Proved(*check_ground_contact(world, labels, passes)),
    }
    if sweep is not None:
        proofs["lidar"] = lambda: Proved(*prove_lidar(world, sweep, passes))
    if not points_to_pixels(labels):
        return proofs
    return proofs | {
        "passes": lambda: Proved(*prove_passes(paint, labels, passes)),
        "image": lambda: Proved(*prove_image(paint, labels, image)),
        "sharpness": lambda: Proved([*check_sharpness(image)] if has_detail else []),
        "colours": lambda: Proved([*check_colours(world, labels.camera, image, passes)]),
        "alignment": lambda: Proved([*check_alignment(image, passes)] if is_sharp else []),
        "pavement": lambda: Proved(*prove_pavement(world, labels, passes)),
        "hills": lambda: Proved([*check_hills(world, labels, passes)]),
        "normals": lambda: Proved([*check_normals(labels.camera, passes)]),
        "ids": lambda: Proved(*prove_ids(paint, labels, passes)),
        "symbols": lambda: Proved([*prove_symbols(world, labels, passes)]),
        # The frames of a clip are alike, and the tests over the data set take samples as independent.
        "bias": lambda: Proved(signed=[*signed_values(paint, labels, image, passes)] if not scene.shot.frame else []),
    }


def world_digest(scene: Scene) -> str:
    """A digest that is equal for scenes of the same world, independent of seed, split and index."""
    document = scene.model_dump_json(exclude={"seed", "split", "index"})
    return hashlib.sha256(document.encode()).hexdigest()


def _pictures(scene: Scene, description: Description, image: Picture, passes: Passes) -> Iterator[Finding]:
    """Findings if passes differ from those in dataset.json, or a picture does not have the camera's size."""
    expected = [name for name in description.render.passes if name != "lidar"]
    if set(passes) != set(expected):
        names = ", ".join(expected)
        yield Finding("", f"passes: expected {names or 'none'}, got {', '.join(passes) or 'none'}")
    camera = scene.camera
    for name, pixels in {"image": image, **passes}.items():
        rows, columns = height_map.SHAPE if name == "height" else (camera.height_px, camera.width_px)
        if pixels.shape[:2] != (rows, columns):
            found = "x".join(str(size) for size in pixels.shape[1::-1])
            yield Finding("", f"{name}: expected {columns}x{rows} pixels, got {found}")
        elif name == "depth" and (pixels < 0).any():
            wrong = int(((pixels < 0) & ~(rays_of_pixels(camera)[..., 1] < 0)).sum())
            if wrong:
                yield Finding("", f"depth: expected distances or infinity, got another at {wrong} places")


@contextmanager
def _mapping(workers: int, n: int) -> Iterator[Map]:
    """`map` in this process or in several (0: as many as `n` samples are worth, at most one per core); results are in
    order."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    workers = workers or min(cores, math.ceil(n / SAMPLES_A_START))
    if workers <= 1:
        yield map
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield partial(pool.map, chunksize=4)
