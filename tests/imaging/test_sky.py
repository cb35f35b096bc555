"""The sky: symmetric about the sun, blue overhead, and brightest where the lamp shines from."""

import numpy as np
import pytest

from synth3dlanes.imaging.daylight import daylight
from synth3dlanes.imaging.sky import SKY_SHAPE, clear_sky, cloud_cover, sun_color, sun_direction
from synth3dlanes.scene.scene import Light
from tests.scenes import changed


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
