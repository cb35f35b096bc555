"""Validate a dataset: shards, then samples, in parallel. Results have constant size per sample."""

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Shaped

from synth3dlanes.dataset.address import connect, splits_near, translate_store_errors
from synth3dlanes.dataset.description import (
    DESCRIPTION,
    Description,
    is_lifted,
    numbers_of_lifted,
    parse_description,
    pictures_per_scene,
    recipe_text,
)
from synth3dlanes.dataset.format import SCENE
from synth3dlanes.dataset.listing import data_set_of, inner_data_sets, outer_data_sets
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.params.cameras import black_pictures
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Library
from synth3dlanes.scene.host import HostCamera
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import Passes
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.processes import n_workers, process_pool
from synth3dlanes.validate.checks import CHECKS
from synth3dlanes.validate.contents import read_contents
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Finding, Own, Problem, Result, findings_of, some
from synth3dlanes.validate.integrity import Entry, check_companions, check_presence, check_shard, read_sample
from synth3dlanes.validate.labels import check_shape
from synth3dlanes.validate.made_again import how_to_make, make_again, some_of
from synth3dlanes.validate.origin import Origin, drawn_otherwise, made_otherwise, read_origin
from synth3dlanes.validate.report import Lacks, ValidationReport, draw, remove_pictures, save_picture
from synth3dlanes.world import height_map
from synth3dlanes.world.world import resolve

# Exceptions of geometry computed from invalid scenes or labels. Samples of a correct data set raise none.
NO_GEOMETRY = (
    ArithmeticError, AssertionError, LookupError, MemoryError, RuntimeError, RuntimeWarning, StopIteration, ValueError
)  # fmt: skip

# Number of samples that are checked in the time that another process takes to start.
SAMPLES_A_START = 8

Map = Callable[..., Iterator[Any]]


class SampleCheck(NamedTuple):
    """The results of one sample. `redrawn` says how the scene differs from the one that dataset.json draws ("" if it
    does not), `lacks` which parts of evidence each check lacked; None where no check was asked."""

    name: str
    redrawn: str
    results: Sequence[Result]
    lacks: Lacks = None


def validate(
    place: str | Path,
    workers: int,
    limit: int | None,
    progress: Callable[[int, int], None],
    rerender: int = 0,
    library: Library = BUILT_IN,
) -> ValidationReport:
    """Check all shards of a dataset or of one split (a folder or a URL) and its samples, or the first `limit` samples
    of every split.

    Writes an overlay picture of each sample that fails to PLACE/validation. `progress` is called with (samples done,
    total). `rerender` samples, chosen at random, are made again and compared, with the `library` that they were made
    with. Raises InputError if there is no folder at `place` or it cannot be made again by this version or library,
    FormatError if its store cannot be read, MissingPackageError without Blender to make samples again.
    """
    place, only = _data_set(str(place).rstrip("/"))
    report = ValidationReport()
    try:
        document = _read_description(place)
        description = Description.model_validate(document)
    except FormatError as error:
        lines = [line.removeprefix(f"{DESCRIPTION}: ") for line in str(error).splitlines()]
        report.problems.append(Problem(DESCRIPTION, "", some(lines)))
        return report
    nested = [*outer_data_sets(place), *inner_data_sets(place, description.splits)]
    report.problems += [Problem(DESCRIPTION, "", line) for line in nested]
    try:
        origin = None if is_lifted(document) else read_origin(document)
    except FormatError as error:
        report.problems.append(Problem(DESCRIPTION, "", str(error)))
        origin = None
    report.notes += black_pictures(origin.shots.cameras) if origin else []
    if rerender and is_lifted(document):
        raise InputError(f"rerender: expected a data set of scenes, got one lifted from a drive: {place}")
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
            report.sample(checked.name, checked.results, checked.lacks)
            redrawn |= {checked.name: checked.redrawn} if checked.redrawn else {}
            progress(done, total)
    if making is not None:
        for done, again in enumerate(make_again(making, chosen, workers), start=len(todo) + 1):
            report.made_again[again.name] = again.verdict
            report.problems += [Problem(again.name, "", fault) for fault in again.faults]
            progress(done, total)
    recipe = recipe_text(document)
    origins = [
        *made_otherwise(recipes, recipe),
        *drawn_otherwise(redrawn, len(todo), description.generator, recipes, recipe),
    ]
    report.problems[:0] = [*origins, *check_companions(place, document)]
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
    place: str, only: str, run: Map, description: Description, report: ValidationReport
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


def check_sample(place: str, origin: Origin | None, description: Description, entry: Entry) -> SampleCheck:
    """All results of one sample; saves its picture if there are findings. Without `origin` its scene is not drawn
    again."""
    members, fault = read_sample(entry)
    (scene, labels, image, passes, sweep), unread = read_contents(members)
    results: list[Result] = [*([Finding("", fault)] if fault else []), *unread]
    redrawn = "" if scene is None or origin is None else origin.fault(scene, entry.split, entry.index)
    if scene is not None:
        # The digest of its world, without the seed and index that it was drawn for.
        document = scene.model_dump_json(exclude={"seed", "split", "index"})
        results.append(Own("scene", hashlib.sha256(document.encode()).hexdigest()))
    if labels is None or image is None or passes is None or (scene is None and SCENE in description.names):
        return SampleCheck(entry.name, redrawn, results)
    if scene is not None:
        digest = hashlib.sha256(image.tobytes()).hexdigest()
        results.append(Own("picture", digest, at=str(labels.camera.world_from_cam.tolist())))
    camera = labels.camera if scene is None else scene.camera
    lacks: Lacks = None
    misshapen = [*_sizes({"image": image}, camera), *check_shape(labels, scene)]
    misshapen += [] if scene is None else _passes(scene, description, passes)
    results += misshapen
    if not misshapen:
        world = None if scene is None else resolve(scene)
        numbers = None if scene else numbers_of_lifted(pictures_per_scene(description.model_dump()), entry.index)
        evidence = Evidence(world, labels, image, passes, sweep, entry, numbers)
        results += _examine(evidence)
        lacks = {check.name: check.needs - evidence.has for check in CHECKS}
    if findings_of(results):
        save_picture(place, entry.name.replace(":", "-"), image if misshapen else draw(image, labels))
    return SampleCheck(entry.name, redrawn, results, lacks)


def _examine(evidence: Evidence) -> list[Result]:
    """The results of every check. A scene without valid geometry, or a check that fails with an error, is a finding."""
    try:
        if "scene" in evidence.has:
            evidence.truth, evidence.paint  # noqa: B018 - computed here, so that no check is blamed for them
    except NO_GEOMETRY as error:
        found = f"{type(error).__name__} {error}"
        return [Finding("", f"{SCENE}: expected a world whose lanes can be computed, got {found}")]
    results: list[Result] = []
    for check in CHECKS:
        if check.needs <= evidence.has:
            try:
                results += list(check.of(evidence))
            except NO_GEOMETRY as error:
                results.append(Finding("", f"{check.name}: the check failed with {type(error).__name__}: {error}"))
    return results


def _sizes(pictures: Mapping[str, Shaped[np.ndarray, "h w *c"]], camera: HostCamera | CameraLabel) -> Iterator[Finding]:
    """Findings for pictures that do not have the camera's size."""
    for name, pixels in pictures.items():
        rows, columns = height_map.SHAPE if name == "height" else (camera.height_px, camera.width_px)
        if pixels.shape[:2] != (rows, columns):
            found = "x".join(str(size) for size in pixels.shape[1::-1])
            yield Finding("", f"{name}: expected {columns}x{rows} pixels, got {found}")


def _passes(scene: Scene, description: Description, passes: Passes) -> Iterator[Finding]:
    """Findings if passes differ from those in dataset.json, or do not have the camera's size."""
    expected = [name for name in description.render.passes if name != "lidar"]
    if set(passes) != set(expected):
        yield Finding("", f"passes: expected {', '.join(expected) or 'none'}, got {', '.join(passes) or 'none'}")
    yield from _sizes(passes, scene.camera)


@contextmanager
def _mapping(workers: int, n: int) -> Iterator[Map]:
    """`map` in this process or in several, with results in order. 0 workers: as many as `n` samples make worth it,
    at most one per core."""
    workers = n_workers(workers, math.ceil(n / SAMPLES_A_START))
    if workers == 1:
        yield map
        return
    with process_pool(workers) as pool:
        yield partial(pool.map, chunksize=4)
