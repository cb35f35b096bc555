"""Distances between labelled and detected lanes of one image, and their one-to-one matching. Pure numpy.

Frame: the road frame of the labels, in which y_k = 0, 0.8, ..., 80 m is the same for all predictions.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.geometry.frames import transform

from .curves import (
    HALF_WIDTH_M,
    METRIC_Y_M,
    MIN_VALID_POINTS,
    Y_REF_M,
    RoadCurve,
    is_usable,
    resample,
)
from .lanes import Detection

Weights = Literal["linear", "uniform", "exponential"]
MATCH_M = 1.5
"""Pairs farther apart than this do not match; also the cost of a missing point (paper: "rather permissive")."""


def point_weights(name: Weights) -> Float[np.ndarray, " y"]:
    """Weight of each y_k, with sum 1. The paper only says that weights decrease; by default from 1 to 0.2, linearly."""
    weights = {
        "linear": 1 - 0.8 * METRIC_Y_M / METRIC_Y_M[-1],
        "uniform": np.ones_like(METRIC_Y_M),
        "exponential": np.exp(-METRIC_Y_M / 40),
    }[name]
    return weights / weights.sum()


@dataclass(frozen=True, eq=False)
class Truth:
    """Labelled lanes of one kind at y_k. Ignored lanes do not count, and their detections are not false positives."""

    x_m: Float[np.ndarray, "l y"]
    z_m: Float[np.ndarray, "l y"]
    valid: Bool[np.ndarray, "l y"]
    ignored: Bool[np.ndarray, " l"]


@dataclass(frozen=True, eq=False)
class DetectedLanes:
    """Detected lanes of one kind at y_k, with their scores; `off_region` lanes cross Y_ref outside the top view or have
    less than 8 m within 0..80 m."""

    x_m: Float[np.ndarray, "p y"]
    z_m: Float[np.ndarray, "p y"]
    present: Bool[np.ndarray, "p y"]
    score: Float[np.ndarray, " p"]
    off_region: Bool[np.ndarray, " p"]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs closer than MATCH_M, nearest first, with their errors at y_k (NaN where not compared). `forgiven`
    detections do not count as false positives when unmatched."""

    n_truth: int
    n_ignored: int
    n_outside: int
    score: Float[np.ndarray, " p"]
    forgiven: Bool[np.ndarray, " p"]
    truth: Int[np.ndarray, " m"]
    detection: Int[np.ndarray, " m"]
    dx_m: Float[np.ndarray, "m y"]
    dz_m: Float[np.ndarray, "m y"]


def sample_truth(curves: tuple[RoadCurve, ...]) -> Truth:
    """Labelled curves at y_k. Ignored are repeats, curves that training ignores, and curves with less than 8 m to
    compare; the latter are compared even where the ground hides them."""
    size = (len(curves), len(METRIC_Y_M))
    x_m, z_m, valid = np.zeros(size), np.zeros(size), np.zeros(size, dtype=bool)
    ignored = np.zeros(len(curves), dtype=bool)
    for i, curve in enumerate(curves):
        at = resample(curve, METRIC_Y_M)
        has_few = at.visible.sum() < MIN_VALID_POINTS
        ignored[i] = has_few or curve.is_repeat or not is_usable(curve)
        x_m[i], z_m[i], valid[i] = at.x_m, at.z_m, at.in_range if has_few else at.visible
    return Truth(x_m, z_m, valid, ignored)


def sample_detections(lanes: list[Detection], road_from_cam: Float[np.ndarray, "4 4"]) -> DetectedLanes:
    """Detected lanes at y_k of the labels' road frame, linear between their points; folded lanes are sorted by y."""
    size = (len(lanes), len(METRIC_Y_M))
    x_m, z_m, present = np.zeros(size), np.zeros(size), np.zeros(size, dtype=bool)
    off_region = np.zeros(len(lanes), dtype=bool)
    for i, lane in enumerate(lanes):
        xyz_road = transform(road_from_cam, lane.xyz_cam)
        if (np.diff(xyz_road[:, 1]) <= 0).any():
            xyz_road = xyz_road[np.argsort(xyz_road[:, 1], kind="stable")]
        y_m = xyz_road[:, 1]
        x_m[i] = np.interp(METRIC_Y_M, y_m, xyz_road[:, 0])
        z_m[i] = np.interp(METRIC_Y_M, y_m, xyz_road[:, 2])
        # A lane over the full range, tilted by a slightly wrong pose, starts or ends centimetres inside the range.
        # This is not a gap, so lanes extend half a step beyond their ends.
        present[i] = (y_m[0] - 0.4 <= METRIC_Y_M) & (y_m[-1] + 0.4 >= METRIC_Y_M)
        x_ref_m = np.interp(Y_REF_M, y_m, xyz_road[:, 0])
        off_region[i] = present[i].sum() < MIN_VALID_POINTS or (
            y_m[0] <= Y_REF_M <= y_m[-1] and abs(x_ref_m) > HALF_WIDTH_M
        )
    return DetectedLanes(x_m, z_m, present, np.array([lane.score for lane in lanes], dtype=float), off_region)


def find_pairs(truth: Truth, found: DetectedLanes, weights: Float[np.ndarray, " y"]) -> Pairs:
    """All pairs closer than MATCH_M, sorted by distance."""
    dx_m = found.x_m[None] - truth.x_m[:, None]
    dz_m = found.z_m[None] - truth.z_m[:, None]
    compared = truth.valid[:, None] & found.present[None]
    error_m = np.where(compared, np.hypot(dx_m, dz_m), MATCH_M)
    weight = truth.valid * weights
    total = weight.sum(-1)
    distance_m = np.einsum("lpy,ly->lp", error_m, weight) / np.where(total > 0, total, 1)[:, None]
    distance_m[total == 0] = np.inf
    counted = ~truth.ignored
    forgiven = found.off_region | (distance_m[truth.ignored] < MATCH_M).any(0)
    rows, columns = np.nonzero((distance_m < MATCH_M) & counted[:, None])
    order = np.lexsort((columns, rows, distance_m[rows, columns]))
    rows, columns = rows[order], columns[order]
    seen = compared[rows, columns]
    return Pairs(
        n_truth=int(counted.sum()),
        n_ignored=int(truth.ignored.sum()),
        n_outside=int(found.off_region.sum()),
        score=found.score,
        forgiven=forgiven,
        truth=rows,
        detection=columns,
        dx_m=np.where(seen, dx_m[rows, columns], np.nan).astype(np.float32),
        dz_m=np.where(seen, dz_m[rows, columns], np.nan).astype(np.float32),
    )


def match(pairs: Pairs, threshold: float) -> list[int]:
    """Match greedily by distance, not by score (paper: "pairs in decreasing similarity"), among scores >= threshold."""
    taken_truth: set[int] = set()
    taken_detection: set[int] = set()
    accepted = []
    for index, (truth, detection) in enumerate(zip(pairs.truth.tolist(), pairs.detection.tolist(), strict=True)):
        if truth in taken_truth or detection in taken_detection or pairs.score[detection] < threshold:
            continue
        taken_truth.add(truth)
        taken_detection.add(detection)
        accepted.append(index)
    return accepted


def count_steps(pairs: Pairs) -> list[tuple[float, int, int]]:
    """Changes of true and false positives as the threshold decreases past each score of this image. Matching is
    repeated each time: a detection with a lower score may be nearer and take a lane from another."""
    steps = []
    before = (0, 0)
    for score in np.unique(pairs.score)[::-1]:
        matched = match(pairs, float(score))
        hits = {int(pairs.detection[index]) for index in matched}
        active = np.flatnonzero(pairs.score >= score)
        misses = sum(1 for d in active.tolist() if d not in hits and not pairs.forgiven[d])
        after = (len(hits), misses)
        steps.append((float(score), after[0] - before[0], after[1] - before[1]))
        before = after
    return steps
