"""The self-check of a COCO export: the masks of the instances must be those of the panoptic PNGs, every pixel of which
must have its segment."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
from pydantic import Field

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.coco.convention import STUFF_IDS, segments_of
from synth3dlanes.formats.reading import MOST_BYTES, image_size, read_file, read_mask
from synth3dlanes.formats.self_check import Verification
from synth3dlanes.schema import MAX_PX, Excerpt, PathBelow, parse

MOVED = 1 / 8  # of the image's width


class _Image(Excerpt):
    id: int
    file_name: PathBelow


class _Segment(Excerpt):
    id: int
    category_id: int
    area: int


class _Frame(Excerpt):
    image_id: int
    file_name: PathBelow
    segments_info: list[_Segment]


class _Panoptic(Excerpt):
    images: list[_Image]
    annotations: list[_Frame]


class _Runs(Excerpt):
    size: tuple[int, int]
    counts: list[Annotated[int, Field(ge=0, le=MAX_PX**2)]]


class _Instance(Excerpt):
    id: int
    image_id: int
    segmentation: _Runs


class _Instances(Excerpt):
    annotations: list[_Instance]


Document = TypeVar("Document", _Panoptic, _Instances)


def _read(model: type[Document], path: Path) -> Document:
    return parse(model, read_file(path), str(path), "annotations of COCO", MOST_BYTES)


def verify(out: Path, most_frames: int) -> Iterator[Verification]:
    """The frames of every part."""
    for path in sorted((out / "annotations").glob("panoptic_*.json")):
        part = path.stem.removeprefix("panoptic_")
        panoptic = _read(_Panoptic, path)
        with_instances = _read(_Instances, path.with_name(f"instances_{part}.json"))
        files = {image.id: image.file_name for image in panoptic.images}
        instances: dict[int, list[_Instance]] = {}
        for instance in with_instances.annotations:
            instances.setdefault(instance.image_id, []).append(instance)
        problems, overlaps, moved, n_things = list[str](), list[float](), list[float](), 0
        for frame in panoptic.annotations[:most_frames]:
            where, things = out / "panoptic" / frame.file_name, instances.get(frame.image_id, [])
            n_things += len(things)
            if frame.image_id not in files:
                raise FormatError(f"{path}: expected an image {frame.image_id}, got none")
            size_px = image_size(out / "images" / files[frame.image_id])
            segments = segments_of(read_mask(where, size_px, "RGB"))
            problems += _problems(str(where), segments, frame.segments_info)
            of_things = [info for info in frame.segments_info if info.category_id not in STUFF_IDS]
            if len(of_things) != len(things):
                problems.append(f"{where}: expected {len(of_things)} instances as segments, got {len(things)}")
            for info, thing in zip(of_things, things, strict=False):
                mask = _decoded(thing.segmentation, size_px)
                if mask is None:
                    problems.append(f"{where}: expected run lengths of an image of {size_px}, got others")
                    continue
                overlaps.append(_overlap(mask, segments == info.id))
                aside = np.roll(mask, round(MOVED * mask.shape[1]), axis=1)
                moved.append(_overlap(aside, segments == info.id))
        perfect, shifted = float(np.mean(overlaps or [1.0])), float(np.mean(moved or [0.0]))
        if perfect < 1:
            problems.append(f"{part}: expected instances to be panoptic segments, got a mean overlap of {perfect:.4f}")
        numbers = Counter(instance.id for instance in with_instances.annotations)
        if 0 in numbers or any(count > 1 for count in numbers.values()):
            problems.append(f"{part}: expected instances with ids of their own from 1 on, got others")
        n_frames = len(panoptic.annotations[:most_frames])
        yield Verification(part, n_frames, n_things, {"overlap": perfect}, {"overlap": shifted}, tuple(problems))


def _problems(where: str, segments: np.ndarray, infos: list[_Segment]) -> Iterator[str]:
    ids, areas = np.unique(segments, return_counts=True)
    found, listed = dict(zip(ids.tolist(), areas.tolist(), strict=True)), {info.id: info.area for info in infos}
    if found != listed:
        yield f"{where}: expected the segments and areas of its annotation, got others"


def _decoded(runs: _Runs, size_px: tuple[int, int]) -> np.ndarray | None:
    """The mask of run lengths; None where they are not those of an image of this size."""
    width_px, height_px = size_px
    if runs.size != (height_px, width_px) or sum(runs.counts) != height_px * width_px:
        return None
    values = np.arange(len(runs.counts)) % 2 == 1
    return np.repeat(values, runs.counts).reshape(height_px, width_px, order="F")


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.count_nonzero(a & b) / max(1, np.count_nonzero(a | b)))
