"""COCO: panoptic segments as PNG and JSON, instances as JSON with run lengths.

| theirs | ours | unit |
|---|---|---|
| `category_id` | the semantic id + 1 | |
| panoptic `id`, R + 256 G + 65536 B of a pixel | category + 32 times the instance id, of things | |
| `segmentation`: run lengths down the columns | the pixels of an instance | px |
| `lane`, `object` | id, marking and colour of a line; class and 3D box of a car | m, camera |
"""

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from jaxtyping import Int, Shaped, UInt8
from pydantic import Field

from synth3dlanes.formats.comparing import Comparison, SourceSample
from synth3dlanes.formats.format import FrameList, ReadFrame, SampleFormat, SampleFrame
from synth3dlanes.formats.reading import MOST_BYTES, image_size, read_file, read_mask
from synth3dlanes.formats.segments import (
    LIMIT_PX,
    PASSES,
    PixelNumbers,
    compare_masks,
    file_name,
    image_path,
    masked_objects,
    most_shared,
    png,
)
from synth3dlanes.formats.writing import FrameAnnotation
from synth3dlanes.labels.labels import Lane
from synth3dlanes.labels.object_labels import ObjectLabel, object_document
from synth3dlanes.scene.instance_ids import thing_of
from synth3dlanes.scene.things import BOXED, SEMANTIC_IDS, STUFF
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import Row3, Row4
from synth3dlanes.system.schema import MAX_PX, Excerpt, PathBelow, parse

CLASSES_AT_MOST = 32  # segment ids are instance * 32 + category


# A category is the semantic id + 1: 0 would be none.
CATEGORIES = [
    {"id": number + 1, "name": name, "supercategory": name, "isthing": int(name not in STUFF)}
    for name, number in SEMANTIC_IDS.items()
]
STUFF_IDS = {SEMANTIC_IDS[name] + 1 for name in STUFF}


def segment_id(semantic: Shaped[np.ndarray, "h w"], instance: Shaped[np.ndarray, "h w"]) -> Shaped[np.ndarray, "h w"]:
    """The segment of every pixel: pixels of one class and one instance."""
    is_thing = ~np.isin(semantic + 1, list(STUFF_IDS))
    return np.where(is_thing, instance.astype(np.int64), 0) * CLASSES_AT_MOST + semantic + 1


def rgb_of(segments: Shaped[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 3"]:
    """Segment ids as the colours of a panoptic PNG: R + 256 G + 65536 B."""
    return np.stack([segments >> shift & 255 for shift in (0, 8, 16)], axis=-1).astype(np.uint8)


# Boxes are rounded as in the labels.
BOX_M = 2e-4

README = """COCO layout.

- `images/*`: as in the data set. `annotations/instances_{train,val,test}.json`: things with masks as run lengths
  (`counts` is a list). `annotations/panoptic_{train,val,test}.json` with `panoptic/*.png`: every pixel's segment,
  R + 256 G + 65536 B.
- Category ids are the semantic ids of the data set plus 1 (COCO's begin with 1). Sky, terrain, road and shoulder are
  stuff, all others are things: each lane line, car, tree, symbol and structure is one.
- A lane line's paint is one instance, with all its dashes. `lane` has the line's id in the labels, its `marking` and
  its `color`; lines that begin more than 110 m ahead have none. There are no crowds.
- Cars, people, riders and road works have the key `object` with their 3D box: `id`, `category`, `size_m`,
  `center_cam` and `rotation_wxyz` as in the labels of the data set (camera frame: x right, y along the viewing
  direction, z up).
"""


def write(frame: SampleFrame) -> FrameAnnotation:
    name, image = file_name(frame), image_path(frame)
    height_px, width_px = frame.passes["semantic"].shape
    segments = segment_id(frame.passes["semantic"], frame.passes["instance"])
    down = segments.ravel(order="F")
    ids, areas = np.unique(down, return_counts=True)
    places = np.split(np.argsort(down, kind="stable"), np.cumsum(areas)[:-1])
    delimiters = [lane for lane in frame.labels.lanes if lane.kind == "delimiter"]
    boxes = {item.id: {"object": box_3d(item)} for item in frame.labels.objects or ()}
    infos, instances = [], []
    for segment, at in zip(ids.tolist(), places, strict=True):
        category = segment % CLASSES_AT_MOST
        info = {"category_id": category, "area": len(at), "bbox": _box(at, height_px), "iscrowd": 0}
        infos.append({"id": segment, **info})
        if category not in STUFF_IDS:
            more = _lane(delimiters, segment // CLASSES_AT_MOST) | boxes.get(segment // CLASSES_AT_MOST, {})
            runs = {"size": [height_px, width_px], "counts": run_lengths(at, down.size)}
            instances.append({"image_id": frame.number, **info, "segmentation": runs, **more})
    about = {"id": frame.number, "file_name": image.removeprefix("images/"), "width": width_px, "height": height_px}
    panoptic = {"image_id": frame.number, "file_name": f"{name}.png", "segments_info": infos}
    parts = frame.served
    return FrameAnnotation(
        image,
        len(instances),
        files={f"panoptic/{name}.png": png(rgb_of(segments))},
        shared=tuple(
            (json.dumps([about, found]), tuple(f"annotations/{kind}_{part}.json" for part in parts))
            for kind, found in (("instances", instances), ("panoptic", [panoptic]))
        ),
    )


def box_3d(item: ObjectLabel) -> dict[str, Any]:
    """The keys of an object's class and 3D box."""
    document = object_document(item)
    return {name: document[name] for name in ("id", "category", "size_m", "center_cam", "rotation_wxyz")}


def run_lengths(places: Int[np.ndarray, " n"], size: int) -> list[int]:
    """Lengths of the runs of 0 and 1 in turn, down the columns, beginning with 0, of a mask of `size` pixels that is 1
    at `places`, in ascending order."""
    last = np.flatnonzero(np.diff(places) > 1)
    starts, ends = places[np.concatenate([[0], last + 1])], places[np.concatenate([last, [len(places) - 1]])] + 1
    turns = np.concatenate([[0], np.column_stack([starts, ends]).ravel(), [size]])
    lengths: list[int] = np.diff(turns).tolist()
    return lengths if lengths[-1] else lengths[:-1]


def _box(places: Int[np.ndarray, " n"], height_px: int) -> list[int]:
    columns, rows = np.divmod(places, height_px)
    return [int(n) for n in (columns[0], rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1)]


def _lane(delimiters: list[Lane], instance: int) -> dict[str, Any]:
    kind, number = thing_of(instance)
    # Lines that begin beyond the labels have numbers after those of the labels.
    if kind != "delimiter" or number >= len(delimiters):
        return {}
    lane = delimiters[number]
    return {"lane": {"id": lane.id, "marking": lane.marking, "color": lane.color}}


def document(path: str, lines: Path) -> Iterator[str]:
    """The images, then the annotations of a part; instances are numbered from 1 (0 means no match to the evaluator)."""
    yield f'{{"info": {{"description": "synth3dlanes"}}, "licenses": [], "categories": {json.dumps(CATEGORIES)}'
    yield ', "images": ['
    for index, (image, _) in enumerate(_lines(lines)):
        yield f"{',' if index else ''}\n{json.dumps(image)}"
    yield '], "annotations": ['
    number = 0
    for _, annotations in _lines(lines):
        for annotation in annotations:
            number += 1
            numbered = annotation if "segments_info" in annotation else {"id": number, **annotation}
            yield f"{',' if number > 1 else ''}\n{json.dumps(numbered)}"
    yield "]}\n"


def _lines(lines: Path) -> Iterator[tuple[dict[str, Any], list[dict[str, Any]]]]:
    with lines.open() as file:
        for line in file:
            image, annotations = json.loads(line)
            yield image, annotations


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


Document = TypeVar("Document", _Panoptic, _Instances)


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
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


def _decoded(runs: _Runs, shape: tuple[int, int]) -> PixelNumbers | None:
    """The mask of run lengths, which go down the columns; None where they are not those of an image of this size."""
    if runs.size != shape or sum(runs.counts) != shape[0] * shape[1]:
        return None
    values = np.arange(len(runs.counts)) % 2 == 1
    return np.flatnonzero(np.repeat(values, runs.counts).reshape(shape, order="F"))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """The mask of each instance, and the segment of each pixel."""
    infos, pixels, instances = frame.content
    ours, classes = masked_objects(truth), {number + 1: name for name, number in SEMANTIC_IDS.items()}
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
    """Findings unless each object has the 3D box of the object whose pixels it has."""
    boxes = {item.id: item for item in truth.labels.objects or ()}
    ids = truth.passes["instance"]
    for instance in instances:
        mask = _decoded(instance.segmentation, (ids.shape[0], ids.shape[1]))
        if instance.category_id - 1 not in BOXED or mask is None or not len(mask):
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


FORMAT = SampleFormat(
    title="COCO: instances and panoptic segments",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    tolerances={"px": LIMIT_PX},
    document=document,
    passes=PASSES,
    counted="objects",
)
