"""The passes against the labels: paint under delimiters, the surface under points, and who hides whom.

A pixel's pass value is one sample at its centre, so a point is judged by the four pixels around it, and where these
disagree (an edge lies between them) by none.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.spatial import cKDTree

from synth3dlanes.geometry.camera import project
from synth3dlanes.labels import Labels, Lane
from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.validate.findings import PROOF_M, Finding, Measure
from synth3dlanes.validate.paint import Paint, Strip

# Spec section 4 asks for 1 px and 2 cm of nearly all points; a fault of labels is a line's, not a point's. So a line
# fails where more than this share of its points, and more than one, is off; single ones are left to the distributions.
MAX_SHARE, MAX_SINGLE = 0.1, 1
PAINT_PX = 1.0
SURFACE_M = 0.02
# Pixels that differ by more in depth belong to two surfaces, or to one seen at too flat an angle to interpolate.
SMOOTH = 1.2
# Nearer than a point by this much hides it: more than a pixel's depth on the point's own surface would not differ.
NEARER, NEARER_M = 0.985, 0.05

Passes = Mapping[str, Shaped[np.ndarray, "h w ..."]]
Corners = Shaped[np.ndarray, "4 n"]
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
            found += _surface(lane, strip, uv, passes["depth"])
        if "depth" in passes and "semantic" in passes:
            found += _sight(lane, uv, passes["depth"], passes["semantic"])
        measures += found
        findings += [finding for measure in found for finding in _judge(lane.id, measure)]
    return findings, _joined(measures)


def _judge(lane_id: str, measure: Measure) -> list[Finding]:
    """A finding where too many of a line's values are too large."""
    limits = {
        "paint_px": (PAINT_PX, "px from the paint"),
        "surface_m": (SURFACE_M, "m from the rendered surface"),
        "terrain_visible": (0.0, "terrain_visible against the depth of the ground"),
        "object_visible": (0.0, "object_visible against the cars and trees in the passes"),
    }
    if measure.name not in limits:
        return []
    limit, words = limits[measure.name]
    values = measure.values[measure.y_m < PROOF_M] if limit else measure.values
    wrong = int((values > limit).sum())
    if wrong <= max(MAX_SINGLE, MAX_SHARE * len(values)):
        return []
    if not limit:
        return [Finding(lane_id, f"{words}: {wrong} of {len(values)} points disagree")]
    reason = f"expected points within {limit} {words}, got {wrong} of {len(values)} off, by {np.median(values):.3g} in the median"
    return [Finding(lane_id, reason)]


def _paint(lane: Lane, strip: Strip, uv: Float[np.ndarray, "n 2"], semantic: Int[np.ndarray, "h w"]) -> Measure:
    """Pixels from each seen point whose paint is wide enough to show to the nearest pixel of paint; 0 inside one."""
    at = lane.visible & strip.resolved
    v, u = np.nonzero(semantic == SEMANTIC_IDS["marking"])
    if not len(v):
        return Measure("paint_px", lane.xyz_cam[at, 1], np.full(int(at.sum()), float(max(semantic.shape))))
    centers = np.column_stack([u, v]) + 0.5
    _, nearest = cKDTree(centers).query(uv[at])
    outside = np.clip(np.abs(uv[at] - centers[nearest]) - 0.5, 0, None)
    return Measure("paint_px", lane.xyz_cam[at, 1], np.hypot(*outside.T))


def _surface(lane: Lane, strip: Strip, uv: Float[np.ndarray, "n 2"], depth: Float[np.ndarray, "h w"]) -> list[Measure]:
    """How far the rendered surface is from each seen point: along the line of sight, and along its own normal. At a
    crest one pixel spans metres of depth, so the first would judge the interpolation."""
    inverse, (fx, fy) = _corners(1 / depth, uv)
    with np.errstate(divide="ignore", invalid="ignore"):
        smooth = lane.visible & (inverse.max(axis=0) < SMOOTH * inverse.min(axis=0))
        upper, lower = (inverse[i] * (1 - fx) + inverse[i + 1] * fx for i in (0, 2))
        error = 1 / (upper * (1 - fy) + lower * fy) / lane.xyz_cam[:, 1] - 1
    y_m, error = lane.xyz_cam[smooth, 1], error[smooth]
    gap_m = np.abs(error * (strip.points_cam * strip.normal_cam).sum(axis=1)[smooth])
    return [Measure("depth_m", y_m, np.abs(error * y_m)), Measure("surface_m", y_m, gap_m)]


def _sight(
    lane: Lane, uv: Float[np.ndarray, "n 2"], depth: Float[np.ndarray, "h w"], semantic: Int[np.ndarray, "h w"]
) -> list[Measure]:
    """Where the passes are sure that a point is seen, or hidden by ground, or by an object: do the masks agree?"""
    y_m = lane.xyz_cam[:, 1]
    depths, _ = _corners(depth, uv)
    kinds, _ = _corners(semantic, uv)
    objects = (kinds == SEMANTIC_IDS["car"]) | (kinds == SEMANTIC_IDS["tree"])
    nearer = depths < NEARER * y_m - NEARER_M
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


def _corners(values: Shaped[np.ndarray, "h w"], uv: Float[np.ndarray, "n 2"]) -> tuple[Corners, tuple[Values, Values]]:
    """The four pixels whose centres are around each place (any, where it is not in the image), upper left first, and
    how far between them it lies."""
    x, y = np.nan_to_num(uv - 0.5).T
    j = np.clip(np.floor(x), 0, values.shape[1] - 2).astype(int)
    i = np.clip(np.floor(y), 0, values.shape[0] - 2).astype(int)
    around = np.stack([values[i, j], values[i, j + 1], values[i + 1, j], values[i + 1, j + 1]])
    return around, (x - j, y - i)


def _joined(measures: list[Measure]) -> list[Measure]:
    names = dict.fromkeys(measure.name for measure in measures)
    return [
        Measure(name, *(np.concatenate([m[i] for m in measures if m.name == name]) for i in (1, 2))) for name in names
    ]
