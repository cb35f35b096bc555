"""The score of OpenLane's 3D benchmark. Frame: its ground frame, metres."""

from collections.abc import Sequence

from synth3dlanes.formats.line_score import (
    HALF_WIDTH_M,
    Frames,
    Line3d,
    LineTally,
    SampledLine,
    Score3d,
    ScoreRules,
    add_frame,
    sample_line,
)
from synth3dlanes.formats.line_score import prune as prune_line

RULES = ScoreRules(absent_m=0.0, missing_m=float("nan"), least_cost=1.0)


def score(frames: Frames) -> Score3d:
    """The evaluator over all frames; it prunes ground truth and prediction alike and has no AP."""
    tally = LineTally()
    for true, predicted in frames:
        add_frame(tally, _sampled(true), _sampled(predicted), RULES)
    return tally.score()


def prune(line: Line3d) -> Line3d | None:
    """What the evaluator keeps of a line."""
    return prune_line(line, HALF_WIDTH_M)


def _sampled(lines: Sequence[Line3d]) -> list[SampledLine]:
    sampled = [sample_line(line) for line in map(prune, lines) if line is not None]
    return [line for line in sampled if line.seen.sum() > 1]
