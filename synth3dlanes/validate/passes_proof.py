"""The passes against the labels: paint under delimiters, the surface under points, and who hides whom.

A pixel's pass value is one sample at its centre. So a depth is taken from the four pixels around a point, and whether
it is seen from the sixteen: where these disagree, an edge is less than two pixels away, and they are not asked.
"""

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Bool, Float, Integer, Shaped
from scipy.spatial import cKDTree

from synth3dlanes.geometry.camera import project
from synth3dlanes.labels import Labels, Lane
from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.validate.findings import PROOF_M, Finding, Measure
from synth3dlanes.validate.paint import Paint, Strip

# A fault of labels is a line's, not a point's: a line fails where more than this share of its points, and more than
# one, is off; single ones, such as on the foot of a car, are left to the distributions.
MAX_SHARE, MAX_SINGLE = 0.1, 1
# Spec section 4.
LIMITS = {"paint_px": (1.0, "px of the paint"), "surface_m": (0.02, "m of the rendered surface")}
MASKS = ("terrain_visible", "object_visible")
# Pixels that differ by more in depth belong to two surfaces, or to one seen at too flat an angle to interpolate.
SMOOTH = 1.2
# Nearer than a point by this much hides it: more than a pixel's depth on the point's own surface would not differ.
NEARER, NEARER_M = 0.985, 0.05

Passes = Mapping[str, Shaped[np.ndarray, "h w ..."]]
Pixels = Float[np.ndarray, "n 2"]
Values = Float[np.ndarray, " n"]


def prove_passes(paint: Paint, labels: Labels, passes: Passes) -> tuple[list[Finding], list[Measure]]:
    """Faults of lines by whichever of depth and semantic there are, and every value measured on the way."""
    findings: list[Finding] = []
    measures: list[Measure] = []
    for lane in labels.lanes:
        uv = project(labels.camera.img_from_cam, lane.xyz_cam)
        strip = paint.strip(labels.camera, lane, lane.xyz_cam)
        found = []
        if "semantic" in passes and lane.kind == "delimiter":
            found.append(_paint(lane, strip, uv, passes["semantic"]))
        if "depth" in passes:
            found += _surface(lane, strip, uv, passes)
        if "depth" in passes and "semantic" in passes:
            found += _sight(lane, uv, passes)
        measures += found
        findings += [finding for measure in found for finding in _judge(lane.id, measure)]
    return findings, _joined(measures)


def _judge(lane_id: str, measure: Measure) -> Iterator[Finding]:
    """A finding where too many of a line's values are too large."""
    is_flag = measure.name in MASKS
    if not is_flag and measure.name not in LIMITS:
        return
    values = measure.values if is_flag else measure.values[measure.y_m < PROOF_M]
    limit, words = (0.0, "") if is_flag else LIMITS[measure.name]
    wrong = int((values > limit).sum())
    if wrong <= max(MAX_SINGLE, MAX_SHARE * len(values)):
        return
    if is_flag:
        yield Finding(
            lane_id, f"{measure.name}: expected what the passes show, got another at {wrong} of {len(values)}"
        )
    else:
        off = f"{wrong} of {len(values)} off, by {np.median(values):.3g} in the median"
        yield Finding(lane_id, f"passes: expected points within {limit} {words}, got {off}")


def _paint(lane: Lane, strip: Strip, uv: Pixels, semantic: Integer[np.ndarray, "h w"]) -> Measure:
    """Pixels from each seen point whose paint is wide enough to show to the nearest pixel of paint; 0 inside one."""
    at = lane.visible & strip.resolved
    v, u = np.nonzero(semantic == SEMANTIC_IDS["marking"])
    if not len(v):
        return Measure("paint_px", lane.xyz_cam[at, 1], np.full(int(at.sum()), float(max(semantic.shape))))
    centers = np.column_stack([u, v]) + 0.5
    _, nearest = cKDTree(centers).query(uv[at])
    outside = np.clip(np.abs(uv[at] - centers[nearest]) - 0.5, 0, None)
    return Measure("paint_px", lane.xyz_cam[at, 1], np.hypot(*outside.T))


def _surface(lane: Lane, strip: Strip, uv: Pixels, passes: Passes) -> list[Measure]:
    """How far the rendered surface is from each seen point: along the line of sight, and along its own normal. At a
    crest one pixel spans metres of depth, so the first would judge the interpolation."""
    inverse, (fx, fy) = _around(1 / passes["depth"], uv, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        smooth = lane.visible & (inverse.max(axis=0) < SMOOTH * inverse.min(axis=0))
        upper, lower = (inverse[i] * (1 - fx) + inverse[i + 1] * fx for i in (0, 2))
        error = 1 / (upper * (1 - fy) + lower * fy) / lane.xyz_cam[:, 1] - 1
    if "semantic" in passes:
        smooth &= ~_of_objects(_around(passes["semantic"], uv, 1)[0]).any(axis=0)
    y_m, error = lane.xyz_cam[smooth, 1], error[smooth]
    gap_m = np.abs(error * (strip.points_cam * strip.normal_cam).sum(axis=1)[smooth])
    return [Measure("depth_m", y_m, np.abs(error * y_m)), Measure("surface_m", y_m, gap_m)]


def _sight(lane: Lane, uv: Pixels, passes: Passes) -> list[Measure]:
    """Where the passes are sure that a point is seen, or hidden by ground, or by an object: do the masks agree?"""
    y_m = lane.xyz_cam[:, 1]
    nearer = _around(passes["depth"], uv, 2)[0] < NEARER * y_m - NEARER_M
    objects = _of_objects(_around(passes["semantic"], uv, 2)[0])
    clear = lane.in_image & ~nearer.any(axis=0)
    by_ground = lane.in_image & (nearer & ~objects).all(axis=0)
    by_object = lane.in_image & (nearer & objects).all(axis=0)
    return [
        Measure(name, y_m[at], (mask != clear)[at].astype(float))
        for name, mask, at in (
            ("terrain_visible", lane.terrain_visible, clear | by_ground),
            ("object_visible", lane.object_visible, clear | by_object),
        )
    ]


def _of_objects(semantic: Integer[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
    return (semantic == SEMANTIC_IDS["car"]) | (semantic == SEMANTIC_IDS["tree"])


def _around(
    values: Shaped[np.ndarray, "h w"], uv: Pixels, reach: int
) -> tuple[Shaped[np.ndarray, "k n"], tuple[Values, Values]]:
    """The square of 2 x reach pixels a side about each place, row by row (anything, where that is not in the image),
    and how far the place lies between the two columns and rows in its middle."""
    height_px, width_px = values.shape
    x, y = np.nan_to_num(uv - 0.5).T
    j, i = np.floor(np.clip([x, y], 0, [[width_px - 2], [height_px - 2]])).astype(int)
    steps = range(1 - reach, reach + 1)
    around = [
        values[np.clip(i + di, 0, height_px - 1), np.clip(j + dj, 0, width_px - 1)] for di in steps for dj in steps
    ]
    return np.stack(around), (x - j, y - i)


def _joined(measures: list[Measure]) -> list[Measure]:
    names = dict.fromkeys(measure.name for measure in measures)
    return [
        Measure(name, *(np.concatenate([m[i] for m in measures if m.name == name]) for i in (1, 2))) for name in names
    ]
