"""The scene's surfaces as vertex and face arrays, as `ground.py` defines them. World frame.

Each row is one station (world y on the main reference line), shared by road, shoulders and paint.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.arrays import Scalars
from synth3dlanes.geometry.ground import CELL_M, EMBANKMENT_SLOPE, GROWTH, VERGE_M, Ground, embankment_width, profile
from synth3dlanes.geometry.horizon import far_dam, on_faces

HORIZON_M = 4000.0
BEHIND_M = 300.0
ROAD_BEHIND_M = 30.0
# From here to the horizon each row of the road is longer than the previous one by this fraction.
FAR_ROWS_M, FAR_ROWS_GROWTH = 420.0, 0.03
# A ramp whose own rows would be closer than this gets them: within the range of labels the road's are no farther apart.
STEEP_M = 1.0
# The exit's inner edge extends a little below the main road or its own verge. Their rows differ, so a gap would show
# the ground otherwise.
SEAM_M, SEAM_FALL_M = 0.05, 0.01
LANE_COLUMNS, SHOULDER_COLUMNS = 4, 4
ROAD, SHOULDER, MEDIAN = 0, 1, 2
# A median this wide is grass between inner shoulders; a narrower one is all shoulder.
GRASS_FROM_M, INNER_SHOULDER_M = 3.0, 0.5


@dataclass(frozen=True, eq=False)
class Mesh:
    """Quads. `uv_m` is (across, along) in metres, for terrain world (x, y); `material` is the material slot per face:
    ROAD, SHOULDER or MEDIAN of a pavement, else 0."""

    vertices_world: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 4"]
    uv_m: Float[np.ndarray, "v 2"]
    material: Int[np.ndarray, " f"]


def terrain_mesh(ground: Ground) -> Mesh:
    """A grid with cells of CELL_M near the road, which grow outwards to the horizon and its hills."""
    xs, ys = terrain_axes(ground)
    xy = np.stack(np.meshgrid(xs, ys), -1)
    vertices = np.concatenate([xy, terrain_heights(ground, xy)[..., None]], -1)
    return grid(vertices, xy, np.zeros(len(xs) - 1, dtype=int))


def terrain_axes(ground: Ground) -> tuple[Scalars, Float[np.ndarray, " m"]]:
    """World x of the columns of the terrain's vertices, and world y of their rows."""
    x0, y0, x1, y1 = ground.fine
    behind_m = HORIZON_M if ground.both_ways else BEHIND_M
    return _axis(x0, x1, HORIZON_M, HORIZON_M), _axis(y0, y1, behind_m, HORIZON_M)


def terrain_heights(ground: Ground, xy_world: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    """Heights of the terrain's vertices."""
    return ground.terrain_mesh_height(xy_world) + ground.hills.height(xy_world)


def road_stations(ground: Ground) -> Scalars:
    """World stations of the rows of road and paint, to beyond the horizon: half a metre apart near the host, more far
    away, less on a ramp that needs it. The split itself is always among them."""
    n_far = int(np.log(2 * HORIZON_M / FAR_ROWS_M) / np.log1p(FAR_ROWS_GROWTH))
    ahead = [
        np.arange(0, 80, 0.5),
        np.arange(80, 160, 1.0),
        np.arange(160, FAR_ROWS_M, 2.0),
        FAR_ROWS_M * (1 + FAR_ROWS_GROWTH) ** np.arange(n_far),
    ]
    rows = [
        *((-part for part in ahead) if ground.both_ways else [np.arange(-ROAD_BEHIND_M, 0, 1.0)]),
        np.arange(0, ground.driven_m, 0.5),
        *(ground.driven_m + part for part in ahead),
    ]
    ramp = ground.plan.plan_station(ground.plan.ramp_stations)
    steep = ramp if ramp.size and np.ptp(ramp) < STEEP_M * len(ramp) else ramp[:0]
    return np.unique(np.concatenate([ground.near_m + np.concatenate(rows), steep, [0.0]]))


def lift_far(
    ground: Ground, xy_world: Float[np.ndarray, "*n 2"], above_m: Float[np.ndarray, "*#n"], s: Float[np.ndarray, "*#n"]
) -> Float[np.ndarray, "*n 3"]:
    """3D points at stations, `above_m` over the terrain with its far hills; far away over the faces of its mesh."""
    points = ground.plan.lift(xy_world, above_m + ground.hills.height(xy_world))
    share = np.broadcast_to(on_faces(s), points.shape[:-1])
    far = share > 0
    over_m = np.broadcast_to(above_m, share.shape)[far] + _face_height(ground, xy_world[far]) - points[far, 2]
    points[far, 2] += share[far] * over_m
    return points


def _face_height(ground: Ground, xy_world: Float[np.ndarray, "n 2"]) -> Scalars:
    """Height of the terrain mesh's faces, not pressed under pavements: of either way to split a quad into triangles the
    higher one."""
    axes = terrain_axes(ground)
    cells = [
        np.clip(np.searchsorted(axis, at) - 1, 0, len(axis) - 2) for axis, at in zip(axes, xy_world.T, strict=True)
    ]
    corners = np.array([[axis[cell], axis[cell + 1]] for axis, cell in zip(axes, cells, strict=True)])
    u, v = (xy_world.T - corners[:, 0]) / (corners[:, 1] - corners[:, 0])

    def height(i: int, j: int) -> Scalars:
        xy = np.stack([corners[0, i], corners[1, j]], -1)
        return np.asarray(ground.plan.lift(xy, ground.hills.height(xy))[:, 2])

    a, b, c, d = height(0, 0), height(1, 0), height(0, 1), height(1, 1)
    one = a + np.where(u > v, (b - a) * u + (d - b) * v, (c - a) * v + (d - c) * u)
    other = np.where(u + v < 1, a + (b - a) * u + (c - a) * v, d + (c - d) * (1 - u) + (b - d) * (1 - v))
    return np.maximum(one, other)


def road_meshes(ground: Ground) -> list[Mesh]:
    """Pavement of the main road, and of the exit outside the main pavement."""
    plan = ground.plan
    s = plan.plan_station(road_stations(ground))
    meshes = [_main_mesh(ground, s)]
    if plan.has_exit:
        meshes.append(_exit_mesh(ground, np.sort(s[s >= 0])))
    return [over_terrain(mesh) for mesh in meshes]


def verge_meshes(ground: Ground) -> list[Mesh]:
    """Verges and embankments along every edge of the pavement, down to below the terrain mesh."""
    plan = ground.plan
    s = plan.plan_station(road_stations(ground))
    raised, free = far_dam(s), np.full(s.shape, np.inf)
    right = ground.main_right_edge(s)
    meshes = [
        _verge(ground, s, lambda d: plan.main_xy(s, ground.left_edge_m - d), raised, free),
        _verge(ground, s, lambda d: plan.main_xy(s, right + d), raised, np.where(_meets_exit(ground, s), 0.0, np.inf)),
    ]
    if plan.has_exit:
        se = np.sort(s[s >= 0])
        edge, raised = ground.exit_edge_m, plan.ramp(se) + far_dam(se)
        meshes += [
            _verge(ground, se, lambda d: plan.exit_xy(se, edge + d), raised, np.full(se.shape, np.inf)),
            _verge(ground, se, lambda d: plan.exit_xy(se, -edge - d), raised, _gap(ground, se)),
        ]
    return [mesh for mesh in map(over_terrain, meshes) if len(mesh.faces)]


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


def _axis(low: float, high: float, out_low: float, out_high: float) -> Scalars:
    """Coordinates CELL_M apart in [low, high]; outside, cells grow by GROWTH per metre of distance."""
    inner = np.linspace(low, high, int(np.ceil((high - low) / CELL_M)) + 1)

    def outside(reach_m: float) -> Scalars:
        n = int(np.ceil(np.log1p(reach_m * GROWTH / CELL_M) / np.log1p(GROWTH)))
        return np.asarray(CELL_M / GROWTH * ((1 + GROWTH) ** np.arange(1, n + 1) - 1))

    return np.concatenate([low - outside(out_low)[::-1], inner, high + outside(out_high)])


def _columns(ground: Ground, half_m: float, edge_m: float, n_lanes: int) -> tuple[Scalars, Int[np.ndarray, " m"]]:
    """Offsets across a pavement whose lanes end at +-half_m and whose shoulders end at +-edge_m, and the material of
    each column of faces."""
    paved_m = half_m + ground.under_paint_m
    shoulder = np.linspace(paved_m, edge_m, SHOULDER_COLUMNS + 1)[1:]
    lanes = np.linspace(-half_m, half_m, n_lanes * LANE_COLUMNS + 1)
    material = np.full(len(lanes) + 1 + 2 * SHOULDER_COLUMNS, ROAD)
    material[:SHOULDER_COLUMNS] = material[-SHOULDER_COLUMNS:] = SHOULDER
    return np.concatenate([-shoulder[::-1], [-paved_m], lanes, [paved_m], shoulder]), material


def _main_columns(ground: Ground) -> tuple[Scalars, Int[np.ndarray, " m"]]:
    """As `_columns`, for the main road with its oncoming lanes and median."""
    plan = ground.plan
    half_m = ground.edge_m - plan.shoulder_m
    t, material = _columns(ground, half_m, ground.edge_m, plan.n_lanes)
    if not plan.n_oncoming:
        return t, material
    # The left part up to the first lane boundary moves out by as much as oncoming lanes and median take.
    first = SHOULDER_COLUMNS + 1
    oncoming = np.linspace(plan.left_m, plan.oncoming_inner_m, plan.n_oncoming * LANE_COLUMNS + 1)
    median, surface = _median_columns(ground)
    return (
        np.concatenate(
            [t[:first] + (plan.left_m + half_m), oncoming, median, t[first if len(median) else first + 1 :]]
        ),
        np.concatenate([material[:first], np.full(len(oncoming) - 1, ROAD), surface, material[first:]]),
    )


def _median_columns(ground: Ground) -> tuple[Scalars, Int[np.ndarray, " m"]]:
    """Offsets inside the median between the inner lane boundaries, and the material of each column of faces there."""
    plan = ground.plan
    width_m = plan.road.median_m
    if width_m == 0:
        return np.zeros(0), np.zeros(0, dtype=int)
    paved_m = min(ground.under_paint_m, width_m / 4)
    inner_m = min(paved_m + INNER_SHOULDER_M, 0.45 * width_m)
    across = np.array([paved_m, inner_m, width_m / 2, width_m - inner_m, width_m - paved_m])
    middle = MEDIAN if width_m >= GRASS_FROM_M else SHOULDER
    return plan.oncoming_inner_m + across, np.array([ROAD, SHOULDER, middle, middle, SHOULDER, ROAD])


def median_grass_m(ground: Ground) -> tuple[float, float] | None:
    """Plan offsets between which the median is grass; None without grass."""
    offsets, surface = _median_columns(ground)
    return (float(offsets[1]), float(offsets[3])) if MEDIAN in surface else None


def _main_mesh(ground: Ground, s: Scalars) -> Mesh:
    plan, k = ground.plan, SHOULDER_COLUMNS
    t, column_material = _main_columns(ground)
    right = ground.main_right_edge(s)[:, None]
    lanes = np.minimum(t[:-k], right - plan.shoulder_m + ground.under_paint_m)
    offsets = np.concatenate([lanes, t[-k:] - ground.edge_m + right], axis=1)
    stations = np.broadcast_to(s[:, None], offsets.shape)
    xy = plan.main_xy(stations, offsets)
    material = np.tile(column_material, (len(s) - 1, 1))
    if plan.has_exit:
        # The main shoulder is road where the exit's lanes cross it.
        middle = (xy[:-1, -k - 1 : -1] + xy[:-1, -k:] + xy[1:, -k - 1 : -1] + xy[1:, -k:]) / 4
        se, te = plan.project_exit(middle, np.broadcast_to((s[:-1, None] + s[1:, None]) / 2, middle.shape[:2]))
        material[:, -k:][(se >= 0) & (np.abs(te) < plan.exit_half_m)] = ROAD
    vertices = lift_far(ground, xy, far_dam(stations), stations)
    return grid(vertices, np.stack([offsets, stations], -1) * plan.flips, material)


def _exit_mesh(ground: Ground, s: Scalars) -> Mesh:
    plan = ground.plan
    t, material = _columns(ground, plan.exit_half_m, ground.exit_edge_m, plan.n_exit_lanes)
    inner = _inner_edge(ground, s)[:, None]
    offsets = np.concatenate([inner - SEAM_M, np.maximum(t, inner)], axis=1)
    material = np.concatenate([material[:1], material])
    stations = np.broadcast_to(s[:, None], offsets.shape)
    vertices = lift_far(ground, plan.exit_xy(stations, offsets), plan.ramp(stations) + far_dam(stations), stations)
    vertices[:, 0, 2] -= SEAM_FALL_M
    return grid(vertices, np.stack([offsets, stations], -1) * plan.flips, material)


def _inner_edge(ground: Ground, s: Scalars) -> Scalars:
    """Exit offset at which the exit's cross-section leaves the main pavement; its own left edge once they are
    separate."""
    return np.clip(_crossing(ground, s, ground.exit_edge_m), -ground.exit_edge_m, ground.exit_edge_m)


def _meets_exit(ground: Ground, s: Scalars) -> Bool[np.ndarray, " n"]:
    """Where the exit's pavement goes on beyond the main pavement's right edge. A verge would show through the seam."""
    if not ground.plan.has_exit:
        return np.zeros(s.shape, bool)
    se, te = ground.plan.project_exit(ground.plan.main_xy(s, ground.main_right_edge(s)), s)
    return np.asarray((se > 0) & (np.abs(te) < ground.exit_edge_m - SEAM_M))


def _gap(ground: Ground, s: Scalars) -> Scalars:
    """Width available to the exit's inner embankment: from its left edge to the main pavement; 0 while they touch."""
    return np.clip(-ground.exit_edge_m - _crossing(ground, s, -ground.exit_edge_m), 0, None)


def _crossing(ground: Ground, s: Scalars, high: float) -> Scalars:
    """Exit offset, at most `high`, at which the exit's cross-section at s crosses the main pavement's right edge."""
    plan = ground.plan
    low = -ground.exit_edge_m - EMBANKMENT_SLOPE * plan.road.ramp_height_m - VERGE_M

    def outside(t: Scalars) -> Scalars:
        at, main_t = plan.project_main(plan.exit_xy(s, t))
        return np.asarray(main_t - ground.main_right_edge(at))

    below, above = np.full(s.shape, low), np.full(s.shape, high)
    for _ in range(24):
        middle = (below + above) / 2
        is_outside = outside(middle) > 0
        above = np.where(is_outside, middle, above)
        below = np.where(is_outside, below, middle)
    return np.asarray(above)


def _verge(
    ground: Ground,
    s: Scalars,
    edge_plus: Callable[[Scalars], Float[np.ndarray, "n 2"]],
    raised: Scalars,
    room_m: Scalars,
) -> Mesh:
    """A strip outwards from an edge, with a row per station; `edge_plus(d)` returns their world points d metres
    outside the edge.

    Faces without room are dropped: single pixels of them would show through the pavement.
    """
    scale = ground.cell_scale(edge_plus(np.zeros(raised.shape)))
    foot = EMBANKMENT_SLOPE * raised
    columns = [0.0 * foot, 0.5 * foot, foot] + [foot + VERGE_M * scale * share for share in (0.33, 0.66, 1.0)]
    distance = np.stack(columns, axis=1)
    squeeze = np.minimum(1.0, room_m / embankment_width(raised, scale))
    xy = np.stack([edge_plus(distance[:, j] * squeeze) for j in range(distance.shape[1])], axis=1)
    vertices = lift_far(ground, xy, profile(distance, raised[:, None], scale[:, None]), s[:, None])
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
