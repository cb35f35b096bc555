"""A height map of the ground ahead over the road plane, for top-view methods. Road frame."""

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import transform
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.world.ground import Ground

# The paper's top view: 20 m x 80 m, starting below the camera; row 0 is the farthest.
CELL_M = (0.2, 0.4)
SHAPE = (200, 100)
# Steps in which all cells are looked for. Those on steep ground need more: these steps are longer by what the one
# before left, at most LONGER times, and each must end NEARER times as far from there.
STEPS, MOST_STEPS, CLOSE_M, NEARER, LONGER = 12, 60, 1e-4, 0.95, 10.0


def cells_road(height_m: Float[np.ndarray, "200 100"]) -> Float[np.ndarray, "20000 3"]:
    """The points of a height map's cells, row by row. Road frame."""
    rows, columns = SHAPE
    x = (np.arange(columns) + 0.5) * CELL_M[0] - columns * CELL_M[0] / 2
    y = rows * CELL_M[1] - (np.arange(rows) + 0.5) * CELL_M[1]
    return np.column_stack([*(axis.ravel() for axis in np.meshgrid(x, y)), height_m.ravel()])


def height_map(ground: Ground, world_from_road: Matrix4) -> Float[np.ndarray, "200 100"]:
    """Height of the ground as built at each cell's centre, over the plane that touches the road at the host; where one
    road passes over another, of that which is nearer to the plane.

    Column c lies at x = (c + 0.5) 0.2 - 10 m, row r at y = 80 - (r + 0.5) 0.4 m.
    """
    points_road = cells_road(np.zeros(SHAPE))
    at, before_m = np.arange(len(points_road)), np.full(len(points_road), np.inf)
    gain = np.full(len(points_road), world_from_road[2, 2])
    for step in range(MOST_STEPS):
        points_world = transform(world_from_road, points_road[at])
        below_m = ground.height_near(points_world) - points_world[:, 2]
        left = below_m / np.where(before_m == 0, np.inf, before_m)
        if step >= STEPS:
            gain = gain / np.clip(1 - left, 1 / LONGER, LONGER)
        points_road[at, 2] += below_m * gain
        # At a kerb a step leads to no nearer place.
        asked = (np.abs(below_m) > CLOSE_M) & (np.abs(left) < NEARER) | (step < STEPS - 1)
        at, before_m, gain = at[asked], below_m[asked], gain[asked]
        if not len(at):
            break
    return points_road[:, 2].reshape(SHAPE)
