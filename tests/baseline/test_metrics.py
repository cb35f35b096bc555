"""The metric against answers known beforehand."""

import dataclasses

import numpy as np
import pytest
from synth3dlanes_baseline.metrics import Evaluation, MetricConfig, ap_at_101_points, average_precision

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.params.params import load_params
from synth3dlanes.truth.ground_truth import ground_truth
from tests.baseline import roads


def _evaluate(pairs, **changes):
    evaluation = Evaluation(MetricConfig(**{"bootstraps": 0, **changes}))
    for labels, prediction in pairs:
        evaluation.add(labels, prediction)
    return evaluation.report()


def _straight(*offsets_m):
    return [lambda y, x=x: (x, 0.0 * y) for x in offsets_m]


def _with_lanes(prediction, lanes):
    return dataclasses.replace(prediction, lanes=tuple(lanes))


@pytest.mark.parametrize("frame", ["camera", "road_raw"])
def test_sideways_shift_is_every_percentile(frame):
    # Straight roads along y: a sideways shift is then the distance at equal y, everywhere.
    labels = roads.labels(_straight(-3.5, 0.0, 3.5), _straight(-5.25, -1.75, 1.75, 5.25))
    report = _evaluate([(labels, roads.as_prediction(labels, shift_m=0.30))], frame=frame)
    for kind in report.kinds.values():
        errors = kind.at_threshold
        for value in (errors.near_1sigma_cm, errors.near_2sigma_cm, errors.far_1sigma_cm, errors.far_2sigma_cm):
            assert value == pytest.approx(30.0, abs=1e-3)
        assert errors.bias_dx_cm == pytest.approx(30.0, abs=1e-3)
        assert errors.bias_dz_cm == pytest.approx(0.0, abs=1e-3)
        assert kind.ap == pytest.approx(1.0)


ALL_FOUND, NAN = {"recall": 1, "precision": 1, "ap": 1, "n_ignored": 0, "n_outside": 0}, float("nan")


@pytest.mark.parametrize(
    ("true_m", "found", "expected"),
    [
        # Every second lane is missing; every lane has a weak duplicate.
        ((-6, -2, 2, 6), [(-6, 0.9), (2, 0.9)], ALL_FOUND | {"recall": 0.5, "ap": 0.5}),
        ((-3, 1), [(-3, 0.9), (1, 0.9), (-3, 0.6), (1, 0.6)], ALL_FOUND | {"precision": 0.5}),
        # Nothing is there to be found, or nothing is found.
        ((), [], {"ap": NAN, "recall": NAN, "precision": NAN}),
        ((), [(0, 0.9)], {"ap": NAN, "precision": 0}),
        ((0,), [], {"ap": 0, "recall": 0, "precision": NAN}),
        # Outside the top view: a label is ignored; a detection is not judged, but counted.
        ((11,), [(11, 0.9)], {"n_truth": 0, "n_ignored": 1, "precision": NAN}),
        ((0,), [(0, 0.9), (5, 0.8)], ALL_FOUND | {"precision": 0.5}),
        ((0,), [(0, 0.9), (10.2, 0.8)], ALL_FOUND | {"precision": 0.5}),
        ((0,), [(0, 0.9), (10.3, 0.8)], ALL_FOUND | {"n_outside": 1}),
        ((0,), [(0, 0.9), (-30, 0.8)], ALL_FOUND | {"n_outside": 1}),
        # Of two paths that coincide one is counted.
        ((0, 0.1), [(0, 0.9), (0.1, 0.8)], ALL_FOUND | {"n_truth": 1, "n_ignored": 1}),
        # The second is nearer to both labels, the first surer. By score, the first would take the left label from the
        # second and leave it the right one (two hits); by distance it finds nothing within reach.
        ((0, 2), [(-0.4, 0.95), (0.3, 0.55)], {"recall": 0.5}),
        # At 0.9 the sure one takes the only label. At 0.5 the nearer one does, and the sure one is a false alarm.
        (
            (0,),
            [(1, 0.9), (0.1, 0.5)],
            {"recalls": [1, 1], "precisions": [1, 0.5], "near_1sigma_cm": 10},
        ),
    ],
)
def test_straight_lanes_score_as_counted_by_hand(true_m, found, expected):
    labels, empty = roads.labels(_straight(*true_m)), roads.labels([])
    lanes = roads.as_prediction(roads.labels(_straight(*(x_m for x_m, _ in found)))).lanes
    scored = [dataclasses.replace(lane, score=score) for lane, (_, score) in zip(lanes, found, strict=True)]
    nothing = _with_lanes(roads.as_prediction(empty), [])
    kind = _evaluate([(labels, _with_lanes(nothing, scored)), (empty, nothing)]).kinds["centerline"]
    figures = vars(kind.at_threshold) | vars(kind)
    for name, value in expected.items():
        assert figures[name] == pytest.approx(value, abs=1e-3, nan_ok=True), name


@pytest.fixture
def scored_pairs():
    """Labels of random lanes, each with its lanes moved sideways, with scores at random, many of them equal."""
    rng = np.random.default_rng(5)
    pairs = []
    for _ in range(30):
        labels = roads.random(rng)
        found = roads.as_prediction(labels, shift_m=rng.uniform(-2, 2))
        lanes = [dataclasses.replace(lane, score=round(rng.uniform(0, 1), 1)) for lane in found.lanes]
        pairs.append((labels, _with_lanes(found, lanes)))
    return pairs


def test_order_of_images_and_lanes_does_not_matter(scored_pairs, rng):
    first = _evaluate(scored_pairs)
    shuffled = [
        (labels, _with_lanes(p, [p.lanes[i] for i in rng.permutation(len(p.lanes))]))
        for labels, p in reversed(scored_pairs)
    ]
    second = _evaluate(shuffled)
    for kind in ("centerline", "delimiter"):
        assert first.kinds[kind].ap == pytest.approx(second.kinds[kind].ap)
        assert first.kinds[kind].at_threshold == second.kinds[kind].at_threshold


def test_hidden_points_are_not_compared():
    labels = roads.labels(_straight(0.0), hidden=(30.0, 200.0))
    bent = dataclasses.replace(labels.lanes[0], xyz_cam=labels.lanes[0].xyz_cam.copy())
    bent.xyz_cam[32:, 0] += 50.0
    prediction = roads.as_prediction(dataclasses.replace(labels, lanes=(bent,)))
    centerline = _evaluate([(labels, prediction)]).kinds["centerline"]
    assert centerline.ap == pytest.approx(1.0)
    assert centerline.at_threshold.near_2sigma_cm == pytest.approx(0.0, abs=1e-3)
    assert np.isnan(centerline.at_threshold.far_1sigma_cm)


def test_points_missing_from_a_prediction_cost_the_match_distance():
    labels = roads.labels(_straight(0.0))
    whole = roads.as_prediction(labels)
    for shift_m, expected in ((1.45, 1.0), (1.55, 0.0)):
        half = [
            dataclasses.replace(lane, xyz_cam=lane.xyz_cam[:40] + np.array([shift_m, 0, 0])) for lane in whole.lanes
        ]
        centerline = _evaluate([(labels, _with_lanes(whole, half))]).kinds["centerline"]
        assert centerline.ap == expected
        if expected:
            assert centerline.at_threshold.far_2sigma_cm == pytest.approx(145.0, abs=1e-3)


def test_average_precision_by_hand():
    recalls, precisions = np.array([0.25, 0.25, 0.5, 0.75]), np.array([1.0, 0.5, 0.6, 0.75])
    assert average_precision(recalls, precisions) == pytest.approx(0.25 * 1.0 + 0.5 * 0.75)
    assert ap_at_101_points(recalls, precisions) == pytest.approx((26 * 1.0 + 50 * 0.75) / 101)


@pytest.mark.parametrize("n", [20, pytest.param(60, marks=pytest.mark.thorough)])
def test_generated_labels_as_predictions_are_perfect(n):
    """Splits, merges, crests and lanes that end: whatever the labels hold, they must not count against themselves."""
    params = load_params("appendix_i", ["cars.n=0", "trees.n=0"])
    many = [ground_truth(sample_scene(Scenes(params, 0, "test"), index)) for index in range(n)]
    report = _evaluate([(labels, roads.as_prediction(labels)) for labels in many])
    for kind in report.kinds.values():
        assert kind.ap == pytest.approx(1.0)
        assert kind.at_threshold.precision == 1.0
        assert kind.at_threshold.far_2sigma_cm == pytest.approx(0.0, abs=1e-3)


def test_bootstrap_interval_holds_the_value_and_repeats(scored_pairs):
    first, second = (_evaluate(scored_pairs, bootstraps=200).kinds["centerline"] for _ in range(2))
    low, high = first.ap_interval
    assert low < first.ap < high
    assert first.ap_interval == second.ap_interval


def test_samples_are_sorted_the_worst_first():
    """Of 2 + 3 lanes: all found at 30 cm, all found, half the score's lanes missing, nothing found."""
    labels = roads.labels(_straight(-1.75, 1.75), _straight(-3.5, 0.0, 3.5))
    shifted, exact, beyond = (roads.as_prediction(labels, shift_m=shift_m) for shift_m in (0.3, 0.0, 1.6))
    fewer = _with_lanes(exact, [lane for lane in exact.lanes if lane.kind == "delimiter"])
    found = {"shifted": shifted, "exact": exact, "fewer": fewer, "none": _with_lanes(exact, []), "beyond": beyond}
    report = _evaluate([(labels, dataclasses.replace(one, key=key)) for key, one in found.items()])
    scores = {sample.key: (sample.f1, sample.error_cm) for sample in report.samples}
    assert [sample.key for sample in report.samples][2:] == ["fewer", "shifted", "exact"]
    assert scores["exact"] == (1.0, pytest.approx(0.0, abs=1e-3))
    assert scores["shifted"] == (1.0, pytest.approx(30.0, abs=1e-2))
    # 3 of 5 lanes without a false one: precision 1, recall 0.6.
    assert scores["fewer"][0] == pytest.approx(2 * 0.6 / 1.6, abs=1e-6)
    assert scores["none"][0] == scores["beyond"][0] == 0.0
    assert np.isnan(scores["none"][1])
