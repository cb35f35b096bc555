"""The scores of traffic elements of OpenLane-V2's benchmark, from its description: DET_t and TOP_lt; and the whole
score, OLS. A prediction is a frame as the ground truth; its lanes and elements count in their order, the first most."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tests.formats.openlane_v2_score import (
    LOST,
    THRESHOLDS_M,
    LanePolylines,
    LaneTopology,
    _average_precision,
    _distances_m,
    _matches,
    _vertex_precision,
    score,
)

N_ATTRIBUTES, LEAST_IOU = 13, 0.25


@dataclass(frozen=True, eq=False)
class MapFrame:
    """A frame: its lanes, which follows which, its elements as (attribute, rectangle), and which governs which lane."""

    lanes: tuple[LanePolylines, ...]
    follows: Float[np.ndarray, "n n"]
    elements: tuple[tuple[int, Float[np.ndarray, "4"]], ...]
    governs: Float[np.ndarray, "n t"]


@dataclass(frozen=True)
class MapScore:
    """The four parts of the score."""

    det_l: float
    det_t: float
    top_ll: float
    top_lt: float

    @property
    def ols(self) -> float:
        return float(np.mean([self.det_l, self.det_t, np.sqrt(self.top_ll), np.sqrt(self.top_lt)]))


def map_score(frames: Sequence[tuple[MapFrame, MapFrame]]) -> MapScore:
    """Each frame is ground truth and prediction."""
    lanes = score([tuple(LaneTopology(one.lanes, one.follows) for one in pair) for pair in frames])
    return MapScore(lanes.det_l, _det_t(frames), lanes.top_ll, _top_lt(frames))


def _gaps(true: MapFrame, predicted: MapFrame) -> Float[np.ndarray, "t p"]:
    """One minus the intersection over union of all rectangles."""
    found = np.zeros((len(true.elements), len(predicted.elements)))
    for i, (_, a) in enumerate(true.elements):
        for j, (_, b) in enumerate(predicted.elements):
            both = np.prod(np.clip(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0, None))
            found[i, j] = 1 - both / (np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - both)
    return found


def _det_t(frames: Sequence[tuple[MapFrame, MapFrame]]) -> float:
    """The mean average precision over all attributes, also those that no frame has."""
    precisions = []
    for attribute in range(N_ATTRIBUTES):
        right, n_true = [np.zeros(0, dtype=bool)], 0
        for true, predicted in frames:
            own = [[i for i, (of, _) in enumerate(one.elements) if of == attribute] for one in (true, predicted)]
            gaps = _gaps(true, predicted)[np.ix_(*own)]
            right.append(_matches(gaps, 1 - LEAST_IOU) >= 0)
            n_true += len(own[0])
        precisions.append(_average_precision(np.concatenate(right), n_true))
    return float(np.mean(precisions))


def _top_lt(frames: Sequence[tuple[MapFrame, MapFrame]]) -> float:
    """The mean over the lanes and the elements of all frames that have both; 0 without such frames."""
    found: list[float] = []
    for threshold_m in THRESHOLDS_M:
        for true, predicted in frames:
            if 0 in true.governs.shape:
                continue
            guess = (1 - true.governs) * LOST
            matches = (
                _matches(_distances_m(true.lanes, predicted.lanes), threshold_m),
                _matches(_gaps(true, predicted), 1 - LEAST_IOU),
            )
            rows, columns = (np.flatnonzero(match >= 0) for match in matches)
            guess[np.ix_(matches[0][rows], matches[1][columns])] = predicted.governs[np.ix_(rows, columns)]
            pairs = [*zip(true.governs, guess, strict=True), *zip(true.governs.T, guess.T, strict=True)]
            found += [_vertex_precision(row > 0, own) for row, own in pairs]
    return float(np.mean(found)) if found else 0.0
