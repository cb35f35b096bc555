"""Temporal smoothing on roads in closed form: what it makes of noise, of motion, and of lanes that come and go."""

import dataclasses

import numpy as np
import pytest
from synth3dlanes_baseline.curves import Pose
from synth3dlanes_baseline.data import CameraImage
from synth3dlanes_baseline.lanes import Detection, Prediction
from synth3dlanes_baseline.smoothing import associate, smoothed

from synth3dlanes.geometry.frames import transform
from synth3dlanes.system.errors import InputError

Y_M = np.arange(1.0, 90.0)
BLACK = np.zeros((2, 2, 3), dtype=np.uint8)


def lane(x_m=0.0, kind="delimiter", score=0.9):
    return Detection(kind, score, np.stack([x_m + 0 * Y_M, Y_M, 0 * Y_M - 1.5], axis=1))


def frame(time_s, lanes, truth=()):
    return CameraImage("0", BLACK, (1, 1, 1, 1), truth, time_s), Prediction("0", tuple(lanes), Pose(0.0, 1.5 + time_s))


def test_noise_shrinks_as_the_theory_of_exponential_means_says():
    noise_m = np.random.default_rng(0).normal(scale=0.1, size=2000)
    found = [frame(0.1 * i, [lane(x_m)]) for i, x_m in enumerate(noise_m)]
    x_m = [prediction.lanes[0].xyz_cam[10, 0] for _, prediction in smoothed(found, 0.2)]
    share = 1 - np.exp(-0.5)
    assert np.std(x_m[50:]) == pytest.approx(0.1 * np.sqrt(share / (2 - share)), rel=0.1)


def test_known_motion_is_made_up_for(roads):
    """A host that turns and drives past straight lanes: with its motion, their means are themselves."""
    label = roads.labels([lambda y: (0 * y, 0 * y)])
    in_world = lane(1.0).xyz_cam
    known, unknown = [], []
    for i in range(6):
        c, s = np.cos(0.02 * i), np.sin(0.02 * i)
        world_from_cam = np.array([[c, -s, 0, 0.3 * i], [s, c, 0, 2.0 * i], [0, 0, 1, 0], [0, 0, 0, 1]])
        camera = dataclasses.replace(label.camera, world_from_cam=world_from_cam)
        seen = Detection("delimiter", 0.9, transform(np.linalg.inv(world_from_cam), in_world))
        known.append(frame(0.1 * i, [seen], dataclasses.replace(label, camera=camera)))
        unknown.append(frame(0.1 * i, [seen]))
    apart_m = [
        max(
            np.abs(smooth.lanes[0].xyz_cam - single.lanes[0].xyz_cam).max()
            for (_, single), (_, smooth) in zip(found, smoothed(found, 0.3), strict=True)
        )
        for found in (known, unknown)
    ]
    assert apart_m[0] < 1e-9
    assert apart_m[1] > 0.5


def test_lanes_are_associated_by_kind_within_the_gate_nearest_first():
    before = [lane(0.0), lane(0.8), lane(5.0), lane(9.0, "centerline")]
    now = [lane(0.6), lane(6.2), lane(9.0), lane(8.7, "centerline"), lane(0.5)]
    assert associate(before, now) == {0: 1, 3: 3, 4: 0}
    assert associate([], now) == associate(before, []) == {}


def test_scores_and_lanes_that_come_stay_and_a_new_clip_begins_anew():
    found = [frame(0.0, [lane(0.0)]), frame(0.1, [lane(0.4, score=0.2), lane(4.0)]), frame(0.0, [lane(0.4)])]
    first, second, third = (prediction for _, prediction in smoothed(found, 0.1))
    share = 1 - np.exp(-1)
    assert [one.score for one in second.lanes] == [0.2, 0.9]
    assert [one.xyz_cam[5, 0] for one in second.lanes] == pytest.approx([0.4 * share, 4.0])
    assert second.pose == pytest.approx((0.0, 1.5 + 0.1 * share))
    assert first.lanes[0].xyz_cam[5, 0] == 0.0
    assert third.lanes[0].xyz_cam[5, 0] == 0.4


@pytest.mark.parametrize(("times_s", "problem"), [([None], "expected frames of a clip"), ([1.0, 1.0], "one camera")])
def test_pictures_and_rigs_are_refused(times_s, problem):
    image, prediction = frame(0.0, [lane()])
    found = [(dataclasses.replace(image, time_s=time_s), prediction) for time_s in times_s]
    with pytest.raises(InputError, match=problem):
        list(smoothed(found, 0.1))
