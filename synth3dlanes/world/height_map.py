"""A height map of the ground ahead over the road plane, for top-view methods. Road frame."""

import numpy as np
from jaxtyping import Float, Int

from synth3dlanes.geometry.frames import transform
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.world.ground import Ground

# The paper's top view: 20 m x 80 m, starting below the camera; row 0 is the farthest.
CELL_M = (0.2, 0.4)
SHAPE = (200, 100)
# All cells are searched with STEPS steps. Cells on steep ground need up to MOST_STEPS: their steps are stretched by the
# error that the previous one left, at most MOST_STRETCH times, and each must leave less than the share MOST_LEFT of the
# error.
STEPS, MOST_STEPS, CLOSE_M, MOST_LEFT, MOST_STRETCH = 12, 60, 1e-4, 0.95, 10.0
# Cells that end farther than LOST_M from the ground are searched up and down in pieces of PIECE_M, which grow by the
# factor GROWING from REACH_M to FARTHEST_M (a valley whose side climbs 100 m over the plane of its bottom), and within
# a piece by halving it.
LOST_M, REACH_M, PIECE_M, GROWING, FARTHEST_M, HALVES = 0.01, 30.0, 0.25, 1.05, 200.0, 12


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
    points_road, lost = cells_road(np.zeros(SHAPE)), []
    at, before_m = np.arange(len(points_road)), np.full(len(points_road), np.inf)
    gain = np.full(len(points_road), world_from_road[2, 2])
    for step in range(MOST_STEPS):
        points_world = transform(world_from_road, points_road[at])
        below_m = ground.height_near(points_world) - points_world[:, 2]
        left = below_m / np.where(before_m == 0, np.inf, before_m)
        if step >= STEPS:
            gain = gain / np.clip(1 - left, 1 / MOST_STRETCH, MOST_STRETCH)
        points_road[at, 2] += below_m * gain
        # At a kerb a step leads to no nearer place.
        asked = (np.abs(below_m) > CLOSE_M) & (np.abs(left) < MOST_LEFT) | (step < STEPS - 1)
        lost.append(at[~asked & (np.abs(below_m) > LOST_M)])
        at, before_m, gain = at[asked], below_m[asked], gain[asked]
        if not len(at):
            break
    lost = np.concatenate([*lost, at])
    points_road[lost, 2] = _searched(ground, world_from_road, points_road[lost])
    return points_road[:, 2].reshape(SHAPE)


def _searched(
    ground: Ground, world_from_road: Matrix4, points_road: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """The height of the ground nearest to the plane at cells; the height that a cell has where there is none."""

    def below(at: Int[np.ndarray, " n"], height_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        points_world = transform(world_from_road, np.column_stack([points_road[at, :2], height_m]))
        return np.asarray(ground.height_near(points_world) - points_world[:, 2])

    beyond_m = REACH_M * GROWING ** np.arange(1, 1 + np.log(FARTHEST_M / REACH_M) / np.log(GROWING))
    up_m = np.concatenate([np.arange(0, REACH_M + PIECE_M / 2, PIECE_M), beyond_m])
    tried_m = np.concatenate([-up_m[:0:-1], up_m])
    pieces_m = np.diff(tried_m)
    n, all_m = len(points_road), np.tile(tried_m, len(points_road))
    is_above = below(np.repeat(np.arange(n), len(tried_m)), all_m).reshape(n, len(tried_m)) < 0
    begins = ~is_above[:, :-1] & is_above[:, 1:]
    nearest = np.where(begins, np.abs(tried_m[:-1] + pieces_m / 2), np.inf).argmin(axis=1)
    found = np.flatnonzero(begins.any(axis=1))
    low_m, piece_m = tried_m[nearest[found]], pieces_m[nearest[found]]
    for half in range(1, HALVES + 1):
        middle_m = low_m + piece_m / 2**half
        low_m = np.where(below(found, middle_m) < 0, low_m, middle_m)
    heights_m = points_road[:, 2].copy()
    heights_m[found] = low_m
    return heights_m
