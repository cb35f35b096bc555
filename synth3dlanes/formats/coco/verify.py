"""Read a COCO export back and compare it with the passes of our samples."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
from jaxtyping import Shaped
from pydantic import Field

from synth3dlanes.formats.comparing import Comparison, SourceSample
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.reading import MOST_BYTES, image_size, read_file, read_mask
from synth3dlanes.formats.segments import STUFF, PixelNumbers, compare_masks, most_shared, things
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import Row3, Row4
from synth3dlanes.system.schema import MAX_PX, Excerpt, PathBelow, parse


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


class _Lane(Excerpt):
    id: str


class _Object(Excerpt):
    id: int
    category: str
    size_m: Row3
    center_cam: Row3
    rotation_wxyz: Row4


class _Instance(Excerpt):
    id: int
    image_id: int
    category_id: int
    segmentation: _Runs
    lane: _Lane | None = None
    object: _Object | None = None


class _Instances(Excerpt):
    annotations: list[_Instance]


# Boxes are rounded as in the labels.
BOX_M = 2e-4

Document = TypeVar("Document", _Panoptic, _Instances)


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """The frames of every part."""
    for path in sorted((out / "annotations").glob("panoptic_*.json")):
        yield FrameList(path.stem.removeprefix("panoptic_"), _frames(out, path, most_frames))


def _frames(out: Path, path: Path, most_frames: int) -> Iterator[ReadFrame]:
    panoptic, beside = _parsed(_Panoptic, path), path.with_name(path.name.replace("panoptic", "instances", 1))
    instances = _parsed(_Instances, beside).annotations
    if any(count > 1 or number < 1 for number, count in Counter(instance.id for instance in instances).items()):
        raise FormatError(f"{beside}: expected instances with ids of their own from 1 on, got others")
    files = {image.id: image.file_name for image in panoptic.images}
    for frame in panoptic.annotations[:most_frames]:
        if frame.image_id not in files:
            raise FormatError(f"{path}: expected an image {frame.image_id}, got none")
        image, file = f"images/{files[frame.image_id]}", f"panoptic/{frame.file_name}"
        pixels = read_mask(out / file, image_size(out / image), "RGB").astype(np.int64) @ np.array([1, 256, 65536])
        mine = [instance for instance in instances if instance.image_id == frame.image_id]
        yield ReadFrame(image, str(out / file), image, (frame.segments_info, pixels, mine))


def _parsed(model: type[Document], path: Path) -> Document:
    return parse(model, read_file(path), str(path), "annotations of COCO", MOST_BYTES)


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """The mask of each instance, and the segment of each pixel."""
    infos, pixels, instances = frame.content
    ours, classes = things(truth), {number + 1: name for name, number in SEMANTIC_IDS.items()}
    found, problems = dict[str, PixelNumbers](), list[str]()
    for instance in instances:
        mask = _decoded(instance.segmentation, pixels.shape)
        if mask is None or not len(mask):
            problems.append(f"instance {instance.id}: expected run lengths of pixels of this image, got others")
            continue
        of_class = classes.get(instance.category_id)
        alike = {name: thing.mask for name, thing in ours.items() if thing.of_class == of_class and name not in found}
        own = instance.lane.id if instance.lane else most_shared(mask, alike, pixels.shape)
        name = own or f"instance {instance.id} of category {instance.category_id}"
        if name in found:
            problems.append(f"instance {instance.id}: expected one of {name}, got another")
        elif name in ours and ours[name].of_class != of_class:
            expected = SEMANTIC_IDS[ours[name].of_class] + 1
            problems.append(f"{name}: expected the category {expected}, got {instance.category_id}")
        found[name] = mask
    problems += _object_problems(instances, truth)
    compared = compare_masks(found, {name: thing.mask for name, thing in ours.items()}, pixels.shape)
    return compared.because([*problems, *_segment_problems(infos, pixels, truth)])


def _object_problems(instances: list[_Instance], truth: SourceSample) -> Iterator[str]:
    """Findings unless each car has the 3D box of the object whose pixels it has."""
    boxes = {item.id: item for item in truth.labels.objects or ()}
    ids = truth.passes["instance"]
    for instance in instances:
        mask = _decoded(instance.segmentation, (ids.shape[0], ids.shape[1]))
        if instance.category_id != SEMANTIC_IDS["car"] + 1 or mask is None or not len(mask):
            continue
        own = boxes.get(int(np.bincount(ids.ravel()[mask].astype(int)).argmax()))
        if own is None or instance.object is None:
            if own is not None:
                yield f"instance {instance.id}: expected the 3D box of {own.category} {own.id}, got none"
            continue
        box = instance.object
        found, expected = (np.concatenate([item.size_m, item.center_cam, item.rotation_wxyz]) for item in (box, own))
        if (box.id, box.category) != (own.id, own.category) or not np.abs(found - expected).max() <= BOX_M:
            yield f"instance {instance.id}: expected the 3D box of {own.category} {own.id}, got another"


def _segment_problems(infos: list[_Segment], pixels: Shaped[np.ndarray, "h w"], truth: SourceSample) -> Iterator[str]:
    """Findings unless segments and objects divide the picture in the same way, and categories and areas are theirs."""
    semantic, instance = (truth.passes[name].astype(np.int64) for name in ("semantic", "instance"))
    is_stuff = np.isin(semantic, [SEMANTIC_IDS[name] for name in STUFF])
    ours = semantic << 32 | np.where(is_stuff, 0, instance)
    of_theirs, of_ours = (np.unique(x, return_inverse=True)[1].ravel() for x in (pixels, ours))
    n_ours = int(of_ours.max()) + 1
    # As one number each: sorted by rows, they take ten times as long.
    numbers, counts = np.unique(of_theirs * n_ours + of_ours, return_counts=True)
    pairs = np.column_stack(np.divmod(numbers, n_ours))
    n_same = sum(counts[pairs[:, 0] == k].max() for k in np.unique(pairs[:, 0]))
    if len(pairs) != len(np.unique(pairs[:, 0])) or len(pairs) != len(np.unique(pairs[:, 1])):
        yield f"expected the segments to be the objects of the passes, got {pixels.size - n_same} pixels of others"
    ids, areas = np.unique(pixels, return_counts=True)
    if dict(zip(ids.tolist(), areas.tolist(), strict=True)) != {info.id: info.area for info in infos}:
        yield "expected the segments and areas of its annotation, got others"
    for info in infos:
        classes = np.unique(semantic[pixels == info.id])
        if len(classes) == 1 and classes[0] + 1 != info.category_id:
            yield f"segment {info.id}: expected the category {classes[0] + 1}, got {info.category_id}"


def _decoded(runs: _Runs, shape: tuple[int, int]) -> PixelNumbers | None:
    """The mask of run lengths, which go down the columns; None where they are not those of an image of this size."""
    if runs.size != shape or sum(runs.counts) != shape[0] * shape[1]:
        return None
    values = np.arange(len(runs.counts)) % 2 == 1
    return np.flatnonzero(np.repeat(values, runs.counts).reshape(shape, order="F"))
