"""Scores as the ONCE-3DLanes (3D, frame `_cv`) and tuSimple (2D rows) benchmarks define them, as described."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw
from scipy.optimize import linear_sum_assignment

Points = Float[np.ndarray, "_ 3"]

RASTER_M = 10.0
RASTER_PX_PER_M = 10
RASTER_WIDTH_PX = 5
ONCE_MATCH_M = 0.3
ONCE_POINTS = 10
ROW_MATCH_PX = 20.0
ROW_SHARE = 0.85


@dataclass(frozen=True)
class OnceScore:
    """F1, precision, recall, and the mean distance of matched lines (NaN without any)."""

    f_score: float
    recall: float
    precision: float
    distance_m: float


@dataclass(frozen=True)
class TusimpleScore:
    """Mean over the frames of row accuracy, false-positive and false-negative rate."""

    accuracy: float
    false_positive: float
    false_negative: float


def score_once(frames: Sequence[tuple[Sequence[Points], Sequence[Points]]]) -> OnceScore:
    """Lines are paired by overlap in a bird's-eye raster of the first 10 m, then matched within 0.3 m in 3D."""
    n_true = sum(len(true) for true, _ in frames)
    n_predicted = sum(len(predicted) for _, predicted in frames)
    distances_m = []
    for true, predicted in frames:
        overlaps = np.array([[_overlap(_raster(a), _raster(b)) for b in predicted] for a in true])
        rows, columns = linear_sum_assignment(overlaps.reshape(len(true), len(predicted)), maximize=True)
        distances_m += [_distance_m(true[i], predicted[j]) for i, j in zip(rows, columns, strict=True)]
    matched_m = [distance_m for distance_m in distances_m if distance_m < ONCE_MATCH_M]
    recall, precision = len(matched_m) / max(1, n_true), len(matched_m) / max(1, n_predicted)
    f_score = 2 * recall * precision / (recall + precision) if matched_m else 0.0
    return OnceScore(f_score, recall, precision, float(np.mean(matched_m)) if matched_m else float("nan"))


def score_tusimple(
    frames: Sequence[tuple[Float[np.ndarray, "_ r"], Float[np.ndarray, "_ r"]]], rows_px: Float[np.ndarray, " r"]
) -> TusimpleScore:
    """The official accuracy: a row is right within 20 px / cos(angle of the true line), or where both are absent."""
    return TusimpleScore(*np.mean([_score_frame(true, predicted, rows_px) for true, predicted in frames], axis=0))


def _raster(points_cv: Points) -> Image.Image:
    size_px = int(2 * RASTER_M * RASTER_PX_PER_M), int(RASTER_M * RASTER_PX_PER_M)
    raster = Image.new("1", size_px)
    x_m, z_m = points_cv[:, 0], points_cv[:, 2]
    inside = (z_m < RASTER_M) & (np.abs(x_m) < RASTER_M)
    if np.count_nonzero(inside) >= 2:
        pixels = np.column_stack([x_m + RASTER_M, z_m])[inside] * RASTER_PX_PER_M
        ImageDraw.Draw(raster).line([(float(u), float(v)) for u, v in pixels], fill=1, width=RASTER_WIDTH_PX)
    return raster


def _overlap(a: Image.Image, b: Image.Image) -> float:
    cells_a, cells_b = np.asarray(a), np.asarray(b)
    return float(np.count_nonzero(cells_a & cells_b) / max(1, np.count_nonzero(cells_a | cells_b)))


def _distance_m(true_cv: Points, predicted_cv: Points) -> float:
    stations_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(true_cv, axis=0), axis=1))])
    wanted_m = np.linspace(0.0, stations_m[-1], ONCE_POINTS)
    points_cv = np.column_stack([np.interp(wanted_m, stations_m, column) for column in true_cv.T])
    starts_cv, steps_cv = predicted_cv[:-1], np.diff(predicted_cv, axis=0)
    lengths2_m2 = np.maximum(np.sum(steps_cv**2, axis=1), 1e-12)
    along = np.clip(np.sum((points_cv[:, None] - starts_cv) * steps_cv, axis=2) / lengths2_m2, 0, 1)
    nearest_cv = starts_cv + along[..., None] * steps_cv
    return float(np.linalg.norm(points_cv[:, None] - nearest_cv, axis=2).min(axis=1).mean())


def _score_frame(
    true: Float[np.ndarray, "_ r"], predicted: Float[np.ndarray, "_ r"], rows_px: Float[np.ndarray, " r"]
) -> tuple[float, float, float]:
    if len(predicted) > len(true) + 2:
        return 0.0, 0.0, 1.0
    best = []
    for line in true:
        present = line >= 0
        slope = np.polyfit(rows_px[present], line[present], 1)[0] if np.count_nonzero(present) > 1 else 0.0
        tolerance_px = ROW_MATCH_PX / np.cos(np.arctan(slope))
        close = np.abs(np.where(present, line, -100.0) - np.where(predicted >= 0, predicted, -100.0)) < tolerance_px
        best.append(float(np.max(close.mean(axis=1))) if len(predicted) else 0.0)
    missed = sum(accuracy < ROW_SHARE for accuracy in best)
    false_positive = (len(predicted) - (len(true) - missed)) / max(1, len(predicted))
    # More than four lines: the worst is forgiven, and the sum is still divided by four.
    forgiven = len(true) > 4
    total = sum(best) - (min(best) if forgiven else 0.0)
    counted = max(1, min(4, len(true)))
    return total / counted, false_positive, max(0, missed - forgiven) / counted
