"""Grade and curvature of labelled lanes, measured over lengths at which rounding does not matter."""

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels, Lane

_BASELINE_POINTS = 5


def grades(lane: Lane, labels: Labels) -> Float[np.ndarray, " n"]:
    """Rise over run along the lane, relative to true vertical; up is positive. Empty for a lane that is too short."""
    steps = _steps_world(lane, labels)
    return np.asarray(steps[:, 2] / np.hypot(steps[:, 0], steps[:, 1]))


def bends(lane: Lane, labels: Labels) -> Float[np.ndarray, " n"]:
    """Curvature seen from above in 1/m; to the right is positive. Empty for a lane that is too short."""
    steps = _steps_world(lane, labels)
    headings = np.unwrap(np.arctan2(steps[:, 0], steps[:, 1]))
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    return np.asarray(2 * np.diff(headings) / (lengths[1:] + lengths[:-1]))


def _steps_world(lane: Lane, labels: Labels) -> Float[np.ndarray, "n 3"]:
    return np.diff(transform(labels.camera.world_from_cam, lane.xyz_cam)[::_BASELINE_POINTS], axis=0)
