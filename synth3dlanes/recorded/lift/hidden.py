"""Which places things hide from the camera, by the points of one scan that are above the ground. Camera frame.

Things stand on the ground: a line of sight that passes below the highest point of one, seen from the camera, is hidden.
"""

import numpy as np
from jaxtyping import Bool

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.recorded.drives.drive import Scan
from synth3dlanes.recorded.lift.ground import GroundMap
from synth3dlanes.system.arrays import Matrix4, Points3

# Heights above the ground of points of things that hide it: no kerbs, and no bridges and signs over the road.
ABOVE_M = (0.3, 2.5)
# Number of directions, step of distances, and how far behind its points a thing begins to hide.
DIRECTIONS, RANGE_STEP_M, BEHIND_M = 1800, 1.0, 1.5
STEPS = 120


def seen_past_things(
    scan: Scan, world_from_lidar: Matrix4, world_from_cam: Matrix4, ground: GroundMap, points_cam: Points3
) -> Bool[np.ndarray, " n"]:
    """Which points no thing hides that the scan has points of."""
    xyz_world = transform(world_from_lidar, scan.xyz_lidar.astype(float))
    above = xyz_world[:, 2] - ground.near(xyz_world[:, :2])
    with np.errstate(invalid="ignore"):
        stands = (above > ABOVE_M[0]) & (above < ABOVE_M[1])
    highest = np.full((DIRECTIONS, STEPS), -np.inf)
    direction, step, rise = _seen(transform(invert(world_from_cam), xyz_world[stands]), 0.0)
    np.maximum.at(highest, (direction, step), rise)
    highest = np.maximum.accumulate(highest, axis=1)
    # Between two points of a thing there is more of it.
    beside = np.maximum(highest, np.maximum(np.roll(highest, 1, axis=0), np.roll(highest, -1, axis=0)))
    direction, step, rise = _seen(points_cam, -BEHIND_M)
    return np.asarray(beside[direction, step] <= rise)


def _seen(points_cam: Points3, farther_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Direction, distance and slope of the lines of sight to points."""
    x, y, z = points_cam.T
    far_m = np.hypot(x, y)
    direction = np.floor((np.arctan2(x, y) / (2 * np.pi) + 0.5) * DIRECTIONS).astype(int) % DIRECTIONS
    step = np.clip((far_m + farther_m) / RANGE_STEP_M, 0, STEPS - 1).astype(int)
    return direction, step, z / np.maximum(far_m, 1e-6)
