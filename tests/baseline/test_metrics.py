"""The metric against answers known beforehand."""

import dataclasses

import numpy as np
import pytest
from synth3dlanes_baseline.metrics import Evaluation, MetricConfig, ap_at_101_points, average_precision
from synth3dlanes_baseline.report import to_document, to_text

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.params.params import load_params
from synth3dlanes.truth.ground_truth import ground_truth


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
def test_sideways_shift_is_every_percentile(roads, frame):
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


def test_every_second_lane_removed_halves_recall(roads):
    labels = roads.labels(_straight(-6.0, -2.0, 2.0, 6.0))
    prediction = roads.as_prediction(labels)
    report = _evaluate([(labels, _with_lanes(prediction, prediction.lanes[::2]))])
    centerline = report.kinds["centerline"]
    assert centerline.at_threshold.recall == 0.5
    assert centerline.at_threshold.precision == 1.0
    assert centerline.ap == pytest.approx(0.5)


def test_weak_duplicates_halve_precision_but_not_ap(roads):
    labels = roads.labels(_straight(-3.5, 0.0, 3.5))
    prediction = roads.as_prediction(labels, score=0.9)
    weak = [dataclasses.replace(lane, score=0.6) for lane in prediction.lanes]
    centerline = _evaluate([(labels, _with_lanes(prediction, (*prediction.lanes, *weak)))]).kinds["centerline"]
    assert centerline.at_threshold.precision == pytest.approx(0.5)
    assert centerline.at_threshold.recall == 1.0
    assert centerline.ap == pytest.approx(1.0)


def test_order_of_images_and_lanes_does_not_matter(roads):
    rng = np.random.default_rng(5)
    pairs = []
    for _ in range(12):
        labels = roads.random(rng)
        prediction = roads.as_prediction(labels, shift_m=rng.uniform(-2, 2))
        pairs.append((labels, _with_lanes(prediction, [_rescored(lane, rng) for lane in prediction.lanes])))
    first = _evaluate(pairs)
    shuffled = [
        (labels, _with_lanes(p, [p.lanes[i] for i in rng.permutation(len(p.lanes))])) for labels, p in reversed(pairs)
    ]
    second = _evaluate(shuffled)
    for kind in ("centerline", "delimiter"):
        assert first.kinds[kind].ap == pytest.approx(second.kinds[kind].ap)
        assert first.kinds[kind].at_threshold == second.kinds[kind].at_threshold


def test_empty_images(roads):
    empty = roads.labels([])
    nothing = _with_lanes(roads.as_prediction(empty), [])
    report = _evaluate([(empty, nothing)])
    assert np.isnan(report.kinds["centerline"].ap)
    full = roads.labels(_straight(0.0))
    report = _evaluate([(empty, nothing), (full, roads.as_prediction(full))])
    assert report.kinds["centerline"].ap == pytest.approx(1.0)
    stray = _evaluate([(empty, roads.as_prediction(full))]).kinds["centerline"]
    assert np.isnan(stray.ap)
    assert stray.at_threshold.precision == 0.0


def test_an_image_of_ignored_lanes_contributes_nothing(roads):
    # One lane begins behind Y_ref, one lies outside the top view: detecting them is neither right nor wrong.
    labels = roads.labels([(lambda y: (0.0 * y, 0.0 * y), 25.0, 110.0), lambda y: (11.0 + 0 * y, 0.0 * y)])
    centerline = _evaluate([(labels, roads.as_prediction(labels))]).kinds["centerline"]
    assert centerline.n_truth == 0
    assert centerline.n_ignored == 2
    assert np.isnan(centerline.at_threshold.precision)


def test_detections_beyond_the_region_are_counted_apart(roads):
    """Where no lane is labelled: within 10.24 m at Y_ref a detection is wrong, beyond it is not judged and is told."""
    labels = roads.labels(_straight(0.0))
    for beside_m, precision, n_outside in (
        (0.0, 1.0, 0),
        (5.0, 0.5, 0),
        (10.2, 0.5, 0),
        (10.3, 1.0, 1),
        (-30.0, 1.0, 1),
    ):
        found = roads.labels([*_straight(0.0), lambda y, x_m=beside_m: (x_m + 0 * y, 0.0 * y)][: 1 + (beside_m != 0)])
        report = _evaluate([(labels, roads.as_prediction(found))])
        centerline = report.kinds["centerline"]
        assert (centerline.at_threshold.precision, centerline.n_outside) == (precision, n_outside)
        assert to_document(report)["centerline"]["n_outside"] == n_outside
        told = f"{n_outside} detection{'s' * (n_outside != 1)} not judged: more than 10.24 m beside the camera at 20 m"
        assert told in to_text(report)


def test_hidden_points_are_not_compared(roads):
    labels = roads.labels(_straight(0.0), hidden=(30.0, 200.0))
    bent = dataclasses.replace(labels.lanes[0], xyz_cam=labels.lanes[0].xyz_cam.copy())
    bent.xyz_cam[32:, 0] += 50.0
    prediction = roads.as_prediction(dataclasses.replace(labels, lanes=(bent,)))
    centerline = _evaluate([(labels, prediction)]).kinds["centerline"]
    assert centerline.ap == pytest.approx(1.0)
    assert centerline.at_threshold.near_2sigma_cm == pytest.approx(0.0, abs=1e-3)
    assert np.isnan(centerline.at_threshold.far_1sigma_cm)


def test_points_missing_from_a_prediction_cost_the_match_distance(roads):
    labels = roads.labels(_straight(0.0))
    whole = roads.as_prediction(labels)
    for shift_m, expected in ((1.45, 1.0), (1.55, 0.0)):
        half = [_moved(lane, shift_m, n_points=40) for lane in whole.lanes]
        centerline = _evaluate([(labels, _with_lanes(whole, half))]).kinds["centerline"]
        assert centerline.ap == expected
        if expected:
            assert centerline.at_threshold.far_2sigma_cm == pytest.approx(145.0, abs=1e-3)


def test_pairs_go_by_distance_and_not_by_score(roads):
    # B is nearer to both labels than A is, A is surer. By score A would take the left lane from B and leave B the
    # right one (two hits); by distance B takes the left one and A finds nothing within reach.
    labels = roads.labels(_straight(0.0, 2.0))
    line = roads.as_prediction(roads.labels(_straight(0.0))).lanes[0]
    a = dataclasses.replace(_moved(line, -0.4), score=0.95)
    b = dataclasses.replace(_moved(line, 0.3), score=0.55)
    prediction = _with_lanes(roads.as_prediction(labels), [a, b])
    assert _evaluate([(labels, prediction)]).kinds["centerline"].at_threshold.recall == 0.5


def test_matching_starts_anew_at_every_threshold(roads):
    # At 0.9 the sure one takes the only lane. At 0.5 the nearer one does and the sure one turns into a false alarm.
    labels = roads.labels(_straight(0.0))
    line = roads.as_prediction(labels).lanes[0]
    sure = dataclasses.replace(_moved(line, 1.0), score=0.9)
    near = dataclasses.replace(_moved(line, 0.1), score=0.5)
    centerline = _evaluate([(labels, _with_lanes(roads.as_prediction(labels), [sure, near]))]).kinds["centerline"]
    assert list(zip(centerline.recalls, centerline.precisions, strict=True)) == [(1.0, 1.0), (1.0, 0.5)]
    assert centerline.at_threshold.near_1sigma_cm == pytest.approx(10.0, abs=1e-3)


def test_average_precision_by_hand(roads):
    recalls, precisions = np.array([0.25, 0.25, 0.5, 0.75]), np.array([1.0, 0.5, 0.6, 0.75])
    assert average_precision(recalls, precisions) == pytest.approx(0.25 * 1.0 + 0.5 * 0.75)
    assert ap_at_101_points(recalls, precisions) == pytest.approx((26 * 1.0 + 50 * 0.75) / 101)


@pytest.mark.parametrize("n", [20, pytest.param(60, marks=pytest.mark.thorough)])
def test_generated_labels_as_predictions_are_perfect(roads, n):
    """Splits, merges, crests and lanes that end: whatever the labels hold, they must not count against themselves."""
    params = load_params("appendix_i", ["cars.n=0", "trees.n=0"])
    many = [ground_truth(sample_scene(Scenes(params, 0, "test"), index)) for index in range(n)]
    report = _evaluate([(labels, roads.as_prediction(labels)) for labels in many])
    for kind in report.kinds.values():
        assert kind.ap == pytest.approx(1.0)
        assert kind.at_threshold.precision == 1.0
        assert kind.at_threshold.far_2sigma_cm == pytest.approx(0.0, abs=1e-3)


def test_of_coinciding_paths_one_is_counted(roads):
    labels = roads.labels(_straight(0.0, 0.1))
    centerline = _evaluate([(labels, roads.as_prediction(labels))]).kinds["centerline"]
    assert (centerline.n_truth, centerline.n_ignored) == (1, 1)
    assert centerline.at_threshold.precision == 1.0


def test_bootstrap_interval_holds_the_value_and_repeats(roads):
    rng = np.random.default_rng(2)
    pairs = []
    for _ in range(30):
        labels = roads.random(rng)
        prediction = roads.as_prediction(labels, shift_m=rng.uniform(-2, 2))
        pairs.append((labels, _with_lanes(prediction, [_rescored(lane, rng) for lane in prediction.lanes])))
    first, second = (_evaluate(pairs, bootstraps=200).kinds["centerline"] for _ in range(2))
    low, high = first.ap_interval
    assert low < first.ap < high
    assert first.ap_interval == second.ap_interval


def _rescored(lane, rng):
    return dataclasses.replace(lane, score=float(rng.uniform(0, 1)))


def _moved(lane, shift_m, n_points=None):
    return dataclasses.replace(lane, xyz_cam=lane.xyz_cam[:n_points] + np.array([shift_m, 0.0, 0.0]))


def test_samples_are_sorted_the_worst_first(roads):
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
