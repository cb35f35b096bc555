"""OpenLane's camera and axes, metres.

Points are in the camera frame with Waymo's axes (`_waymo`): x forward, y left, z up. `extrinsic` is vehicle_from_cam in
these axes.
"""

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.writing import Pinhole
from synth3dlanes.labels.labels import Marking, PaintColor, Pair
from synth3dlanes.system.arrays import Matrix4

CAMERA = Pinhole(1920, 1280, 2015.0)
PAINTS: dict[int, tuple[Marking, PaintColor, bool, Pair | None]] = {
    1: ("dashed", "white", False, None),
    2: ("solid", "white", False, None),
    3: ("dashed", "white", True, None),
    4: ("solid", "white", True, None),
    5: ("solid", "white", True, "dashed_solid"),
    6: ("solid", "white", True, "solid_dashed"),
    7: ("dashed", "yellow", False, None),
    8: ("solid", "yellow", False, None),
    9: ("dashed", "yellow", True, None),
    10: ("solid", "yellow", True, None),
    11: ("solid", "yellow", True, "dashed_solid"),
    12: ("solid", "yellow", True, "solid_dashed"),
}
"""Marking, colour, whether the line is double, and its stripes if they differ, by the field `category`."""
KERB_LEFT, KERB_RIGHT = 20, 21
CASES = {
    "curve": "1000_curve.txt",
    "extreme_weather": "1000_extreme_weather.txt",
    "intersection": "1000_intersection.txt",
    "merge_split": "1000_merge_split_case.txt",
    "night": "1000_night.txt",
    "up_down": "1000_updown.txt",
}
"""The lists that evaluation scripts open, by kind of scene."""
WAYMO_FROM_CAM = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def vehicle_from_cam_waymo(height_m: float, pitch_rad: float) -> Matrix4:
    """The field `extrinsic`, the vehicle's origin at the camera's foot on the road plane: pitched about the left axis,
    then raised by the height."""
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    return np.array([[c, 0, s, 0], [0, 1.0, 0, 0], [-s, 0, c, height_m], [0, 0, 0, 1]])


def ground_from_waymo(
    points_waymo: Float[np.ndarray, "n 3"], vehicle_from_cam: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "n 3"]:
    """The frame of OpenLane's evaluator: x right, y forward, z up, origin exactly under the camera."""
    points_vehicle = points_waymo @ vehicle_from_cam[:3, :3].T + np.array([0.0, 0.0, vehicle_from_cam[2, 3]])
    return np.asarray(points_vehicle @ WAYMO_FROM_CAM)
