"""Which lane points a camera sees over the ground. World frame."""

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.ground import Ground

STEP_M = 2.0
# Ground higher than the line of sight by less than this does not hide a point that lies on that ground.
TOLERANCE_M = 0.01


def seen_over_ground(
    ground: Ground, eye_world: Float[np.ndarray, "3"], points_world: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """True where the straight line from the eye to the point passes over terrain, embankments and roads."""
    to = points_world - eye_world
    distance = np.linalg.norm(to[:, :2], axis=1)
    n_steps = np.maximum(np.ceil(distance / STEP_M).astype(int), 2)
    ray = np.repeat(np.arange(len(to)), n_steps - 1)
    step = np.arange(len(ray)) - np.repeat(np.cumsum(n_steps - 1) - (n_steps - 1), n_steps - 1) + 1
    sight = eye_world + to[ray] * (step / n_steps[ray])[:, None]
    hidden = ground.height(sight[:, :2]) > sight[:, 2] + TOLERANCE_M
    seen = np.ones(len(to), dtype=bool)
    seen[ray[hidden]] = False
    return seen
