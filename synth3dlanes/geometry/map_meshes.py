"""The surfaces of a map as vertex and face arrays. World frame.

Roads are strips along their lines; junctions, their walkways and islands are areas; terrain is what these leave.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import shapely
from jaxtyping import Float
from shapely.geometry.base import BaseGeometry

from synth3dlanes.arrays import Points2, Points3, Scalars
from synth3dlanes.geometry.areas import clipped, contains
from synth3dlanes.geometry.map_ground import GroundArea, MapGround
from synth3dlanes.geometry.meshes import MEDIAN, ROAD, SHOULDER, Mesh, facing_up, grid, terrain_axes, terrain_heights
from synth3dlanes.geometry.section_road import KERB_M, CrossSection, SectionRoad
from synth3dlanes.road_map import MapLaneKind

# Faces of lanes are no wider than this; cells of junctions, near the host and far from it.
COLUMN_M, CELL_M, FAR_CELL_M, FAR_M = 0.9, 0.75, 3.0, 150.0
# What lies beside a surface extends this far under it, this much lower, and kerbs reach this far down.
SEAM_M, SEAM_FALL_M, FOOT_M = 0.08, 0.006, 0.05
# The terrain's hole under the pavement is so much smaller.
UNDER_M = 0.15
# Smaller parts of a cell are left out.
LEAST_PART_M2, ASIDE_M = 1e-9, 0.01
# Pavement farther than this from the host's way is left out.
REACH_M = 480.0
SURFACES: dict[MapLaneKind, int] = {"shoulder": SHOULDER, "border": SHOULDER, "median": MEDIAN, "walkway": SHOULDER,
                                    "kerb": SHOULDER}  # fmt: skip
AREA_SURFACES = {"road": ROAD, "walkway": SHOULDER, "paved": SHOULDER, "grass": MEDIAN}


def pavement_meshes(ground: MapGround) -> list[Mesh]:
    """The strips of all roads outside junctions, and the areas of junctions and islands."""
    found = []
    for road in ground.outside:
        for section in road.sections:
            if section.end_m > section.start_m and section.lanes:
                found += _strips(ground, road, section, ground.section_rows(road, section))
    for area in ground.areas:
        found += _area_meshes(ground, area)
    near = (_near(ground, mesh) for mesh in found)
    return [mesh for mesh in near if len(mesh.faces)]


def _near(ground: MapGround, mesh: Mesh) -> Mesh:
    """The mesh without the faces beyond REACH_M."""
    kept = (ground.away_at(mesh.vertices_world[:, :2]) < REACH_M)[mesh.faces].all(axis=1)
    return mesh if kept.all() else replace(mesh, faces=mesh.faces[kept], material=mesh.material[kept])


def _strips(ground: MapGround, road: SectionRoad, section: CrossSection, s: Scalars) -> list[Mesh]:
    """The lanes of a section, raised ones with kerbs on both sides."""
    edges, first, last = section.edges(s), *section.paved
    found, i = [], first
    while i < last:
        run = next((run for run in section.raised if run[0] == i), None)
        level = next((run[0] for run in section.raised if run[0] > i), last)
        end = min(run[1] if run else level, last)
        columns, surfaces, across = [], [], []
        for k in range(i, end):
            n = max(int(np.ceil((edges[k + 1] - edges[k]).mean() / COLUMN_M)), 1)
            share = np.linspace(0, 1, n + 1)[0 if k == i else 1 :]
            columns += [edges[k] + (edges[k + 1] - edges[k]) * at for at in share]
            across += ((k + share) * ground.network.lane_width_m).tolist()
            surfaces += [SURFACES.get(section.lanes[k].kind, ROAD)] * n
        t = np.stack(columns, axis=1)
        vertices = road.base_points(np.broadcast_to(s[:, None], t.shape), t)
        uv = np.stack(np.broadcast_arrays(np.array(across)[None], s[:, None]), -1)
        if run:
            vertices[..., 2] += KERB_M
            feet = vertices[:, [0, -1]] - [0, 0, KERB_M + FOOT_M]
            vertices = np.concatenate([feet[:, :1], vertices, feet[:, 1:]], axis=1)
            uv = np.concatenate([uv[:, :1] - [0.2, 0], uv, uv[:, -1:] + [0.2, 0]], axis=1)
            surfaces = [surfaces[0], *surfaces, surfaces[-1]]
            ends = vertices[[0, -1]]
            ends[:, 1:-1, 2] -= KERB_M + FOOT_M
            vertices = np.concatenate([ends[:1], vertices, ends[1:]])
            uv = np.concatenate([uv[:1], uv, uv[-1:]])
        found.append(grid(vertices, uv, np.array(surfaces)))
        i = end
    return found


def _area_meshes(ground: MapGround, area: GroundArea) -> list[Mesh]:
    """An area over a grid of cells, with kerbs around it where it is raised. One that is not goes on a little below
    what lies beside it."""
    if area.polygon.is_empty:
        return []
    wide = area.polygon
    if not area.raised_m:
        shapely.prepare(area.polygon)
        seam = shapely.buffer(area.polygon, SEAM_M, join_style="mitre")
        wide = shapely.union(area.polygon, shapely.intersection(seam, ground.pavement))
    x0, y0, x1, y1 = shapely.bounds(wide)
    away_m = float(ground.away_at(np.array([[(x0 + x1) / 2, (y0 + y1) / 2]]))[0]) - np.hypot(x1 - x0, y1 - y0) / 2
    cell_m = CELL_M if away_m < FAR_M else FAR_CELL_M
    axes = [np.arange(low - cell_m, high + 2 * cell_m, cell_m) for low, high in ((x0, x1), (y0, y1))]
    whole, parts = _cut(axes[0], axes[1], wide)
    xs, ys = axes
    corners = [np.stack([xs[whole[0] + i], ys[whole[1] + j]], -1) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    quads = np.concatenate([np.stack(corners, axis=1), _quads(parts)])

    def lifted(xy: Points2) -> Points3:
        z = ground.area_height(area, xy)
        if not area.raised_m:
            beside = ~contains(area.polygon, xy)
            beside[beside] = shapely.distance(area.polygon, shapely.points(xy[beside])) > 0.5 * SEAM_M
            z = z - SEAM_FALL_M * beside
        return np.column_stack([xy, z])

    found = [_shared(quads, lifted, AREA_SURFACES[area.kind])]
    if area.raised_m:
        found.append(_kerb(ground, area))
    return found


def _kerb(ground: MapGround, area: GroundArea) -> Mesh:
    """Upright faces around a raised area."""
    quads = []
    for ring in shapely.get_rings(shapely.get_parts(area.polygon)):
        ring = shapely.segmentize(ring, 1.0)
        xy = shapely.get_coordinates(ring)
        top = np.column_stack([xy, ground.area_height(area, xy)])
        low = top - [0, 0, area.raised_m + FOOT_M]
        quads.append(np.stack([low[:-1], low[1:], top[1:], top[:-1]], axis=1))
    corners = np.concatenate(quads)
    faces = np.arange(4 * len(corners)).reshape(-1, 4)
    outward = shapely.is_ccw(shapely.get_exterior_ring(shapely.get_geometry(area.polygon, 0)))
    return Mesh(
        corners.reshape(-1, 3),
        faces if outward else faces[:, ::-1],
        corners.reshape(-1, 3)[:, :2].copy(),
        np.full(len(faces), AREA_SURFACES[area.kind]),
    )


def terrain_mesh(ground: MapGround) -> Mesh:
    """A grid with fine cells near the host, which grow to the horizon, without what lies under the pavement."""
    xs, ys = terrain_axes(ground)
    hole: BaseGeometry = shapely.buffer(ground.pavement, -UNDER_M, join_style="mitre")
    near = shapely.box(*(ground.way_box(REACH_M - 20.0)))
    hole = shapely.intersection(hole, near)
    xy = np.stack(np.meshgrid(xs, ys), -1)
    vertices = np.concatenate([xy, terrain_heights(ground, xy)[..., None]], -1)
    whole = grid(vertices, xy, np.zeros(len(xs) - 1, dtype=int))
    under, parts = _cut(xs, ys, hole, keep_outside=True)
    n = len(xs) - 1
    faces = np.delete(whole.faces, under[1] * n + under[0], axis=0)
    rest = _quads(parts)

    def lifted(at: Points2) -> Points3:
        z = terrain_heights(ground, at)
        return np.column_stack([at, z])

    border = _shared(rest, lifted, 0)
    return Mesh(
        np.concatenate([whole.vertices_world, border.vertices_world]),
        np.concatenate([faces, border.faces + len(whole.vertices_world)]),
        np.concatenate([whole.uv_m, border.vertices_world[:, :2]]),
        np.zeros(len(faces) + len(border.faces), dtype=int),
    )


def _cut(
    xs: Scalars, ys: Float[np.ndarray, " m"], area: BaseGeometry, keep_outside: bool = False
) -> tuple[np.ndarray, list[BaseGeometry]]:
    """The cells of a grid that an area covers, by column and row, and its parts in those that it covers partly. With
    `keep_outside`: the cells that it meets at all, and what it leaves of them."""
    columns, rows, cut, whole = [], [], list[BaseGeometry](), list[BaseGeometry]()
    x0, y0, x1, y1 = shapely.bounds(area) if not area.is_empty else (0.0, 0.0, 0.0, 0.0)
    for i in range(max(int(np.searchsorted(xs, x0)) - 1, 0), min(int(np.searchsorted(xs, x1)), len(xs) - 1)):
        # A little wider, so that cells do not touch its sides: these are slow to ask about.
        column = clipped(area, (xs[i] - ASIDE_M, y0 - 1, xs[i + 1] + ASIDE_M, y1 + 1))
        if column.is_empty:
            continue
        _, low, _, high = shapely.bounds(column)
        j = np.arange(max(int(np.searchsorted(ys, low)) - 1, 0), min(int(np.searchsorted(ys, high)), len(ys) - 1))
        cells = shapely.box(xs[i], ys[j], xs[i + 1], ys[j + 1])
        shapely.prepare(column)
        taken = shapely.contains_properly(column, cells)
        meets = np.flatnonzero(shapely.intersects(column, cells) & ~taken)
        pieces = [clipped(column, (xs[i], ys[k], xs[i + 1], ys[k + 1])) for k in j[meets]]
        is_part = shapely.area(pieces) >= LEAST_PART_M2
        cut += [piece for piece, is_one in zip(pieces, is_part, strict=True) if is_one]
        if keep_outside:
            taken[meets] = is_part
            whole += cells[meets[is_part]].tolist()
        columns += [i] * int(taken.sum())
        rows += j[taken].tolist()
    parts = shapely.difference(whole, cut).tolist() if keep_outside else cut
    return np.array([columns, rows], dtype=int).reshape(2, -1), parts


def _triangles(polygons: np.ndarray) -> np.ndarray:
    """The triangles of polygons; those that are too thin for any are left out."""
    try:
        return np.asarray(shapely.constrained_delaunay_triangles(polygons))
    except shapely.errors.GEOSException:
        pass
    found = []
    for polygon in polygons:
        for grid_m in (0.0, 1e-4, 1e-2):
            try:
                found.append(shapely.constrained_delaunay_triangles(shapely.set_precision(polygon, grid_m)))
                break
            except shapely.errors.GEOSException:
                continue
    return np.array(found)


def _quads(parts: list[BaseGeometry]) -> Float[np.ndarray, "q 4 2"]:
    """Polygons as quads: triangles, each as three from its corners to its middle."""
    pieces = shapely.get_parts(parts)
    polygons = pieces[shapely.get_type_id(pieces) == shapely.GeometryType.POLYGON]
    if not len(polygons):
        return np.zeros((0, 4, 2))
    rings = shapely.get_coordinates(_triangles(polygons)).reshape(-1, 4, 2)[:, :3]
    areas = np.abs(np.cross(rings[:, 1] - rings[:, 0], rings[:, 2] - rings[:, 0]))
    rings = rings[areas > 1e-9]
    after, before = np.roll(rings, -1, axis=1), np.roll(rings, 1, axis=1)
    middle = np.broadcast_to(rings.mean(axis=1, keepdims=True), rings.shape)
    return np.stack([rings, (rings + after) / 2, middle, (rings + before) / 2], axis=2).reshape(-1, 4, 2)


def _shared(quads: Float[np.ndarray, "q 4 2"], lifted: Callable[[Points2], Points3], surface: int) -> Mesh:
    """A mesh of quads from above that share their corners, facing up."""
    corners = quads.reshape(-1, 2)
    x, y = np.rint(corners * 1e6).astype(int).T
    # As one number each: sorted by rows, they take longer.
    numbers = (x - x.min()) * (np.ptp(y) + 1) + y if len(y) else y
    _, first, which = np.unique(numbers, return_index=True, return_inverse=True)
    xy = corners[first]
    vertices = lifted(xy) if len(xy) else np.zeros((0, 3))
    faces = which.reshape(-1, 4)
    if not len(faces):
        return Mesh(vertices, faces, xy, np.zeros(0, dtype=int))
    up = facing_up(vertices[faces].reshape(-1, 3), corners).faces
    flipped = up[:, 0] != np.arange(0, 4 * len(faces), 4)
    faces = np.where(flipped[:, None], faces[:, ::-1], faces)
    return Mesh(vertices, faces, xy, np.full(len(faces), surface))
