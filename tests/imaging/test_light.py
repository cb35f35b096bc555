"""Light, film, air, sky, sensor, weather and glass: each against its law, in numbers that do not come from the code."""

import io
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.ndimage import label as components

from synth3dlanes.dataset.format import encode_image
from synth3dlanes.geometry.frames import transform
from synth3dlanes.imaging.daylight import daylight
from synth3dlanes.imaging.falling import add_falling, add_spray
from synth3dlanes.imaging.film import response, tonemap
from synth3dlanes.imaging.glare import add_glow, add_lamp_heads, add_sun_glare
from synth3dlanes.imaging.glass import add_dirt, add_drops
from synth3dlanes.imaging.haze import through_air
from synth3dlanes.imaging.sensor import MOST_GAIN, add_noise, add_vignette, gain, motion_blur
from synth3dlanes.imaging.sky import (
    LUMINANCE,
    SKY_SHAPE,
    clear_sky,
    cloud_cover,
    irradiance,
    overcast_dome,
    sun_color,
    sun_direction,
)
from synth3dlanes.scene.scene import Car, Light
from synth3dlanes.world.bonnet import bonnet
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed

LEVEL = FLAT.camera.model_copy(update={"pitch_rad": 0.0})


def lit(**parts):
    """The flat scene and its daylight with fields changed."""
    scene = changed(**parts)
    return scene, daylight(scene, scene.camera.height_m)


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
        (scene, fixed), (_, metered) = (
            lit(**{**parts, "light": {**parts.get("light", {}), "metering": metering}}) for metering in (0, 1)
        )
        assert fixed.film == scene.light.exposure
        assert metered.film > 1.5 * scene.light.exposure
    scene, clear = lit(light={"sun_zenith_rad": 0.5, "metering": 1}, air={"visibility_m": 1e6})
    assert clear.film == pytest.approx(scene.light.exposure, rel=0.1)


def test_blur_is_the_mean_along_each_pixels_own_motion_and_the_sky_stands_still(rng):
    """Over a level road, against sixty places along the motion, for pixels that move little and much."""
    below = np.arange(360)[:, None] + 0.5 - 180
    depth_m = np.where(below > 5, 1.5 * 415.7 / np.maximum(below, 1), np.inf) * np.ones((1, 480), np.float32)
    depth_m = depth_m.astype(np.float32)
    image = gaussian_filter(rng.random((360, 480, 3), dtype=np.float32), (2, 2, 0))
    image /= image.std()
    driven = np.array([0, 0.5, 0.0])
    v, u = np.nonzero(np.isfinite(depth_m))
    ahead = depth_m[v, u].astype(float)
    points = np.column_stack([(u + 0.5 - 240) / 415.7 * ahead, ahead, (180 - v - 0.5) / 415.7 * ahead])
    total = np.zeros((len(u), 3))
    for share in (np.arange(60) + 0.5) / 60 - 0.5:
        x, y, z = (points + share * driven).T
        places = [180 - 415.7 * z / y - 0.5, 240 + 415.7 * x / y - 0.5]
        total += np.stack([map_coordinates(image[..., k], places, order=1, mode="nearest") for k in range(3)], 1)
    blurred = motion_blur(image, depth_m, LEVEL, driven)
    np.testing.assert_array_equal(blurred[:180], image[:180])
    error = blurred[v, u] - total / 60
    assert np.sqrt((error**2).mean()) < 0.1
    assert np.abs(error.mean()) < 2e-3
    # As one picture it would be off by more than this everywhere near the camera.
    assert np.sqrt(((image[v, u] - total / 60)[ahead < 10] ** 2).mean()) > 0.3


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


SHAPE = (360, 480)
SKY = np.full(SHAPE, np.inf, np.float32)


def level(zenith_deg, overcast=0.0):
    """Luminance of the whole sky on level ground."""
    scene = changed(light={"sun_zenith_rad": np.radians(zenith_deg)}, air={"overcast": overcast})
    light = daylight(scene, 1.5)
    return float(LUMINANCE @ irradiance(light.sky[:, 256:])), light


def test_the_sky_darkens_through_dusk_as_measured():
    """600 lx at sunset, 3.4 lx at the end of civil twilight (6 degrees); at night the glow of lit land is left."""
    levels = [level(zenith)[0] for zenith in (80, 88, 90, 91, 93, 96, 99)]
    assert all(after < before for before, after in pairwise(levels))
    assert level(90.01)[0] == pytest.approx(level(90)[0], rel=0.02)
    assert 80 < level(90)[0] / level(96)[0] < 350
    assert level(107)[0] == pytest.approx(level(110)[0], rel=0.02)
    assert level(105, overcast=1.0)[0] > 3 * level(105)[0], "clouds return the glow"
    assert not level(92)[1].sun.any()
    red, _, blue = irradiance(level(94)[1].sky[:, 256:])
    red_before, _, blue_before = irradiance(level(90)[1].sky[:, 256:])
    assert blue / red > 1.3 * blue_before / red_before


def ahead(elevation_deg=12.0):
    """A world whose sun stands straight ahead of the camera, its daylight, and the sun's pixel."""
    scene = changed(
        light={"sun_zenith_rad": np.radians(90 - elevation_deg), "sun_azimuth_rad": np.pi / 2}, camera={"pitch_rad": 0}
    )
    row = 180 - 415.7 * np.tan(np.radians(elevation_deg))
    return scene, resolve(scene).view, daylight(scene, 1.5), (row, 240.0)


def test_the_veil_of_the_sun_falls_with_the_square_of_the_angle():
    scene, view, light, (row, column) = ahead()
    veil = add_sun_glare(np.zeros((*SHAPE, 3), np.float32), SKY, scene.light, light, view)[..., 1]
    peak = np.unravel_index(veil.argmax(), veil.shape)
    assert np.hypot(peak[0] + 0.5 - row, peak[1] + 0.5 - column) < 1.5
    at = np.array([column + 415.7 * np.tan(np.radians(angle)) / np.cos(np.radians(12)) for angle in (6.0, 12.0)])
    near, far = veil[int(row), at.astype(int)]
    assert near / far == pytest.approx(145 / 37, rel=0.15)


def test_a_hidden_sun_and_one_behind_leave_no_veil():
    scene, view, light, (row, column) = ahead()
    black = np.zeros((*SHAPE, 3), np.float32)
    hill = SKY.copy()
    hill[int(row) - 5 : int(row) + 6, int(column) - 5 : int(column) + 6] = 50
    assert not add_sun_glare(black, hill, scene.light, light, view).any()
    behind = scene.light.model_copy(update={"sun_azimuth_rad": -np.pi / 2})
    assert not add_sun_glare(black, SKY, behind, light, view).any()


def test_lamps_glow_where_they_are_seen():
    _, view, _, _ = ahead()
    black = np.zeros((*SHAPE, 3), np.float32)
    head = (view.world_from_cam @ [2.0, 40.0, 4.0, 1.0])[:3]
    lit = add_lamp_heads(black.copy(), SKY, head[None], view, 1e4)
    v, u = np.unravel_index(lit[..., 0].argmax(), SHAPE)
    assert abs(u + 0.5 - (240 + 415.7 * 2 / 40)) <= 1
    assert abs(v + 0.5 - (180 - 415.7 * 4 / 40)) <= 1
    assert not add_lamp_heads(black.copy(), np.full(SHAPE, 30.0, np.float32), head[None], view, 1e4).any()
    glow = add_glow(lit)
    assert glow[v, u + 12, 0] > 0.01 > lit[v, u + 12, 0]
    dim = np.full((*SHAPE, 3), 0.8, np.float32)
    np.testing.assert_array_equal(add_glow(dim), dim)


def test_snow_streaks_point_away_from_where_the_host_drives_to():
    """The image's gradients along the direction from the vanishing point are smaller than across it."""
    scene = changed(weather={"snowfall": 1.0}, sensor={"motion_blur_m": 0.8}, camera={"pitch_rad": 0})
    view = resolve(scene).view
    black = np.zeros((*SHAPE, 3), np.float32)
    args = (black, SKY, scene, view, np.ones(3), 1.0)
    snow = add_falling(*args)[..., 1]
    np.testing.assert_array_equal(snow, add_falling(*args)[..., 1])
    assert 0.001 < snow.mean() < 0.2
    dv, du = np.gradient(snow)
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]] - np.array([180, 240])[:, None, None]
    away = np.maximum(np.hypot(u, v), 1)
    along, across = np.abs(du * u + dv * v) / away, np.abs(du * v - dv * u) / away
    far = away > 60
    assert across[far].mean() > 1.4 * along[far].mean()
    assert not add_falling(black, np.ones(SHAPE, np.float32), *args[2:]).any(), "the bonnet is nearer"


@pytest.mark.parametrize(("speed_m_s", "share"), [(0.0, 0.0), (7.0, 0.5), (14.0, 1.0), (30.0, 1.0)])
def test_spray_follows_the_speed_of_a_car_which_it_is_behind_and_fades_towards_the_road(speed_m_s, share) -> None:
    """Whoever waits throws none, its lower edge is no step where the road comes near, and what is nearer has none."""
    car = Car(model=1, scale=1.0, color=(1, 0, 0), gloss=0.5, lane="main_2", s_m=-35, speed_m_s=speed_m_s)
    scene = changed(weather={"rain": 1.0}, shot={"n_frames": 2, "fps": 10.0}).model_copy(update={"cars": (car,)})
    view, black = resolve(scene).view, np.zeros((*SHAPE, 3), np.float32)
    below = np.maximum(np.arange(SHAPE[0]) + 0.5 - SHAPE[0] / 2, 0.01)
    road = np.broadcast_to((1.6 * 415.7 / below)[:, None], SHAPE).astype(np.float32)
    spray = add_spray(black.copy(), road, scene, view, np.ones(3))[..., 1]
    assert abs(spray.max() - 0.58 * share) < 0.04
    assert np.abs(np.diff(spray, axis=0)).max() <= 0.15 * spray.max()
    v, u = np.unravel_index(spray.argmax(), SHAPE)
    assert not share or (abs(u - 240) < 12 and 180 < v < 240)
    assert not add_spray(black, np.full(SHAPE, 5.0, np.float32), scene, view, np.ones(3)).any()


def test_drops_show_the_picture_upside_down_and_leave_the_rest():
    ramp = np.repeat(np.linspace(0, 1, SHAPE[0], dtype=np.float32)[:, None], SHAPE[1], axis=1)
    picture = np.repeat(ramp[..., None], 3, axis=2)
    wet = add_drops(picture, 1.0, np.random.default_rng(0))
    moved = (wet != picture).any(axis=2)
    assert 0.001 < moved.mean() < 0.2
    marks, n = components(moved)
    slopes = []
    for mark in range(1, n + 1):
        v, u = np.nonzero(marks == mark)
        inner = np.abs(v - v.mean()) < 0.5 * np.ptp(v) / 2
        if len(v) > 150 and 60 < v.mean() < 300:
            slopes.append(np.polyfit(v[inner], wet[v[inner], u[inner], 0], 1)[0])
    assert len(slopes) > 5
    assert np.mean(np.array(slopes) < 0) >= 0.9


def test_dirt_takes_contrast_and_comes_again():
    picture = np.zeros((*SHAPE, 3), np.float32)
    picture[:, ::2] = 1.0
    dirty, again = (add_dirt(picture, 1.0, np.random.default_rng(1)) for _ in range(2))
    np.testing.assert_array_equal(dirty, again)
    contrast = dirty[:, ::2] - dirty[:, 1::2]
    assert contrast.min() > 0.5, "lines stay visible"
    assert contrast.min() < 0.8 < contrast.max()


def test_jpeg_quality_is_that_of_the_scene():
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(noise).save(buffer, "JPEG", quality=95)
    assert encode_image(noise, "jpg") == buffer.getvalue()
    assert len(encode_image(noise, "jpg", 50)) < len(buffer.getvalue()) / 2
