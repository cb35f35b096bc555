"""Strategies of cameras and roads that the formats' tests share."""

import numpy as np
from hypothesis import strategies as st

from synth3dlanes.formats.writing import CV_FROM_CAM

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


def distance_to_lane_m(points_cv, lane):
    """How far each point is from the nearest sample of a lane."""
    lane_cv = lane.xyz_cam @ CV_FROM_CAM.T
    return np.linalg.norm(points_cv[:, None] - lane_cv, axis=2).min(axis=1)
