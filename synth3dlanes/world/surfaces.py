"""The surfaces of a ground as vertex and face arrays, as `ground.py` defines it. World frame.

Roads are strips along their lines; junctions, their walkways and islands are areas; the terrain is one surface below
all of these.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from shapely.geometry.base import BaseGeometry

from synth3dlanes.geometry.polylines import parted
from synth3dlanes.roads.cross_section import KERB_M
from synth3dlanes.roads.roads import Road
from synth3dlanes.scene.road_map import MapLaneKind
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.areas import clipped, contains, difference, intersection, outset, union, valid
from synth3dlanes.world.cells import Merged, beside, corners_in, cut_cells, merged
from synth3dlanes.world.decks import span_bodies
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.meshes import MEDIAN, ROAD, SHOULDER, Mesh, grid, where, with_crease
from synth3dlanes.world.paved_areas import GroundArea, PavedAreas
from synth3dlanes.world.solids import Body

# Cells of junctions, and faces of the kerbs around them, by how far these are from the host.
CELLS_M, KERBS_M, CELLS_TO_M = (0.75, 2.5, 10.0), (1.0, 2.5, 10.0), (60.0, 150.0)
# What lies beside a surface extends SEAM_M under it and SEAM_FALL_M lower; kerbs reach FOOT_M below the bed,
# as a road of a map may begin higher than the one it meets.
SEAM_M, SEAM_FALL_M, SEAM_EDGE_M, FOOT_M = 0.6, 0.006, 0.04, 0.15
# Edges of pavement without a kerb have upright faces that reach as much below the terrain's bed.
SKIRT_M = 0.09
# How far a branch reaches below the edge of its road, and the number of steps of the search for that edge.
OVERLAP_M, EDGE_STEPS = 0.05, 7
# Distance inside the edges of the pavement from which the terrain goes down to its bed.
UNDER_M = 0.15
# Greatest distance of places along the border of the bed whose heights are those of the ground.
BED_STEP_M = 40.0
SURFACES: dict[MapLaneKind, int] = {"shoulder": SHOULDER, "border": SHOULDER, "median": MEDIAN, "walkway": SHOULDER,
                                    "kerb": SHOULDER}  # fmt: skip
AREA_SURFACES = {"road": ROAD, "walkway": SHOULDER, "paved": SHOULDER, "grass": MEDIAN}


@dataclass(frozen=True, eq=False)
class Surfaces:
    """What of a ground is built; each part is made on first access and kept."""

    ground: Ground

    @cached_property
    def pavement(self) -> list[Mesh]:
        """The strips of all roads outside junctions, of branches outside the pavement of their road, and the areas of
        junctions and islands."""
        paved = self.ground.paved
        near = (where(mesh, paved.is_built) for mesh in [*_strips(paved), *_area_meshes(paved)])
        return [mesh for mesh in near if len(mesh.faces)]

    @cached_property
    def terrain(self) -> Mesh:
        """A grid with fine cells near the host, which grow to the horizon. It is one surface: it goes on below the
        pavement, a little lower at its edges and deeper inside, so that no gap shows the sky. Over tunnels it is the
        ground there, which ends in steps at their edges."""
        ground, paved = self.ground, self.ground.paved
        xs, ys = paved.grid.axes
        reach = shapely.box(*paved.way.box(paved.reach_m - 20.0))
        # Where below the pavement its border lies exactly, nobody sees.
        bed = intersection(outset(valid(shapely.simplify(paved.graded_pavement, UNDER_M / 5)), -UNDER_M), reach)
        bed = shapely.segmentize(bed, BED_STEP_M)
        over = difference(intersection(union(span.area for span in paved.tunnels), reach), bed)
        areas = [bed] if over.is_empty else [bed, over]
        shapely.prepare(areas)
        xs, ys = (beside(axis, at) for axis, at in zip((xs, ys), shapely.get_coordinates(areas).T, strict=True))
        xy, cells = np.stack(np.meshgrid(xs, ys), -1), [cut_cells(xs, ys, [area]) for area in areas]
        (inside, near), *tunnels = (corners_in(xs, ys, *at) for at in zip(areas, cells, strict=True))
        z, near = ground.hills.height(xy), near & ~inside
        z[inside] += paved.inner_bed_height(xy[inside])
        z[near] += paved.bed_height(xy[near])
        # Away from the border of the bed there is no pavement.
        away = ~inside & ~near
        z[away] += paved.graded(xy[away], are_paved=False)
        for above, _ in tunnels:
            z[above] = ground.hills.height(xy[above]) + paved.beside_tunnels(xy[above], is_over=True)
        whole = grid(np.concatenate([xy, z[..., None]], -1), xy, np.zeros(len(xs) - 1, dtype=int))
        free = cells[0] if over.is_empty else cut_cells(xs, ys, [union([bed, over])])
        _, column, row = np.concatenate([own.cut for own in cells], axis=1)
        vertices = [whole.vertices_world]
        faces = [np.delete(whole.faces, np.unique(row * (len(xs) - 1) + column), axis=0)]
        below = np.concatenate([free.outside.quads, cells[0].inside.quads])
        for own, is_over in ((below, False), *((over.inside.quads, True) for over in cells[1:])):
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
        return span_bodies(self.ground, self.ground.paved)


class _Strip(NamedTuple):
    """Lanes beside each other of a stretch of a road: the number of that in the table, stations, the offsets of columns
    at each, how far these are across the texture, the surfaces between them and at both sides, one after another or
    also row by row, whether they are raised, and whether the strip has upright faces where it begins and ends; and how
    much lower its first column is."""

    number: int
    s: Scalars
    t: Float[np.ndarray, "r c"]
    across: Float[np.ndarray, "#r c"]
    surfaces: Int[np.ndarray, "*#r k"]
    is_raised: bool
    has_ends: tuple[bool, bool]
    fall_m: float = 0.0


def _strips(paved: PavedAreas) -> list[Mesh]:
    """The lanes of all roads outside junctions, raised ones with kerbs on all sides. Others have upright faces on the
    sides of the road and at its ends, where what follows may be narrower."""
    outside, strips, number = {road.id for road in paved.outside}, list[_Strip](), -1
    for road in paved.roads:
        for stretch in road.stretches:
            number += 1
            if road.id in outside and stretch.end_m > stretch.start_m and stretch.sections[0].lanes:
                is_end = stretch is road.stretches[0], stretch is road.stretches[-1]
                strips += _strips_of(paved, number, stretch, is_end)
    counts = [strip.t.size for strip in strips]
    places = [(np.repeat(at.number, at.t.size), np.repeat(at.s, at.t.shape[1]), at.t.ravel()) for at in strips]
    if not places:
        return []
    # Textures that are along all roads go on as the host drives.
    onwards = paved.network.onwards if paved.network.across.is_along else 1.0
    points = paved.table.base_points(*map(np.concatenate, zip(*places, strict=True)))
    points[:, 2] += paved.hills.height(points[:, :2])
    depths_m = parted(paved.bed_depth(points[:, :2]), counts)
    return [
        _strip_mesh(strip, strip.s * onwards, own.reshape(*strip.t.shape, 3), depth_m.reshape(strip.t.shape))
        for strip, own, depth_m in zip(strips, parted(points, counts), depths_m, strict=True)
    ]


def _strips_of(paved: PavedAreas, number: int, stretch: Road, is_end: tuple[bool, bool]) -> Iterator[_Strip]:
    """The strips of a stretch of a road, from the left."""
    s, (section,) = paved.face_rows(stretch), stretch.sections
    edges, i, last = section.edges(s), *section.paved
    widths_m = np.diff(edges, axis=0)
    columns = np.maximum(np.ceil(widths_m.max(axis=1) / paved.column_m), 1).astype(int)
    surfaces = np.array([SURFACES.get(lane.kind, ROAD) for lane in section.lanes])
    while i < last:
        run = next((run for run in section.raised if run[0] == i), None)
        level = next((run[0] for run in section.raised if run[0] > i), last)
        end = min(run[1] if run else level, last)
        n = columns[i:end]
        lane = np.repeat(np.arange(i, end), n)
        share = (np.arange(len(lane)) - np.repeat(np.cumsum(n) - n, n) + 1) / n[lane - i]
        t = np.concatenate([edges[i : i + 1], edges[lane] + widths_m[lane] * share[:, None]]).T
        across = np.append(i, lane + share)[None] * paved.network.across.width_m
        own = surfaces[np.concatenate([[i], lane, [end - 1]])]
        strip = _Strip(
            number, s, t, across, own, run is not None, (run is not None or is_end[0], run is not None or is_end[1])
        )
        yield _beside_others(paved, stretch, strip) if paved.network.across.is_along else strip
        i = end


def _beside_others(paved: PavedAreas, road: Road, strip: _Strip) -> _Strip:
    """The strip of a road whose texture is along all roads: of a branch outside the pavement of its road, and with the
    surface of roads where the lanes of branches cross its right shoulder."""
    s, t, surfaces = strip.s, strip.t, strip.surfaces
    if road.parting is not None:
        inner = _edge_of(road.parting.road, road, s)[:, None]
        t, surfaces = (
            np.concatenate([inner - OVERLAP_M, np.maximum(t, inner)], axis=1),
            np.append(surfaces[0], surfaces),
        )
    # The first and the last ones are upright.
    shoulder = slice(int(np.flatnonzero(surfaces == ROAD)[-1]), len(surfaces) - 2)
    middle = ((t[:-1, :-1] + t[:-1, 1:] + t[1:, :-1] + t[1:, 1:]) / 4)[:, shoulder]
    at = np.broadcast_to((s[:-1, None] + s[1:, None]) / 2, middle.shape)
    surfaces = np.tile(surfaces, (len(at), 1))
    for branch in paved.network.branches(paved.network.road(road.id)):
        surfaces[:, 1:][:, shoulder][branch.in_lanes(*branch.line.project(road.xy(at, middle), at))] = ROAD
    return strip._replace(
        t=t,
        across=paved.network.rightward * t,
        surfaces=surfaces,
        fall_m=SEAM_FALL_M if road.parting is not None else 0.0,
    )


def _edge_of(other: Road, road: Road, s: Scalars) -> Scalars:
    """Offsets on a road at which the right edge of another one's pavement is, within its own edges."""
    left, right = road.left(s), road.right(s)
    t = right
    # Roads that part are nearly parallel: each step leaves a small part of the error.
    for _ in range(EDGE_STEPS):
        at, beside = other.line.project(road.xy(s, t), s)
        t = np.clip(t - (beside - other.right(at)), left, right)
    return t


def _strip_mesh(
    strip: _Strip, along: Scalars, points: Float[np.ndarray, "r c 3"], depth_m: Float[np.ndarray, "r c"]
) -> Mesh:
    """A strip with these points, and its upright faces; the terrain's bed is `depth_m` below."""
    # The texture goes on over kerbs.
    up_m, foot_m, over_m = (KERB_M, FOOT_M, 0.2) if strip.is_raised else (0.0, SKIRT_M, 0.0)
    (n_rows, n_columns), (first, last) = strip.t.shape, strip.has_ends
    row = np.concatenate([[0] * first, np.arange(n_rows), [n_rows - 1] * last]).astype(int)
    column = np.clip(np.arange(-1, n_columns + 1), 0, n_columns - 1)
    vertices, uv = points[row[:, None], column], np.zeros((len(row), len(column), 2))
    uv[..., 0], uv[..., 1] = np.broadcast_to(strip.across, strip.t.shape)[row[:, None], column], along[row, None]
    uv[:, 0, 0] -= over_m
    uv[:, -1, 0] += over_m
    is_foot = np.zeros(vertices.shape[:2], dtype=bool)
    is_foot[:, [0, -1]] = is_foot[: int(first)] = is_foot[len(row) - int(last) :] = True
    vertices[..., 2] += np.where(is_foot, -foot_m - depth_m[row[:, None], column], up_m)
    vertices[:, :2, 2] -= strip.fall_m
    surfaces = strip.surfaces
    if surfaces.ndim == 2:
        surfaces = surfaces[np.concatenate([[0] * first, np.arange(n_rows - 1), [n_rows - 2] * last]).astype(int)]
    mesh = grid(vertices, uv, surfaces)
    # Shading of an edge does not bend down its skirt or kerb.
    is_skirt = np.zeros((len(row) - 1, len(column) - 1), dtype=bool)
    is_skirt[:, [0, -1]] = is_skirt[: int(first)] = is_skirt[len(row) - 1 - int(last) :] = True
    return with_crease(mesh, is_skirt.ravel())


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
    flat = _area_faces(paved, [area for area in paved.areas if not area.polygon.is_empty])
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
        depths_m = (paved.bed_depth(ring) for ring in at.rings)
        found.append(_kerb(at.area, [np.column_stack(places) for places in zip(at.rings, tops, depths_m, strict=True)]))
    return found


def _area_faces(paved: PavedAreas, areas: Sequence[GroundArea]) -> list[_AreaFaces]:
    """The faces of areas: grids of cells, cut at their borders."""
    middles, radii_m = np.zeros((len(areas), 2)), np.zeros(len(areas))
    if areas:
        low, high = np.split(shapely.bounds([area.polygon for area in areas]), 2, axis=1)
        middles, radii_m = (low + high) / 2, np.hypot(*(high - low).T) / 2
    far = np.searchsorted(CELLS_TO_M, paved.way.away_at(middles) - radii_m)
    # Gaps beside those farthest away would be less than a pixel.
    wide = [area.polygon if at == len(CELLS_TO_M) else _wide(paved, area) for area, at in zip(areas, far, strict=True)]
    found: list[_AreaFaces | None] = [None] * len(areas)
    for distance, (cell_m, kerb_m) in enumerate(zip(CELLS_M, KERBS_M, strict=True)):
        own = np.flatnonzero(far == distance).tolist()
        for i, (xy, faces) in zip(own, _faces([wide[i] for i in own], cell_m), strict=True):
            area, is_beside = areas[i], np.zeros(len(xy), dtype=bool)
            if not area.raised_m:
                is_beside = ~contains(area.polygon, xy)
                is_beside[is_beside] = shapely.distance(area.polygon, shapely.points(xy[is_beside])) > SEAM_EDGE_M
            rings = shapely.segmentize(shapely.get_rings(shapely.get_parts(area.polygon)), kerb_m)
            found[i] = _AreaFaces(area, xy, faces, is_beside, [shapely.get_coordinates(ring) for ring in rings])
    return [at for at in found if at is not None]


def _wide(paved: PavedAreas, area: GroundArea) -> BaseGeometry:
    """An area with what it has below the surfaces beside it."""
    if area.raised_m:
        return area.polygon
    shapely.prepare(area.polygon)
    beyond = outset(area.polygon, SEAM_M)
    x0, y0, x1, y1 = shapely.bounds(beyond).tolist()
    # With the area's own corners: without them its faces leave gaps beside those of other surfaces.
    return union([area.polygon, intersection(beyond, clipped(paved.pavement, (x0, y0, x1, y1)))])


def _faces(areas: Sequence[BaseGeometry], cell_m: float) -> list[Merged]:
    """The faces of each of some areas, cut by one grid."""
    if not areas:
        return []
    places = shapely.get_coordinates(areas)
    xs, ys = (beside(np.arange(at.min() - cell_m, at.max() + 2 * cell_m, cell_m), at) for at in places.T)
    cells = cut_cells(xs, ys, areas, outside=False)
    of, column, row = cells.whole
    whole = np.stack([np.stack([xs[column + i], ys[row + j]], -1) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))], axis=1)
    return [
        merged(np.concatenate([whole[of == i], cells.inside.quads[cells.inside.area == i]])) for i in range(len(areas))
    ]


def _kerb(area: GroundArea, rings: Sequence[Float[np.ndarray, "_ 4"]]) -> Mesh:
    """Upright faces around an area below its upper edges, down into the terrain, whose bed is as deep below its
    pavement as the last column says."""
    quads = []
    for ring in rings:
        top, low = ring[:, :3], ring[:, :3].copy()
        low[:, 2] -= ring[:, 3] + (area.raised_m + FOOT_M if area.raised_m else SKIRT_M)
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
