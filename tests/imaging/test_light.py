"""Light, film, air, sky and sensor: each against its law, in numbers that do not come from the code under test."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates

from synth3dlanes.geometry.frames import transform
from synth3dlanes.imaging.daylight import daylight
from synth3dlanes.imaging.film import response, tonemap
from synth3dlanes.imaging.haze import through_air
from synth3dlanes.imaging.sensor import MOST_GAIN, add_noise, add_vignette, gain, motion_blur
from synth3dlanes.imaging.sky import SKY_SHAPE, clear_sky, cloud_cover, overcast_dome, sun_color, sun_direction
from synth3dlanes.scene.scene import Light
from synth3dlanes.world.bonnet import bonnet
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed

LEVEL = FLAT.camera.model_copy(update={"pitch_rad": 0.0})


def lit(**parts):
    """The flat scene and its daylight with fields changed."""
    scene = changed(**parts)
    return scene, daylight(scene, scene.camera.height_m)


def film_of(scene):
    return daylight(scene, scene.camera.height_m).film


def test_haze_is_bluish_far_away_and_fog_is_not():
    for visibility_m, blue_per_red in ((200.0, 1.0), (40_000.0, 1.4)):
        scene, light = lit(air={"visibility_m": visibility_m})
        view = resolve(scene).view
        haze = np.full((360, 480, 2), [0.2, 1], np.float32)
        black = through_air(np.zeros((360, 480, 3), np.float32), haze, visibility_m, light.airlight, view)
        airlight = through_air(np.zeros_like(black), np.full_like(haze, 1), visibility_m, light.airlight, view)
        red, _, blue = (black / airlight)[100, 240]
        assert blue / red > blue_per_red - 1e-3
    assert blue / red > 1.4


def test_overcast_takes_the_sun_and_most_of_the_light():
    (_, clear), (_, half), (_, closed) = (lit(air={"overcast": share}) for share in (0, 0.5, 1))
    assert np.all(closed.sun == 0)
    assert np.all(clear.sun > half.sun)
    zenith, horizon = closed.sky[1, -1].mean(), closed.sky[1, 270].mean()
    assert 2 < zenith / horizon < 3.2, "the CIE overcast sky is three times brighter overhead"
    assert overcast_dome(np.pi / 2) == pytest.approx(3 * overcast_dome(0.0))


def test_full_metering_keeps_the_daylight_of_a_picture():
    """Of a low sun and of closed clouds; none keeps the exposure as it is."""
    for parts in ({"light": {"sun_zenith_rad": 1.5}}, {"air": {"overcast": 1}}):
        fixed, metered = (
            changed(**{**parts, "light": {**parts.get("light", {}), "metering": metering}}) for metering in (0, 1)
        )
        assert film_of(fixed) == fixed.light.exposure
        assert film_of(metered) > 1.5 * fixed.light.exposure
    clear = changed(light={"sun_zenith_rad": 0.5, "metering": 1}, air={"visibility_m": 1e6})
    assert film_of(clear) == pytest.approx(clear.light.exposure, rel=0.1)


def road_picture(rng):
    """Linear stripes across a level road, and its depth."""
    v = np.arange(360)[:, None] + 0.5
    depth_m = np.where(v > 185, 1.5 * 415.7 / np.maximum(v - 180, 1), np.inf) * np.ones((1, 480))
    return rng.random((360, 480, 3), dtype=np.float32), depth_m.astype(np.float32)


def test_motion_blur_is_symmetric_in_time_and_in_space(rng):
    image, depth_m = road_picture(rng)
    forward = motion_blur(image, depth_m, LEVEL, np.array([0, 0.4, 0.0]))
    backward = motion_blur(image, depth_m, LEVEL, np.array([0, -0.4, 0.0]))
    np.testing.assert_allclose(forward, backward, atol=1e-5)
    mirrored = motion_blur(np.ascontiguousarray(image[:, ::-1]), depth_m, LEVEL, np.array([0, 0.4, 0.0]))
    np.testing.assert_allclose(mirrored[:, ::-1], forward, atol=1e-5)


def test_a_mark_on_the_road_is_smeared_by_the_way_driven_and_stays_centred():
    """A bright bar across the lane at 6 m: its rows are those of the road 0.2 m nearer to 0.2 m farther."""
    v = np.arange(360) + 0.5
    _, depth_m = road_picture(np.random.default_rng(0))
    bar = np.zeros((360, 480, 3), np.float32)
    at = 180 + 1.5 * 415.7 / 6.0
    bar[int(at)] = 1.0
    blurred = motion_blur(bar, depth_m, LEVEL, np.array([0, 0.4, 0.0]))[:, 240, 0]
    rows = np.flatnonzero(blurred > 0.02)
    near, far = 180 + 1.5 * 415.7 / 5.8, 180 + 1.5 * 415.7 / 6.2
    assert rows.min() + 0.5 == pytest.approx(far, abs=1.5)
    assert rows.max() + 0.5 == pytest.approx(near, abs=1.5)
    assert (blurred * v).sum() / blurred.sum() == pytest.approx(at, abs=0.5)


def test_blur_is_the_mean_along_each_pixels_own_motion(rng):
    """Against two hundred places along the motion, for pixels that move little and much."""
    image, depth_m = road_picture(rng)
    image = gaussian_filter(image, (2, 2, 0))
    image /= image.std()
    driven = np.array([0, 0.5, 0.0])
    v, u = np.nonzero(np.isfinite(depth_m))
    ahead = depth_m[v, u].astype(float)
    points = np.column_stack([(u + 0.5 - 240) / 415.7 * ahead, ahead, (180 - v - 0.5) / 415.7 * ahead])
    total = np.zeros((len(u), 3))
    for share in (np.arange(200) + 0.5) / 200 - 0.5:
        x, y, z = (points + share * driven).T
        places = [180 - 415.7 * z / y - 0.5, 240 + 415.7 * x / y - 0.5]
        total += np.stack([map_coordinates(image[..., k], places, order=1, mode="nearest") for k in range(3)], 1)
    error = motion_blur(image, depth_m, LEVEL, driven)[v, u] - total / 200
    assert np.sqrt((error**2).mean()) < 0.1
    assert np.abs(error.mean()) < 2e-3
    # As one picture it would be off by more than this everywhere near the camera.
    assert np.sqrt(((image[v, u] - total / 200)[ahead < 10] ** 2).mean()) > 0.3


def test_the_sky_stands_still(rng):
    image, depth_m = road_picture(rng)
    blurred = motion_blur(image, depth_m, LEVEL, np.array([0, 0.5, 0.0]))
    np.testing.assert_array_equal(blurred[:180], image[:180])
    np.testing.assert_array_equal(motion_blur(image, np.full_like(depth_m, np.inf), LEVEL, np.ones(3)), image)


def test_corners_are_darker_by_the_square_of_the_distance_from_the_optical_axis():
    """The axis of this camera is right of the middle, so the left corners are beyond half a diagonal."""
    camera = LEVEL.model_copy(update={"cx_px": 300.0, "cy_px": 180.0})
    white = np.ones((360, 480, 3), np.float32)
    seen = add_vignette(white, camera, 0.8)
    assert (seen == seen[..., :1]).all()
    assert seen[..., 0].max() == pytest.approx(1, abs=1e-4)
    assert np.unravel_index(seen[..., 0].argmax(), (360, 480)) in ((179, 299), (179, 300), (180, 299), (180, 300))
    # Half a diagonal is 300 px.
    assert seen[180, 150, 0] == pytest.approx(1 - 0.8 / 4, abs=0.005)
    assert seen[0, 60, 0] == pytest.approx(0.2, abs=0.005)
    assert seen[0, 0, 0] == pytest.approx(0.2), "no darker than the parameter says"
    np.testing.assert_allclose(add_vignette(3 * white, camera, 0.8), 3 * seen, rtol=1e-6)


@given(st.sampled_from([1.0, 2.5, 6.0]))
def test_noise_at_middle_gray_has_the_deviation_asked_for(levels):
    gray = np.full((200, 200, 3), 0.18, np.float32)
    noisy = add_noise(gray, levels, np.random.default_rng(1))
    picture = tonemap(noisy).astype(float)
    assert picture.std() == pytest.approx(np.hypot(levels, 12**-0.5), rel=0.04), "with the rounding to whole levels"
    bright = add_noise(np.full_like(gray, 0.72), levels, np.random.default_rng(2))
    assert bright.std() / noisy.std() == pytest.approx(np.sqrt(0.1 + 0.9 * 4), rel=0.03), "photons: with the root"


def test_only_dark_pictures_of_a_camera_that_meters_are_amplified_and_not_without_end(rng):
    seen = np.ones((40, 60), bool)
    picture = rng.random((40, 60, 3)).astype(np.float32)
    assert gain(picture, seen, 1.0) == gain(0.001 * picture, seen, 0.0) == 1
    dark = gain(0.01 * picture, seen, 1.0)
    assert 0.01 * picture.mean() * dark == pytest.approx(0.02, rel=0.01)
    assert gain(0.01 * picture, seen, 0.5) == pytest.approx(np.sqrt(dark))
    assert gain(0 * picture, seen, 1.0) == MOST_GAIN
    lamp = 0.01 * picture
    lamp[:2, :2] = 1000
    assert gain(lamp, seen, 1.0) > dark / 2, "a lamp does not hide the dark around it"
    half = 0.01 * picture
    half[:, :30], seen[:, :30] = 0, False
    assert gain(half, seen, 1.0) == pytest.approx(dark, rel=0.1), "what is out of a lens's field does not count"


def test_what_is_amplified_is_noisier(rng):
    """Amplified eightfold, a picture has the noise of the dark one before it."""
    dark = np.full((200, 300, 3), 0.004, np.float32)
    before = add_noise(dark, 4.0, np.random.default_rng(1)) - dark
    after = add_noise(8 * dark, 4.0, np.random.default_rng(1), 8.0) - 8 * dark
    np.testing.assert_allclose(after, 8 * before, rtol=1e-3, atol=1e-6)


def test_more_light_is_never_darker() -> None:
    x = np.concatenate([np.linspace(0, 1e-4, 500), np.geomspace(1e-4, 60000, 20000)])
    assert np.all(np.diff(response(x)) >= 0)
    levels = tonemap(np.repeat(x[None, :, None], 3, axis=2).astype(np.float32))[0, :, 0]
    assert np.all(np.diff(levels.astype(int)) >= 0)
    assert (levels[0], levels[-1]) == (0, 255)


def test_every_level_between_black_and_white_is_used() -> None:
    x = np.linspace(0, 8, 200_000, dtype=np.float32)
    assert len(np.unique(tonemap(np.repeat(x[None, :, None], 3, axis=2)))) == 256


def test_middle_gray_stays_and_sunlit_white_does_not_clip() -> None:
    gray, white = tonemap(np.array([[[0.18] * 3, [2.5] * 3]], np.float32))[0, :, 0]
    assert abs(int(gray) - 118) <= 8
    assert 225 < white < 254


def test_what_is_no_light_is_black() -> None:
    assert np.all(tonemap(np.array([[[-1.0, np.nan, -np.inf]]], np.float32)) == 0)
    assert np.all(tonemap(np.array([[[np.inf, 1e9, 7e4]]], np.float32)) == 255)


@given(st.floats(0, 100, width=32))
def test_the_table_agrees_with_the_curve(x: float) -> None:
    level = tonemap(np.full((1, 1, 3), x, np.float32))[0, 0, 0]
    assert abs(float(level) - 255 * float(response(np.array(x)))) <= 0.7


def light(zenith_deg: float, azimuth_deg: float = 0.0) -> Light:
    return Light(sun_zenith_rad=np.deg2rad(zenith_deg), sun_azimuth_rad=np.deg2rad(azimuth_deg), exposure=1.0)


@pytest.mark.parametrize("zenith_deg", [5.0, 30.0, 45.0, 80.0])
def test_the_sky_is_symmetric_and_brighter_near_the_sun(zenith_deg: float) -> None:
    elevation = np.deg2rad([90 - zenith_deg])
    towards, left, right, away = clear_sky(light(zenith_deg), elevation, np.deg2rad([0, 60, 60, 180])).sum(axis=0)[0]
    assert left == right
    assert min(left, away) > 0
    assert towards > max(left, away)


def test_a_high_sun_leaves_a_blue_zenith_and_a_low_sun_is_red() -> None:
    zenith = clear_sky(light(40), np.array([np.pi / 2]), np.array([0.0]))[:, 0, 0]
    assert zenith[2] > zenith[1] > zenith[0]
    noon, evening = sun_color(light(0)), sun_color(light(86))
    assert np.all(noon > evening)
    assert evening[0] / evening[2] > 2 * noon[0] / noon[2]


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 200.0])
def test_the_image_is_brightest_where_the_lamp_shines_from(azimuth_deg: float) -> None:
    scene = changed(light={"sun_zenith_rad": np.deg2rad(60), "sun_azimuth_rad": np.deg2rad(azimuth_deg)})
    sky = daylight(scene, scene.camera.height_m).sky.sum(axis=0)
    row = SKY_SHAPE[0] // 2 + round(SKY_SHAPE[0] * 12 / 180)  # below the clouds, above the haze
    column = int(np.argmax(np.convolve(np.tile(sky[row], 3), np.ones(65) / 65, "same")[1024:2048]))
    u = (column + 0.5) / SKY_SHAPE[1]
    azimuth_rad = -(u - 0.5) * 2 * np.pi  # Blender's equirectangular projection
    seen = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad)])
    assert seen @ sun_direction(scene.light)[:2] > 0.999 * np.sin(scene.light.sun_zenith_rad)


def test_clouds_follow_their_generator() -> None:
    first, again, other = (cloud_cover(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert 0 <= first.min() <= first.max() <= 1


HOST = {"bonnet": 0.3, "gray": 0.2, "gloss": 0.5}


@pytest.mark.parametrize(
    "place", [{"right_m": 0.4}, {"yaw_rad": 0.4, "forward_m": 0.5}, {"yaw_rad": -0.3, "right_m": -0.3}]
)
def test_the_bonnet_lies_along_the_middle_of_the_host(place):
    view = resolve(changed(host=HOST, camera={"pitch_rad": 0.0, **place})).view
    points_host = np.linalg.solve(view.world_from_host, np.eye(4)) @ view.world_from_bonnet
    points = transform(points_host, bonnet().vertices_world)
    assert abs(points[:, 0].min() + points[:, 0].max()) < 1e-6
    assert np.ptp(points[:, 0]) == pytest.approx(1.56)
    assert points[:, 1].min() == pytest.approx(place.get("forward_m", 0) + 0.02, abs=0.2)


@pytest.mark.parametrize(
    ("place", "is_seen"),
    [({}, True), ({"yaw_rad": 1.0}, False), ({"yaw_rad": np.pi}, False), ({"forward_m": 2.0}, False)],
)
def test_cameras_that_look_ahead_from_behind_the_windscreen_see_the_bonnet(place, is_seen):
    assert (resolve(changed(host=HOST, camera=place)).view.world_from_bonnet is not None) == is_seen
