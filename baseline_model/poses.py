"""Camera poses relative to a road plane, in numpy: (pitch, height) to 4x4 transforms and back.

Frames: camera and road as in the labels (x right, y forward, z up); pitch is positive looking down.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry import frames

MEAN_PITCH_RAD = float(np.radians(2.5))
MEAN_HEIGHT_M = 1.65


class Pose(NamedTuple):
    """The camera's pose relative to a road plane, without roll."""

    pitch_rad: float
    height_m: float


MEAN_POSE = Pose(MEAN_PITCH_RAD, MEAN_HEIGHT_M)


def road_from_cam(pose: Pose) -> Float[np.ndarray, "4 4"]:
    """The camera's pose in the road frame, whose origin is below the camera: the camera is at (0, 0, height)."""
    return frames.road_from_cam(pose.height_m, pose.pitch_rad)


def cam_from_road(pose: Pose) -> Float[np.ndarray, "4 4"]:
    """Inverse of `road_from_cam`: p_cam = R (p_road - C), with the camera at C = (0, 0, height) of the road frame."""
    return frames.invert(road_from_cam(pose))


def onto_plane(rays_cam: Float[np.ndarray, "n 3"], pose: Pose) -> Float[np.ndarray, "m 3"]:
    """Where viewing rays, each given by a point on it, meet the plane, in camera coordinates. Rays at or above the
    plane's horizon and points behind the camera are dropped."""
    # The height over the plane along a ray is height + scale * fall: the camera is at z = height.
    fall = rays_cam @ road_from_cam(pose)[2, :3]
    meets = (fall < -1e-6) & (rays_cam[:, 1] > 0.05)
    return rays_cam[meets] * (pose.height_m / -fall[meets])[:, None]
