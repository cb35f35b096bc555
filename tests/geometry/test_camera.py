"""The camera: where it stands, and signs in words."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.geometry.frames import invert, project, transform
from synth3dlanes.roads.terrain import gradient_at, height_at
from synth3dlanes.world.camera import img_from_cam
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed, hill


def pixel_of(x, y, z):
    return project(img_from_cam(FLAT.camera), np.array([[x, y, z]], dtype=float))[0]


def test_a_point_straight_ahead_is_the_principal_point():
    np.testing.assert_allclose(pixel_of(0, 7, 0), [240, 180])


def test_a_point_to_the_right_projects_right_of_centre_and_one_above_projects_above():
    assert pixel_of(1, 10, 0)[0] > 240
    assert pixel_of(0, 10, 1)[1] < 180


def test_ten_metres_ahead_one_metre_right_is_a_tenth_of_the_focal_length():
    np.testing.assert_allclose(pixel_of(1, 10, 0), [240 + 41.57, 180])


def test_a_point_behind_the_camera_has_no_pixel():
    assert np.isnan(pixel_of(0, -1, 0)).all()


@given(st.floats(-60, -20), st.floats(-0.4, 0.4), st.floats(1.4, 1.9), st.integers(1, 3))
def test_the_camera_stands_its_height_above_the_surface_along_its_normal(y, offset, height, lane):
    scene = changed(
        terrain={"gaussians": (hill(20, -10, 30, 60), hill(-70, 40, -20, 45))},
        road={"offset_m50_m": 7, "offset_p50_m": -8},
        camera={"y_m": y, "offset_m": offset, "height_m": height, "lane": lane},
    )
    eye = resolve(scene).view.world_from_cam[:3, 3]
    foot = resolve(scene).view.world_from_road[:3, 3]
    assert foot[2] == pytest.approx(height_at(scene.terrain, foot[None, :2])[0])
    slope = gradient_at(scene.terrain, foot[None, :2])[0]
    normal = np.array([-slope[0], -slope[1], 1]) / np.sqrt(1 + slope @ slope)
    np.testing.assert_allclose(eye - foot, height * normal, atol=1e-9)


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


def test_pitched_down_on_a_flat_road_the_axis_meets_it_at_height_over_tangent():
    scene = changed(camera={"pitch_rad": 0.08})
    axis = transform(resolve(scene).view.world_from_cam, np.array([[0, 1.6 / np.sin(0.08), 0]]))[0]
    np.testing.assert_allclose(axis, [0, -50 + 1.6 / np.tan(0.08), 0], atol=1e-9)


@given(st.floats(-0.3, 0.3), st.floats(-0.1, 0.2))
def test_roll_clockwise_sinks_the_cameras_right_side_and_lifts_the_right_end_of_the_horizon(roll, pitch):
    scene = changed(camera={"roll_rad": roll, "pitch_rad": pitch})
    level = changed(camera={"pitch_rad": pitch})
    right_world = resolve(scene).view.world_from_cam[:3, 0]
    assert right_world[2] == pytest.approx(-np.sin(roll) * np.cos(pitch)), "clockwise: the right side is down"
    far_world = np.array([[-4e5, 1e6, 0], [4e5, 1e6, 0]])
    far_img = project(img_from_cam(scene.camera), transform(invert(resolve(scene).view.world_from_cam), far_world))
    down = (far_img[1] - far_img[0])[1] / (far_img[1] - far_img[0])[0]
    assert down == pytest.approx(-np.tan(roll), abs=1e-3), "the horizon turns the other way: its right end rises"
    np.testing.assert_allclose(
        resolve(scene).view.world_from_cam[:3, [1, 3]], resolve(level).view.world_from_cam[:3, [1, 3]], atol=1e-12
    )


def test_the_principal_point_is_where_the_viewing_axis_meets_the_image():
    camera = changed(camera={"cx_px": 250, "cy_px": 170}).camera
    np.testing.assert_allclose(project(img_from_cam(camera), np.array([[0, 7.0, 0]])), [[250, 170]])


def test_there_is_no_roll_about_the_axis_on_a_banked_road():
    scene = changed(terrain={"gaussians": (hill(40, -50, 20, 40),)})
    right = resolve(scene).view.world_from_cam[:3, 0]
    normal = resolve(scene).view.world_from_road[:3, 2]
    assert abs(right @ normal) < 1e-12
    assert abs(right[2]) > 0.1, "the road is banked, and the camera with it"
