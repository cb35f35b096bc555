"""Viewing directions of a camera's pixels. Camera frame: x right, y ahead, z up."""

import numpy as np
from jaxtyping import Float

from synth3dlanes.scene.host import HostCamera
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.world.camera import rays, rays_of_pixels


def cosines(camera: HostCamera, direction_cam: Float[np.ndarray, "3"]) -> Float[np.ndarray, "h w"]:
    """The cosines of the angles between the rays of all pixels and a unit vector; NaN where the lens has no picture."""
    right, ahead, up = direction_cam
    if not camera.lens.is_pinhole:
        return np.asarray(rays_of_pixels(camera) @ direction_cam, np.float32)
    x, z = _tangents(camera)
    return np.asarray((ahead + right * x + up * z[:, None]) / np.sqrt(1 + x * x + (z * z)[:, None]))


def azimuths(camera: HostCamera, world_from_cam: Matrix4) -> Float[np.ndarray, "h w"]:
    """The azimuths (world, radians) of the rays of all pixels; for a pinhole only the row of its principal point."""
    if camera.lens.is_pinhole:
        x, _ = _tangents(camera)
        rays_cam = np.stack([x, np.ones_like(x), np.zeros_like(x)], axis=1)[None]
    else:
        rays_cam = rays_of_pixels(camera)
    rays_world = rays_cam @ world_from_cam[:3, :3].T
    return np.asarray(np.arctan2(rays_world[..., 1], rays_world[..., 0]))


def points(
    camera: HostCamera, uv: Float[np.ndarray, "n 2"], depth_m: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """The points in the camera frame that pixels see at depths y."""
    if camera.lens.is_pinhole:
        return points_away(camera, uv, depth_m)
    found = rays(camera, uv)
    return np.asarray(found * (depth_m / found[:, 1])[:, None])


def points_away(
    camera: HostCamera, uv: Float[np.ndarray, "n 2"], away_m: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """The points in the camera frame seen by pixels at distances from the eye; for a pinhole, at depths y."""
    if not camera.lens.is_pinhole:
        return np.asarray(rays(camera, uv) * away_m[:, None])
    found = [(uv[:, 0] - camera.cx_px) / camera.fx_px, np.ones(len(uv)), (camera.cy_px - uv[:, 1]) / camera.fy_px]
    return np.asarray(np.column_stack(found) * away_m[:, None])


def _tangents(camera: HostCamera) -> tuple[Float[np.ndarray, " w"], Float[np.ndarray, " h"]]:
    """x/y of each column and z/y of each row of a pinhole, at the pixels' centres."""
    x = (np.arange(camera.width_px) + 0.5 - camera.cx_px) / camera.fx_px
    z = (camera.cy_px - np.arange(camera.height_px) - 0.5) / camera.fy_px
    return x.astype(np.float32), z.astype(np.float32)
