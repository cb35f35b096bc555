"""A user's sky picture in place of the built-in dome, rotated to the scene's sun and scaled to the same brightness.

Equirectangular in Blender's layout: bottom row first, azimuth decreasing from pi to -pi, radiance in any unit.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.imaging.daylight import Daylight
from synth3dlanes.imaging.haze import seen_through_haze
from synth3dlanes.imaging.sky import AZIMUTH_RAD, ELEVATION_RAD, HORIZON, LUMINANCE, SKY_SHAPE, irradiance
from synth3dlanes.scene.scene import Scene

# Limit of the picture as a multiple of its median luminance, because a lamp renders the sun.
BRIGHTEST = 24.0
SPOT_PX = 4.0  # standard deviation of the blur before the search for the brightest spot


@dataclass(frozen=True, eq=False)
class UserSky:
    """Radiance above the horizon per unit of its luminous irradiance, and the sun's azimuth in the picture."""

    upper: Float[np.ndarray, "3 h w"]
    sun_azimuth_rad: float


def prepare_sky(upper: Float[np.ndarray, "3 h w"], sun_azimuth_rad: float) -> UserSky:
    """The sky without the sun's disc, scaled to unit luminous irradiance."""
    luminance = np.tensordot(LUMINANCE, upper, 1)
    upper = upper * np.minimum(1, BRIGHTEST * np.median(luminance) / np.maximum(luminance, 1e-9))
    return UserSky(upper / (LUMINANCE @ irradiance(upper)), sun_azimuth_rad)


def brightest_azimuth(upper: Float[np.ndarray, "3 h w"]) -> float:
    """Azimuth of the brightest spot above the horizon."""
    luminance = np.tensordot(LUMINANCE, upper, 1)
    spots = scipy.ndimage.gaussian_filter(luminance, SPOT_PX, mode=("nearest", "wrap"))
    return float(AZIMUTH_RAD[spots.max(axis=0).argmax()])


def hang(sky: UserSky, scene: Scene, light: Daylight) -> Float[np.ndarray, "3 H W"]:
    """The dome of `light` with the sky picture above the horizon, behind the scene's haze."""
    turn_rad = scene.light.sun_azimuth_rad - sky.sun_azimuth_rad
    # Azimuth decreases along the columns.
    turned = np.roll(sky.upper, -round(turn_rad / (2 * np.pi) * SKY_SHAPE[1]), axis=2)
    brightness = LUMINANCE @ irradiance(light.sky[:, HORIZON:])
    left = seen_through_haze(scene.air.visibility_m, np.sin(ELEVATION_RAD[HORIZON:]))[:, None]
    upper = left * brightness * turned + (1 - left) * light.airlight[:, None]
    return np.concatenate([light.sky[:, :HORIZON], upper.astype(np.float32)], axis=1)


def resized(
    upper: Float[np.ndarray, "3 a b"], height: int = HORIZON, width: int = SKY_SHAPE[1]
) -> Float[np.ndarray, "3 h w"]:
    """Resize to the dome's upper half: by area means along an axis that shrinks, by nearest pixel along an axis that
    grows."""
    for axis, size in ((1, height), (2, width)):
        n = upper.shape[axis]
        at = (np.arange(size) * n) // size
        sums = np.add.reduceat(upper.astype(float), at, axis=axis) if n >= size else np.take(upper, at, axis=axis)
        counts = np.diff(np.append(at, n)) if n >= size else np.ones(size)
        upper = sums / counts.reshape([-1 if k == axis else 1 for k in range(3)])
    return upper.astype(np.float32)
