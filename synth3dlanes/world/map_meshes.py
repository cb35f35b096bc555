"""The surfaces of a map as vertex and face arrays. World frame.

Roads are strips along their lines; junctions, their walkways and islands are areas; the terrain is one surface below
all of these.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from synth3dlanes.geometry.polylines import parted
from synth3dlanes.roads.cross_section import KERB_M
from synth3dlanes.roads.roads import Road
from synth3dlanes.scene.road_map import MapLaneKind
from synth3dlanes.world.areas import clipped, contains, difference, intersection, outset, union, valid
from synth3dlanes.world.cells import beside, cut_cells, merged
from synth3dlanes.world.decks import span_bodies
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.meshes import MEDIAN, ROAD, SHOULDER, Mesh, grid, with_crease
from synth3dlanes.world.paved_areas import GroundArea, PavedAreas
from synth3dlanes.world.solids import Body

# Faces of lanes are no wider than this; cells of junctions, by how far these are from the host.
COLUMN_M, CELLS_M, CELLS_TO_M = 0.9, (0.75, 1.5, 3.0), (60.0, 150.0)
# What lies beside a surface extends SEAM_M under it and SEAM_FALL_M lower; kerbs reach FOOT_M down.
SEAM_M, SEAM_FALL_M, SEAM_EDGE_M, FOOT_M = 0.6, 0.006, 0.04, 0.05
# Edges of pavement without a kerb have upright faces of this height: the terrain beside them is a little lower.
SKIRT_M = 0.12
# Distance inside the edges of the pavement from which the terrain goes down to its bed.
UNDER_M = 0.15
# Pavement farther than this from the host's way is left out.
REACH_M = 480.0
SURFACES: dict[MapLaneKind, int] = {"shoulder": SHOULDER, "border": SHOULDER, "median": MEDIAN, "walkway": SHOULDER,
                                    "kerb": SHOULDER}  # fmt: skip
AREA_SURFACES = {"road": ROAD, "walkway": SHOULDER, "paved": SHOULDER, "grass": MEDIAN}


@dataclass(frozen=True, eq=False)
class AreaSurfaces:
    """What of a ground with paved areas is built, as `Surfaces` has it."""

    ground: Ground
    paved: PavedAreas

    @cached_property
    def pavement(self) -> list[Mesh]:
        """The strips of all roads outside junctions, and the areas of junctions and islands."""
        found, paved = list[Mesh](), self.paved
        for road in paved.outside:
            for stretch in road.stretches:
                if stretch.end_m > stretch.start_m and stretch.sections[0].lanes:
                    found += _strips(paved, stretch, (stretch is road.stretches[0], stretch is road.stretches[-1]))
        found += _area_meshes(paved)
        near = (_near(paved, mesh) for mesh in found)
        return [mesh for mesh in near if len(mesh.faces)]

    @property
    def verges(self) -> list[Mesh]:
        """None: the terrain meets the pavement."""
        return []

    @cached_property
    def terrain(self) -> Mesh:
        """A grid with fine cells near the host, which grow to the horizon. It is one surface: it goes on below the
        pavement, a little lower at its edges and deeper inside, so that no gap shows the sky. Over tunnels it is the
        ground there, which ends in steps at their edges."""
        ground, paved = self.ground, self.paved
        xs, ys = paved.grid.axes
        near = shapely.box(*paved.way.box(REACH_M - 20.0))
        # Where below the pavement its border lies exactly, nobody sees.
        bed = valid(shapely.simplify(intersection(outset(paved.graded_pavement, -UNDER_M), near), UNDER_M / 5))
        over = difference(intersection(union(span.area for span in paved.tunnels), near), bed)
        for area in (bed, over):
            shapely.prepare(area)
        corners = np.concatenate([shapely.get_coordinates(area) for area in (bed, over)])
        xs, ys = (beside(axis, at) for axis, at in zip((xs, ys), corners.T, strict=True))
        xy = np.stack(np.meshgrid(xs, ys), -1)
        z, inside = np.zeros(xy.shape[:2]), contains(bed, xy.reshape(-1, 2)).reshape(xy.shape[:2])
        z[inside] = paved.inner_bed_height(xy[inside]) + ground.hills.height(xy[inside])
        z[~inside] = ground.mesh_heights(xy[~inside])
        inside = contains(over, xy.reshape(-1, 2)).reshape(xy.shape[:2])
        z[inside] = paved.beside_tunnels(xy[inside], is_over=True) + ground.hills.height(xy[inside])
        whole = grid(np.concatenate([xy, z[..., None]], -1), xy, np.zeros(len(xs) - 1, dtype=int))
        cells = [cut_cells(xs, ys, area) for area in (bed, over)]
        free = cells[0] if over.is_empty else cut_cells(xs, ys, union([bed, over]))
        column, row = np.concatenate([own.cut for own in cells], axis=1)
        vertices = [whole.vertices_world]
        faces = [np.delete(whole.faces, np.unique(row * (len(xs) - 1) + column), axis=0)]
        for own, is_over in ((np.concatenate([free.outside, cells[0].inside]), False), (cells[1].inside, True)):
            places, quads = merged(own)
            # The corners of cells are those of the grid.
            at = [
                np.clip(np.searchsorted(axis, x), 0, len(axis) - 1) for axis, x in zip((xs, ys), places.T, strict=True)
            ]
            is_corner = (xs[at[0]] == places[:, 0]) & (ys[at[1]] == places[:, 1])
            number, new = at[1] * len(xs) + at[0], places[~is_corner]
            number[~is_corner] = sum(map(len, vertices)) + np.arange(len(new))
            heights = paved.beside_tunnels(new, is_over) + ground.hills.height(new)
            vertices.append(np.column_stack([new, heights]))
            faces.append(number[quads])
        points, quads = np.concatenate(vertices), np.concatenate(faces)
        return Mesh(points, quads, points[:, :2].copy(), np.zeros(len(quads), dtype=int))

    @cached_property
    def bodies(self) -> list[Body]:
        """The decks and tunnels."""
        return span_bodies(self.ground, self.paved)


def _near(paved: PavedAreas, mesh: Mesh) -> Mesh:
    """The mesh without the faces beyond REACH_M."""
    kept = (paved.way.away_at(mesh.vertices_world[:, :2]) < REACH_M)[mesh.faces].all(axis=1)
    return mesh if kept.all() else replace(mesh, faces=mesh.faces[kept], material=mesh.material[kept])


def _strips(paved: PavedAreas, stretch: Road, is_end: tuple[bool, bool]) -> list[Mesh]:
    """The lanes of a stretch of a road, raised ones with kerbs on all sides. Others have upright faces on the sides of
    the road and at its ends, where what follows may be narrower."""
    s, (section,) = paved.stretch_rows(stretch), stretch.sections
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
            across += ((k + share) * paved.network.across.width_m).tolist()
            surfaces += [SURFACES.get(section.lanes[k].kind, ROAD)] * n
        t = np.stack(columns, axis=1)
        vertices = stretch.rows(s, t)
        uv = np.stack(np.broadcast_arrays(np.array(across)[None], s[:, None]), -1)
        # The texture goes on over kerbs.
        up_m, down_m, over_m = (KERB_M, KERB_M + FOOT_M, 0.2) if run else (0.0, SKIRT_M, 0.0)
        vertices[..., 2] += up_m
        feet = vertices[:, [0, -1]] - [0, 0, down_m]
        vertices = np.concatenate([feet[:, :1], vertices, feet[:, 1:]], axis=1)
        uv = np.concatenate([uv[:, :1] - [over_m, 0], uv, uv[:, -1:] + [over_m, 0]], axis=1)
        surfaces = [surfaces[0], *surfaces, surfaces[-1]]
        ends = [int(run is not None or at) for at in is_end]
        vertices, uv = (np.pad(values, (ends, (0, 0), (0, 0)), mode="edge") for values in (vertices, uv))
        is_foot = np.zeros(len(vertices), dtype=bool)
        is_foot[: ends[0]] = is_foot[len(is_foot) - ends[1] :] = True
        vertices[is_foot, 1:-1, 2] -= down_m
        mesh = grid(vertices, uv, np.array(surfaces))
        if not run:
            # Shading of a level edge does not bend down to its skirt.
            is_skirt = np.tile((is_foot[1:] | is_foot[:-1])[:, None], len(surfaces))
            is_skirt[:, [0, -1]] = True
            mesh = with_crease(mesh, is_skirt.ravel())
        found.append(mesh)
        i = end
    return found


class _AreaFaces(NamedTuple):
    """An area from above: the corners of its faces, these, which corners are beside it, where it goes on below what
    lies there, and the rings around it."""

    area: GroundArea
    xy: Float[np.ndarray, "v 2"]
    faces: Int[np.ndarray, "f 4"]
    is_beside: Bool[np.ndarray, " v"]
    rings: list[Float[np.ndarray, "_ 2"]]


def _area_meshes(paved: PavedAreas) -> list[Mesh]:
    """All areas, with kerbs around them where they are raised. One that is not goes on a little below what lies beside
    it."""
    flat = [_area_faces(paved, area) for area in paved.areas if not area.polygon.is_empty]
    # Heights of all together, and below what lies beside them.
    heights = paved.area_heights([(at.area, np.concatenate([at.xy, *at.rings])) for at in flat])
    beside = [at.xy[at.is_beside] for at in flat]
    under = parted(paved.under(np.concatenate([*beside, np.zeros((0, 2))])), list(map(len, beside)))
    found = []
    for at, heights_m, under_m in zip(flat, heights, under, strict=False):
        z, *tops = parted(heights_m, [len(at.xy), *map(len, at.rings)])
        z[at.is_beside] = np.minimum(z[at.is_beside], under_m) - SEAM_FALL_M
        surface = np.full(len(at.faces), AREA_SURFACES[at.area.kind])
        found.append(Mesh(np.column_stack([at.xy, z]), at.faces, at.xy, surface))
        found.append(_kerb(at.area, [np.column_stack(places) for places in zip(at.rings, tops, strict=True)]))
    return found


def _area_faces(paved: PavedAreas, area: GroundArea) -> _AreaFaces:
    """The faces of an area: a grid of cells, cut at its border."""
    wide = area.polygon
    if not area.raised_m:
        shapely.prepare(area.polygon)
        beyond = outset(area.polygon, SEAM_M)
        x0, y0, x1, y1 = shapely.bounds(beyond).tolist()
        wide = union([area.polygon, intersection(beyond, clipped(paved.pavement, (x0, y0, x1, y1)))])
    x0, y0, x1, y1 = shapely.bounds(wide)
    away_m = float(paved.way.away_at(np.array([[(x0 + x1) / 2, (y0 + y1) / 2]]))[0]) - np.hypot(x1 - x0, y1 - y0) / 2
    cell_m = CELLS_M[int(np.searchsorted(CELLS_TO_M, away_m))]
    wide_corners = shapely.get_coordinates(wide)
    xs, ys = (
        beside(np.arange(low - cell_m, high + 2 * cell_m, cell_m), places)
        for low, high, places in zip((x0, y0), (x1, y1), wide_corners.T, strict=True)
    )
    cells = cut_cells(xs, ys, wide, outside=False)
    column, row = cells.whole
    corners = [np.stack([xs[column + i], ys[row + j]], -1) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    xy, faces = merged(np.concatenate([np.stack(corners, axis=1), cells.inside]))
    is_beside = np.zeros(len(xy), dtype=bool)
    if not area.raised_m:
        is_beside = ~contains(area.polygon, xy)
        is_beside[is_beside] = shapely.distance(area.polygon, shapely.points(xy[is_beside])) > SEAM_EDGE_M
    rings = shapely.segmentize(shapely.get_rings(shapely.get_parts(area.polygon)), 1.0)
    return _AreaFaces(area, xy, faces, is_beside, [shapely.get_coordinates(ring) for ring in rings])


def _kerb(area: GroundArea, tops: Sequence[Float[np.ndarray, "_ 3"]]) -> Mesh:
    """Upright faces around an area below its upper edges, down into the terrain."""
    quads = []
    for top in tops:
        low = top - [0, 0, area.raised_m + FOOT_M if area.raised_m else SKIRT_M]
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
