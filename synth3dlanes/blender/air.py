"""What the air does to the picture: contrast falls by exp(-d 3.912 / V), and the air's own light takes its place.

Pure numpy, on linear radiance before the tone mapping. Distances come in Cycles' pass `haze` (`world.add_haze`).
"""

import numpy as np
from jaxtyping import Float

from synth3dlanes.blender.sky import AZIMUTH_RAD, Daylight, seen_through_haze
from synth3dlanes.frames import Matrix4
from synth3dlanes.scene import Camera, Scene

WAVELENGTHS_NM = np.array([680.0, 550.0, 440.0])
GREEN_NM = 550.0

Image = Float[np.ndarray, "h w 3"]


def through_air(
    linear: Image, haze: Float[np.ndarray, "h w _"], scene: Scene, daylight: Daylight, world_from_cam: Matrix4
) -> Image:
    """The radiance that arrives, per channel: what the haze takes from it, the airlight makes up for.

    `daylight` has its haze in its sky. Yet where that is nothing but haze, sky counts as far ground: the denoiser
    leaves specks of leaves in it, which fog must cover.
    """
    in_sky = 1 - seen_through_haze(scene.air.visibility_m, _rise(scene.camera, world_from_cam))
    left = 1 - haze[..., 0] - (1 - haze[..., 1]) * in_sky**8
    ratios = (WAVELENGTHS_NM / GREEN_NM) ** -scattering_exponent(scene.air.visibility_m)
    share = np.maximum(left, 0)[..., None] ** ratios.astype(np.float32)
    airlight = _airlight(daylight, scene.camera, world_from_cam)
    return np.asarray(airlight + share * (linear - airlight))


def scattering_exponent(visibility_m: float) -> float:
    """How fast extinction falls with the wavelength: droplets of fog not at all, fine haze as Kruse measured."""
    return float(np.interp(visibility_m / 1000, [1, 6, 50, 100], [0, 1.1, 1.3, 1.6]))


def _rise(camera: Camera, world_from_cam: Matrix4) -> Float[np.ndarray, "h w"]:
    """The sine of the elevation that each pixel looks to."""
    x, z = _tangents(camera)
    right_up, ahead_up, up_up = world_from_cam[2, :3].astype(np.float32)
    return np.asarray((ahead_up + right_up * x + up_up * z[:, None]) / np.sqrt(1 + x * x + (z * z)[:, None]))


def _airlight(daylight: Daylight, camera: Camera, world_from_cam: Matrix4) -> Float[np.ndarray, "w 3"]:
    """The airlight of every column of the image: near the horizon a column is one azimuth."""
    x, _ = _tangents(camera)
    rays_world = np.stack([x, np.ones_like(x), np.zeros_like(x)], axis=1) @ world_from_cam[:3, :3].T
    azimuth = np.arctan2(rays_world[:, 1], rays_world[:, 0])
    columns = [np.interp(azimuth, AZIMUTH_RAD[::-1], channel[::-1], period=2 * np.pi) for channel in daylight.airlight]
    return np.stack(columns, axis=-1).astype(np.float32)


def _tangents(camera: Camera) -> tuple[Float[np.ndarray, " w"], Float[np.ndarray, " h"]]:
    """How far right and up the columns and rows look, per metre ahead."""
    x = (np.arange(camera.width_px) + 0.5 - camera.cx_px) / camera.fx_px
    z = (camera.cy_px - np.arange(camera.height_px) - 0.5) / camera.fy_px
    return x.astype(np.float32), z.astype(np.float32)
