"""The lane scores of OpenLane-V2's benchmark, from its description: DET_l and TOP_ll. Vehicle frame (`_ego`), metres.

A lane is a tuple of polylines, (centre line,) or (centre line, left, right). Predictions count in their order, those of
the first frame first; a predicted connection is one above 0.5.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from synth3dlanes.system.arrays import Polyline3

LanePolylines = tuple[Polyline3, ...]

THRESHOLDS_M = (1.0, 2.0, 3.0)
RECALLS = np.arange(11) / 10
# Far lanes count as nearer than they are, by this share a metre, down to half.
RELAXED_PER_M, LEAST_RELAXED = 0.005, 0.5
# What the benchmark gives a connection between lanes that were not found: just more than it takes to be one.
LOST = 0.6


@dataclass(frozen=True, eq=False)
class LaneTopology:
    """The lanes of a frame, and which lane (column) follows which (row)."""

    lanes: tuple[LanePolylines, ...]
    follows: Float[np.ndarray, "n n"]


@dataclass(frozen=True)
class LaneScore:
    """Mean average precisions of lanes and of their connections, over the thresholds."""

    det_l: float
    top_ll: float


def score(frames: Sequence[tuple[LaneTopology, LaneTopology]]) -> LaneScore:
    """Each frame is ground truth and prediction."""
    distances_m = [_distances_m(true.lanes, predicted.lanes) for true, predicted in frames]
    precisions, connected = [], list[float]()
    for threshold_m in THRESHOLDS_M:
        matches = [_matches(frame_m, threshold_m) for frame_m in distances_m]
        is_right = np.concatenate([np.zeros(0, dtype=bool), *(match >= 0 for match in matches)])
        precisions.append(_average_precision(is_right, sum(len(true.lanes) for true, _ in frames)))
        for (true, predicted), match in zip(frames, matches, strict=True):
            connected += _connection_precisions(true, predicted, match)
    return LaneScore(float(np.mean(precisions)), float(np.mean(connected)) if connected else 0.0)


def frechet_m(a: Polyline3, b: Polyline3) -> float:
    """The discrete Frechet distance of two polylines."""
    between_m = cdist(a, b)
    reach_m = np.maximum.accumulate(between_m[0])
    for row_m in between_m[1:]:
        best_m = np.minimum(reach_m, np.concatenate([[np.inf], reach_m[:-1]]))
        last_m = np.inf
        for j, step_m in enumerate(row_m):
            last_m = best_m[j] = max(step_m, min(best_m[j], last_m))
        reach_m = best_m
    return float(reach_m[-1])


def chamfer_m(a: Polyline3, b: Polyline3) -> float:
    """The mean distance of the points of two polylines from the nearest point of the other."""
    between_m = cdist(a, b)
    return float(between_m.min(axis=0).mean() + between_m.min(axis=1).mean()) / 2


def _distances_m(true: Sequence[LanePolylines], predicted: Sequence[LanePolylines]) -> Float[np.ndarray, "t p"]:
    distances_m = np.full((len(true), len(predicted)), np.inf)
    for i, of_true in enumerate(true):
        relaxed = max(LEAST_RELAXED, 1 - RELAXED_PER_M * float(np.linalg.norm(of_true[0], axis=1).min()))
        for j, of_predicted in enumerate(predicted):
            if chamfer_m(of_true[0], of_predicted[0]) * relaxed < THRESHOLDS_M[-1]:
                distances_m[i, j] = relaxed * _distance_m(of_true, of_predicted)
    return distances_m


def _distance_m(true: LanePolylines, predicted: LanePolylines) -> float:
    middle_m = frechet_m(true[0], predicted[0])
    if len(true) == 1:
        return middle_m
    return (middle_m + sum(chamfer_m(a, b) for a, b in zip(true[1:], predicted[1:], strict=True))) / 2


def _matches(distances_m: Float[np.ndarray, "t p"], threshold_m: float) -> np.ndarray:
    """The true lane of each prediction, -1 for none: its nearest one, if no earlier prediction has it."""
    found = np.full(distances_m.shape[1], -1)
    if len(distances_m):
        for j, i in enumerate(distances_m.argmin(axis=0)):
            if distances_m[i, j] < threshold_m and i not in found:
                found[j] = i
    return found


def _average_precision(is_right: np.ndarray, n_true: int) -> float:
    if len(is_right) == n_true == 0:
        return 1.0
    right = np.cumsum(is_right)
    recall, precision = right / max(1, n_true), right / np.arange(1, len(is_right) + 1)
    return float(np.mean([precision[recall >= least].max(initial=0.0) for least in RECALLS]))


def _connection_precisions(true: LaneTopology, predicted: LaneTopology, match: np.ndarray) -> list[float]:
    """The average precision of what follows, and of what precedes, each true lane."""
    follows = (1 - true.follows) * LOST
    found = np.flatnonzero(match >= 0)
    follows[np.ix_(match[found], match[found])] = predicted.follows[np.ix_(found, found)]
    pairs = [*zip(true.follows, follows, strict=True), *zip(true.follows.T, follows.T, strict=True)]
    return [_vertex_precision(row > 0, guess) for row, guess in pairs]


def _vertex_precision(is_next: np.ndarray, guess: Float[np.ndarray, " n"]) -> float:
    ranked = is_next[np.argsort(-guess, kind="stable")][: np.count_nonzero(guess > 0.5)]
    if not len(ranked) or not is_next.any():
        return float(len(ranked) == np.count_nonzero(is_next))
    return float(np.sum(ranked * np.cumsum(ranked) / np.arange(1, len(ranked) + 1)) / np.count_nonzero(is_next))
