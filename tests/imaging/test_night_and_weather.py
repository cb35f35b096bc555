"""Dusk, stray light, rain, snow and the glass: each against its law, in numbers that do not come from the code."""

import io
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import label as components

from synth3dlanes.dataset.format import encode_image
from synth3dlanes.imaging.daylight import daylight
from synth3dlanes.imaging.falling import add_falling, add_spray
from synth3dlanes.imaging.glare import add_glow, add_lamp_heads, add_sun_glare
from synth3dlanes.imaging.glass import add_dirt, add_drops
from synth3dlanes.imaging.sky import LUMINANCE, irradiance
from synth3dlanes.scene.scene import Car
from synth3dlanes.world.world import resolve
from tests.scenes import changed

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


def test_spray_is_behind_its_car_and_before_what_is_farther():
    car = Car(model=1, scale=1.0, color=(1, 0, 0), gloss=0.5, lane="main_2", s_m=-25)
    scene = changed(weather={"rain": 1.0}).model_copy(update={"cars": (car,)})
    view = resolve(scene).view
    black = np.zeros((*SHAPE, 3), np.float32)
    spray = add_spray(black.copy(), SKY, scene, view, np.ones(3))[..., 1]
    v, u = np.unravel_index(spray.argmax(), SHAPE)
    assert abs(u - 240) < 12
    assert 180 < v < 240
    assert 0.4 < spray.max() < 0.8
    assert not add_spray(black.copy(), np.full(SHAPE, 5.0, np.float32), scene, view, np.ones(3)).any()


@pytest.mark.parametrize(("speed_m_s", "share"), [(0.0, 0.0), (7.0, 0.5), (14.0, 1.0), (30.0, 1.0)])
def test_spray_follows_the_speed_of_a_car_and_fades_towards_the_road(speed_m_s: float, share: float) -> None:
    """Whoever waits throws none, and its lower edge is no step where the road comes near."""
    car = Car(model=1, scale=1.0, color=(1, 0, 0), gloss=0.5, lane="main_2", s_m=-35, speed_m_s=speed_m_s)
    scene = changed(weather={"rain": 1.0}, shot={"n_frames": 2, "fps": 10.0}).model_copy(update={"cars": (car,)})
    view = resolve(scene).view
    below = np.maximum(np.arange(SHAPE[0]) + 0.5 - SHAPE[0] / 2, 0.01)
    road = np.broadcast_to((1.6 * 415.7 / below)[:, None], SHAPE).astype(np.float32)
    spray = add_spray(np.zeros((*SHAPE, 3), np.float32), road, scene, view, np.ones(3))[..., 1]
    assert abs(spray.max() - 0.58 * share) < 0.04
    assert np.abs(np.diff(spray, axis=0)).max() <= 0.15 * spray.max()


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
