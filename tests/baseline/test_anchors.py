"""Targets: association, order, validity, and that decoding gives the curves back."""

import math

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicSpline
from synth3dlanes_baseline.anchors import DROPPED, IGNORED, KEPT, encode, sample_curves
from synth3dlanes_baseline.config import NANO, PAPER_KNOTS_M, TEN_KNOTS_M
from synth3dlanes_baseline.curves import is_usable, plane_pose, resample, road_curves, road_from_cam, target_pose
from synth3dlanes_baseline.data import annotation_of, pack
from synth3dlanes_baseline.lanes import interpolate
from synth3dlanes_baseline.onnx_decode import distinct_lanes
from synth3dlanes_baseline.statistics import statistics_of

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.geometry.frames import transform
from synth3dlanes.params.params import load_params
from synth3dlanes.truth.ground_truth import ground_truth
from tests.baseline import roads


def _encode(labels, **changes):
    config = NANO.model_copy(update=changes)
    to_top = torch.from_numpy(road_from_cam(plane_pose(labels))).float()[None]
    return encode(pack([annotation_of("", labels, (360, 480), "plane")]), to_top, config)


def _line(x_m, slope=0.0):
    return lambda y: (x_m + slope * (y - 20.0), 0.0 * y)


def test_a_lane_goes_to_the_anchor_nearest_at_twenty_metres():
    # At 5 m this lane is nearest to the anchor at -0.64, at 20 m to the one at 1.92.
    targets, _ = _encode(roads.labels([_line(2.0, slope=0.15)]))
    (at,) = torch.nonzero(targets.assigned).tolist()
    assert at == [0, 0, 9]
    assert targets.x_m[0, 0, 9].tolist() == pytest.approx([0.08 + 0.15 * (y - 20) for y in (5, 20, 40, 60, 80, 100)])


def test_two_paths_of_a_split_share_an_anchor_in_order():
    def stem_then_right(y):
        return 0.1 + np.maximum(y - 30, 0) * 0.1, 0.0 * y

    for lanes in ([stem_then_right, _line(0.12)], [_line(0.12), stem_then_right]):
        targets, status = _encode(roads.labels(lanes))
        assert targets.assigned[0, :2, 8].tolist() == [True, True]
        assert targets.x_m[0, 0, 8, 4] < targets.x_m[0, 1, 8, 4], "c1 is the one on the left where they differ"
        assert status[0].tolist() == [1, 1]


def test_a_third_centerline_is_dropped_and_only_the_leftmost_delimiter_stays():
    lanes = [_line(0.1, slope) for slope in (0.05, -0.05, 0.0)]
    targets, status = _encode(roads.labels(lanes, [_line(0.5, 0.03), _line(0.1)]))
    assert status[0].tolist() == [DROPPED, KEPT, KEPT, DROPPED, KEPT]
    assert targets.assigned.sum() == 3
    assert targets.x_m[0, 2, 8, 1] == pytest.approx(0.1 - 0.64, abs=1e-4)


def test_knots_beyond_the_lane_or_hidden_by_ground_are_masked():
    long, short = _line(0.0), (_line(4.0), 8.0, 55.0)
    targets, _ = _encode(roads.labels([long, short], hidden=(45.0, 90.0)))
    assert targets.visible[0, 0, 7].tolist() == [True, True, True, False, False, True]
    assert targets.in_range[0, 0, 7].tolist() == [True] * 6
    short_anchor = torch.nonzero(targets.assigned)[1, 2]
    assert targets.in_range[0, 0, short_anchor].tolist() == [False, True, True, False, False, False]
    assert targets.visible[0, 0, short_anchor].tolist() == [False, True, True, False, False, False]


def test_ignored_lanes_are_neither_positive_nor_negative():
    # Crosses Y_ref but too little of it is seen; the second starts behind Y_ref; the third is outside the top view.
    labels = roads.labels([_line(0.1), (_line(4.0), 30.0, 110.0), _line(10.5)], hidden=(10.0, 200.0))
    targets, status = _encode(labels)
    assert status[0].tolist() == [IGNORED] * 3
    assert not targets.assigned.any()
    unscored = torch.nonzero(~targets.scored).tolist()
    assert unscored == [[0, 0, 8], [0, 1, 8]]


def test_training_and_metric_ignore_the_same_lanes():
    rng = np.random.default_rng(7)
    for _ in range(200):
        lanes = [(_line(rng.uniform(-13, 13), rng.uniform(-0.2, 0.2)), rng.uniform(0, 30), 110.0) for _ in range(4)]
        start = rng.uniform(0, 60)
        labels = roads.labels(lanes, hidden=(start, start + rng.uniform(0, 60)))
        _, status = _encode(labels)
        curves = road_curves(labels)
        usable = [is_usable(curve) for curve in curves]
        assert [s != IGNORED for s in status[0].tolist()] == usable


def test_curves_are_sampled_alike_in_numpy_and_torch():
    rng = np.random.default_rng(17)
    y_m = np.concatenate([rng.uniform(-5, 120, 60), np.arange(0.0, 111.0, 10.0)])
    n_seen = 0
    for _ in range(30):
        bend = rng.uniform(-2e-3, 2e-3)
        start, hidden = rng.uniform(0, 30), rng.uniform(0, 60)
        lane = (lambda y, b=bend: (b * y**2, b * y), start, 110.0)
        (curve,) = road_curves(roads.labels([lane], hidden=(hidden, hidden + rng.uniform(0, 40))))
        alone = resample(curve, y_m)
        xyz, visible = torch.from_numpy(curve.xyz_road)[None, None], torch.from_numpy(curve.visible)[None, None]
        x_m, z_m, in_range, seen = (part[0, 0].numpy() for part in sample_curves(xyz, visible, torch.from_numpy(y_m)))
        assert x_m == pytest.approx(alone.x_m, abs=1e-9)
        assert z_m == pytest.approx(alone.z_m, abs=1e-9)
        assert (in_range == alone.in_range).all()
        assert (seen == alone.visible).all()
        n_seen += seen.sum()
    assert 500 < n_seen < 1800


def test_mirrored_scene_gives_mirrored_targets():
    rng = np.random.default_rng(11)
    for _ in range(50):
        x_m, slopes, bends = rng.uniform(-9, 9, 4), rng.uniform(-0.1, 0.1, 4), rng.uniform(-2e-3, 2e-3, 4)

        def curve(a, s, b, sign):
            return lambda y: (sign * (a + s * (y - 20) + b * (y - 20) ** 2), 0.01 * y)

        pair = []
        for sign in (1, -1):
            lanes = [curve(*values, sign) for values in zip(x_m, slopes, bends, strict=True)]
            pair.append(_encode(roads.labels(lanes[:3], lanes[3:]))[0])
        straight, mirrored = pair
        both = straight.assigned & mirrored.assigned.flip(2)
        # A type may change (c2 becomes c1) but where a slot is used alone on its anchor, the geometry mirrors.
        alone = (straight.assigned[:, 0] & ~straight.assigned[:, 1])[0]
        x, x_mirrored = straight.x_m[0, 0][alone], mirrored.x_m[0, 0].flip(0)[alone]
        assert torch.allclose(x, -x_mirrored, atol=1e-4)
        assert (straight.assigned.sum((0, 1)) == mirrored.assigned.sum((0, 1)).flip(0)).all()
        assert both[0, 2].equal(straight.assigned[0, 2])


@pytest.mark.parametrize(("knots", "near_cm"), [("paper", 4.0), ("ten", 0.5)])
def test_encode_then_decode_is_the_identity_within_the_splines_error(knots, near_cm):
    rng = np.random.default_rng(13)
    model = NANO.model_copy(update={"knots_y_m": PAPER_KNOTS_M if knots == "paper" else TEN_KNOTS_M})
    statistics = statistics_of([roads.random(rng) for _ in range(60)], model)
    for report in statistics.ceiling.kinds.values():
        assert report.ap > 0.99
        assert report.at_threshold.near_1sigma_cm < near_cm
    assert statistics.ceiling.pitch_median_deg == 0.0
    assert statistics.counts["centerline"]["dropped"] == 0
    assert sum(statistics.counts["centerline"].values()) > 120


def test_horizon_targets_are_the_labels_own_and_put_the_host_lanes_farthest_point_on_the_plane():
    params = load_params("appendix_i", ["cars.n=0", "trees.n=0"])
    n_tilted = 0
    # 37, 63 and 128: the ground hides the host's lane before 20 m.
    for index in (*range(12), 37, 63, 128):
        labels = ground_truth(sample_scene(Scenes(params, 0, "test"), index))
        plane, pose = plane_pose(labels), target_pose(labels, "horizon")
        assert pose == (labels.horizon.pitch_rad, labels.horizon.height_m)
        assert target_pose(labels, "plane") == target_pose(labels, "fixed") == plane
        ends_road = [
            transform(road_from_cam(pose), lane.xyz_cam[seen[-1:]])[0]
            for lane in labels.lanes
            if lane.kind == "centerline" and (seen := np.flatnonzero(lane.in_image & lane.terrain_visible)).size
        ]
        # The plane holds the farthest point of one of the centre lines, the host's, and the foot of the camera.
        assert min(abs(end[2]) for end in ends_road) < 2e-4
        foot_cam = transform(np.linalg.inv(road_from_cam(plane)), np.zeros((1, 3)))
        assert transform(road_from_cam(pose), foot_cam)[0, 2] == pytest.approx(0.0, abs=1e-6)
        n_tilted += abs(pose.pitch_rad - plane.pitch_rad) > math.radians(1.0)
    assert n_tilted >= 5
    without = roads.labels([lambda y: (0.0 * y, 0.03 * y)])
    assert without.horizon is None
    assert target_pose(without, "horizon") == plane_pose(without)


def test_a_lane_that_two_anchors_predict_is_kept_once_and_lanes_beside_each_other_both():
    """Anchors 1 to 4 are neighbours: 1 and 2 have the same lane, 3 and 4 two lanes 2.5 m apart, which only meet beyond
    40 m. Anchors 0 and 5 have the same lane without being neighbours; that of the other type coincides with it."""
    knots_y_m = np.array(TEN_KNOTS_M)
    ahead = (knots_y_m <= 40).astype(float)
    left, middle, right = (-6.0 + 0 * ahead, 0.3 * ahead, 2.5 + 2.5 * ahead)
    lanes_m = [left, middle, middle + 0.9 * ahead, right - 2.5 * ahead, right, left + 0.5]
    x_m = np.stack([lanes_m, [left] * 6])
    scores = np.array([[0.4, 0.8, 0.9, 0.7, 0.6, 0.5], [0.2, 0.2, 0.005, 0.1, 0.1, 0.1]])
    # Of equal ones, the left one is kept.
    kept = [[0, 2], [0, 3], [0, 4], [0, 5], [1, 0]]
    assert distinct_lanes(scores, x_m, 0 * x_m, knots_y_m).tolist() == kept
    # Lanes above each other, as on a ramp, are two.
    above = 0 * x_m
    above[0, 1] = 2.0
    assert distinct_lanes(scores, x_m, above, knots_y_m).tolist() == [[0, 1], *kept]
    assert distinct_lanes(scores, x_m, 0 * x_m, knots_y_m, min_score=0.65).tolist() == [[0, 2], [0, 3]]


def test_the_default_spline_is_the_natural_cubic():
    knots = np.array([5.0, 20, 40, 60, 80, 100])
    values, at_m = np.random.default_rng(0).normal(size=(6, 3, 2)), np.arange(-3.0, 110.0)
    expected = CubicSpline(knots, values, bc_type="natural")(at_m)
    assert interpolate(knots, values, at_m, "natural") == pytest.approx(expected, abs=1e-12)
    row_at_zero = interpolate(knots, np.eye(6), np.array([0.0]), "natural")
    # By how much noise of the knots grows at y = 0: 1.48 with natural ends, 2.15 with not-a-knot ones.
    assert math.hypot(*row_at_zero[0]) == pytest.approx(1.48, abs=0.005)
