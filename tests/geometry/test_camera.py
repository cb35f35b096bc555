"""The camera: where it stands, and signs in words."""

import numpy as np
import pytest

from synth3dlanes.geometry.frames import project
from synth3dlanes.world.camera import img_from_cam
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed


def pixel_of(x, y, z):
    return project(img_from_cam(FLAT.camera), np.array([[x, y, z]], dtype=float))[0]


def test_a_point_to_the_right_projects_right_of_centre_and_one_above_projects_above():
    assert pixel_of(1, 10, 0)[0] > 240
    assert pixel_of(0, 10, 1)[1] < 180


def test_a_point_behind_the_camera_has_no_pixel():
    assert np.isnan(pixel_of(0, -1, 0)).all()


def test_a_camera_further_right_in_its_lane_stands_further_right():
    left, right = (resolve(changed(camera={"offset_m": offset})).view.eye_world[0] for offset in (-0.3, 0.3))
    assert (left, right) == (pytest.approx(-0.3), pytest.approx(0.3))


@pytest.mark.parametrize("flip", [False, True])
def test_lanes_count_from_the_left_whatever_the_flip(flip):
    xs = [
        resolve(changed(road={"topology": 2, "flip_longitudinal": flip}, camera={"lane": lane})).view.world_from_cam[
            0, 3
        ]
        for lane in (1, 2, 3)
    ]
    np.testing.assert_allclose(xs, [-3.5, 0, 3.5], atol=1e-9)
