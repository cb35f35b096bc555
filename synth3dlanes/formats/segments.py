"""What the segmentation formats share: names, masks as PNG, lines in pixels, and how far masks are from the passes.

There, masks are the sorted numbers of their pixels, row by row.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float, Int, Shaped
from PIL import Image

from synth3dlanes.formats.comparing import Comparison, Gap, SourceSample
from synth3dlanes.formats.format import SampleFrame
from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.labels.labels import CameraLabel, Lane
from synth3dlanes.scene.instance_ids import numbers_of, thing_of
from synth3dlanes.scene.things import SEMANTIC_IDS, STUFF
from synth3dlanes.system.files import encoded

PASSES = ("semantic", "instance")
LINE_STEP_M = 0.1
NEAREST_M = 0.5
POINT_EVERY_PX = 8.0


def file_name(frame: SampleFrame) -> str:
    """The name of a frame's files, unique in the export."""
    return f"{frame.split}-{frame.key}"


def image_path(frame: SampleFrame) -> str:
    """Where the frame's image goes."""
    return f"images/{file_name(frame)}.{frame.image_format}"


def png(pixels: Shaped[np.ndarray, "h w ..."]) -> bytes:
    """A PNG of 8 or 16 bits a pixel without palette, or of RGB."""
    return encoded(lambda stream: Image.fromarray(pixels).save(stream, "PNG"))


def delimiter_numbers(instance: Shaped[np.ndarray, "h w"]) -> Shaped[np.ndarray, "h w"]:
    """1 + i at the paint of delimiter i of the labels, 0 elsewhere; 8 bits where they are enough."""
    numbers = numbers_of("delimiter", instance) + 1
    return numbers.astype(np.uint8 if numbers.max() <= np.iinfo(np.uint8).max else np.uint16)


def line_pixels(lane: Lane, camera: CameraLabel) -> Float[np.ndarray, "_ 2"]:
    """Pixels along the part of a lane in the image that the ground does not hide, from near to far."""
    at = np.arange(len(lane.xyz_cam) - 1.0)
    lengths_m = np.linalg.norm(np.diff(lane.xyz_cam, axis=0), axis=1)
    pieces = np.maximum(1, np.ceil(lengths_m / LINE_STEP_M)).astype(int)
    fine = np.concatenate([i + np.arange(n) / n for i, n in zip(at, pieces, strict=True)] + [np.array([len(at)])])
    knots = np.arange(len(lane.xyz_cam))
    points_cam = np.column_stack([np.interp(fine, knots, column) for column in lane.xyz_cam.T])
    # Between two samples the ground is seen if it is at both.
    seen = np.interp(fine, knots, lane.terrain_visible.astype(float)) == 1
    uv = camera.project(points_cam[seen & (points_cam[:, 1] > NEAREST_M)])
    uv = uv[((uv >= 0) & (uv < [camera.width_px, camera.height_px])).all(axis=1)]
    if not len(uv):
        return uv
    along_px = lengths_along(uv)[: len(uv)]
    _, first = np.unique(along_px // POINT_EVERY_PX, return_index=True)
    return uv[np.unique([*first, len(uv) - 1])]


PixelNumbers = Int[np.ndarray, " _"]
LIMIT_PX = 0.5
"""Masks are exact."""


@dataclass(frozen=True, eq=False)
class MaskedObject:
    """An object: its class and its pixels."""

    of_class: str
    mask: PixelNumbers


def masked_objects(truth: SourceSample) -> dict[str, MaskedObject]:
    """All objects of a sample by their names: paint by the id of its line."""
    semantic, instance = (truth.passes[name].ravel().astype(np.int64) for name in ("semantic", "instance"))
    names = {number: name for name, number in SEMANTIC_IDS.items()}
    delimiters = [lane.id for lane in truth.labels.lanes if lane.kind == "delimiter"]
    pairs = semantic << 32 | instance
    values, counts = np.unique(pairs, return_counts=True)
    masks = np.split(np.argsort(pairs, kind="stable"), np.cumsum(counts)[:-1])
    found = dict[str, MaskedObject]()
    for pair, mask in zip(values.tolist(), masks, strict=True):
        of_class, number = names[pair >> 32], pair & 0xFFFFFFFF
        kind, line = thing_of(number)
        is_line = of_class == "marking" and kind == "delimiter" and line < len(delimiters)
        if of_class not in STUFF:
            found[delimiters[line] if is_line else f"{of_class} {number}"] = MaskedObject(of_class, mask)
    return found


def compare_masks(
    found: Mapping[str, PixelNumbers], ours: Mapping[str, PixelNumbers], shape: tuple[int, int]
) -> Comparison:
    """Masks of pictures of this shape by the names of their objects."""
    gaps = [_gap(name, mask, ours[name], shape) for name, mask in found.items() if name in ours]
    strange = found.keys() - ours.keys()
    problems = [f"{name}: expected an object of the passes, got none of it" for name in strange]
    every = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *found.values()]))
    for name in ours.keys() - found.keys():
        apart = _beyond(ours[name], every, shape).max(initial=0)
        problems.append(f"{name}: expected a mask of it, got pixels of it {apart:.3g} px from all masks")
    problems += (
        f"{gap.name}: expected its pixels as in the passes, got some {gap.worst:.3g} px away"
        for gap in gaps
        if gap.worst > LIMIT_PX
    )
    return Comparison(tuple(gaps), tuple(sorted(problems)), strange=Counter({"mask": len(strange)}))


def most_shared(mask: PixelNumbers, ours: Mapping[str, PixelNumbers], shape: tuple[int, int]) -> str | None:
    """The one of ours that has most of the pixels; the nearest one where none has any."""
    if not ours:
        return None
    shares = {name: len(np.intersect1d(mask, other, assume_unique=True)) for name, other in ours.items()}
    if max(shares.values()):
        return max(shares, key=lambda name: shares[name])
    middles = {name: np.mean(np.unravel_index(other, shape), axis=1) for name, other in ours.items()}
    middle = np.mean(np.unravel_index(mask, shape), axis=1)
    return min(middles, key=lambda name: float(np.linalg.norm(middles[name] - middle)))


def _gap(name: str, found: PixelNumbers, ours: PixelNumbers, shape: tuple[int, int]) -> Gap:
    """How far pixels that only one of two masks has are from the other."""
    if np.array_equal(found, ours):
        return Gap(name, "px", 0.0, 0.0, "mask")
    apart = np.concatenate([_beyond(found, ours, shape), _beyond(ours, found, shape)])
    return Gap.of(name, "px", apart, "mask")


def _beyond(mask: PixelNumbers, other: PixelNumbers, shape: tuple[int, int]) -> Float[np.ndarray, " _"]:
    """Distances of the pixels that the other mask lacks from it."""
    if not len(other):
        return np.full(1, float(np.hypot(*shape)))
    off = np.ones(shape, dtype=bool)
    off.ravel()[other] = False
    return np.asarray(scipy.ndimage.distance_transform_edt(off)).ravel()[np.setdiff1d(mask, other, assume_unique=True)]
