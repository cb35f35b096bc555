"""Labels in closed form: parallel lines on a road plane with a chosen curvature, slope and camera; strategies of such
roads and cameras."""

import numpy as np
from hypothesis import strategies as st

from synth3dlanes.formats.writing import CV_FROM_CAM, PinholeFrame
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, LaneGraph

ROUNDING_M = 2e-6
# Built inside the tests: the shape checks draw random numbers, which Hypothesis forbids in a strategy.
cameras = st.tuples(st.floats(1.4, 1.9), st.floats(0.0, 0.0873))
roads = st.fixed_dictionaries(
    {
        "n_lines": st.integers(2, 5),
        "width_m": st.floats(3.2, 4.0),
        "curvature": st.floats(-0.004, 0.004),
        "slope": st.floats(-0.0008, 0.0015),
    }
)


def frame(pinhole, **changes):
    """Training frame 17 of a data set with training and test frames, without lanes."""
    parts = frozenset({"train", "test"})
    of_frame = {"split": "train", "key": "00000017", "number": 17, "part": "train", "parts": parts}
    of_frame["labels"] = labels_of(camera_label())
    return PinholeFrame(**{**of_frame, "pinhole": pinhole, "tags": frozenset(), "illumination": 1, **changes})


def camera_label(height_m=1.6, pitch_rad=0.05, size_px=(1920, 1280), f_px=2015.0, roll_rad=0.0):
    """A camera over its road plane, as wide as every export's."""
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    road_from_cam = np.array([[1, 0, 0, 0], [0, c, s, 0], [0, -s, c, height_m], [0, 0, 0, 1.0]])
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    road_from_cam = road_from_cam @ np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1.0]])
    width_px, height_px = size_px
    img_from_cam = np.array([[f_px, width_px / 2, 0], [0, height_px / 2, -f_px], [0, 1.0, 0]])
    return CameraLabel(width_px, height_px, img_from_cam, height_m, pitch_rad, road_from_cam, road_from_cam, roll_rad)


def lane(camera, points_road, name="d0", kind="delimiter", marking="solid", hidden_from_m=np.inf, road="main", **paint):
    """A lane through points of the road frame; the terrain hides it from `hidden_from_m` ahead on."""
    points_cam = (points_road - camera.road_from_cam[:3, 3]) @ camera.road_from_cam[:3, :3]
    seen = points_road[:, 1] < hidden_from_m
    everywhere = np.ones(len(points_road), dtype=bool)
    return Lane(name, kind, road, marking, None, None, points_cam, everywhere, seen, None, **paint)


def curve(x_m, curvature=0.0, slope=0.0, start_m=0.0, end_m=110.0):
    """Points of the road frame every metre of y: x = x_m + curvature y^2 / 2, z = slope y^2 / 2."""
    y_m = np.arange(start_m, end_m + 0.5)
    return np.column_stack([x_m + curvature * y_m**2 / 2, y_m, slope * y_m**2 / 2])


def labels_of(camera, *lanes):
    """Labels without a graph."""
    return Labels(camera, lanes, LaneGraph((), {}, None))


def road(camera, n_lines=4, width_m=3.6, curvature=0.0, slope=0.0, end_m=110.0):
    """Delimiters `d0`.. and centre lines `c0`.. from left to right, the camera in the middle of the road."""
    x_m = (np.arange(n_lines) - (n_lines - 1) / 2) * width_m
    marking = ["solid", *["dashed"] * (n_lines - 2), "solid"]
    delimiters = [
        lane(camera, curve(x, curvature, slope, end_m=end_m), f"d{i}", marking=marking[i]) for i, x in enumerate(x_m)
    ]
    centers = [
        lane(camera, curve(x + width_m / 2, curvature, slope, end_m=end_m), f"c{i}", "centerline", "none")
        for i, x in enumerate(x_m[:-1])
    ]
    return labels_of(camera, *delimiters, *centers)


def distance_to_lane_m(points_cv, lane):
    """How far each point is from the nearest sample of a lane."""
    lane_cv = lane.xyz_cam @ CV_FROM_CAM.T
    return np.linalg.norm(points_cv[:, None] - lane_cv, axis=2).min(axis=1)
