"""The ground of a given map with heights: smooth, at the heights of its roads near these, with the hills of the
parameters beyond. World frame."""

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.roads.map_lines import plan_line
from synth3dlanes.roads.section_road import CrossSection
from synth3dlanes.roads.terrain import grid_weights, height_at
from synth3dlanes.scene.road_map import MapRoad, RoadMap
from synth3dlanes.scene.scene import HeightGrid, Terrain
from synth3dlanes.system.arrays import Points3, Scalars

# The grid reaches so far from the world's origin, in steps; at its edge the ground is level.
REACH_M, STEP_M, LEVEL = 640.0, 20.0, 4
# Places of roads that the ground is fitted to, along roads.
ALONG_M = 6.0
# Of two roads one above the other the ground meets the lower one: of places so close, with so much and more than their
# distance between.
ABOVE_M, BESIDE_M = 3.0, 15.0
# How much a bend of the ground counts beside a metre off a road, and its distance from the mean height.
STIFF, MEAN = 0.02, 1e-4
DECIMALS = 3


def terrain_of(roads: RoadMap, hills: Terrain) -> Terrain:
    """The hills, on a ground so that both together meet the roads; the hills alone for a map without heights."""
    points = [road_points(road) for road in roads.roads if road.heights]
    if not points:
        return hills
    xyz = _lowest(np.concatenate(points))
    xyz = xyz[(np.abs(xyz[:, :2]) < REACH_M - LEVEL * STEP_M).all(axis=1)]
    n = 2 * round(REACH_M / STEP_M) + 1
    flat = HeightGrid(corner_m=(-REACH_M, -REACH_M), step_m=STEP_M, rows=((0.0,) * n,) * n)
    rows = _fitted(flat, xyz[:, :2], xyz[:, 2] - height_at(hills, xyz[:, :2]))
    base = flat.model_copy(update={"rows": tuple(tuple(row) for row in np.round(rows, DECIMALS).tolist())})
    return hills.model_copy(update={"base": base})


def road_points(road: MapRoad) -> Points3:
    """Places of a road's surface outside tunnels: on its line and at both edges of its pavement."""
    line, found = plan_line(road.plan), []
    for i in range(len(road.sections)):
        section = CrossSection.of(road, i)
        length_m = max(section.end_m - section.start_m, 0.0)
        s = np.linspace(section.start_m, section.end_m, 2 + int(length_m / ALONG_M))
        s = s[~np.any([(s > at.from_m) & (s < at.to_m) for at in road.tunnels] or [s < 0], axis=0)]
        edges, own = section.edges(s), line.within(section.start_m, section.end_m)
        for t in (edges[0], 0 * s, edges[-1]):
            found.append(np.column_stack([own.xy(s, t), section.height(s, t)]))
    return np.concatenate(found)


def _lowest(xyz: Points3) -> Float[np.ndarray, "_ 3"]:
    """Those of places that have no other far below them close by."""
    pairs = scipy.spatial.cKDTree(xyz[:, :2]).query_pairs(BESIDE_M, output_type="ndarray")
    apart = xyz[pairs[:, 0]] - xyz[pairs[:, 1]]
    most, dz = ABOVE_M + np.hypot(*apart[:, :2].T), apart[:, 2]
    above = np.concatenate([pairs[dz > most, 0], pairs[dz < -most, 1]])
    return np.delete(xyz, above, axis=0)


def _fitted(grid: HeightGrid, xy_world: Float[np.ndarray, "m 2"], z: Scalars) -> Float[np.ndarray, "rows columns"]:
    """The coefficients with which a grid is nearest to these heights and bends least; level at its edge."""
    n, sparse = len(grid.rows), scipy.sparse
    mean = float(np.mean(z)) if len(z) else 0.0
    weights, first = grid_weights(grid, xy_world)
    columns = first[:, 0, None] + np.arange(4)
    lines = first[:, 1, None] + np.arange(4)
    numbers = (lines[:, :, None] * n + columns[:, None, :]).reshape(-1)
    values = (weights[:, 1, :, None] * weights[:, 0, None, :]).reshape(-1)
    at = sparse.csr_matrix((values, (np.repeat(np.arange(len(z)), 16), numbers)), shape=(len(z), n * n))
    bend = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n))
    slope = sparse.diags([-1.0, 1.0], [0, 1], shape=(n - 1, n))
    same = sparse.identity(n)
    terms = [sparse.kron(same, bend), sparse.kron(bend, same), np.sqrt(2) * sparse.kron(slope, slope)]
    stiff = sum((term.T @ term for term in terms), sparse.csr_matrix((n * n, n * n)))
    i, j = np.divmod(np.arange(n * n), n)
    inner = (np.minimum(i, j) >= LEVEL) & (np.maximum(i, j) < n - LEVEL)
    kept = sparse.identity(n * n, format="csr")[np.flatnonzero(inner)]
    system = kept @ (at.T @ at + STIFF * stiff + MEAN * sparse.identity(n * n)) @ kept.T
    found = np.zeros(n * n)
    found[inner] = sparse.linalg.spsolve(system.tocsc(), kept @ (at.T @ (z - mean)))
    return np.asarray(found.reshape(n, n) + mean)
