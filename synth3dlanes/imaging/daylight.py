"""The daylight of a scene: sun, sky dome and airlight.

World frame; RGB radiance and irradiance in the picture's units before exposure. The sky is a clear or cloudy sky, mixed
with an overcast one, behind a layer of haze; at the horizon it has the colour that distant objects fade to.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from synth3dlanes.imaging.haze import HAZE_LAYER_M, KOSCHMIEDER, seen_through_haze
from synth3dlanes.imaging.sky import (
    ELEVATION_RAD,
    HORIZON,
    LUMINANCE,
    Dome,
    LinearRgb,
    clear_sky,
    cloud_cover,
    cloudy_sky,
    from_sun,
    integral,
    irradiance,
    overcast_dome,
    skyglow,
    sun_color,
)
from synth3dlanes.scene.scene import Light, Scene

# Irradiance of the sun outside the atmosphere; sets the brightness of exposure 1.
SUN_STRENGTH = 3.4
OVERCAST_LOSS = 0.65  # share of the daylight that a closed layer of clouds reflects upwards
FOG_AIRLIGHT = 0.6  # radiance of thick fog as a share of E / pi
GROUND_ALBEDO = 0.14
# Luminance of the host's headlights on the road ahead, as a level of daylight: a 5000th of a cloudy day's.
HEADLIGHT_LEVEL = 3e-4
# The light for which full metering leaves the exposure unchanged.
REFERENCE_SUN = Light(sun_zenith_rad=0.5, sun_azimuth_rad=0.0, exposure=1.0, metering=1.0)


@dataclass(frozen=True, eq=False)
class Daylight:
    """Sun, sky and airlight of a scene.

    `sun` is the irradiance on a plane facing the sun, `softness` (0..1) how much clouds diffuse it. `sky` is radiance
    in Blender's equirectangular layout (bottom row first, azimuth decreasing from pi to -pi). `airlight` is the
    radiance of infinitely deep haze at the azimuths of the sky's columns. `film` is the factor on radiance before the
    film curve: the exposure times (reference / actual daylight) ** metering.
    """

    sun: LinearRgb
    softness: float
    sky: Float[np.ndarray, "3 H W"]
    airlight: Float[np.ndarray, "3 W"]
    film: float


def daylight(scene: Scene, eye_height_m: float) -> Daylight:
    """The light of one scene; its clouds follow from seed, split and index. `eye_height_m`, over the plain beyond the
    terrain mesh, determines how much haze lies in front of that plain."""
    light, per_m = scene.light, KOSCHMIEDER / scene.air.visibility_m
    cover = cloud_cover(scene.stream("clouds"))
    through = np.exp(-per_m * HAZE_LAYER_M / max(np.cos(light.sun_zenith_rad), 0.1))
    hidden = 1 - (1 - scene.air.overcast) * through
    clear = clear_sky(light, ELEVATION_RAD[HORIZON:], from_sun(light))
    sun = sun_color(light)
    whole = sun * np.cos(light.sun_zenith_rad) + irradiance(clear)
    whole = (whole + 2 * whole.mean()) / 3  # clouds are gray
    gray = whole * hidden * (1 - OVERCAST_LOSS * hidden)
    # In place: a dome has a million numbers, and new memory costs more than the sums.
    sky = cloudy_sky(light, clear, cover)
    sky *= 1 - hidden
    sky += gray[:, None, None] * overcast_dome(ELEVATION_RAD[HORIZON:, None]) * (0.85 + 0.3 * cover[::-1])
    airlight = (1 - hidden) * clear[:, 0] + gray[:, None] * overcast_dome(0.0)
    if light.sun_zenith_rad > np.pi / 2:
        glow = skyglow(light, scene.air.overcast)
        sky, airlight = sky + glow, airlight + glow[:, 0]
    lit = sun * (1 - hidden) * np.cos(light.sun_zenith_rad) + irradiance(sky)
    thickness = 1 - np.exp(-per_m * HAZE_LAYER_M)
    airlight = airlight + thickness * (FOG_AIRLIGHT * lit[:, None] / np.pi - airlight)
    left = seen_through_haze(scene.air.visibility_m, np.sin(ELEVATION_RAD[HORIZON:]))[:, None]
    sky *= left
    sky += (1 - left) * airlight[:, None]
    below = _ground(lit, airlight, per_m, max(eye_height_m, scene.camera.height_m))
    dome = np.concatenate([below, sky], axis=1).astype(np.float32, copy=False)
    dome *= np.float32(SUN_STRENGTH)
    sun = SUN_STRENGTH * (1 - hidden) * sun
    lamps = HEADLIGHT_LEVEL if scene.weather.headlights else 0.0
    ratio = _reference_level() / (_level(sun, light.sun_zenith_rad, dome[:, HORIZON:]) + lamps)
    film = float(light.exposure * ratio**light.metering)
    return Daylight(sun, float(hidden), dome, SUN_STRENGTH * airlight, film)


def _level(sun: LinearRgb, sun_zenith_rad: float, upper: Dome) -> float:
    """Luminance of the daylight: the mean of the irradiance on level ground and on walls."""
    ground = sun * np.cos(sun_zenith_rad) + irradiance(upper)
    walls = sun * np.sin(sun_zenith_rad) / np.pi + integral(upper, np.cos(ELEVATION_RAD[HORIZON:]) / np.pi)
    return float(LUMINANCE @ (ground + walls) / 2)


@cache
def _reference_level() -> float:
    sky = clear_sky(REFERENCE_SUN, ELEVATION_RAD[HORIZON:], from_sun(REFERENCE_SUN))
    return _level(SUN_STRENGTH * sun_color(REFERENCE_SUN), REFERENCE_SUN.sun_zenith_rad, SUN_STRENGTH * sky)


def _ground(lit: LinearRgb, airlight: Float[np.ndarray, "3 w"], per_m: float, height_m: float) -> Dome:
    """The lower half of the dome: the plain beyond the terrain mesh, seen through haze from `height_m`."""
    left = np.exp(-per_m * height_m / np.sin(-ELEVATION_RAD[:HORIZON]))[:, None]
    dome: Dome = (1 - left) * airlight[:, None]
    dome += left * (GROUND_ALBEDO * lit / np.pi)[:, None, None]
    return dome
