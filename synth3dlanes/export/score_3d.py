"""Scores of 3D lines as the Gen-LaneNet (Apollo) and OpenLane benchmarks define them, from their description alone.

Frame: each benchmark's ground frame (x right, y forward, z up), metres. Both sample every line at y = 3..102 m and
call a pair's sample matched within 1.5 m; they differ in what they prune and in what a missing part costs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment

SAMPLES_Y_M = np.arange(3.0, 103.0)
NEAR = SAMPLES_Y_M <= 40.0
HALF_WIDTH_M = 10.0
LOADED_HALF_WIDTH_M = 30.0
LOADED_Y_M = 200.0
MATCH_M = 1.5
MATCHED_SHARE = 0.75
THRESHOLDS = np.linspace(0.05, 0.95, 19)

Points = Float[np.ndarray, "_ 3"]


@dataclass(frozen=True, eq=False)
class Line3d:
    """A ground-truth line (with visibility) or a predicted one (all visible, with its probability)."""

    points_ground: Points
    visible: Bool[np.ndarray, " _"]
    category: int = 0
    probability: float = 1.0


@dataclass(frozen=True)
class Score3d:
    """`ap` is Gen-LaneNet's, `category_accuracy` OpenLane's; NaN where undefined."""

    f_score: float
    recall: float
    precision: float
    ap: float
    category_accuracy: float
    x_near_m: float
    x_far_m: float
    z_near_m: float
    z_far_m: float


@dataclass(frozen=True, eq=False)
class _Sampled:
    x_m: Float[np.ndarray, " y"]
    z_m: Float[np.ndarray, " y"]
    seen: Bool[np.ndarray, " y"]
    category: int


@dataclass
class _Counts:
    n_true: int = 0
    n_predicted: int = 0
    recalled: int = 0
    precise: int = 0
    same_category: int = 0


Frames = Sequence[tuple[Sequence[Line3d], Sequence[Line3d]]]


def score_apollo(frames: Frames) -> Score3d:
    """Gen-LaneNet's evaluator over (ground truth, prediction) of every frame; probabilities above 0.5 count."""
    counts, errors = _total(frames, 0.5, is_openlane=False)
    curve = [_rates(_total(frames, threshold, is_openlane=False)[0]) for threshold in THRESHOLDS]
    return _score(counts, errors, _average_precision(curve))


def score_openlane(frames: Frames) -> Score3d:
    """OpenLane's 3D evaluator over (ground truth, prediction) of every frame."""
    counts, errors = _total(frames, -1.0, is_openlane=True)
    return _score(counts, errors, float("nan"))


def prune(line: Line3d, half_width_m: float = LOADED_HALF_WIDTH_M) -> Line3d | None:
    """The part of a true line that an evaluator keeps: visible, within the bounds; None if it drops the line."""
    points_ground = line.points_ground[line.visible]
    if len(points_ground) < 2 or points_ground[0, 1] >= SAMPLES_Y_M[-1] or points_ground[-1, 1] <= SAMPLES_Y_M[0]:
        return None
    x_m, y_m, _ = points_ground.T
    points_ground = points_ground[(np.abs(x_m) < half_width_m) & (y_m > 0) & (y_m < LOADED_Y_M)].copy()
    if len(points_ground) < 2:
        return None
    return Line3d(points_ground, np.ones(len(points_ground), dtype=bool), line.category, line.probability)


def samples_seen(line: Line3d) -> Bool[np.ndarray, " y"]:
    """At which of the evaluator's samples the line exists within 10 m beside the axis."""
    return _sampled(line).seen


def _total(frames: Frames, threshold: float, is_openlane: bool) -> tuple[_Counts, list[Float[np.ndarray, " 4"]]]:
    counts, errors = _Counts(), list[Float[np.ndarray, " 4"]]()
    for true, predicted in frames:
        confident = [line for line in predicted if line.probability > threshold]
        if is_openlane:
            kept = [[prune(line, HALF_WIDTH_M) for line in lines] for lines in (true, confident)]
            sampled = [[_sampled(line) for line in lines if line is not None] for lines in kept]
            true_lines, predicted_lines = [[line for line in lines if line.seen.sum() > 1] for lines in sampled]
        else:
            true_lines = [_sampled(line) for line in map(prune, true) if line is not None]
            predicted_lines = [_sampled(line) for line in confident]
        counts.n_true += len(true_lines)
        counts.n_predicted += len(predicted_lines)
        if true_lines and predicted_lines:
            _match(true_lines, predicted_lines, is_openlane, counts, errors)
    return counts, errors


def _sampled(line: Line3d) -> _Sampled:
    assert len(line.points_ground) >= 2, "the evaluators cannot resample a line of one point"
    x_m, y_m, z_m = line.points_ground[np.argsort(line.points_ground[:, 1], kind="stable")].T
    sample_x_m = np.interp(SAMPLES_Y_M, y_m, x_m)
    start_m, end_m = y_m[0], y_m[-1]
    seen = (start_m <= SAMPLES_Y_M) & (end_m >= SAMPLES_Y_M) & (np.abs(sample_x_m) <= HALF_WIDTH_M)
    return _Sampled(sample_x_m, np.interp(SAMPLES_Y_M, y_m, z_m), seen, line.category)


def _match(
    true: list[_Sampled],
    predicted: list[_Sampled],
    is_openlane: bool,
    counts: _Counts,
    errors: list[Float[np.ndarray, " 4"]],
) -> None:
    true_seen = np.stack([line.seen for line in true])[:, None]
    predicted_seen = np.stack([line.seen for line in predicted])[None]
    both = true_seen & predicted_seen
    dx_m = np.abs(np.stack([line.x_m for line in true])[:, None] - np.stack([line.x_m for line in predicted]))
    dz_m = np.abs(np.stack([line.z_m for line in true])[:, None] - np.stack([line.z_m for line in predicted]))
    distances_m = np.where(both, np.hypot(dx_m, dz_m), MATCH_M)
    if is_openlane:
        distances_m = np.where(~true_seen & ~predicted_seen, 0.0, distances_m)
    sums_m = distances_m.sum(axis=-1)
    costs = np.where((sums_m > 0) & (sums_m < 1), 1.0, np.trunc(sums_m)) if is_openlane else np.trunc(sums_m)
    # The tiny share of the exact sum only decides between pairings whose whole costs are equal.
    rows, columns = linear_sum_assignment(costs + 1e-6 * sums_m)
    for i, j in zip(rows, columns, strict=True):
        if costs[i, j] >= MATCH_M * len(SAMPLES_Y_M):
            continue
        n_matched = np.count_nonzero(both[i, j] & (distances_m[i, j] < MATCH_M))
        counts.recalled += bool(n_matched >= MATCHED_SHARE * max(1, true[i].seen.sum()))
        counts.precise += bool(n_matched >= MATCHED_SHARE * max(1, predicted[j].seen.sum()))
        counts.same_category += true[i].category == predicted[j].category or (
            (true[i].category, predicted[j].category) == (21, 20)
        )
        missing_m = np.nan if is_openlane else MATCH_M
        parts = [(d_m, part) for d_m in (dx_m[i, j], dz_m[i, j]) for part in (both[i, j] & NEAR, both[i, j] & ~NEAR)]
        errors.append(np.array([d_m[part].mean() if part.any() else missing_m for d_m, part in parts]))


def _rates(counts: _Counts) -> tuple[float, float]:
    return counts.recalled / max(1, counts.n_true), counts.precise / max(1, counts.n_predicted)


def _average_precision(curve: list[tuple[float, float]]) -> float:
    # Ends fixed at (R 0, P 1) and (R 1, P 0), each after measured points of equal recall: hence 0.5 for no match
    # at all and 1 for a perfect one.
    ends = [(0.0, 1.0), (1.0, 0.0)]
    recalls, precisions = np.array(sorted(curve + ends, key=lambda point: (point[0], point in ends))).T
    below = np.searchsorted(recalls, THRESHOLDS, side="left") - 1
    r0, r1, p0, p1 = recalls[below], recalls[below + 1], precisions[below], precisions[below + 1]
    return float(np.mean(p0 + (p1 - p0) * (THRESHOLDS - r0) / (r1 - r0)))


def _score(counts: _Counts, errors: list[Float[np.ndarray, " 4"]], ap: float) -> Score3d:
    recall, precision = _rates(counts)
    rows = np.array(errors).reshape(-1, 4)
    means = [float(np.mean(column[~np.isnan(column)])) if (~np.isnan(column)).any() else np.nan for column in rows.T]
    x_near_m, x_far_m, z_near_m, z_far_m = means
    return Score3d(
        f_score=2 * recall * precision / (recall + precision + 1e-6),
        recall=recall,
        precision=precision,
        ap=ap,
        category_accuracy=counts.same_category / len(errors) if errors else float("nan"),
        x_near_m=x_near_m,
        x_far_m=x_far_m,
        z_near_m=z_near_m,
        z_far_m=z_far_m,
    )
