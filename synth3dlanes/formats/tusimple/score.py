"""The tuSimple benchmark's accuracy, from its description alone. Lines are columns (x) by row; below 0 is absent."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

MATCH_PX = 20.0
MATCHED_SHARE = 0.85
MAX_EXTRA = 2
MAX_COUNTED = 4
ABSENT_AT_PX = -100.0

Lines = Float[np.ndarray, "_ r"]
Rows = Float[np.ndarray, " r"]


@dataclass(frozen=True)
class TusimpleScore:
    """Row accuracy, false-positive and false-negative rate: of one frame, or their means over many."""

    accuracy: float
    false_positive: float
    false_negative: float


def score(frames: Sequence[tuple[Lines, Lines]], rows_px: Rows) -> TusimpleScore:
    """Means over frames of (ground truth, prediction)."""
    return mean_score([score_frame(true, predicted, rows_px) for true, predicted in frames])


def mean_score(scores: Sequence[TusimpleScore]) -> TusimpleScore:
    """Means over frames; NaN without any."""
    rates = [(one.accuracy, one.false_positive, one.false_negative) for one in scores]
    return TusimpleScore(*(map(float, np.mean(rates, axis=0)) if rates else (float("nan"),) * 3))


def score_frame(true: Lines, predicted: Lines, rows_px: Rows) -> TusimpleScore:
    """A row is right within 20 px / cos(angle of the true line), or where both lines are absent. Of more than four true
    lines the worst is left out. Frames that took longer than 200 ms score as no line would; time is not looked at here.
    """
    if len(predicted) > len(true) + MAX_EXTRA:
        return TusimpleScore(0.0, 0.0, 1.0)
    best = [_best_share(line, predicted, rows_px) for line in true]
    missed = sum(share < MATCHED_SHARE for share in best)
    false_positive = (len(predicted) - (len(true) - missed)) / max(1, len(predicted))
    # The sum is divided by four where a line was left out, too.
    is_forgiven = len(true) > MAX_COUNTED
    total = sum(best) - (min(best) if is_forgiven else 0.0)
    counted = max(1, min(MAX_COUNTED, len(true)))
    return TusimpleScore(total / counted, false_positive, max(0, missed - is_forgiven) / counted)


def _best_share(line: Rows, predicted: Lines, rows_px: Rows) -> float:
    present = line >= 0
    slope = np.polyfit(rows_px[present], line[present], 1)[0] if np.count_nonzero(present) > 1 else 0.0
    tolerance_px = MATCH_PX / np.cos(np.arctan(slope))
    gaps_px = np.abs(np.where(present, line, ABSENT_AT_PX) - np.where(predicted >= 0, predicted, ABSENT_AT_PX))
    return float(np.max((gaps_px < tolerance_px).mean(axis=1), initial=0.0))
