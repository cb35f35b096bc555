"""The sun and the sky dome: a clear-sky table without the sun's disc, dusk, skyglow, clouds, the CIE overcast sky.

World frame, azimuth counter-clockwise from x. Domes are in Blender's equirectangular layout (bottom row first, azimuth
decreasing from pi to -pi); upper halves start at the horizon. RGB per unit of the sun's irradiance outside the
atmosphere. `blender_assets/sky.py` makes the table.
"""

from functools import cache

import numpy as np
from jaxtyping import Float
from PIL import Image

from synth3dlanes.scene.assets.built_in import assets_dir
from synth3dlanes.scene.scene import Light

SKY_SHAPE = (512, 1024)
HORIZON = SKY_SHAPE[0] // 2
N_CLOUD_MAPS = 4
CLOUD_ALBEDO = 0.75
# The share of the sky's light that is left for each degree of the sun below the horizon: 600 lx at sunset become 3.4 lx
# at the end of civil twilight, at 6 degrees. Its red turns to blue within twice BLUE_DEG. The sun's disc sets within
# SET_DEG.
DUSK_PER_DEG, DUSK_TINT, BLUE_DEG, SET_DEG = 0.42, np.array([0.55, 0.95, 1.1], np.float32), 2.5, 0.53
# Skyglow over lit land: radiance at the horizon, and its share at the zenith. Clouds return GLOW_OF_CLOUDS times more.
GLOW, GLOW_AT_ZENITH, GLOW_OF_CLOUDS = np.array([3.2e-7, 2.5e-7, 1.9e-7]), 0.25, 4.0
# The weights of red, green and blue in the luminance of linear light (ITU-R BT.709).
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
ELEVATION_RAD = (np.pi * ((np.arange(SKY_SHAPE[0]) + 0.5) / SKY_SHAPE[0] - 0.5)).astype(np.float32)
AZIMUTH_RAD = np.pi - 2 * np.pi * (np.arange(SKY_SHAPE[1]) + 0.5) / SKY_SHAPE[1]

LinearRgb = Float[np.ndarray, "3"]
Dome = Float[np.ndarray, "3 h w"]


def sun_direction(light: Light) -> LinearRgb:
    """Unit vector towards the sun, world frame."""
    zenith, azimuth = light.sun_zenith_rad, light.sun_azimuth_rad
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])


def sun_color(light: Light) -> LinearRgb:
    """The sun's irradiance after the atmosphere, as a share of that outside it."""
    table = _sky_table()
    at_sun = _weights(table["sun_zenith_rad"], np.array([light.sun_zenith_rad]))[0]
    share = max(1 - _below_deg(light) / SET_DEG, 0.0)
    return np.asarray(share * (at_sun @ table["sun_transmittance"]), np.float32)


def _below_deg(light: Light) -> float:
    """How far the sun is below the horizon; 0 by day."""
    return max(float(np.degrees(light.sun_zenith_rad)) - 90, 0.0)


def dusk(light: Light) -> LinearRgb:
    """The sky's light as a share of that with the sun on the horizon; 1 by day."""
    below_deg = _below_deg(light)
    return np.asarray(DUSK_PER_DEG**below_deg * DUSK_TINT ** min(below_deg / BLUE_DEG, 2.0), np.float32)


def skyglow(light: Light, overcast: float) -> Float[np.ndarray, "3 h 1"]:
    """The glow of lit land in the night sky, brighter towards the horizon and under clouds."""
    begun = np.float32(min(_below_deg(light) / 4, 1.0))
    rise = np.sin(ELEVATION_RAD[HORIZON:])
    shape = GLOW_AT_ZENITH + (1 - GLOW_AT_ZENITH) * (1 - rise) ** 3
    return np.asarray(begun * (1 + GLOW_OF_CLOUDS * overcast) * GLOW[:, None, None] * shape[:, None])


def cloud_cover(rng: np.random.Generator) -> Float[np.ndarray, "h w"]:
    """Opacity 0..1 of a random cloud map at a random azimuth; rows from zenith to horizon."""
    cover = _cloud_map(int(rng.integers(1, N_CLOUD_MAPS + 1)))
    strength = np.float32(rng.uniform(0.0, 1.0))
    return strength * np.roll(cover, rng.integers(cover.shape[1]), axis=1)


@cache
def _cloud_map(number: int) -> Float[np.ndarray, "h w"]:
    with Image.open(assets_dir() / "textures" / f"clouds_{number}.png") as picture:
        return np.asarray(picture, np.float32) / 255


def clear_sky(light: Light, elevation_rad: Float[np.ndarray, " h"], from_sun_rad: Float[np.ndarray, " w"]) -> Dome:
    """Cloudless radiance per unit of solar irradiance, interpolated from the table; below the horizon it fades."""
    table = _sky_table()
    at_sun = _weights(table["sun_zenith_rad"], np.array([light.sun_zenith_rad]))[0]
    by_elevation = _weights(table["elevation_rad"], elevation_rad)
    by_azimuth = _weights(table["azimuth_rad"], from_sun_rad)
    dome = np.moveaxis(np.tensordot(at_sun, table["radiance"], 1), -1, 0)
    radiance: Dome = by_elevation @ dome @ by_azimuth.T
    radiance *= dusk(light)[:, None, None]
    return radiance


def cloudy_sky(light: Light, clear: Dome, cover: Float[np.ndarray, "h w"]) -> Dome:
    """The clear sky with sunlit clouds in front."""
    sunlit = sun_color(light) * (0.3 + 0.7 * max(np.cos(light.sun_zenith_rad), 0.0)) * CLOUD_ALBEDO / np.pi
    ambient = clear.mean(axis=(1, 2))
    opacity = cover[::-1]
    sky: Dome = sunlit[:, None, None] * (1.25 - 0.5 * opacity)
    sky += ambient[:, None, None]
    sky -= clear
    sky *= opacity
    sky += clear
    return sky


def overcast_dome(elevation_rad: Float[np.ndarray, "..."] | float) -> Float[np.ndarray, "..."]:
    """Radiance of the CIE overcast sky per unit of its horizontal irradiance."""
    return np.asarray(9 / (7 * np.pi) * (1 + 2 * np.sin(elevation_rad)) / 3)


def irradiance(upper: Dome) -> LinearRgb:
    """Irradiance on level ground from an upper hemisphere of radiance."""
    return integral(upper, np.sin(ELEVATION_RAD[HORIZON:]))


def integral(upper: Dome, weight: Float[np.ndarray, " h"]) -> LinearRgb:
    """The integral of an upper hemisphere over solid angle, each row multiplied by its weight."""
    solid_angle = np.cos(ELEVATION_RAD[HORIZON:]) * np.pi / SKY_SHAPE[0] * 2 * np.pi
    return np.asarray(upper.mean(axis=2) @ (weight * solid_angle))


def from_sun(light: Light) -> Float[np.ndarray, " w"]:
    """The absolute azimuth difference between each column of a dome and the sun, in radians."""
    return np.asarray(np.abs((AZIMUTH_RAD - light.sun_azimuth_rad + np.pi) % (2 * np.pi) - np.pi))


@cache
def _sky_table() -> dict[str, Float[np.ndarray, "..."]]:
    with np.load(assets_dir() / "sky.npz") as table:
        return dict(table)


def _weights(knots: Float[np.ndarray, " k"], x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n k"]:
    """The matrix of linear interpolation: row i holds the weights of the knots at x[i]."""
    return np.stack([np.interp(x, knots, unit) for unit in np.eye(len(knots))], axis=1).astype(np.float32)
