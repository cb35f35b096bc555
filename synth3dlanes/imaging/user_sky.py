"""A user's picture of the sky in the place of our dome: turned to the scene's sun, and as bright as our sky would be.

Equirectangular in Blender's layout: bottom row first, azimuth falling from pi to -pi, radiance in any unit.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from synth3dlanes.imaging.daylight import Daylight
from synth3dlanes.imaging.haze import seen_through_haze
from synth3dlanes.imaging.sky import AZIMUTH_RAD, ELEVATION_RAD, HORIZON, LUMINANCE, SKY_SHAPE, irradiance
from synth3dlanes.scene import Scene

# The lamp is the sun: what is brighter than so many times the sky's median is dimmed to that.
BRIGHTEST = 24.0
SPOT_PX = 4.0  # the sky's picture is blurred by that before its brightest spot is looked for


@dataclass(frozen=True, eq=False)
class UserSky:
    """Radiance above the horizon per unit of its luminous irradiance, and where in the picture the sun stands."""

    upper: Float[np.ndarray, "3 h w"]
    sun_azimuth_rad: float


def prepare_sky(upper: Float[np.ndarray, "3 h w"], sun_azimuth_rad: float) -> UserSky:
    """The sky without its sun's disc, at unit brightness."""
    luminance = np.tensordot(LUMINANCE, upper, 1)
    upper = upper * np.minimum(1, BRIGHTEST * np.median(luminance) / np.maximum(luminance, 1e-9))
    return UserSky(upper / (LUMINANCE @ irradiance(upper)), sun_azimuth_rad)


def brightest_azimuth(upper: Float[np.ndarray, "3 h w"]) -> float:
    """Where the brightest spot above the horizon stands."""
    luminance = np.tensordot(LUMINANCE, upper, 1)
    spots = gaussian_filter(luminance, SPOT_PX, mode=("nearest", "wrap"))
    return float(AZIMUTH_RAD[spots.max(axis=0).argmax()])


def hang(sky: UserSky, scene: Scene, light: Daylight) -> Float[np.ndarray, "3 H W"]:
    """The dome of `light` with the sky's picture above the horizon, behind the scene's haze."""
    turn_rad = scene.light.sun_azimuth_rad - sky.sun_azimuth_rad
    # Azimuth falls along the columns.
    turned = np.roll(sky.upper, -round(turn_rad / (2 * np.pi) * SKY_SHAPE[1]), axis=2)
    brightness = LUMINANCE @ irradiance(light.sky[:, HORIZON:])
    left = seen_through_haze(scene.air.visibility_m, np.sin(ELEVATION_RAD[HORIZON:]))[:, None]
    upper = left * brightness * turned + (1 - left) * light.airlight[:, None]
    return np.concatenate([light.sky[:, :HORIZON], upper.astype(np.float32)], axis=1)


def resized(
    upper: Float[np.ndarray, "3 a b"], height: int = HORIZON, width: int = SKY_SHAPE[1]
) -> Float[np.ndarray, "3 h w"]:
    """At the size of the dome's upper half: means over the pixels that fall together, or the nearest pixel where there
    are too few."""
    for axis, size in ((1, height), (2, width)):
        n = upper.shape[axis]
        at = (np.arange(size) * n) // size
        sums = np.add.reduceat(upper.astype(float), at, axis=axis) if n >= size else np.take(upper, at, axis=axis)
        counts = np.diff(np.append(at, n)) if n >= size else np.ones(size)
        upper = sums / counts.reshape([-1 if k == axis else 1 for k in range(3)])
    return upper.astype(np.float32)
