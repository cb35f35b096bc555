"""Haze: over a distance d light is attenuated by exp(-d 3.912 / V) at visibility V, and airlight replaces the rest.

Applies to linear radiance, before the tone curve.
"""

import numpy as np
from jaxtyping import Float

from synth3dlanes.imaging.lens import azimuths, cosines
from synth3dlanes.imaging.sky import AZIMUTH_RAD
from synth3dlanes.system.arrays import LinearImage
from synth3dlanes.world.world import View

KOSCHMIEDER = 3.912  # -log 0.02: 2 % of the contrast is left at the meteorological visibility
HAZE_LAYER_M = 400.0  # height of the haze layer
WAVELENGTHS_NM = np.array([680.0, 550.0, 440.0])
GREEN_NM = 550.0


def seen_through_haze(visibility_m: float, up: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """The share of the sky's light that passes the haze layer at elevations with the sine `up`."""
    return np.asarray(np.exp(-KOSCHMIEDER / visibility_m * HAZE_LAYER_M / np.maximum(up, 1e-3)))


def through_air(
    radiance: LinearImage,
    haze: Float[np.ndarray, "h w 2"],
    visibility_m: float,
    airlight: Float[np.ndarray, "3 W"],
    view: View,
) -> LinearImage:
    """The radiance that arrives at the camera, per channel: attenuated by the haze, plus airlight.

    `haze` is the layer of that name (see `Layers`). The sky's radiance already includes its haze. Where the sky is
    nothing but haze it is treated as distant ground, because the denoiser leaves specks of leaves in it that fog must
    cover.
    """
    in_sky = 1 - seen_through_haze(visibility_m, cosines(view.camera, view.world_from_cam[2, :3].astype(np.float32)))
    left = 1 - haze[..., 0] - (1 - haze[..., 1]) * in_sky**8
    ratios = (WAVELENGTHS_NM / GREEN_NM) ** -scattering_exponent(visibility_m)
    share = np.maximum(left, 0)[..., None] ** ratios.astype(np.float32)
    behind = _airlight(airlight, view)
    return np.asarray(behind + share * (radiance - behind))


def scattering_exponent(visibility_m: float) -> float:
    """The exponent q of extinction ~ wavelength ** -q: 0 in fog, Kruse's values in fine haze."""
    return float(np.interp(visibility_m / 1000, [1, 6, 50, 100], [0, 1.1, 1.3, 1.6]))


def _airlight(airlight: Float[np.ndarray, "3 W"], view: View) -> Float[np.ndarray, "h w 3"]:
    """The airlight behind every pixel."""
    azimuth = azimuths(view.camera, view.world_from_cam)
    channels = [np.interp(azimuth, AZIMUTH_RAD[::-1], channel[::-1], period=2 * np.pi) for channel in airlight]
    return np.stack(channels, axis=-1).astype(np.float32)
