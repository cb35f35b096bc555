"""OpenLane-V2's folder, its vehicle frame (`_ego`: x forward, y left, z up, metres) and its codes."""

import numpy as np

from synth3dlanes.labels import Marking

ROOT = "OpenLane-V2"
COLLECTIONS = ("data_dict_subset_A", "data_dict_subset_B")
FRONT_CAMERA = "ring_front_center"
"""Loaders expect it to be the first camera."""
ROAD_FROM_EGO = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Our ego frame has its origin at the foot of the first camera, on the road."""
AHEAD_M, ASIDE_M = 50.0, 25.0
"""Half the size of the area that is labelled and scored."""
CENTERLINE_POINTS, POINTS = 201, 51
"""Points of a centre line; the devkit keeps every 20th for validation. Points of a lane segment's lines."""
LINE_TYPES: dict[Marking, int] = {"none": 0, "solid": 1, "dashed": 2}
PEDESTRIAN_CROSSING, ROAD_BOUNDARY = 1, 2


def collection(first_camera: str) -> str:
    """The list of all frames: subset B has the cameras of nuScenes, CAM_FRONT first."""
    return COLLECTIONS[first_camera.startswith("CAM_")]
