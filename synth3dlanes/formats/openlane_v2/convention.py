"""OpenLane-V2's folder, its vehicle frame (`_ego`: x forward, y left, z up, metres) and its codes."""

import numpy as np

from synth3dlanes.labels.element_labels import ElementLabel
from synth3dlanes.labels.labels import Marking
from synth3dlanes.scene.traffic_elements import ElementKind, ElementState

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
NEXT_PART = 1_000_000
"""A lane that leaves the area and comes back has a part of its own for each time, whose ids are this much apart."""
LINE_TYPES: dict[Marking, int] = {"none": 0, "solid": 1, "dashed": 2}
LEAST_PX, LEAST_SEEN = 3.0, 0.1
"""The shorter side of the rectangle of a traffic element, and the share of it that must be seen."""
PEDESTRIAN_CROSSING, ROAD_BOUNDARY = 1, 2
TRAFFIC_LIGHT, ROAD_SIGN = 1, 2
UNKNOWN = 0
"""The attribute of what the benchmark has no attribute for."""
STATE_ATTRIBUTES: dict[ElementState, int] = {
    "red": 1, "red_cross": 1, "red_amber": 1, "green": 2, "green_arrow": 2,
    "amber": 3, "amber_left": 3, "amber_right": 3
}  # fmt: skip
"""Of signals the colour, whatever the form of their lenses; those that are off have none."""
SIGN_ATTRIBUTES: dict[ElementKind, int] = {
    "ahead_only": 4, "direction_ahead": 4, "left_only": 5, "right_only": 6, "no_left_turn": 7, "no_right_turn": 8,
    "no_u_turn": 10, "exit_left": 11, "direction_left": 11, "exit_right": 12, "direction_right": 12
}  # fmt: skip
"""Of signs the direction that they order, forbid or point to; 9 (turn back) is on none of ours."""


def category_and_attribute(item: ElementLabel) -> tuple[int, int]:
    """The codes of a traffic element."""
    if item.state is None:
        return ROAD_SIGN, SIGN_ATTRIBUTES.get(item.kind, UNKNOWN)
    return TRAFFIC_LIGHT, STATE_ATTRIBUTES.get(item.state, UNKNOWN)


def collection(first_camera: str) -> str:
    """The list of all frames: subset B has the cameras of nuScenes, CAM_FRONT first."""
    return COLLECTIONS[first_camera.startswith("CAM_")]
