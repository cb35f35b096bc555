"""Check the symbols on the road against the scene: their pixels must lie in their paint, and their paint must show.

Pixels are unprojected onto the road by depth and compared with the scene's polygons, in metres beside and along the
symbol's lane, as `places` measures them; the meshes are not used.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.roads.roads import Parting, Road
from synth3dlanes.scene.instance_ids import numbers_of
from synth3dlanes.scene.scene import Symbol
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Finding
from synth3dlanes.validate.pixels import some_pixels
from synth3dlanes.validate.places import AnyPlaces, on_road, places
from synth3dlanes.world.symbols import Polygon, SymbolShape, dense, shape
from synth3dlanes.world.world import World

# Pixels this close to an edge of paint may show either side of it.
MARGIN_M = 0.04
# The lines beside a gore may lie this far over its edges.
LINE_M = 0.15
# Number and share of pixels of a symbol that may be wrong.
MAX_SINGLE, MAX_SHARE = 3, 0.05
# Of the search for a station between two lines.
STEPS = 5
# Sides of symbols are straight over this length from above.
SIDE_M = 0.5
GROUND = [SEMANTIC_IDS[name] for name in ("road", "shoulder", "marking", "symbol")]


def check_symbols(evidence: Evidence) -> Iterator[Finding]:
    """Findings about the pixels of symbols, from depth and semantic ids, and from instance ids if there are any."""
    world, passes = evidence.world, evidence.passes
    near = (passes["depth"] < PROOF_M) & evidence.has_points
    is_symbol = passes["semantic"] == SEMANTIC_IDS["symbol"]
    if not world.symbol_shapes:
        if is_symbol.sum() > MAX_SINGLE:
            yield Finding("", f"semantic: expected no symbols as in the scene, got {is_symbol.sum()} pixels of them")
        return
    rows, columns = some_pixels(near & np.isin(passes["semantic"], GROUND))
    points, used = on_road(world, evidence.camera, evidence.points_cam(rows, columns))
    rows, columns, place = rows[used], columns[used], places(world.ground, points[used, :2])
    shown = is_symbol[rows, columns]
    margin_m = np.where(passes["semantic"][rows, columns] == SEMANTIC_IDS["marking"], LINE_M, MARGIN_M)
    number = np.where(shown, 0, -1)
    if "instance" in passes:
        number = numbers_of("symbol", passes["instance"][rows, columns])
    # The paint of a map is none of the scene's symbols.
    of_scene = [_beyond_m(world, symbol, place) for symbol in world.scene.symbols]
    beyond_m = np.stack(of_scene or [_beyond_from_above(form, place.xy_world) for form in world.symbol_shapes])
    if "instance" not in passes:
        beyond_m = beyond_m.min(axis=0, keepdims=True)
    for i, outside_m in enumerate(beyond_m):
        yield from _judge(f"symbol {i}" if "instance" in passes else "symbols", number == i, outside_m, margin_m)


def _judge(name: str, shown: Bool[np.ndarray, " n"], outside_m: Scalars, margin_m: Scalars) -> Iterator[Finding]:
    strays, gaps = shown & (outside_m > MARGIN_M), ~shown & (outside_m < -margin_m)
    inside = int((outside_m < -MARGIN_M).sum())
    if strays.sum() > max(MAX_SINGLE, MAX_SHARE * shown.sum()):
        yield Finding("", f"{name}: expected pixels within its paint, got {strays.sum()} of {shown.sum()} outside")
    if gaps.sum() > max(MAX_SINGLE, MAX_SHARE * inside):
        yield Finding("", f"{name}: expected {inside} pixels of its paint, got another surface at {gaps.sum()} of them")


def _beyond_m(world: World, symbol: Symbol, place: AnyPlaces) -> Scalars:
    """Distance of points on the road outside a symbol's paint, negative inside."""
    network, form = world.network, shape(world.ground, symbol)
    if symbol.kind == "gore":
        share, s = _between_lines(world, place.xy_world)
        polygons = [polygon * np.column_stack([_gap_m(world, polygon[:, 1]), np.ones(4)]) for polygon in form.polygons]
        return _outside(polygons, np.column_stack([share * _gap_m(world, s), s]))
    path = None if symbol.lane is None else network.path(symbol.lane)
    if path is None:
        s, aside = network.main.line.project(place.xy_world)
    else:
        s, aside = place.station(path), place.right_of(path)
    around = network.stations(symbol.s_m + np.array([-0.5, 0.5]))
    ends = network.main.xy(around, 0.0) if path is None else path.xy_world(around)
    ahead = (s * network.onwards - symbol.s_m) * np.hypot(*(ends[1] - ends[0]))
    return _outside(form.polygons, np.nan_to_num(np.column_stack([aside * network.rightward, ahead]), nan=1e3))


def _beyond_from_above(form: SymbolShape, xy_world: Points2) -> Scalars:
    """The same of a map's symbol, seen from above."""
    return _outside([form.points_world(dense(polygon, SIDE_M))[:, :2] for polygon in form.polygons], xy_world)


def _between_lines(world: World, xy_world: Points2) -> tuple[Scalars, Scalars]:
    """Where points are between the lines of two roads that part: the share of the way, and the station at which both
    lines have them between each other."""
    branch, parting = _gore(world)
    begun = [line for line in world.network.delimiters if line.start_m == parting.station(0.0)]
    near = next(line for line in reversed(begun) if line.pieces[0].road is parting.road)
    far = next(line for line in begun if line.pieces[0].road is branch)
    s = np.clip(parting.road.line.project(xy_world)[0], near.start_m, None)
    mirrored = -1 if branch.line.is_mirrored else 1
    for _ in range(STEPS):
        main, across = near.xy_world(s), far.xy_world(s) - near.xy_world(s)
        to, length = xy_world - main, np.maximum(np.hypot(*across.T), 1e-3)
        ahead_m = (across[:, 0] * to[:, 1] - across[:, 1] * to[:, 0]) / length * mirrored
        s = np.clip(s + ahead_m, near.start_m, None)
    return (to * across).sum(axis=1) / length**2, s


def _gap_m(world: World, s: Scalars) -> Scalars:
    return np.maximum(_gore(world)[1].gap_m(s), 0.01)


def _gore(world: World) -> tuple[Road, Parting]:
    branch = next(road for road in world.network.roads if road.parting is not None)
    assert branch.parting is not None, "just asked for"
    return branch, branch.parting


def _outside(polygons: list[Polygon], points: Float[np.ndarray, "n 2"]) -> Scalars:
    """Distance of points from the nearest polygon; inside one, minus the distance from its sides."""
    outside = np.full(len(points), np.inf)
    for polygon in polygons:
        near = ((points > polygon.min(axis=0) - 1) & (points < polygon.max(axis=0) + 1)).all(axis=1)
        a, side = polygon, np.roll(polygon, -1, axis=0) - polygon
        to = points[near, None] - a
        share = np.clip((to * side).sum(axis=-1) / (side * side).sum(axis=-1), 0, 1)
        distance = np.linalg.norm(to - share[..., None] * side, axis=-1).min(axis=1)
        y = points[near, 1:]
        crosses = (a[:, 1] > y) != ((a + side)[:, 1] > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            right = a[:, 0] + (y - a[:, 1]) / side[:, 1] * side[:, 0] > points[near, :1]
        inside = (crosses & right).sum(axis=1) % 2 == 1
        outside[near] = np.minimum(outside[near], np.where(inside, -distance, distance))
    return outside
