"""Rigid transforms: the group's laws, and signs in words."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.geometry.frames import invert, road_from_cam, transform

POSES = st.builds(road_from_cam, st.floats(0.5, 5), st.floats(-1, 1))


@given(POSES, POSES)
def test_inverse_undoes_and_inverts_products(a_from_b, b_from_c):
    points = np.array([[1.0, 2, 3], [-4, 5, 0.5]])
    np.testing.assert_allclose(transform(invert(a_from_b), transform(a_from_b, points)), points, atol=1e-12)
    np.testing.assert_allclose(invert(a_from_b @ b_from_c), invert(b_from_c) @ invert(a_from_b), atol=1e-12)


def test_the_axis_of_a_camera_that_looks_down_sinks_towards_the_road():
    ahead = transform(road_from_cam(1.5, 0.1), np.array([[0.0, 10, 0]]))[0]
    assert ahead[2] < 1.5, "ten metres along the axis of a camera pitched down is lower than the camera"
    np.testing.assert_allclose(ahead, [0, 10 * np.cos(0.1), 1.5 - 10 * np.sin(0.1)])


def test_the_camera_stands_its_height_above_the_foot():
    np.testing.assert_allclose(transform(road_from_cam(1.7, 0.05), np.zeros((1, 3)))[0], [0, 0, 1.7])
