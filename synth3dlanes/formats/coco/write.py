"""Write COCO: panoptic segments as PNG and JSON, instances as JSON with run lengths."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from synth3dlanes.formats.coco.convention import CATEGORIES, CLASSES_AT_MOST, STUFF_IDS, rgb_of, segment_id
from synth3dlanes.formats.format import SampleFrame
from synth3dlanes.formats.segments import file_name, image_path, png
from synth3dlanes.formats.writing import PARTS, FrameAnnotation
from synth3dlanes.labels.labels import Lane
from synth3dlanes.labels.object_labels import ObjectLabel, object_document
from synth3dlanes.scene.instance_ids import thing_of

README = """COCO layout.

- `images/*`: as in the data set. `annotations/instances_{train,val,test}.json`: things with masks as run lengths
  (`counts` is a list). `annotations/panoptic_{train,val,test}.json` with `panoptic/*.png`: every pixel's segment,
  R + 256 G + 65536 B.
- Category ids are the semantic ids of the data set plus 1 (COCO's begin with 1). Sky, terrain, road and shoulder are
  stuff, all others are things: each lane line, car, tree, symbol and structure is one.
- A lane line's paint is one instance, with all its dashes. `lane` has the line's id in the labels, its `marking` and
  its `color`; lines that begin more than 110 m ahead have none. There are no crowds.
- Cars have the key `object` with their 3D box: `id`, `category`, `size_m`, `center_cam` and `rotation_wxyz` as in the
  labels of the data set (camera frame: x right, y along the viewing direction, z up).
"""


def annotate(frame: SampleFrame) -> FrameAnnotation:
    """The frame's segments."""
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
    parts = [part for part in PARTS if frame.serves_as(part)]
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
    for index, (image, _) in enumerate(_frames(lines)):
        yield f"{',' if index else ''}\n{json.dumps(image)}"
    yield '], "annotations": ['
    number = 0
    for _, annotations in _frames(lines):
        for annotation in annotations:
            number += 1
            numbered = annotation if "segments_info" in annotation else {"id": number, **annotation}
            yield f"{',' if number > 1 else ''}\n{json.dumps(numbered)}"
    yield "]}\n"


def _frames(lines: Path) -> Iterator[tuple[dict[str, Any], list[dict[str, Any]]]]:
    with lines.open() as file:
        for line in file:
            image, annotations = json.loads(line)
            yield image, annotations
