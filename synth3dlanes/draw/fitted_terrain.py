"""The ground of a given map with heights: smooth, at the heights of its roads near these, with the hills of the
parameters beyond. World frame."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import scipy
from jaxtyping import Float, Int

from synth3dlanes.geometry.polylines import spaced
from synth3dlanes.roads.road_table import RoadTable
from synth3dlanes.roads.roads import Road
from synth3dlanes.roads.terrain import grid_weights, height_at
from synth3dlanes.scene.scene import HeightGrid, Terrain
from synth3dlanes.system.arrays import Points3, Scalars

# The grid's step, half its number of steps, and the number of level coefficients at its edge.
GROUND_GRID_STEP_M, HALF_N, LEVEL_AT_EDGE = 20.0, 32, 4
# Places of roads that the ground is fitted to, along roads.
ALONG_M = 6.0
# Where one road passes over another, the ground meets the lower one: at places less than BESIDE_M apart seen from
# above, whose heights differ by that distance and ABOVE_M more.
ABOVE_M, BESIDE_M = 3.0, 15.0
# Weights of the ground's bends and of its distance from the mean height, where that of its distance from roads is 1.
BEND_WEIGHT, MEAN_WEIGHT = 0.02, 1e-4
MM_DECIMALS = 3


def terrain_of(roads: Sequence[Road], hills: Terrain, step_m: float = GROUND_GRID_STEP_M) -> Terrain:
    """The hills, on a ground so that both together meet the roads; the hills alone for a map without heights. The
    ground is a grid of this step around the world's origin."""
    raised = [road for road in roads if road.has_heights]
    if not raised:
        return hills
    xyz = _lowest(road_points(raised, hills))
    xyz = xyz[(np.abs(xyz[:, :2]) < (HALF_N - LEVEL_AT_EDGE) * step_m).all(axis=1)]
    n, corner_m = 2 * HALF_N + 1, -HALF_N * step_m
    flat = HeightGrid(corner_m=(corner_m, corner_m), step_m=step_m, rows=((0.0,) * n,) * n)
    rows = _fitted(flat, xyz[:, :2], xyz[:, 2] - height_at(hills, xyz[:, :2]))
    base = flat.model_copy(update={"rows": tuple(tuple(row) for row in np.round(rows, MM_DECIMALS).tolist())})
    return hills.model_copy(update={"base": base})


def road_points(roads: Sequence[Road], terrain: Terrain) -> Points3:
    """Places of the surfaces of roads with heights outside tunnels: on their lines and at both edges of their
    pavement."""
    stretches = [stretch for road in roads for stretch in road.stretches]
    start_m, end_m = (np.array([getattr(at, end) for at in stretches]) for end in ("start_m", "end_m"))
    counts = 2 + (np.maximum(end_m - start_m, 0.0) / ALONG_M).astype(int)
    number, s = np.repeat(np.arange(len(stretches)), counts), spaced(start_m, end_m, counts)
    in_tunnel = np.zeros(len(s), dtype=bool)
    for i, at in enumerate(stretches):
        for tunnel in at.tunnels:
            in_tunnel |= (number == i) & (s > tunnel.from_m) & (s < tunnel.to_m)
    number, s, table = number[~in_tunnel], s[~in_tunnel], RoadTable(stretches, terrain)
    last = np.array([len(at.sections[0].lanes) for at in stretches])[number]
    edges = (table.edge(number, edge, s) for edge in (0 * last, last))
    return np.concatenate([table.base_points(number, s, t) for t in (0 * s, *edges)])


def _lowest(xyz: Points3) -> Float[np.ndarray, "_ 3"]:
    """The places that are not on a road which passes over another one."""
    # Most places have nothing far below them in the cells of a grid around them.
    cells = (
        np.floor((xyz[:, :2] - xyz[:, :2].min(axis=0)) / BESIDE_M).astype(int) if len(xyz) else np.zeros((0, 2), int)
    )
    lowest = np.full(cells.max(axis=0, initial=0) + 1, np.inf)
    np.minimum.at(lowest, tuple(cells.T), xyz[:, 2])
    around = scipy.ndimage.minimum_filter(lowest, size=3, mode="nearest")[tuple(cells.T)]
    high = np.flatnonzero(xyz[:, 2] - around > ABOVE_M)
    near = scipy.spatial.cKDTree(xyz[:, :2]).query_ball_point(xyz[high, :2], BESIDE_M) if high.size else []
    which, below = np.repeat(high, [len(at) for at in near]), np.array([i for at in near for i in at], dtype=int)
    apart = xyz[which] - xyz[below]
    above = which[apart[:, 2] > ABOVE_M + np.hypot(*apart[:, :2].T)]
    return np.delete(xyz, above, axis=0)


def _fitted(grid: HeightGrid, xy_world: Float[np.ndarray, "m 2"], z: Scalars) -> Float[np.ndarray, "rows columns"]:
    """The coefficients with which a grid is nearest to these heights and bends least; level at its edge."""
    n = len(grid.rows)
    mean = float(np.mean(z)) if len(z) else 0.0
    weights, first = grid_weights(grid, xy_world)
    columns = first[:, 0, None] + np.arange(4)
    lines = first[:, 1, None] + np.arange(4)
    number, stiff = _stiffness(n)
    numbers = number[lines[:, :, None], columns[:, None, :]].ravel()
    values = (weights[:, 1, :, None] * weights[:, 0, None, :]).ravel()
    free = numbers >= 0
    places = np.repeat(np.arange(len(z)), 16)[free], numbers[free]
    at = scipy.sparse.csr_matrix((values[free], places), shape=(len(z), stiff.shape[1]))
    # Unknowns are coupled with those of three rows around them alone: the system is a band below its diagonal.
    products, system = (at.T @ at).tocoo(), stiff.copy()
    low = products.row >= products.col
    system[(products.row - products.col)[low], products.col[low]] += products.data[low]
    found = np.zeros((n, n))
    found[number >= 0] = scipy.linalg.solveh_banded(system, at.T @ (z - mean), lower=True)
    return found + mean


@cache
def _stiffness(n: int) -> tuple[Int[np.ndarray, "n n"], Float[np.ndarray, "b _"]]:
    """For a grid of n rows and columns: the number of each coefficient that is not at the edge, else -1; and the matrix
    of the penalty of bends and of distance from the mean height, as a band: row i couples each coefficient with the
    i-th after it."""
    sparse, inside = scipy.sparse, n - 2 * LEVEL_AT_EDGE
    bend = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n))
    slope = sparse.diags([-1.0, 1.0], [0, 1], shape=(n - 1, n))
    same = sparse.identity(n)
    terms = [sparse.kron(same, bend), sparse.kron(bend, same), np.sqrt(2) * sparse.kron(slope, slope)]
    whole = sum((BEND_WEIGHT * (term.T @ term) for term in terms), MEAN_WEIGHT * sparse.identity(n * n))
    number = np.full((n, n), -1)
    number[LEVEL_AT_EDGE:-LEVEL_AT_EDGE, LEVEL_AT_EDGE:-LEVEL_AT_EDGE] = np.arange(inside**2).reshape(inside, inside)
    kept = np.flatnonzero(number.ravel() >= 0)
    inner = whole.tocsr()[kept][:, kept].tocoo()
    stiff, low = np.zeros((3 * inside + 4, inside**2)), inner.row >= inner.col
    stiff[(inner.row - inner.col)[low], inner.col[low]] = inner.data[low]
    return number, stiff
