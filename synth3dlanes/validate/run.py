"""Validate a dataset: shards, then samples, in parallel; what comes back is of constant size per sample."""

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Shaped, UInt8
from PIL import Image

from synth3dlanes import labels as labels_module
from synth3dlanes import scene as scene_module
from synth3dlanes.dataset.folder import read_description
from synth3dlanes.dataset.format import HEIGHT, LABELS, PASSES, SCENE, decode_image, member_names, read_passes
from synth3dlanes.errors import FormatError, ParamsError
from synth3dlanes.figures.overlay import draw_overlay
from synth3dlanes.geometry import height_map
from synth3dlanes.scene import Scene
from synth3dlanes.validate.findings import Finding, Measure, Problem
from synth3dlanes.validate.frame import check_frame
from synth3dlanes.validate.image_proof import prove_image
from synth3dlanes.validate.integrity import Entry, check_presence, check_shard, read_sample
from synth3dlanes.validate.obstacles import check_objects
from synth3dlanes.validate.paint import Paint
from synth3dlanes.validate.passes_proof import Passes, prove_passes
from synth3dlanes.validate.report import Report
from synth3dlanes.validate.standing import check_standing
from synth3dlanes.validate.structure import check_shape, check_values

PICTURES = "validation"

Map = Callable[..., Iterator[Any]]


class Checked(NamedTuple):
    """What one sample's check found; `digest` is of its world, whatever split, seed and index it was drawn for."""

    name: str
    digest: str
    findings: list[Finding]
    measures: list[Measure]


def validate(root: Path, workers: int, limit: int | None, progress: Callable[[int, int], None]) -> Report:
    """Check all shards of a dataset and its samples, or the first `limit` samples of every split.

    Writes an overlay picture of each sample that fails to ROOT/validation. `progress` gets (samples done, in all).
    """
    if not root.is_dir():
        raise ParamsError(f"{root}: expected the folder of a dataset, got none")
    report = Report()
    try:
        description = read_description(root)
        passes = tuple(description["render"]["passes"])
        names = member_names(description["image_format"], passes)
        splits = {split: int(value["n"]) for split, value in description["splits"].items()}
        shard_size = int(description["shard_size"])
        # Where samples were dealt anew or varied, scene.json names the data set that they came from.
        seed = None if "derived" in description else int(description["seed"])
    except FormatError as error:
        report.problems.append(Problem("", "", str(error)))
        return report
    except (KeyError, TypeError, ValueError) as error:
        report.problems.append(
            Problem(f"{root / 'dataset.json'}", "", f"expected a dataset's description, got no {error}")
        )
        return report
    for picture in (root / PICTURES).glob("*.png"):
        picture.unlink()
    with _mapping(workers) as run:
        entries = _check_shards(root, run, names, shard_size, splits, report)
        todo = [entry for split in entries.values() for entry in split[:limit]]
        progress(0, len(todo))
        for done, checked in enumerate(run(partial(check_sample, root, seed, passes), todo), start=1):
            report.sample(checked.name, checked.digest, checked.findings, checked.measures)
            progress(done, len(todo))
    return report


def _check_shards(
    root: Path, run: Map, names: Sequence[str], shard_size: int, splits: dict[str, int], report: Report
) -> dict[str, list[Entry]]:
    """The readable samples of every split, in order."""
    parquets = sorted(
        {path.with_suffix(".parquet") for kind in ("tar", "parquet") for path in root.glob(f"*/*.{kind}")}
    )
    entries: dict[str, list[Entry]] = {split: [] for split in splits}
    indices: dict[str, set[int]] = {split: set() for split in splits}
    check = partial(check_shard, names=names, shard_size=shard_size)
    for parquet, shard in zip(parquets, run(check, parquets), strict=True):
        split = parquet.parent.name
        report.problems += shard.problems
        entries.setdefault(split, []).extend(shard.entries)
        indices.setdefault(split, set()).update(shard.indices)
    for split, found in indices.items():
        report.problems += check_presence(split, splits.get(split, 0), found)
    return entries


def check_sample(root: Path, seed: int | None, pass_names: tuple[str, ...], entry: Entry) -> Checked:
    """All faults of one sample; leaves its picture where it has any. Without a seed, it may come from anywhere."""
    members, fault = read_sample(entry)
    findings = [Finding("", fault)] if fault else []
    measures: list[Measure] = []
    digest = ""
    try:
        scene = scene_module.from_json(members[SCENE], SCENE)
        digest = world_digest(scene)
        findings += [] if seed is None else _origin(scene, entry, seed)
        labels = labels_module.from_json(members[LABELS], LABELS)
        image = decode_image(next(iter(members.values())), next(iter(members)))
        passes: dict[str, Shaped[np.ndarray, ...]] = {}
        for name in members.keys() & {PASSES, HEIGHT}:
            passes |= read_passes(members[name], name)
    except FormatError as error:
        return Checked(entry.name, digest, [*findings, Finding("", str(error))], measures)
    misshapen = [*_pictures(scene, pass_names, image, passes), *check_shape(scene, labels)]
    if not misshapen:
        findings += [*check_values(scene, labels), *check_objects(scene, labels)]
        paint = Paint(scene)
        for found, measured in (
            prove_passes(paint, labels, passes),
            prove_image(paint, labels, image),
            check_frame(image, passes),
            check_standing(scene, labels, passes),
        ):
            findings += found
            measures += measured
    findings += misshapen
    if findings:
        folder = root / PICTURES
        folder.mkdir(exist_ok=True)
        picture = Image.fromarray(image if misshapen else draw_overlay(image, labels))
        picture.save(folder / f"{entry.name.replace(':', '-')}.png")
    return Checked(entry.name, digest, findings, measures)


def world_digest(scene: Scene) -> str:
    """The same for scenes that show the same world, whatever they were drawn for."""
    document = scene.model_dump_json(exclude={"seed", "split", "index"})
    return hashlib.sha256(document.encode()).hexdigest()


def _origin(scene: Scene, entry: Entry, seed: int) -> Iterator[Finding]:
    found = {"index": scene.index, "split": scene.split, "seed": scene.seed}
    for name, expected in {"index": entry.index, "split": entry.split, "seed": seed}.items():
        if found[name] != expected:
            yield Finding("", f"{SCENE}: {name}: expected {expected}, got {found[name]}")


def _pictures(
    scene: Scene, pass_names: tuple[str, ...], image: UInt8[np.ndarray, "_ _ 3"], passes: Passes
) -> Iterator[Finding]:
    """Are there the passes that dataset.json names, and have all pictures the camera's size?"""
    if set(passes) != set(pass_names):
        yield Finding("", f"passes: expected {', '.join(pass_names)}, got {', '.join(passes) or 'none'}")
    camera = scene.camera
    for name, pixels in {"image": image, **passes}.items():
        rows, columns = height_map.SHAPE if name == "height" else (camera.height_px, camera.width_px)
        if pixels.shape[:2] != (rows, columns):
            found = "x".join(str(size) for size in pixels.shape[1::-1])
            yield Finding("", f"{name}: expected {columns}x{rows} pixels, got {found}")


@contextmanager
def _mapping(workers: int) -> Iterator[Map]:
    """`map`, in this process or in several (0: one for each core); results come in order."""
    if workers == 1:
        yield map
        return
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    with ProcessPoolExecutor(workers or cores, mp_context=get_context("spawn")) as pool:
        yield partial(pool.map, chunksize=4)
