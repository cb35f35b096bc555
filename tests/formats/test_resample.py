"""The image's change of intrinsics: marks land where the foreign camera sees them."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.formats.format import PinholeFormat, format_names, open_format
from synth3dlanes.formats.one_frame import fitting_pinhole, resample, source_pixels
from synth3dlanes.formats.writing import Pinhole
from synth3dlanes.geometry.lens import Lens
from synth3dlanes.system.errors import InputError
from tests.formats import closed_form as cf

FORMATS = {name: open_format(name) for name in format_names()}
APOLLO, OPENLANE = (FORMATS[name].camera for name in ("apollo", "openlane"))


@pytest.mark.parametrize("view", [foreign.camera for foreign in FORMATS.values() if isinstance(foreign, PinholeFormat)])
@pytest.mark.parametrize(("size_px", "roll_rad"), [((480, 360), 0), ((960, 640), 0.02), ((1920, 1280), 0)])
def test_a_mark_lands_where_the_foreign_camera_sees_it(view, size_px, roll_rad):
    f_px = 0.86 * size_px[0]
    camera = cf.camera_label(size_px=size_px, f_px=f_px, roll_rad=roll_rad)
    view = fitting_pinhole(camera, view)
    points_img = np.array([[view.width_px * 0.3, view.height_px * 0.7], [view.width_px * 0.8, view.height_px * 0.4]])
    rows, columns = np.mgrid[0 : size_px[1], 0 : size_px[0]] + 0.5
    for point_img in points_img:
        u_px, v_px = source_pixels(camera, view, point_img[None])[0]
        spread_px = 3 * f_px / view.f_px + 2
        spot = np.exp(-((columns - u_px) ** 2 + (rows - v_px) ** 2) / (2 * spread_px**2))
        image = np.repeat((200 * spot)[..., None].astype(np.uint8), 3, axis=2)
        found = np.asarray(resample(image, camera, view, "test"))[..., 0].astype(float)
        v_grid, u_grid = np.mgrid[0 : view.height_px, 0 : view.width_px] + 0.5
        centroid = np.array([(found * u_grid).sum(), (found * v_grid).sum()]) / found.sum()
        np.testing.assert_allclose(centroid, point_img, atol=0.15)


@pytest.mark.parametrize("roll_rad", [0.0, 0.03])
def test_source_pixels_are_the_same_rays(roll_rad):
    camera, level = (cf.camera_label(size_px=(480, 360), f_px=415.7, roll_rad=roll) for roll in (roll_rad, 0.0))
    points_cv = np.array([[1.0, 0.5, 8.0], [-3.0, 1.2, 20.0]])
    points_road = (points_cv[:, [0, 2, 1]] * [1, 1, -1]) @ level.road_from_cam[:3, :3].T
    homogeneous = points_road @ camera.road_from_cam[:3, :3] @ camera.img_from_cam.T
    ours_img = homogeneous[:, :2] / homogeneous[:, 2:]
    np.testing.assert_allclose(source_pixels(camera, APOLLO, APOLLO.project(points_cv)), ours_img, atol=1e-9)


def test_a_native_image_is_not_touched_and_one_of_another_size_refused():
    pixels = np.random.default_rng(0).integers(0, 255, (1280, 1920, 3), dtype=np.uint8)
    native = cf.camera_label(size_px=(1920, 1280), f_px=2014.9991)
    np.testing.assert_array_equal(np.asarray(resample(pixels, native, OPENLANE, "test")), pixels)
    cropped = np.asarray(resample(pixels, cf.camera_label(), APOLLO, "test"))
    np.testing.assert_array_equal(cropped, pixels[100:1180])
    with pytest.raises(InputError, match=r"^x: expected an image of 1920x1280 as in its labels, got 640x480"):
        resample(np.zeros((480, 640, 3), dtype=np.uint8), cf.camera_label(), Pinhole(100, 100, 2015.0), "x")


@pytest.mark.parametrize("roll_rad", [0.0, 0.02])
@pytest.mark.parametrize("f_px", [300.0, 415.7, 900.0])
def test_the_fitting_camera_is_the_widest_that_the_image_covers(f_px, roll_rad):
    camera = cf.camera_label(size_px=(480, 360), f_px=f_px, roll_rad=roll_rad)
    fitting = fitting_pinhole(camera, Pinhole(1920, 1020, 1500.0))

    def outside_px(pinhole):
        """How far the foreign image's border reaches beyond ours."""
        u, v = np.meshgrid(np.linspace(0, 1920, 49), np.linspace(0, 1020, 49))
        found = source_pixels(camera, pinhole, np.stack([u.ravel(), v.ravel()], axis=1))
        return max((-found).max(), (found - [480, 360]).max())

    assert outside_px(fitting) <= 0.0101
    if roll_rad == 0:
        # 480 px at f are as wide as 1920 px at 4 f.
        assert fitting.f_px == pytest.approx(max(1500.0, 4 * f_px), abs=0.2)
    if fitting.f_px > 1500:
        assert outside_px(replace(fitting, f_px=0.999 * fitting.f_px)) > 0.05


@pytest.mark.parametrize("name", ["apollo", "openlane"])
def test_camera_presets_render_natively_and_change_nothing_else(name):
    from synth3dlanes.draw.sample import Scenes, sample_scene
    from synth3dlanes.params.params import load_params
    from synth3dlanes.truth.ground_truth import ground_truth

    params, base = load_params(f"{name}_camera"), load_params("appendix_i")
    view = FORMATS[name].camera
    camera = ground_truth(sample_scene(Scenes(params), 0)).camera
    pixels = np.random.default_rng(0).integers(0, 255, (view.height_px, view.width_px, 3), dtype=np.uint8)
    np.testing.assert_array_equal(np.asarray(resample(pixels, camera, view, "test")), pixels)
    changed = {"width_px", "height_px", "horizontal_fov_deg"}
    for group in type(params).model_fields:
        for key, value in getattr(params, group):
            assert value == getattr(getattr(base, group), key) or key in changed


@pytest.mark.parametrize("view", [foreign.camera for foreign in FORMATS.values() if hasattr(foreign, "camera")])
@pytest.mark.parametrize("k1", [-0.25, 0.2])
def test_the_fitting_camera_of_a_lens_is_covered_and_hardly_narrower_than_it_must_be(view, k1):
    lens = Lens(model="opencv", coefficients=(k1, 0.03, 0.002, -0.001, 0, 0, 0, 0))
    camera = replace(cf.camera_label(size_px=(480, 360), f_px=415.7), lens=lens)
    fitting = fitting_pinhole(camera, view)

    def room_px(pinhole):
        """How far inside ours the nearest point of the foreign image's border lies; negative outside."""
        share = np.linspace(0, 1, 400)[:, None]
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * [pinhole.width_px, pinhole.height_px]
        border = np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)])
        uv = source_pixels(camera, pinhole, border)
        return np.minimum(uv, [480, 360] - uv).min()

    assert room_px(fitting) > -0.05
    assert fitting == view or room_px(replace(fitting, f_px=0.995 * fitting.f_px)) < 0
