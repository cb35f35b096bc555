"""The self-check of a COCO export: the masks of the instances must be those of the panoptic PNGs, every pixel of which
must have its segment."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from synth3dlanes.formats.coco.convention import STUFF_IDS, segments_of
from synth3dlanes.formats.reading import image_size, json_object, read_text
from synth3dlanes.formats.self_check import Verified

MOVED = 1 / 8  # of the image's width


def verify(out: Path, most_frames: int) -> Iterator[Verified]:
    """The frames of every part."""
    for path in sorted((out / "annotations").glob("panoptic_*.json")):
        part = path.stem.removeprefix("panoptic_")
        panoptic = json_object(read_text(path), str(path))
        with_instances = json_object(read_text(path.with_name(f"instances_{part}.json")), str(path))
        files = {image["id"]: image["file_name"] for image in panoptic["images"]}
        instances: dict[int, list[dict[str, Any]]] = {}
        for instance in with_instances["annotations"]:
            instances.setdefault(instance["image_id"], []).append(instance)
        problems, overlaps, moved, n_things = list[str](), list[float](), list[float](), 0
        for frame in panoptic["annotations"][:most_frames]:
            where = out / "panoptic" / frame["file_name"]
            things = instances.get(frame["image_id"], [])
            n_things += len(things)
            if (size_px := image_size(out / "images" / files[frame["image_id"]])) != image_size(where):
                problems.append(f"{where}: expected the size of its image, {size_px}, got {image_size(where)}")
                continue
            segments = segments_of(np.asarray(Image.open(where)))
            problems += _problems(str(where), segments, frame["segments_info"])
            of_things = [info for info in frame["segments_info"] if info["category_id"] not in STUFF_IDS]
            for info, thing in zip(of_things, things, strict=True):
                mask = _decoded(thing["segmentation"])
                overlaps.append(_overlap(mask, segments == info["id"]))
                aside = np.roll(mask, round(MOVED * mask.shape[1]), axis=1)
                moved.append(_overlap(aside, segments == info["id"]))
        perfect, shifted = float(np.mean(overlaps or [1.0])), float(np.mean(moved or [0.0]))
        if perfect < 1:
            problems.append(f"{part}: expected instances to be panoptic segments, got a mean overlap of {perfect:.4f}")
        numbers = Counter(instance["id"] for instance in with_instances["annotations"])
        if 0 in numbers or any(count > 1 for count in numbers.values()):
            problems.append(f"{part}: expected instances with ids of their own from 1 on, got others")
        n_frames = len(panoptic["annotations"][:most_frames])
        yield Verified(part, n_frames, n_things, {"overlap": perfect}, {"overlap": shifted}, tuple(problems))


def _problems(where: str, segments: np.ndarray, infos: list[dict[str, Any]]) -> Iterator[str]:
    ids, areas = np.unique(segments, return_counts=True)
    found, listed = dict(zip(ids.tolist(), areas.tolist(), strict=True)), {info["id"]: info["area"] for info in infos}
    if found != listed:
        yield f"{where}: expected the segments and areas of its annotation, got others"


def _decoded(runs: dict[str, Any]) -> np.ndarray:
    height_px, width_px = runs["size"]
    values = np.arange(len(runs["counts"])) % 2 == 1
    return np.repeat(values, runs["counts"]).reshape(height_px, width_px, order="F")


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.count_nonzero(a & b) / max(1, np.count_nonzero(a | b)))
