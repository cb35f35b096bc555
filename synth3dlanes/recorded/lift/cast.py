"""Lines of sight on the ground: where pixels see it, and which places it hides, in the world; and which
places things hide from the camera, by the points of one scan that are above the ground, in its frame. Metres.

Things stand on the ground: a line of sight that passes below the highest point of one, seen from the camera, is hidden.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.recorded.drives.drive import Scan
from synth3dlanes.recorded.lift.ground import GroundMap
from synth3dlanes.system.arrays import Matrix4, Points3, Scalars
from synth3dlanes.world.visibility import along_sights

# Length and steps of lines of sight. Ground without support is bridged for one step at most.
RANGE_M, SIGHT_STEP_M = 110.0, 2.0
BISECTIONS = 10
# Where a line of sight meets the ground at a smaller slope than this, the place is not determined.
LEAST_FALL = 1e-3
# Step along the lines of sight of which the ground may hide the end.
FINE_M = 1.0
# Ground above a line of sight by less than this, and by less than twice its standard deviation, hides nothing.
TOLERANCE_M = 0.03


class CastPoints(NamedTuple):
    """Where lines of sight meet the ground, in the world, NaN where they do not; the standard deviation of the ground's
    height there; and the sine of the angle at which they meet it."""

    xyz_world: Points3
    height_std_m: Scalars
    grazing: Scalars


def cast(ground: GroundMap, eye_world: Float[np.ndarray, "3"], rays_world: Points3) -> CastPoints:
    """Follow lines of sight (unit vectors) from an eye to the ground.

    A line meets the ground where it is above it at one step and below it at the next, with support at both.
    """
    n = len(rays_world)
    level = np.linalg.norm(rays_world[:, :2], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = rays_world / np.where(level > 0, level, np.nan)[:, None]
    away_m = np.arange(1.0, RANGE_M + SIGHT_STEP_M, SIGHT_STEP_M)
    places = eye_world + ahead[:, None] * away_m[None, :, None]
    flat = places.reshape(-1, 3)
    usable = np.isfinite(flat).all(axis=1)
    height = np.full(len(flat), np.nan)
    height[usable] = ground.near(flat[usable, :2])
    above = (flat[:, 2] - height).reshape(n, -1)
    with np.errstate(invalid="ignore"):
        crosses = (above[:, :-1] > 0) & (above[:, 1:] <= 0)
    first = np.argmax(crosses, axis=1)
    meets = crosses.any(axis=1)
    near, far = away_m[first], away_m[first + 1]
    ahead_met = ahead[meets]
    low, high = near[meets], far[meets]
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        place = eye_world + ahead_met * middle[:, None]
        with np.errstate(invalid="ignore"):
            is_above = place[:, 2] > ground.near(place[:, :2])
        low, high = np.where(is_above, middle, low), np.where(is_above, high, middle)
    xyz, std, grazing = np.full((n, 3), np.nan), np.full(n, np.nan), np.full(n, np.nan)
    found = eye_world + ahead_met * ((low + high) / 2)[:, None]
    slopes = ground.slopes(found[:, :2])
    # From the planes of single cells to the blended ground, along the line of sight.
    for _ in range(2):
        height, height_std = ground.at(found[:, :2])
        fall = ahead_met[:, 2] - (slopes * ahead_met[:, :2]).sum(axis=1)
        step = np.nan_to_num((found[:, 2] - height) / np.maximum(-fall, LEAST_FALL))
        found = found + ahead_met * np.clip(step, -SIGHT_STEP_M / 2, SIGHT_STEP_M / 2)[:, None]
    height, height_std = ground.at(found[:, :2])
    found[:, 2] = height
    normal = np.column_stack([-slopes, np.ones(len(found))])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    known = np.isfinite(height)
    rows = np.flatnonzero(meets)[known]
    xyz[rows], std[rows] = found[known], height_std[known]
    grazing[rows] = -(normal * rays_world[meets]).sum(axis=1)[known]
    return CastPoints(xyz, std, grazing)


def seen_over(ground: GroundMap, eye_world: Float[np.ndarray, "3"], points_world: Points3) -> Bool[np.ndarray, " n"]:
    """Which points on the ground an eye sees over it. Ground without support hides nothing."""
    ray, _, sight = along_sights(eye_world, points_world - eye_world, FINE_M)
    height, std = ground.at(sight[:, :2])
    with np.errstate(invalid="ignore"):
        hidden = height > sight[:, 2] + TOLERANCE_M + 2 * std
    seen = np.ones(len(points_world), dtype=bool)
    seen[ray[hidden]] = False
    return seen


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
