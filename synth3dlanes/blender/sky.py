"""The daylight of a scene: sun, sky dome, and the light of the air towards the horizon. Pure numpy.

World frame, azimuth counter-clockwise from x; RGB radiance and irradiance in the picture's units before exposure. A
clear-sky table (blender_assets/sky.py) without the sun's disc, clouds drawn into it, a closed CIE overcast dome mixed
over it, and a layer of haze that ends both at the horizon in the very colour that far things fade to.
"""

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from jaxtyping import Float
from PIL import Image

from synth3dlanes.blender.assets import assets_dir
from synth3dlanes.geometry.camera import world_from_cam
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.scene import Light, Scene
from synth3dlanes.streams import stream

# Irradiance of the sun outside the atmosphere: sets how bright exposure 1 is.
SUN_STRENGTH = 3.4
SKY_SHAPE = (512, 1024)
HORIZON = SKY_SHAPE[0] // 2
N_CLOUD_MAPS = 4
CLOUD_ALBEDO = 0.75
KOSCHMIEDER = 3.912  # -log 0.02: at the meteorological visibility 2 % of a contrast is left
HAZE_LAYER_M = 400.0  # height of the layer that holds the haze
OVERCAST_LOSS = 0.65  # share of the daylight that a closed layer of clouds sends back up
FOG_AIRLIGHT = 0.6  # of E / pi: thick fog is lit from all sides
GROUND_ALBEDO = 0.14
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
ELEVATION_RAD = (np.pi * ((np.arange(SKY_SHAPE[0]) + 0.5) / SKY_SHAPE[0] - 0.5)).astype(np.float32)
AZIMUTH_RAD = np.pi - 2 * np.pi * (np.arange(SKY_SHAPE[1]) + 0.5) / SKY_SHAPE[1]
# The sun for which full metering changes nothing.
REFERENCE_SUN = Light(sun_zenith_rad=0.5, sun_azimuth_rad=0.0, exposure=1.0, metering=1.0)

Rgb = Float[np.ndarray, "3"]
Dome = Float[np.ndarray, "3 h w"]


@dataclass(frozen=True, eq=False)
class Daylight:
    """`sun` is its irradiance on a plane facing it, `softness` 0..1 how far clouds have spread it, `sky` the radiance
    in Blender's equirectangular layout (bottom row first, azimuth falling from pi to -pi), `airlight` the radiance of
    endless haze at the azimuths of the sky's columns."""

    sun: Rgb
    softness: float
    sky: Float[np.ndarray, "3 H W"]
    airlight: Float[np.ndarray, "3 W"]


@lru_cache(maxsize=1)
def daylight(scene: Scene) -> Daylight:
    """The light of one scene; its clouds follow from seed, split and index. Kept for the scene's second asker."""
    light, per_m = scene.light, KOSCHMIEDER / scene.air.visibility_m
    cover = cloud_cover(stream(scene.seed, scene.split, scene.index, "clouds"))
    through = np.exp(-per_m * HAZE_LAYER_M / max(np.cos(light.sun_zenith_rad), 0.1))
    hidden = 1 - (1 - scene.air.overcast) * through
    clear = clear_sky(light, ELEVATION_RAD[HORIZON:], _from_sun(light))
    sun = sun_color(light)
    whole = sun * np.cos(light.sun_zenith_rad) + irradiance(clear)
    whole = (whole + 2 * whole.mean()) / 3  # clouds are gray
    gray = whole * hidden * (1 - OVERCAST_LOSS * hidden)
    sky = (1 - hidden) * cloudy_sky(light, clear, cover)
    sky += gray[:, None, None] * overcast_dome(ELEVATION_RAD[HORIZON:, None]) * (0.85 + 0.3 * cover[::-1])
    airlight = (1 - hidden) * clear[:, 0] + gray[:, None] * overcast_dome(0.0)
    lit = sun * (1 - hidden) * np.cos(light.sun_zenith_rad) + irradiance(sky)
    thickness = 1 - np.exp(-per_m * HAZE_LAYER_M)
    airlight = airlight + thickness * (FOG_AIRLIGHT * lit[:, None] / np.pi - airlight)
    left = seen_through_haze(scene.air.visibility_m, np.sin(ELEVATION_RAD[HORIZON:]))[:, None]
    sky = left * sky + (1 - left) * airlight[:, None]
    below = _ground(scene, lit, airlight, per_m)
    dome = SUN_STRENGTH * np.concatenate([below, sky], axis=1).astype(np.float32)
    return Daylight(SUN_STRENGTH * (1 - hidden) * sun, float(hidden), dome, SUN_STRENGTH * airlight)


def seen_through_haze(visibility_m: float, up: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """The share of the sky's light that the layer of haze lets through in directions that rise by `up` (a sine)."""
    return np.asarray(np.exp(-KOSCHMIEDER / visibility_m * HAZE_LAYER_M / np.maximum(up, 1e-3)))


def film_factor(scene: Scene) -> float:
    """What the film multiplies radiance with: the exposure, times the metering's share of the missing daylight."""
    light, now = scene.light, daylight(scene)
    ratio = _reference_level() / _level(now.sun, light.sun_zenith_rad, now.sky[:, HORIZON:])
    return float(light.exposure * ratio**light.metering)


def sun_direction(light: Light) -> Rgb:
    """Unit vector towards the sun, world frame."""
    zenith, azimuth = light.sun_zenith_rad, light.sun_azimuth_rad
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])


def sun_color(light: Light) -> Rgb:
    """The sun's irradiance after the atmosphere, as a share of that outside it."""
    table = _sky_table()
    at_sun = _weights(table["sun_zenith_rad"], np.array([light.sun_zenith_rad]))[0]
    return np.asarray(at_sun @ table["sun_transmittance"], np.float32)


def cloud_cover(rng: np.random.Generator) -> Float[np.ndarray, "h w"]:
    """Opacity 0..1 of one of the cloud maps, turned to a random azimuth; rows from zenith to horizon."""
    file = assets_dir() / "textures" / f"clouds_{rng.integers(1, N_CLOUD_MAPS + 1)}.png"
    with Image.open(file) as picture:
        cover = np.asarray(picture, np.float32) / 255
    strength = np.float32(rng.uniform(0.0, 1.0))
    return strength * np.roll(cover, rng.integers(cover.shape[1]), axis=1)


def clear_sky(light: Light, elevation_rad: Float[np.ndarray, " h"], from_sun_rad: Float[np.ndarray, " w"]) -> Dome:
    """Cloudless radiance per unit of solar irradiance, interpolated in the table."""
    table = _sky_table()
    at_sun = _weights(table["sun_zenith_rad"], np.array([light.sun_zenith_rad]))[0]
    by_elevation = _weights(table["elevation_rad"], elevation_rad)
    by_azimuth = _weights(table["azimuth_rad"], from_sun_rad)
    dome = np.moveaxis(np.tensordot(at_sun, table["radiance"], 1), -1, 0)
    radiance: Dome = by_elevation @ dome @ by_azimuth.T
    return radiance


def cloudy_sky(light: Light, clear: Dome, cover: Float[np.ndarray, "h w"]) -> Dome:
    """The clear sky behind sunlit clouds."""
    sunlit = sun_color(light) * (0.3 + 0.7 * np.cos(light.sun_zenith_rad)) * CLOUD_ALBEDO / np.pi
    ambient = clear.mean(axis=(1, 2))
    opacity = cover[::-1]
    cloud = sunlit[:, None, None] * (1.25 - 0.5 * opacity) + ambient[:, None, None]
    return np.asarray(clear + opacity * (cloud - clear))


def overcast_dome(elevation_rad: Float[np.ndarray, "..."] | float) -> Float[np.ndarray, "..."]:
    """Radiance of the CIE overcast sky per unit of its horizontal irradiance."""
    return np.asarray(9 / (7 * np.pi) * (1 + 2 * np.sin(elevation_rad)) / 3)


def irradiance(upper: Dome) -> Rgb:
    """What an upper hemisphere of radiance gives to level ground."""
    return _integral(upper, np.sin(ELEVATION_RAD[HORIZON:]))


def _integral(upper: Dome, weight: Float[np.ndarray, " h"]) -> Rgb:
    solid_angle = np.cos(ELEVATION_RAD[HORIZON:]) * np.pi / SKY_SHAPE[0] * 2 * np.pi
    return np.asarray(upper.mean(axis=2) @ (weight * solid_angle))


def _level(sun: Rgb, sun_zenith_rad: float, upper: Dome) -> float:
    """The daylight that a picture shows: the mean of what the ground gets and what walls get."""
    ground = sun * np.cos(sun_zenith_rad) + irradiance(upper)
    walls = sun * np.sin(sun_zenith_rad) / np.pi + _integral(upper, np.cos(ELEVATION_RAD[HORIZON:]) / np.pi)
    return float(LUMINANCE @ (ground + walls) / 2)


@cache
def _reference_level() -> float:
    sky = clear_sky(REFERENCE_SUN, ELEVATION_RAD[HORIZON:], _from_sun(REFERENCE_SUN))
    return _level(SUN_STRENGTH * sun_color(REFERENCE_SUN), REFERENCE_SUN.sun_zenith_rad, SUN_STRENGTH * sky)


def _ground(scene: Scene, lit: Rgb, airlight: Float[np.ndarray, "3 w"], per_m: float) -> Dome:
    """The plain beyond the terrain's mesh, as seen through the air from the camera's height."""
    height_m = max(float(world_from_cam(RoadPlan(scene))[2, 3]), scene.camera.height_m)
    left = np.exp(-per_m * height_m / np.sin(-ELEVATION_RAD[:HORIZON]))[:, None]
    return np.asarray(left * (GROUND_ALBEDO * lit / np.pi)[:, None, None] + (1 - left) * airlight[:, None])


def _from_sun(light: Light) -> Float[np.ndarray, " w"]:
    return np.asarray(np.abs((AZIMUTH_RAD - light.sun_azimuth_rad + np.pi) % (2 * np.pi) - np.pi))


@cache
def _sky_table() -> dict[str, Float[np.ndarray, "..."]]:
    with np.load(assets_dir() / "sky.npz") as table:
        return dict(table)


def _weights(knots: Float[np.ndarray, " k"], x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n k"]:
    """The matrix of linear interpolation: row i holds the weights of the knots at x[i]."""
    return np.stack([np.interp(x, knots, unit) for unit in np.eye(len(knots))], axis=1).astype(np.float32)
