"""The score of the ONCE-3DLanes benchmark, from its description alone. Frame `_cv`, metres."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw
from scipy.optimize import linear_sum_assignment

from synth3dlanes.geometry.polylines import resampled
from synth3dlanes.system.arrays import Polyline3

RASTER_M = 10.0
RASTER_PX_PER_M = 10
RASTER_WIDTH_PX = 5
MATCH_M = 0.3
N_POINTS = 10


@dataclass(frozen=True)
class OnceScore:
    """F1, precision, recall, and the mean distance of matched lines (NaN without any)."""

    f_score: float
    recall: float
    precision: float
    distance_m: float


def score(frames: Sequence[tuple[Sequence[Polyline3], Sequence[Polyline3]]]) -> OnceScore:
    """Lines are paired by overlap in a bird's-eye raster of the first 10 m, those without any in the order of the list,
    then matched within 0.3 m in 3D."""
    n_true = sum(len(true) for true, _ in frames)
    n_predicted = sum(len(predicted) for _, predicted in frames)
    distances_m = []
    for true, predicted in frames:
        overlaps = np.array([[_overlap(_raster(a), _raster(b)) for b in predicted] for a in true])
        overlaps = overlaps.reshape(len(true), len(predicted))
        in_order = -1e-6 * np.abs(np.subtract.outer(np.arange(len(true)), np.arange(len(predicted))))
        rows, columns = linear_sum_assignment(overlaps + in_order, maximize=True)
        distances_m += [_distance_m(true[i], predicted[j]) for i, j in zip(rows, columns, strict=True)]
    matched_m = [distance_m for distance_m in distances_m if distance_m < MATCH_M]
    recall, precision = len(matched_m) / max(1, n_true), len(matched_m) / max(1, n_predicted)
    f_score = 2 * recall * precision / (recall + precision) if matched_m else 0.0
    return OnceScore(f_score, recall, precision, float(np.mean(matched_m)) if matched_m else float("nan"))


def _raster(points_cv: Polyline3) -> Image.Image:
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


def _distance_m(true_cv: Polyline3, predicted_cv: Polyline3) -> float:
    points_cv = resampled(true_cv, N_POINTS)
    starts_cv, steps_cv = predicted_cv[:-1], np.diff(predicted_cv, axis=0)
    lengths2_m2 = np.maximum(np.sum(steps_cv**2, axis=1), 1e-12)
    along = np.clip(np.sum((points_cv[:, None] - starts_cv) * steps_cv, axis=2) / lengths2_m2, 0, 1)
    nearest_cv = starts_cv + along[..., None] * steps_cv
    return float(np.linalg.norm(points_cv[:, None] - nearest_cv, axis=2).min(axis=1).mean())
