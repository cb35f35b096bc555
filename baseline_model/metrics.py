"""The paper's metric (section 4.3): average precision, and errors near and far at 1 and 2 sigma. Numpy only.

Every choice that the paper leaves open is in `MetricConfig` and printed with the result.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from synth3dlanes.labels.labels import Labels, LaneKind

from .curves import METRIC_Y_M, plane_pose, road_curves, road_from_cam
from .lanes import Detection, Prediction
from .matching import (
    Pairs,
    Weights,
    count_steps,
    find_pairs,
    match,
    point_weights,
    sample_detections,
    sample_truth,
)

KINDS: tuple[LaneKind, ...] = ("centerline", "delimiter")
NEAR_TO_M = 30.0


@dataclass(frozen=True)
class MetricConfig:
    """`threshold` is the score at which errors, recall and precision are computed. `frame`: `camera` transforms
    detections to the road by the labels' pose, `road_raw` by the predicted pose."""

    weights: Weights = "linear"
    alternatives: tuple[Weights, ...] = ("uniform", "exponential")
    threshold: float = 0.5
    frame: Literal["camera", "road_raw"] = "camera"
    bootstraps: int = 300

    @property
    def all_weights(self) -> tuple[Weights, ...]:
        """Every weighting of knots that is evaluated, that of the reported AP first."""
        return (self.weights, *self.alternatives)


@dataclass(frozen=True)
class Errors:
    """Errors of matched lanes at one threshold, in centimetres; NaN without matches."""

    threshold: float
    precision: float
    recall: float
    f1: float
    near_1sigma_cm: float
    near_2sigma_cm: float
    far_1sigma_cm: float
    far_2sigma_cm: float
    near_median_abs_dx_cm: float
    near_median_abs_dz_cm: float
    far_median_abs_dx_cm: float
    far_median_abs_dz_cm: float
    bias_dx_cm: float
    bias_dz_cm: float


@dataclass(frozen=True, eq=False)
class KindReport:
    """One kind of lane: AP with its 95 % bootstrap interval over images, errors at three operating points."""

    ap: float
    ap_interval: tuple[float, float]
    ap_101_points: float
    ap_by_weights: dict[str, float]
    n_truth: int
    n_ignored: int
    n_outside: int
    """Detections beyond the metric's region (`DetectedLanes.off_region`), which are no false positives."""
    n_detections: int
    at_threshold: Errors
    at_best_f1: Errors
    at_all: Errors
    recalls: Float[np.ndarray, " r"]
    precisions: Float[np.ndarray, " r"]
    error_by_y_cm: Float[np.ndarray, "2 y"]


@dataclass(frozen=True)
class SampleScore:
    """One image: F1 of its centre lines and delimiters at the threshold (1 without lanes and detections), and the mean
    error of matched lanes in centimetres, NaN without."""

    key: str
    f1: float
    error_cm: float


@dataclass(frozen=True, eq=False)
class EvaluationReport:
    """A whole evaluation; pose medians are NaN if no pose was predicted. `samples` are sorted, the worst first."""

    n_images: int
    config: MetricConfig
    kinds: dict[str, KindReport]
    pitch_median_deg: float
    height_median_cm: float
    samples: tuple[SampleScore, ...]
    tusimple: tuple[float, float, float] | None = None
    """The tuSimple benchmark's accuracy, false positive and false negative rate, for its label files."""


@dataclass
class Evaluation:
    """Accumulates images: call `add` for each, then `report`."""

    config: MetricConfig = MetricConfig()
    _pairs: dict[str, list[Pairs]] = field(default_factory=lambda: {kind: [] for kind in KINDS})
    _steps: dict[tuple[str, str], list[tuple[int, float, int, int]]] = field(default_factory=dict)
    _pose_errors: list[tuple[float, float]] = field(default_factory=list)
    _scores: list[SampleScore] = field(default_factory=list)
    _n_images: int = 0

    def add(self, labels: Labels, prediction: Prediction) -> None:
        """Compare one image's detections with its labels."""
        plane = plane_pose(labels)
        pose = prediction.pose
        if pose is not None:
            self._pose_errors.append((abs(pose.pitch_rad - plane.pitch_rad), abs(pose.height_m - plane.height_m)))
        to_road = labels.camera.road_from_cam
        if self.config.frame == "road_raw" and pose is not None:
            to_road = road_from_cam(pose)
        curves = road_curves(labels)
        for kind in KINDS:
            truth = sample_truth(tuple(curve for curve in curves if curve.kind == kind))
            lanes: list[Detection] = [lane for lane in prediction.lanes if lane.kind == kind]
            found = sample_detections(lanes, to_road)
            for name in self.config.all_weights:
                pairs = find_pairs(truth, found, point_weights(name))
                steps = self._steps.setdefault((kind, name), [])
                steps += [(self._n_images, *step) for step in count_steps(pairs)]
                if name == self.config.weights:
                    self._pairs[kind].append(pairs)
        pairs_of_image = [self._pairs[kind][-1] for kind in KINDS]
        self._scores.append(_sample_score(prediction.key, pairs_of_image, self.config.threshold))
        self._n_images += 1

    def report(self) -> EvaluationReport:
        """The numbers over all images added."""
        medians = np.median(self._pose_errors, axis=0) if self._pose_errors else np.full(2, np.nan)
        return EvaluationReport(
            n_images=self._n_images,
            config=self.config,
            kinds={kind: self._kind_report(kind) for kind in KINDS},
            pitch_median_deg=float(np.degrees(medians[0])),
            height_median_cm=float(100 * medians[1]),
            samples=tuple(sorted(self._scores, key=lambda one: (one.f1, -np.nan_to_num(one.error_cm), one.key))),
        )

    def _kind_report(self, kind: str) -> KindReport:
        images = self._pairs[kind]
        truth_per_image = np.array([pairs.n_truth for pairs in images], dtype=int)
        curves = {name: Counts.of(self._steps.get((kind, name), [])) for name in self.config.all_weights}
        counts = curves[self.config.weights]
        n_truth = int(truth_per_image.sum())
        recalls, precisions = counts.curve(n_truth)
        f1 = 2 * recalls * precisions / np.maximum(recalls + precisions, 1e-12)
        best = float(counts.thresholds[np.argmax(f1)]) if len(f1) else self.config.threshold
        lowest = float(counts.thresholds[-1]) if len(f1) else 0.0
        return KindReport(
            ap=counts.ap(n_truth),
            ap_interval=bootstrap_interval(counts, truth_per_image, self.config.bootstraps),
            ap_101_points=ap_at_101_points(recalls, precisions) if n_truth else float("nan"),
            ap_by_weights={name: other.ap(n_truth) for name, other in curves.items()},
            n_truth=n_truth,
            n_ignored=sum(pairs.n_ignored for pairs in images),
            n_outside=sum(pairs.n_outside for pairs in images),
            n_detections=sum(len(pairs.score) for pairs in images),
            at_threshold=_errors(images, self.config.threshold),
            at_best_f1=_errors(images, best),
            at_all=_errors(images, lowest),
            recalls=recalls,
            precisions=precisions,
            error_by_y_cm=_error_by_y(images, self.config.threshold),
        )


@dataclass(frozen=True, eq=False)
class Counts:
    """Changes of true and false positives over all images, by decreasing threshold; `last` indexes the final one of
    each run of equal scores, since ties are counted together."""

    image: Int[np.ndarray, " s"]
    true: Float[np.ndarray, " s"]
    false: Float[np.ndarray, " s"]
    last: Int[np.ndarray, " r"]
    thresholds: Float[np.ndarray, " r"]

    @staticmethod
    def of(steps: list[tuple[int, float, int, int]]) -> "Counts":
        """Sort the steps of all images into one sequence."""
        table = np.array(steps, dtype=float).reshape(-1, 4)
        table = table[np.argsort(-table[:, 1], kind="stable")]
        last = np.flatnonzero(np.append(np.diff(table[:, 1]) != 0, True)) if len(table) else np.zeros(0, dtype=int)
        return Counts(table[:, 0].astype(int), table[:, 2], table[:, 3], last, table[last, 1])

    def curve(
        self, n_truth: int, times: Int[np.ndarray, " i"] | None = None
    ) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, " r"]]:
        """Recall and precision at each threshold; `times` is how often each image counts (bootstrap)."""
        factor = 1.0 if times is None else times[self.image]
        true = np.cumsum(self.true * factor)[self.last]
        false = np.cumsum(self.false * factor)[self.last]
        return true / max(n_truth, 1), true / np.maximum(true + false, 1e-12)

    def ap(self, n_truth: int, times: Int[np.ndarray, " i"] | None = None) -> float:
        """Average precision; NaN without labelled lanes, since recall is undefined then."""
        return average_precision(*self.curve(n_truth, times)) if n_truth else float("nan")


def average_precision(recalls: Float[np.ndarray, " r"], precisions: Float[np.ndarray, " r"]) -> float:
    """Area under the precision envelope, from recall 0 to the largest recall."""
    order = np.argsort(recalls, kind="stable")
    envelope = np.maximum.accumulate(precisions[order][::-1])[::-1]
    return float(np.sum(np.diff(recalls[order], prepend=0.0) * envelope))


def ap_at_101_points(recalls: Float[np.ndarray, " r"], precisions: Float[np.ndarray, " r"]) -> float:
    """COCO's variant: the envelope's mean at recalls 0, 0.01, ..., 1."""
    wanted = np.linspace(0, 1, 101)[:, None]
    return float(np.where(recalls[None] >= wanted - 1e-12, precisions[None], 0.0).max(1, initial=0.0).mean())


def bootstrap_interval(counts: Counts, truth_per_image: Int[np.ndarray, " i"], n_draws: int) -> tuple[float, float]:
    """95 % bootstrap interval of AP over images, with a fixed seed, so that reports are reproducible."""
    if not truth_per_image.sum() or not n_draws:
        return (float("nan"), float("nan"))
    rng = np.random.default_rng(0)
    n_images = len(truth_per_image)
    draws = []
    for _ in range(n_draws):
        times = np.bincount(rng.integers(0, n_images, n_images), minlength=n_images)
        draws.append(counts.ap(int(truth_per_image @ times), times))
    low, high = np.nanpercentile(draws, [2.5, 97.5])
    return (float(low), float(high))


def _errors(images: list[Pairs], threshold: float) -> Errors:
    n_true, n_false, n_truth, dx_m, dz_m = _matched(images, threshold)
    precision = n_true / (n_true + n_false) if n_true + n_false else float("nan")
    recall = n_true / n_truth if n_truth else float("nan")
    error_m = np.hypot(dx_m, dz_m)
    is_near = METRIC_Y_M <= NEAR_TO_M

    figures = {"bias_dx_cm": _percentile_cm(dx_m, 50.0), "bias_dz_cm": _percentile_cm(dz_m, 50.0)}
    for name, part in (("near", is_near), ("far", ~is_near)):
        figures[f"{name}_1sigma_cm"] = _percentile_cm(error_m[:, part], 68.0)
        figures[f"{name}_2sigma_cm"] = _percentile_cm(error_m[:, part], 95.0)
        figures[f"{name}_median_abs_dx_cm"] = _percentile_cm(np.abs(dx_m[:, part]), 50.0)
        figures[f"{name}_median_abs_dz_cm"] = _percentile_cm(np.abs(dz_m[:, part]), 50.0)
    f1 = 2 * n_true / (n_true + n_false + n_truth) if n_true + n_false + n_truth else float("nan")
    return Errors(threshold=threshold, precision=precision, recall=recall, f1=f1, **figures)


def _sample_score(key: str, kinds: list[Pairs], threshold: float) -> SampleScore:
    n_true, n_false, n_truth, dx_m, dz_m = _matched(kinds, threshold)
    n_all = n_true + n_false + n_truth
    error_m = np.hypot(dx_m, dz_m)
    error_m = error_m[~np.isnan(error_m)]
    error_cm = round(100 * float(error_m.mean()), 3) if len(error_m) else float("nan")
    return SampleScore(key, round(2 * n_true / n_all, 6) if n_all else 1.0, error_cm)


def _matched(
    images: list[Pairs], threshold: float
) -> tuple[int, int, int, Float[np.ndarray, "m y"], Float[np.ndarray, "m y"]]:
    """The numbers of true and false positives and of labelled lanes, and the errors of matched ones, x and z."""
    n_true = n_false = 0
    dx_m = [np.zeros((0, len(METRIC_Y_M)), dtype=np.float32)]
    dz_m = dx_m.copy()
    for pairs in images:
        accepted = match(pairs, threshold)
        is_false = (pairs.score >= threshold) & ~pairs.forgiven
        is_false[pairs.detection[accepted]] = False
        n_true, n_false = n_true + len(accepted), n_false + np.count_nonzero(is_false)
        dx_m.append(pairs.dx_m[accepted])
        dz_m.append(pairs.dz_m[accepted])
    return n_true, n_false, sum(pairs.n_truth for pairs in images), np.concatenate(dx_m), np.concatenate(dz_m)


def _percentile_cm(values_m: Float[np.ndarray, "*n"], percent: float) -> float:
    finite = values_m[~np.isnan(values_m)]
    return float(100 * np.percentile(finite, percent)) if len(finite) else float("nan")


def _error_by_y(images: list[Pairs], threshold: float) -> Float[np.ndarray, "2 y"]:
    error_m = np.hypot(*_matched(images, threshold)[3:])
    columns = [[_percentile_cm(error_m[:, k], percent) for k in range(len(METRIC_Y_M))] for percent in (68.0, 95.0)]
    return np.array(columns)
