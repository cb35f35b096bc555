"""Apollo Sim-3D's camera, folder and ground frame (`_apollo`), metres.

The ground frame is x right, y forward, z up, but its origin is not the camera's foot: the projection that all tools of
the format share puts the camera at (0, h sin p, h cos p), where h is the field `cam_height` and p the pitch.
"""

import numpy as np

from synth3dlanes.formats.writing import Pinhole
from synth3dlanes.geometry.frames import road_from_cam
from synth3dlanes.system.arrays import Matrix4

CAMERA = Pinhole(1920, 1080, 2015.0)
"""The tools of the format assume it; its files do not carry intrinsics."""
ROOT = "Apollo_Sim_3D_Lane_Release"


def cam_height_m(height_m: float, pitch_rad: float) -> float:
    """The field `cam_height` of a camera `height_m` above the road: with it the road plane is z = 0."""
    return float(height_m / np.cos(pitch_rad))


def apollo_from_cam(cam_height_m: float, pitch_rad: float) -> Matrix4:
    """From our camera frame to their ground frame."""
    moved = road_from_cam(cam_height_m * float(np.cos(pitch_rad)), pitch_rad)
    moved[1, 3] = cam_height_m * np.sin(pitch_rad)
    return moved
