"""Pose and projection of the host's camera. World and camera frames (docs/frames.md)."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.frames import from_axes
from synth3dlanes.geometry.lens import width_rad
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.host import HostCamera
from synth3dlanes.system.arrays import AnyPoints2, AnyPoints3, Matrix4

TANGENT_STEP_M = 1e-3
BORDER_PX = 1
# Pixels along the border of a picture that bound what it shows, and the steepest direction that such bounds hold for.
BORDER_STEPS, STEEPEST_RAD = 33, np.radians(80)
# What is nearer to the eye than this counts as seen: its light reaches what is in the picture.
AROUND_EYE_M = 30.0


class Sector(NamedTuple):
    """What a camera may see of the plan: the directions within an angle of one, and what is close to the eye."""

    eye_world: Float[np.ndarray, "2"]
    ahead_world: Float[np.ndarray, "2"]
    half_rad: float

    def holds(self, xy_world: AnyPoints2) -> Bool[np.ndarray, "*n"]:
        """Which places are in it."""
        to = xy_world - self.eye_world
        away_m = np.hypot(to[..., 0], to[..., 1])
        return np.asarray((to @ self.ahead_world >= np.cos(self.half_rad) * away_m) | (away_m < AROUND_EYE_M))


def sector(camera: HostCamera, world_from_cam: Matrix4) -> Sector | None:
    """What a camera sees from above; None for one that sees on all sides, or straight up or down."""
    edge = np.linspace(0.0, 1.0, BORDER_STEPS)
    ends, size = np.repeat([0.0, 1.0], BORDER_STEPS), np.array([camera.width_px, camera.height_px])
    border = np.concatenate([np.column_stack([np.tile(edge, 2), ends]), np.column_stack([ends, np.tile(edge, 2)])])
    seen = rays(camera, border * size)
    ahead = world_from_cam[:3, 1]
    steepest_rad = np.arccos(np.clip(seen[:, 1].min(), -1, 1)) + np.arcsin(np.clip(abs(ahead[2]), 0, 1))
    # `not <` holds for NaN too, where the lens has no picture at its border.
    if not steepest_rad < STEEPEST_RAD:
        return None
    directions = (seen @ world_from_cam[:3, :3].T)[:, :2]
    along, across = directions @ ahead[:2], directions @ np.array([-ahead[1], ahead[0]])
    return Sector(
        world_from_cam[:2, 3], ahead[:2] / np.hypot(*ahead[:2]), float(np.abs(np.arctan2(across, along)).max())
    )


def img_from_cam(camera: HostCamera) -> Float[np.ndarray, "3 3"]:
    """The 3x3 projection matrix of the camera frame: u = cx + fx x/y, v = cy - fy z/y."""
    return np.array(
        [[camera.fx_px, camera.cx_px, 0], [0, camera.cy_px, -camera.fy_px], [0, 1, 0]],
        dtype=float,
    )


def project(camera: HostCamera, points_cam: AnyPoints3) -> Float[np.ndarray, "*n 2"]:
    """Pixels (u, v) of points through the lens; NaN for those that are not in its field."""
    return camera.lens.project(img_from_cam(camera), points_cam)


def rays(camera: HostCamera, uv: Float[np.ndarray, "*n 2"]) -> AnyPoints3:
    """Unit vectors (camera frame) along which pixels look; NaN where the lens has no picture."""
    return camera.lens.rays(img_from_cam(camera), uv)


@lru_cache(maxsize=2)
def rays_with_border(camera: HostCamera) -> Float[np.ndarray, "h w 3"]:
    """`rays` of the centres of all pixels, and of those of a border of BORDER_PX around the picture."""
    columns, rows = (np.arange(-BORDER_PX, size + BORDER_PX) + 0.5 for size in (camera.width_px, camera.height_px))
    found = rays(camera, np.stack(np.meshgrid(columns, rows), axis=-1))
    found.flags.writeable = False
    return found


def rays_of_pixels(camera: HostCamera) -> Float[np.ndarray, "h w 3"]:
    """`rays` of the centres of all pixels."""
    return rays_with_border(camera)[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]


def horizontal_fov_rad(camera: HostCamera) -> float:
    """The angle that the image is wide (`lens.width_rad`)."""
    return width_rad(img_from_cam(camera), camera.lens, camera.width_px)


def world_from_host(network: Network, camera: HostCamera) -> Matrix4:
    """The pose of the road frame at the host: origin on the surface at its place, z the surface normal, y along the
    lane."""
    foot, behind, ahead = network.host_points(camera, np.array([0.0, -TANGENT_STEP_M, TANGENT_STEP_M]))
    z = network.up(camera, foot)
    along = ahead - behind
    y = along - (along @ z) * z
    y /= np.linalg.norm(y)
    return from_axes(np.cross(y, z), y, z, foot)
