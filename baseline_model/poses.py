"""Camera poses relative to a road plane, in numpy: (pitch, height) to 4x4 transforms and back.

Frames: camera and road as in the labels (x right, y forward, z up); pitch is positive looking down.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes import frames

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
