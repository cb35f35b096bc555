"""Score predictions for an export by the rule of its benchmark: `evaluate --format`. The scores are made from the
descriptions of the evaluators alone.

CULane's and CurveLanes' compares lines as wide bands of pixels. Gen-LaneNet's (Apollo) and OpenLane's sample every 3D
line at y = 3..102 m and call a pair's sample matched within 1.5 m; frame: each benchmark's ground frame (x right, y
forward, z up), metres.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import scipy
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw

from synth3dlanes.formats.format import FrameList, Rates, ReadFrame, open_format
from synth3dlanes.formats.reading import json_lines
from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.system.arrays import MaskImage, Polyline2, Polyline3
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.schema import Excerpt, parse

EVERY = 10**9

Scores = Mapping[str, float]
"""The numbers of a benchmark by name; NaN where one is not defined."""
Prediction = TypeVar("Prediction")
Line = TypeVar("Line", bound=Excerpt)


def score_predictions(out: Path, format_name: str, predictions: Path) -> tuple[Rates, ...]:
    """The rates of each list of an export that the predictions, a file or a folder as the benchmark takes it, are for.
    Raises InputError for a format that has no benchmark, FormatError for predictions that cannot be read or that lack
    a frame."""
    foreign = open_format(format_name)
    if foreign.score is None:
        raise InputError(f"format_name: expected a format with a benchmark that can be scored here, got {format_name}")
    found = tuple(foreign.score(out, predictions))
    if not found:
        raise FormatError(f"{predictions}: expected predictions for the frames of {out}, got none")
    return found


def predicted(
    lists: Iterable[FrameList], find: Callable[[ReadFrame], Prediction | None], predictions: Path
) -> Iterator[tuple[str, list[tuple[ReadFrame, Prediction]]]]:
    """The frames of each list with their predictions. Lists of which no frame has any are left out; one without them in
    another list is a FormatError."""
    for frames in lists:
        found = [(frame, find(frame)) for frame in frames.frames]
        both = [(frame, prediction) for frame, prediction in found if prediction is not None]
        if both and len(both) < len(found):
            lacking = next(frame.file for frame, prediction in found if prediction is None)
            expected = f"predictions for the {len(found)} frames of {frames.name}"
            raise FormatError(f"{predictions}: expected {expected}, got {len(both)}, none for {lacking}")
        if both:
            yield frames.name, both


def scored(
    lists: Iterable[FrameList],
    of_frame: Callable[[ReadFrame], Prediction | None],
    benchmark: Callable[[list[Prediction]], Scores],
    predictions: Path,
) -> Iterator[Rates]:
    """The rates of each list by what `of_frame` gives for its frames, such as the true and the predicted lines; None
    for a frame without a prediction."""
    for name, frames in predicted(lists, of_frame, predictions):
        yield rates(name, len(frames), benchmark([found for _, found in frames]))


def lines_by(path: Path, model: type[Line], key: str) -> dict[str, Line]:
    """The documents of a JSON-lines file of predictions, by one of their values."""
    found = [parse(model, line, f"{path}:{i}", "a prediction") for i, line in enumerate(json_lines(path), start=1)]
    return {getattr(line, key): line for line in found}


def rates(name: str, n_frames: int, scores: Scores) -> Rates:
    """The scores of a list of frames, without those that are not defined."""
    return Rates(name, n_frames, {key: value for key, value in scores.items() if value == value})


def f_score(n_matched: int, frames: Sequence[tuple[Sequence[Any], Sequence[Any]]]) -> dict[str, float]:
    """F1, recall and precision of frames of (ground truth, prediction); 0 where nothing matches."""
    recall, precision = (n_matched / max(1, sum(len(pair[i]) for pair in frames)) for i in (0, 1))
    f1 = 2 * recall * precision / (recall + precision) if n_matched else 0.0
    return {"f_score": f1, "recall": recall, "precision": precision}


STEPS = 50


@dataclass(frozen=True)
class Canvas:
    """What the bands are drawn on, their width, and the overlap (IoU) from which on two of them match."""

    width_px: int
    height_px: int
    band_px: int
    iou: float


def band_score(frames: Sequence[tuple[Sequence[Polyline2], Sequence[Polyline2]]], canvas: Canvas) -> Scores:
    """Frames of (ground truth, prediction); pairs are those of the greatest overlap in all."""
    n_matched = sum(_matched(true, predicted, canvas) for true, predicted in frames)
    return f_score(n_matched, frames)


def _matched(true: Sequence[Polyline2], predicted: Sequence[Polyline2], canvas: Canvas) -> int:
    found = overlaps(*([_band(line, canvas) for line in lines] for lines in (true, predicted)))
    pairs = scipy.optimize.linear_sum_assignment(found, maximize=True)
    return int(np.count_nonzero(found[pairs] > canvas.iou))


def _band(line: Polyline2, canvas: Canvas) -> MaskImage:
    """The pixels of a line: a natural cubic spline through its points, drawn as OpenCV does: between whole pixels, half
    the width to either side of the middle one, with round ends."""
    points = np.rint(_spline(line) if len(line) > 2 else line)
    image = Image.new("1", (canvas.width_px, canvas.height_px))
    draw, half_px = ImageDraw.Draw(image), canvas.band_px // 2
    corners = [(float(x), float(y)) for x, y in points]
    draw.line(corners, fill=1, width=2 * half_px + 1, joint="curve")
    for x, y in (corners[0], corners[-1]):
        draw.ellipse((x - half_px, y - half_px, x + half_px, y + half_px), fill=1)
    return np.asarray(image)


def _spline(line: Polyline2) -> Polyline2:
    knots_px = lengths_along(line)
    at_px = np.interp(np.arange(STEPS * (len(line) - 1) + 1) / STEPS, np.arange(len(line)), knots_px)
    return np.asarray(scipy.interpolate.CubicSpline(knots_px, line, bc_type="natural")(at_px))


def overlaps(true: Sequence[MaskImage], predicted: Sequence[MaskImage]) -> Float[np.ndarray, "t p"]:
    """The overlap (IoU) of each true mask with each predicted one."""
    shares = [np.count_nonzero(a & b) / max(1, np.count_nonzero(a | b)) for a in true for b in predicted]
    return np.array(shares).reshape(len(true), len(predicted))


SAMPLES_Y_M = np.arange(3.0, 103.0)
NEAR = SAMPLES_Y_M <= 40.0
HALF_WIDTH_M = 10.0
LOADED_Y_M = 200.0
MATCH_M = 1.5
MATCHED_SHARE = 0.75
ERRORS = ("x_near_m", "x_far_m", "z_near_m", "z_far_m")


@dataclass(frozen=True, eq=False)
class Line3d:
    """A ground-truth line (with visibility) or a predicted one (all visible, with its probability)."""

    points_ground: Polyline3
    visible: Bool[np.ndarray, " _"]
    category: int = 0
    probability: float = 1.0

    @classmethod
    def whole(cls, points_ground: Polyline3, category: int = 0, probability: float = 1.0) -> "Line3d":
        """A line that is visible everywhere."""
        return cls(points_ground, np.ones(len(points_ground), dtype=bool), category, probability)


LinePair = tuple[Sequence[Line3d], Sequence[Line3d]]
"""Ground truth and prediction of a frame."""
Frames = Sequence[LinePair]


@dataclass(frozen=True)
class ScoreRules:
    """Where the two benchmarks differ: what a sample costs that neither line has, the error of a near or far part that
    a pair does not have, and the least cost of a pair that is not identical; how far beside the axis true lines may be.
    Gen-LaneNet's predictions have probabilities, which give an AP; OpenLane's are pruned like true lines."""

    absent_m: float
    missing_m: float
    least_cost: float
    half_width_m: float
    has_probabilities: bool


GEN_LANENET = ScoreRules(MATCH_M, MATCH_M, 0.0, half_width_m=30.0, has_probabilities=True)
OPENLANE = ScoreRules(0.0, float("nan"), 1.0, half_width_m=HALF_WIDTH_M, has_probabilities=False)
CONFIDENT = 0.5
THRESHOLDS = np.linspace(0.05, 0.95, 19)


@dataclass(frozen=True, eq=False)
class SampledLine:
    """A line at `SAMPLES_Y_M`; `seen` where it exists within 10 m beside the axis."""

    x_m: Float[np.ndarray, " y"]
    z_m: Float[np.ndarray, " y"]
    seen: Bool[np.ndarray, " y"]
    category: int


@dataclass
class LineTally:
    """Counts and errors (ERRORS) of pairs over many frames."""

    n_true: int = 0
    n_predicted: int = 0
    recalled: int = 0
    precise: int = 0
    same_category: int = 0
    errors_m: list[Float[np.ndarray, " 4"]] = field(default_factory=list)

    def rates(self) -> tuple[float, float]:
        """Recall and precision."""
        return self.recalled / max(1, self.n_true), self.precise / max(1, self.n_predicted)

    def score(self, ap: float = np.nan) -> Scores:
        """Rates, and the errors' means over all pairs that have them."""
        recall, precision = self.rates()
        columns = np.array(self.errors_m).reshape(-1, len(ERRORS)).T
        known = [column[~np.isnan(column)] for column in columns]
        return {
            "f_score": 2 * recall * precision / (recall + precision + 1e-6),
            "recall": recall,
            "precision": precision,
            "ap": ap,
            "category_accuracy": self.same_category / len(self.errors_m) if self.errors_m else np.nan,
            **{
                name: float(np.mean(errors)) if len(errors) else np.nan
                for name, errors in zip(ERRORS, known, strict=True)
            },
        }


def line_score(frames: Frames, rules: ScoreRules) -> Scores:
    """The evaluator over all frames, in the benchmark's ground frame. Where predictions have probabilities, those above
    0.5 count, and the AP (Gen-LaneNet's) looks at 19 thresholds. OpenLane has the accuracy of categories."""
    if not rules.has_probabilities:
        return _tally(frames, rules).score()
    curve = [_tally(frames, rules, threshold).rates() for threshold in THRESHOLDS]
    return _tally(frames, rules, CONFIDENT).score(_average_precision(curve))


def _tally(frames: Frames, rules: ScoreRules, threshold: float = -np.inf) -> LineTally:
    tally = LineTally()
    for true, predicted in frames:
        confident = [line for line in predicted if line.probability > threshold]
        if rules.has_probabilities:
            found = [sample_line(line) for line in confident]
        else:
            found = [line for line in _pruned(confident, rules) if line.seen.sum() > 1]
        kept = [line for line in _pruned(true, rules) if rules.has_probabilities or line.seen.sum() > 1]
        add_frame(tally, kept, found, rules)
    return tally


def _pruned(lines: Sequence[Line3d], rules: ScoreRules) -> list[SampledLine]:
    return [sample_line(kept) for line in lines if (kept := prune(line, rules)) is not None]


def _average_precision(curve: list[tuple[float, float]]) -> float:
    # Ends fixed at (R 0, P 1) and (R 1, P 0), each after measured points of equal recall: hence 0.5 for no match
    # at all and 1 for a perfect one.
    ends = [(0.0, 1.0), (1.0, 0.0)]
    recalls, precisions = np.array(sorted(curve + ends, key=lambda point: (point[0], point in ends))).T
    below = np.searchsorted(recalls, THRESHOLDS, side="left") - 1
    r0, r1, p0, p1 = recalls[below], recalls[below + 1], precisions[below], precisions[below + 1]
    return float(np.mean(p0 + (p1 - p0) * (THRESHOLDS - r0) / (r1 - r0)))


def prune(line: Line3d, rules: ScoreRules) -> Line3d | None:
    """The part of a line that an evaluator keeps: visible, within the bounds; None if it drops the line."""
    points_ground = line.points_ground[line.visible]
    if len(points_ground) < 2 or points_ground[0, 1] >= SAMPLES_Y_M[-1] or points_ground[-1, 1] <= SAMPLES_Y_M[0]:
        return None
    x_m, y_m, _ = points_ground.T
    points_ground = points_ground[(np.abs(x_m) < rules.half_width_m) & (y_m > 0) & (y_m < LOADED_Y_M)].copy()
    if len(points_ground) < 2:
        return None
    return Line3d.whole(points_ground, line.category, line.probability)


def sample_line(line: Line3d) -> SampledLine:
    """The line at the evaluator's samples."""
    assert len(line.points_ground) >= 2, "the evaluators cannot resample a line of one point"
    x_m, y_m, z_m = line.points_ground[np.argsort(line.points_ground[:, 1], kind="stable")].T
    sample_x_m = np.interp(SAMPLES_Y_M, y_m, x_m)
    start_m, end_m = y_m[0], y_m[-1]
    seen = (start_m <= SAMPLES_Y_M) & (end_m >= SAMPLES_Y_M) & (np.abs(sample_x_m) <= HALF_WIDTH_M)
    return SampledLine(sample_x_m, np.interp(SAMPLES_Y_M, y_m, z_m), seen, line.category)


def add_frame(
    tally: LineTally, true: Sequence[SampledLine], predicted: Sequence[SampledLine], rules: ScoreRules
) -> None:
    """Pair the lines of one frame at the least total cost, and count the pairs."""
    tally.n_true += len(true)
    tally.n_predicted += len(predicted)
    if not true or not predicted:
        return
    true_seen = np.stack([line.seen for line in true])[:, None]
    predicted_seen = np.stack([line.seen for line in predicted])[None]
    both = true_seen & predicted_seen
    dx_m = np.abs(np.stack([line.x_m for line in true])[:, None] - np.stack([line.x_m for line in predicted]))
    dz_m = np.abs(np.stack([line.z_m for line in true])[:, None] - np.stack([line.z_m for line in predicted]))
    distances_m = np.where(both, np.hypot(dx_m, dz_m), MATCH_M)
    distances_m = np.where(~true_seen & ~predicted_seen, rules.absent_m, distances_m)
    sums_m = distances_m.sum(axis=-1)
    costs = np.where(sums_m > 0, np.maximum(np.trunc(sums_m), rules.least_cost), 0.0)
    # The tiny share of the exact sum only decides between pairings whose whole costs are equal.
    for i, j in zip(*scipy.optimize.linear_sum_assignment(costs + 1e-6 * sums_m), strict=True):
        if costs[i, j] >= MATCH_M * len(SAMPLES_Y_M):
            continue
        n_matched = np.count_nonzero(both[i, j] & (distances_m[i, j] < MATCH_M))
        tally.recalled += bool(n_matched >= MATCHED_SHARE * max(1, true[i].seen.sum()))
        tally.precise += bool(n_matched >= MATCHED_SHARE * max(1, predicted[j].seen.sum()))
        tally.same_category += _is_same_category(true[i].category, predicted[j].category)
        parts = [(d_m, part) for d_m in (dx_m[i, j], dz_m[i, j]) for part in (both[i, j] & NEAR, both[i, j] & ~NEAR)]
        tally.errors_m.append(np.array([d_m[part].mean() if part.any() else rules.missing_m for d_m, part in parts]))


def _is_same_category(true: int, predicted: int) -> bool:
    # A right curb (21) may be found as a left one (20), not the other way round.
    return true == predicted or (true, predicted) == (21, 20)
