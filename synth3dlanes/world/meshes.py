"""The scene's surfaces as vertex and face arrays, as `ground.py` defines them. World frame.

Each row is one station, shared by road, shoulders and paint.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.roads.roads import Road, Side
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.horizon import HORIZON_M, far_dam
from synth3dlanes.world.solids import Body
from synth3dlanes.world.spans import EMBANKMENT_SLOPE
from synth3dlanes.world.verges import GRASS_FROM_M, VERGE_M, Verges, embankment_width, profile

# Where a road begins beside another, its inner edge extends a little below that one or its own verge. Their rows
# differ, so a gap would show the ground otherwise.
SEAM_M, SEAM_FALL_M = 0.05, 0.01
LANE_COLUMNS, SHOULDER_COLUMNS = 4, 4
ROAD, SHOULDER, MEDIAN = 0, 1, 2
# Least distance between carriageways; nearer ones share a line.
LEAST_MEDIAN_M = 0.01


@dataclass(frozen=True, eq=False)
class Mesh:
    """Quads, of which a triangle has its last corner twice. `uv_m` is (across, along) in metres, for terrain world (x,
    y); `material` is the material slot per face: ROAD, SHOULDER or MEDIAN of a pavement, else 0."""

    vertices_world: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 4"]
    uv_m: Float[np.ndarray, "v 2"]
    material: Int[np.ndarray, " f"]


@dataclass(frozen=True, eq=False)
class Surfaces:
    """What of a ground is built; each part is made on first access and kept."""

    ground: Ground
    paved: Verges

    @cached_property
    def pavement(self) -> list[Mesh]:
        """The pavement of every road, of one that begins beside another outside that one's pavement."""
        paved = self.paved
        return [over_terrain(_pavement(paved, road, _rows(paved, road))) for road in paved.network.roads]

    @cached_property
    def verges(self) -> list[Mesh]:
        """Verges and embankments along every edge of the pavement, down to below the terrain mesh."""
        meshes, paved = [], self.paved
        for road in paved.network.roads:
            s = _rows(paved, road)
            free = np.full(s.shape, np.inf)
            left_m = free if road.parting is None else _gap(road, s)
            right_m = np.where(_is_continued(paved, road, s), 0.0, np.inf)
            meshes += [_verge(paved, road, "left", s, left_m), _verge(paved, road, "right", s, right_m)]
        return [mesh for mesh in map(over_terrain, meshes) if len(mesh.faces)]

    @cached_property
    def terrain(self) -> Mesh:
        """A grid with cells of CELL_M near the road, which grow outwards to the horizon and its hills."""
        xs, ys = self.paved.grid.axes
        xy = np.stack(np.meshgrid(xs, ys), -1)
        vertices = np.concatenate([xy, self.ground.mesh_heights(xy)[..., None]], -1)
        return grid(vertices, xy, np.zeros(len(xs) - 1, dtype=int))

    @property
    def bodies(self) -> list[Body]:
        """What carries or covers roads: decks and tunnels."""
        return []


def _rows(paved: Verges, road: Road) -> Scalars:
    """Stations of a road's rows as the host drives; of a road that begins or ends somewhere, as s grows."""
    s = paved.network.stations(paved.rows_driven_m)
    inside = (s >= road.start_m) & (s <= road.end_m)
    return s if inside.all() else np.sort(s[inside])


def grid(vertices: Float[np.ndarray, "r c 3"], uv: Float[np.ndarray, "r c 2"], column_material: np.ndarray) -> Mesh:
    """Quads between rows and columns, facing up. `column_material` is one slot per column or, in 2D, per face."""
    rows, columns = vertices.shape[:2]
    i = np.arange(rows * columns).reshape(rows, columns)
    faces = np.stack([i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]], -1).reshape(-1, 4)
    across, along = vertices[:-1, 1:] - vertices[:-1, :-1], vertices[1:, :-1] - vertices[:-1, :-1]
    if (across[..., 0] * along[..., 1] - across[..., 1] * along[..., 0]).sum() < 0:
        faces = faces[:, ::-1]
    material = np.broadcast_to(column_material, (rows - 1, columns - 1)).reshape(-1)
    return Mesh(vertices.reshape(-1, 3), faces, uv.reshape(-1, 2), material)


def with_crease(mesh: Mesh, apart: Bool[np.ndarray, " f"]) -> Mesh:
    """The mesh with some of its faces apart from the others: shading, which is smooth over vertices that faces share,
    ends between them."""
    used, numbers = np.unique(mesh.faces[apart], return_inverse=True)
    faces = mesh.faces.copy()
    faces[apart] = len(mesh.vertices_world) + numbers.reshape(-1, 4)
    vertices, uv = (np.concatenate([values, values[used]]) for values in (mesh.vertices_world, mesh.uv_m))
    return replace(mesh, vertices_world=vertices, uv_m=uv, faces=faces)


def facing_up(vertices_world: Float[np.ndarray, "v 3"], uv_m: Float[np.ndarray, "v 2"]) -> Mesh:
    """A mesh of separate quads, four vertices each, with their front sides up."""
    faces = np.arange(len(vertices_world)).reshape(-1, 4)
    mesh = Mesh(vertices_world, faces, uv_m, np.zeros(len(faces), dtype=int))
    up = is_facing_up(mesh)
    return Mesh(vertices_world, np.where(up[:, None], faces, faces[:, ::-1]), uv_m, mesh.material)


def is_facing_up(mesh: Mesh) -> Bool[np.ndarray, " f"]:
    """Which faces have their front side up."""
    a, b, c, d = (mesh.vertices_world[mesh.faces[:, i], :2] for i in range(4))
    across, along = c - a, d - b
    return np.asarray(across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0] >= 0)


def over_terrain(mesh: Mesh) -> Mesh:
    """The mesh without the faces beyond the end of the terrain mesh."""
    kept = (np.abs(mesh.vertices_world[mesh.faces, :2]) < HORIZON_M).all(axis=(1, 2))
    return replace(mesh, faces=mesh.faces[kept], material=mesh.material[kept])


def _columns(paved: Verges, road: Road) -> tuple[Scalars, Int[np.ndarray, " m"]]:
    """Offsets across a road where it begins, and the material of each column of faces."""
    parts = road.carriageways
    paved_m = paved.under_paint_m(road)
    shoulder = np.linspace(paved_m, road.shoulder_m, SHOULDER_COLUMNS + 1)[::-1]
    offsets, material = [parts[0].left_m - shoulder], [np.full(SHOULDER_COLUMNS, SHOULDER), np.full(1, ROAD)]
    for i, part in enumerate(parts):
        across = np.linspace(part.left_m, part.right_m, part.n_lanes * LANE_COLUMNS + 1)
        if i > 0:
            median, surface = _median_columns(paved, road, *road.medians[i - 1])
            # Without a median both carriageways share a column.
            across = across if len(median) else across[1:]
            offsets.append(median)
            material.append(surface)
        offsets.append(across)
        material.append(np.full(part.n_lanes * LANE_COLUMNS, ROAD))
    offsets.append(parts[-1].right_m + shoulder[::-1])
    material += [np.full(1, ROAD), np.full(SHOULDER_COLUMNS, SHOULDER)]
    return np.concatenate(offsets), np.concatenate(material)


def _median_columns(paved: Verges, road: Road, left_m: float, right_m: float) -> tuple[Scalars, Int[np.ndarray, " m"]]:
    """Offsets inside a median between the inner lane boundaries, and the material of each column of faces there."""
    width_m = right_m - left_m
    if width_m < LEAST_MEDIAN_M:
        return np.zeros(0), np.zeros(0, dtype=int)
    paved_m, inner_m = paved.beside_median_m(road, width_m)
    across = np.array([paved_m, inner_m, width_m / 2, width_m - inner_m, width_m - paved_m])
    middle = MEDIAN if width_m >= GRASS_FROM_M else SHOULDER
    return left_m + across, np.array([ROAD, SHOULDER, middle, middle, SHOULDER, ROAD])


def _pavement(paved: Verges, road: Road, s: Scalars) -> Mesh:
    k, network = SHOULDER_COLUMNS, paved.network
    t, column_material = _columns(paved, road)
    right = road.right(s)[:, None]
    lanes = np.minimum(t[:-k], right - road.shoulder_m + paved.under_paint_m(road))
    offsets = np.concatenate([lanes, t[-k:] - road.right.base_m + right], axis=1)
    if road.parting is not None:
        inner = _inner_edge(road, s)[:, None]
        offsets = np.concatenate([inner - SEAM_M, np.maximum(offsets, inner)], axis=1)
        column_material = np.concatenate([column_material[:1], column_material])
    vertices = paved.with_far_hills(road.rows(s, offsets) + far_dam(s)[:, None, None] * [0, 0, 1], s[:, None])
    xy = vertices[..., :2]
    material = np.tile(column_material, (len(s) - 1, 1))
    for branch in network.branches(road):
        # The shoulder is road where the lanes of another cross it.
        middle = (xy[:-1, -k - 1 : -1] + xy[:-1, -k:] + xy[1:, -k - 1 : -1] + xy[1:, -k:]) / 4
        guess = np.broadcast_to((s[:-1, None] + s[1:, None]) / 2, middle.shape[:2])
        material[:, -k:][branch.in_lanes(*branch.line.project(middle, guess))] = ROAD
    if road.parting is not None:
        vertices[:, 0, 2] -= SEAM_FALL_M
    return grid(
        vertices,
        np.stack(np.broadcast_arrays(offsets, s[:, None]), -1) * [network.rightward, network.onwards],
        material,
    )


def _inner_edge(road: Road, s: Scalars) -> Scalars:
    """Offset at which a road's cross-section leaves the pavement of the road where it begins; its own left edge once
    they are separate."""
    return np.clip(_crossing(road, s, road.right(s)), road.left(s), road.right(s))


def _is_continued(paved: Verges, road: Road, s: Scalars) -> Bool[np.ndarray, " n"]:
    """Where another road's pavement goes on beyond a road's right edge. A verge would show through the seam."""
    found = np.zeros(s.shape, bool)
    for branch in paved.network.branches(road):
        at, t = branch.line.project(road.xy(s, road.right(s)), s)
        found |= (at > branch.start_m) & (branch.outside(at, t) < -SEAM_M)
    return found


def _gap(road: Road, s: Scalars) -> Scalars:
    """Width available to a road's left embankment: from its edge to the pavement of the road where it begins; 0 while
    they touch."""
    return np.clip(road.left(s) - _crossing(road, s, road.left(s)), 0, None)


def _crossing(road: Road, s: Scalars, high: Scalars) -> Scalars:
    """Offset, at most `high`, at which a road's cross-section crosses the right edge of the road where it begins."""
    assert road.parting is not None, "asked only of roads that begin beside another"
    other = road.parting.road
    low = road.left(s) - EMBANKMENT_SLOPE * road.parting.rise_m - VERGE_M
    below, above = low, high
    for _ in range(24):
        middle = (below + above) / 2
        at, t = other.line.project(road.xy(s, middle))
        is_outside = t > other.right(at)
        above = np.where(is_outside, middle, above)
        below = np.where(is_outside, below, middle)
    return np.asarray(above)


def _verge(paved: Verges, road: Road, side: Side, s: Scalars, room_m: Scalars) -> Mesh:
    """A strip outwards from an edge, with a row per station.

    Faces without room are dropped: single pixels of them would show through the pavement.
    """
    raised = road.raised(s) + far_dam(s)
    scale = paved.grid.cell_scale(road.xy(s, road.edge(side, s)))
    foot = EMBANKMENT_SLOPE * raised
    columns = [0.0 * foot, 0.5 * foot, foot] + [foot + VERGE_M * scale * share for share in (0.33, 0.66, 1.0)]
    distance = np.stack(columns, axis=1)
    squeeze = np.minimum(1.0, room_m / embankment_width(raised, scale))
    xy = np.stack([road.xy(s, road.edge(side, s, column * squeeze)) for column in columns], axis=1)
    vertices = paved.network.lift(xy, profile(distance, raised[:, None], scale[:, None]))
    vertices = paved.with_far_hills(vertices, s[:, None])
    mesh = grid(vertices, _unrolled(vertices), np.zeros(distance.shape[1] - 1, dtype=int))
    is_open = np.repeat((room_m[:-1] > 0) | (room_m[1:] > 0), distance.shape[1] - 1)
    return replace(mesh, faces=mesh.faces[is_open], material=mesh.material[is_open])


def _unrolled(vertices: Float[np.ndarray, "r c 3"]) -> Float[np.ndarray, "r c 2"]:
    """World (x, y) with each row unrolled to its length along the slope from its first column. A texture projected
    from above would be stretched into streaks on a steep embankment."""
    outward = vertices[:, :, :2] - vertices[:, :1, :2]
    steps_m = np.linalg.norm(np.diff(vertices, axis=1, prepend=vertices[:, :1]), axis=2)
    reach_m = np.maximum(np.linalg.norm(outward, axis=2, keepdims=True), 1e-6)
    return np.asarray(vertices[:, :1, :2] + outward / reach_m * np.cumsum(steps_m, axis=1)[..., None])
