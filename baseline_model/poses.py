"""Camera poses relative to a road plane, in numpy: (pitch, height) to 4x4 transforms and back.

Frames: camera and road as in the labels (x right, y forward, z up); pitch is positive looking down.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

MEAN_PITCH_RAD = float(np.radians(2.5))
MEAN_HEIGHT_M = 1.65


class Pose(NamedTuple):
    """The two numbers that fix the camera relative to a road plane when there is no roll."""

    pitch_rad: float
    height_m: float


MEAN_POSE = Pose(MEAN_PITCH_RAD, MEAN_HEIGHT_M)


def road_from_cam(pose: Pose) -> Float[np.ndarray, "4 4"]:
    """The road frame has its origin at the camera's foot, so the camera sits at (0, 0, height) of it."""
    cos, sin = np.cos(pose.pitch_rad), np.sin(pose.pitch_rad)
    return np.array([[1, 0, 0, 0], [0, cos, sin, 0], [0, -sin, cos, pose.height_m], [0, 0, 0, 1]], dtype=float)


def cam_from_road(pose: Pose) -> Float[np.ndarray, "4 4"]:
    """Inverse of `road_from_cam`: p_cam = R (p_road - C) with C above the origin of the *road* frame."""
    return np.linalg.inv(road_from_cam(pose))


def transform(b_from_a: Float[np.ndarray, "4 4"], points_a: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Apply a rigid transform to points."""
    return points_a @ b_from_a[:3, :3].T + b_from_a[:3, 3]


def project(img_from_cam: Float[np.ndarray, "3 3"], points_cam: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Pixel positions; points at or behind the camera give NaN."""
    homogeneous = points_cam @ img_from_cam.T
    depth_m = np.where(homogeneous[..., 2:] > 1e-6, homogeneous[..., 2:], np.nan)
    return homogeneous[..., :2] / depth_m


def horizon_pose(plane: Pose, farthest_road: Float[np.ndarray, " 3"]) -> Pose:
    """Tilt the plane through the host's ground point and the farthest visible road point (paper, 4.3 'horizon').

    With slope alpha = atan2(z, y) the camera's distance to the tilted plane is height * cos(alpha).
    """
    slope_rad = float(np.arctan2(farthest_road[2], farthest_road[1]))
    return Pose(plane.pitch_rad + slope_rad, plane.height_m * float(np.cos(slope_rad)))
