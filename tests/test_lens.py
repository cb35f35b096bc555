"""Lenses and rigid transforms: projection and its inverse, against numbers of OpenCV 4.11 and against properties."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.geometry.frames import invert, project, road_from_cam, transform
from synth3dlanes.geometry.lens import COEFFICIENTS, PINHOLE, Lens, LensModel

# By projectPoints of cv2, cv2.fisheye and cv2.omnidir (of opencv-contrib), whose axes are
# x right, y down, z forward, for this matrix.
REFERENCE: dict[str, Any] = json.loads((Path(__file__).parent / "opencv_lenses.json").read_text())
FX, FY, CX, CY = 700.0, 690.0, 640.0, 350.0
IMG_FROM_CAM = np.array([[FX, CX, 0], [0, CY, -FY], [0, 1, 0]])


def lens(model: LensModel, k: list[float]) -> Lens:
    wanted = {"fisheye": 4, "omni": 5}.get(model, 8 if len(k) <= 8 else 14)
    return Lens(model=model, coefficients=tuple(k + [0.0] * (wanted - len(k))))


def cases() -> list[tuple[Lens, np.ndarray, np.ndarray]]:
    found = []
    for case in REFERENCE.values():
        x, y, z = np.array(case["points_cv"]).T
        found.append((lens(case["model"], case["k"]), np.stack([x, z, -y], axis=1), np.array(case["uv"])))
    return found


@pytest.mark.parametrize(("lens", "points_cam", "uv"), cases(), ids=list(REFERENCE))
def test_it_projects_as_opencv_does_and_rays_lead_back(lens: Lens, points_cam: np.ndarray, uv: np.ndarray) -> None:
    # The reference is rounded to a millionth of a pixel.
    np.testing.assert_allclose(lens.project(IMG_FROM_CAM, points_cam), uv, atol=2e-6)
    directions = points_cam / np.linalg.norm(points_cam, axis=1, keepdims=True)
    np.testing.assert_allclose(lens.rays(IMG_FROM_CAM, uv), directions, atol=5e-8)


@given(
    st.sampled_from([case[0] for case in cases()]), st.floats(0, 0.999), st.floats(-np.pi, np.pi), st.floats(0.5, 500)
)
def test_rays_undo_the_projection_over_the_whole_field(lens: Lens, share: float, around: float, away_m: float) -> None:
    angle = share * min(lens.field_rad, np.radians(85) if lens.model == "opencv" else np.pi)
    direction = np.array([[np.sin(angle) * np.cos(around), np.cos(angle), np.sin(angle) * np.sin(around)]])
    uv = lens.project(IMG_FROM_CAM, away_m * direction)
    ray = lens.rays(IMG_FROM_CAM, uv)
    again = lens.project(IMG_FROM_CAM, ray)
    if np.isnan(ray).any():
        # With p1 and p2 the field's border is no circle.
        assert share > 0.9
        assert any(lens.tangential)
    else:
        np.testing.assert_allclose(again, uv, rtol=0, atol=1e-9 * (FX + np.abs(uv).max()))


def test_what_is_out_of_the_field_does_not_project() -> None:
    # r (1 - r^2 / 3) turns back at r = 1: 45 degrees.
    barrel = lens("opencv", [-1 / 3])
    assert barrel.field_rad == pytest.approx(np.pi / 4)
    # r / (1 - r^2) has a pole there: it grows without end towards r = 1.
    assert lens("opencv", [0, 0, 0, 0, 0, -1.0]).field_rad == pytest.approx(np.pi / 4)
    inside, outside = np.array([[0.999, 1, 0]]), np.array([[1.001, 1, 0]])
    assert np.isfinite(barrel.project(IMG_FROM_CAM, inside)).all()
    assert np.isnan(barrel.project(IMG_FROM_CAM, outside)).all()
    behind = np.array([[0.1, -1.0, 0.1], [0, -1, 0], [0, 0, 0]])
    for one in (barrel, PINHOLE, lens("fisheye", [-0.1])):
        assert np.isnan(one.project(IMG_FROM_CAM, behind)).all()
    # Its farthest pixels lie 2/3 focal lengths from the principal point; there is nothing beyond.
    row = np.array([[CX + 0.666 * FX, CY], [CX + 0.667 * FX, CY]])
    assert np.isnan(barrel.rays(IMG_FROM_CAM, row)).any(axis=1).tolist() == [False, True]


def test_an_equidistant_fisheye_sees_behind_itself() -> None:
    fisheye = lens("fisheye", [])
    assert fisheye.field_rad == np.pi
    angle = np.radians(100)
    aside = np.array([[np.sin(angle), np.cos(angle), 0.0]])
    np.testing.assert_allclose(fisheye.project(IMG_FROM_CAM, aside), [[CX + FX * angle, CY]])
    np.testing.assert_allclose(fisheye.rays(IMG_FROM_CAM, np.array([[CX + FX * angle, CY]])), aside, atol=1e-12)


def test_without_coefficients_it_is_a_pinhole_to_the_bit() -> None:
    points_cam = np.random.default_rng(0).normal(size=(50, 3)) * [5, 30, 2]
    for one in (PINHOLE, lens("opencv", [])):
        np.testing.assert_array_equal(one.project(IMG_FROM_CAM, points_cam), project(IMG_FROM_CAM, points_cam))


def test_an_omnidirectional_camera_is_opencvs_at_its_centre_and_stereographic_on_its_sphere() -> None:
    k = [-0.2, 0.05, 0.003, -0.002]
    points_cam = np.random.default_rng(0).normal(size=(50, 3)) * [3, 1, 2] + [0, 5, 0]
    uv = lens("omni", [0.0, *k]).project(IMG_FROM_CAM, points_cam)
    np.testing.assert_allclose(uv, lens("opencv", k).project(IMG_FROM_CAM, points_cam), atol=1e-9)
    angles = np.radians([1, 60, 120, 178])
    np.testing.assert_allclose([lens("omni", [1.0]).radius(angle) for angle in angles], np.tan(angles / 2))
    # From outside its sphere, twice its radius from the middle, it sees as far as a tangent touches: 120 degrees.
    assert np.degrees(lens("omni", [2.0]).field_rad) == pytest.approx(119)


@given(st.lists(st.floats(-1e4, 1e4), min_size=12, max_size=12), st.sampled_from([4, 8, 12]))
def test_any_coefficients_give_numbers_or_nan(k: list[float], count: int) -> None:
    any_lens = lens("fisheye" if count == 4 else "opencv", k[:count])
    assert 0 < lens("omni", [abs(k[0]), *k[1:5]]).field_rad <= np.pi
    assert 0 < any_lens.field_rad <= np.pi
    uv = np.random.default_rng(1).uniform(0, 1280, (20, 2))
    rays = any_lens.rays(IMG_FROM_CAM, uv)
    known = np.isfinite(rays).all(axis=1)
    np.testing.assert_allclose(np.linalg.norm(rays[known], axis=1), 1, atol=1e-9)


@pytest.mark.parametrize("model", COEFFICIENTS)
def test_a_wrong_number_of_coefficients_is_refused(model: LensModel) -> None:
    for n in {len(COEFFICIENTS[model]) + 1, 5 if model == "opencv" else len(COEFFICIENTS[model]) - 1} - {-1}:
        with pytest.raises(ValueError, match="coefficients: expected"):
            Lens(model=model, coefficients=(0.0,) * n)


def test_a_coefficient_that_no_lens_has_is_refused() -> None:
    with pytest.raises(ValueError, match="expected xi of at least 0, got -1"):
        lens("omni", [-1.0])
    with pytest.raises(ValueError, match=r"expected tau_x and tau_y of at most 0\.5, in radians"):
        lens("opencv", [0.0] * 13 + [0.6])


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
