"""The score of the Gen-LaneNet benchmark (Apollo Sim-3D). Frame: its ground frame, metres."""

import numpy as np

from synth3dlanes.formats.line_score import (
    MATCH_M,
    Frames,
    Line3d,
    LineTally,
    Score3d,
    ScoreRules,
    add_frame,
    sample_line,
)
from synth3dlanes.formats.line_score import prune as prune_line

RULES = ScoreRules(absent_m=MATCH_M, missing_m=MATCH_M, least_cost=0.0)
HALF_WIDTH_M = 30.0
CONFIDENT = 0.5
THRESHOLDS = np.linspace(0.05, 0.95, 19)


def score(frames: Frames) -> Score3d:
    """The evaluator over all frames; predictions of a probability above 0.5 count, the AP looks at 19 thresholds."""
    curve = [_tally(frames, threshold).rates() for threshold in THRESHOLDS]
    return _tally(frames, CONFIDENT).score(_average_precision(curve))


def prune(line: Line3d) -> Line3d | None:
    """What the evaluator keeps of a true line; it prunes no prediction."""
    return prune_line(line, HALF_WIDTH_M)


def _tally(frames: Frames, threshold: float) -> LineTally:
    tally = LineTally()
    for true, predicted in frames:
        kept = [sample_line(line) for line in map(prune, true) if line is not None]
        confident = [sample_line(line) for line in predicted if line.probability > threshold]
        add_frame(tally, kept, confident, RULES)
    return tally


def _average_precision(curve: list[tuple[float, float]]) -> float:
    # Ends fixed at (R 0, P 1) and (R 1, P 0), each after measured points of equal recall: hence 0.5 for no match
    # at all and 1 for a perfect one.
    ends = [(0.0, 1.0), (1.0, 0.0)]
    recalls, precisions = np.array(sorted(curve + ends, key=lambda point: (point[0], point in ends))).T
    below = np.searchsorted(recalls, THRESHOLDS, side="left") - 1
    r0, r1, p0, p1 = recalls[below], recalls[below + 1], precisions[below], precisions[below + 1]
    return float(np.mean(p0 + (p1 - p0) * (THRESHOLDS - r0) / (r1 - r0)))
