"""Scenes on the paper's roads as OpenDRIVE describes them: their roads on banked planes, with all paint in place
along the edges of lanes, each that of the delimiter which runs there, and what lies and stands on and beside them."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.opendrive.described import (
    SHAPE_PLACES,
    Described,
    Element,
    PaintedMark,
    add,
    add_crosswalk,
    lane_ascends,
    shapes,
)
from synth3dlanes.formats.opendrive.roads import JUNCTION, OdrRoad, roads
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.maps.profiles import cubics, pieces
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.road_map import (
    LaneName,
    MapJunction,
    MapLane,
    MapMark,
    MapMarkKind,
    MapRoad,
    MapSection,
    MapShape,
    PlanPiece,
    RoadMap,
)
from synth3dlanes.scene.roadside import Rail
from synth3dlanes.scene.scene import Symbol
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.beside import beside, on_ground
from synth3dlanes.world.buildings import building_frame
from synth3dlanes.world.paint import is_dotted, is_double, line_width_m, paint_color, pair_of
from synth3dlanes.world.posts import post_frames
from synth3dlanes.world.symbols import shape
from synth3dlanes.world.world import World

# Greatest distance of a delimiter from the edge that it runs along: lanes that leave a road turn aside at once, which
# moves their lines against those before.
ON_EDGE_M = 0.1
# Shorter stretches are left out.
SHORT_M = 0.5
# Dashes are counted anew after this length, and lengths are measured in these steps.
MARK_M, LENGTH_STEP_M = 50.0, 0.5
# From the first to the last place of a stretch that have to be near, as shares of it.
PROBES = np.array([0.2, 0.5, 0.8])

MIRRORED: dict[MapMarkKind, MapMarkKind] = {"solid_dashed": "dashed_solid", "dashed_solid": "solid_dashed"}
# Towards which lane numbers, which increase to the left, a mark may be crossed: from the side of its dashes.
LANE_CHANGES = {"dashed": "both", "dots": "both", "solid_dashed": "increase", "dashed_solid": "decrease"}
DOUBLE: frozenset[MapMarkKind] = frozenset({"solid_solid", *MIRRORED})
# The pattern of a stripe: the lengths of its dashes and gaps, and where the first dash begins.
Pattern = tuple[float, float, float]


def marks(world: World, road: OdrRoad) -> dict[int, tuple[MapMark, ...]]:
    """The marks on the outer edges of all lanes by their numbers, and those of lane 0, which lies between both
    directions or at the inner edge of a road of one direction."""
    edges = {0: road.center_m, **{lane.number: lane.outer_m for lane in road.lanes}}
    found = {number: tuple(_along(world, road, number, road.plane_points(t)[:, :2])) for number, t in edges.items()}
    # The line between both directions belongs to the lanes of the host's where these are another road's.
    return found | ({0: ()} if road.is_oncoming and road.in_junction else {})


def _along(world: World, road: OdrRoad, number: int, edge_xy: Float[np.ndarray, "m 2"]) -> Iterator[MapMark]:
    """All marks of an edge, and `none` between them; nothing where it is not painted at all."""
    found = sorted(
        (mark for line in world.site.lines for mark in _of(world, road, edge_xy, line)), key=lambda at: at[0].s_m
    )
    reached = 0.0
    for mark, end_m in found:
        if mark.s_m > reached + SHORT_M:
            yield MapMark(s_m=reached, kind="none")
        # From the left; on lanes to the left of lane 0 the inner stripe comes first.
        yield mark.model_copy(update={"kind": MIRRORED.get(mark.kind, mark.kind)}) if number > 0 else mark
        reached = end_m
    if found and road.s_m[-1] > reached + SHORT_M:
        yield MapMark(s_m=reached, kind="none")


def _of(
    world: World, road: OdrRoad, edge_xy: Float[np.ndarray, "m 2"], line: LaneCurve
) -> Iterator[tuple[PaintedMark, float]]:
    """The marks of a delimiter along an edge, each with its end, if it runs there; of stripes that differ, the left one
    is named first."""
    at = np.flatnonzero((road.network_s >= line.start_m - 1e-6) & (road.network_s <= line.end_m + 1e-6))
    if line.kind != "delimiter" or len(at) < 2 or road.s_m[at[-1]] - road.s_m[at[0]] < SHORT_M:
        return
    probes = at[((len(at) - 1) * PROBES).astype(int)]
    # Stations of different roads differ, so the whole line is looked at.
    there = line.xy_world(np.sort(road.network_s[at]))
    apart_m = np.linalg.norm(edge_xy[probes][:, None] - there, axis=2).min(axis=1)
    if apart_m.max() > ON_EDGE_M:
        return
    markings = world.scene.markings
    width_m = line_width_m(line, markings)

    def painted(kind: MapMarkKind, s_m: float, length_m: float, dashes: Pattern = (0.0, 0.0, 0.0)) -> PaintedMark:
        solid = (length_m, 0.0, 0.0)
        patterns: dict[float, Pattern] = {0.0: solid if kind == "solid" else dashes}
        if kind in DOUBLE:
            right, left = (dashes if kind == dashed else solid for dashed in ("solid_dashed", "dashed_solid"))
            patterns = {-width_m: right, width_m: left}
        return PaintedMark(
            s_m=s_m,
            kind=kind,
            yellow=paint_color(line, markings) == "yellow",
            width_m=width_m,
            stripes=tuple((t_m, *pattern) for t_m, pattern in patterns.items()),
            lane_change=LANE_CHANGES.get(kind, "none"),
        )

    start_m, end_m = float(road.s_m[at[0]]), float(road.s_m[at[-1]])
    pair = pair_of(line, markings)
    if line.marking == "solid" and pair is None:
        yield painted("solid_solid" if is_double(line, markings) else "solid", start_m, end_m - start_m), end_m
        return
    kind: MapMarkKind = "dots" if is_dotted(line, markings) else "dashed"
    if pair:
        kind = MIRRORED[pair] if road.is_oncoming else pair
    cycle_m, dash_m = markings.dash_cycle_m, markings.dash_fraction * markings.dash_cycle_m
    length_m, ascends = _lengths(line, road.network_s[at]), road.network_s[at[-1]] > road.network_s[at[0]]
    # Dashes begin at multiples of their cycle along the line from station 0; seen from behind, they end there.
    first_m = length_m[0] + (-length_m[0] - (0 if ascends else dash_m)) % cycle_m
    # Marks begin with a dash, and are so short that the line is nowhere much longer or shorter than the road.
    begins_m = np.arange(first_m, length_m[-1], cycle_m * max(1, round(MARK_M / cycle_m)))
    begins_m = np.unique([*(begins_m if len(begins_m) else [first_m]), max(first_m + 1e-3, length_m[-1])])
    places_m = np.interp(begins_m, length_m, road.s_m[at])
    for i, (place_m, next_m) in enumerate(pairwise(places_m)):
        scale = (next_m - place_m) / (begins_m[i + 1] - begins_m[i])
        from_m = place_m if i else start_m
        dashes = float(scale * dash_m), float(scale * (cycle_m - dash_m)), float(place_m - from_m)
        yield painted(kind, float(from_m), float(next_m - from_m), dashes), float(next_m)


def _lengths(line: LaneCurve, network_s: Scalars) -> Scalars:
    """Lengths along a line, in the order of these stations, from station 0."""
    to_start = np.clip(
        np.linspace(0, network_s[0], 2 + int(abs(network_s[0]) / LENGTH_STEP_M)), line.start_m, line.end_m
    )
    before, along = (np.linalg.norm(np.diff(line.points_world(s), axis=0), axis=1) for s in (to_start, network_s))
    start_m = np.sign(network_s[0]) * before.sum() * np.sign(network_s[-1] - network_s[0])
    return np.asarray(start_m + np.concatenate([[0.0], np.cumsum(along)]))


# How far the written reference line, heights and widths (metres) and rolls (radians) may be from the world's.
LINE_M, HEIGHT_M, WIDTH_M, ROLL_RAD = 1e-3, 1e-3, 1e-3, 1e-4


def described_paper(world: World) -> Described:
    """All roads of a world with the paper's roads."""
    found = {road.name: road for road in roads(world.network)}
    told = {name: _told(world, road) for name, road in found.items()}
    segments = {f"{road.name}.0.{lane.number}": str(lane.segment) for road in found.values() for lane in road.driving}
    links = tuple(link for name in found for link in _links(world.network, found, told[name]))
    has_junction = any(road.in_junction for road in found.values())
    junctions = (MapJunction(id=JUNCTION),) if has_junction else ()
    whole = RoadMap(roads=tuple(told.values()), links=links, junctions=junctions, route=(next(iter(segments)),))
    xy_world = np.concatenate([road.xy_world for road in found.values()])
    return Described(whole, told, xy_world, segments, partial(add_objects, world, list(found.values())))


def _told(world: World, road: OdrRoad) -> MapRoad:
    s, painted = road.s_m, marks(world, road)
    lanes = [MapLane(number=0, kind="none", marks=painted[0])]
    for lane in road.lanes:
        widths = tuple(cubics(s, np.abs(lane.outer_m - lane.inner_m), WIDTH_M))
        lanes.append(MapLane(number=lane.number, kind=lane.kind, widths=widths, marks=painted[lane.number]))
    return MapRoad(
        id=road.name,
        plan=tuple(_plan(road)),
        sections=(MapSection(s_m=0.0, lanes=tuple(lanes)),),
        lane_offsets=tuple(cubics(s, road.center_m, WIDTH_M)),
        heights=tuple(cubics(s, road.elevation_m, HEIGHT_M)),
        banks=tuple(cubics(s, road.roll_rad, ROLL_RAD)),
        shapes=tuple(_shapes(road)),
        junction=JUNCTION if road.in_junction else None,
        keeps_left=road.is_left_hand,
    )


def _plan(road: OdrRoad) -> Iterator[PlanPiece]:
    for piece in pieces(road.s_m, road.xy_world, LINE_M, unit_speed=True):
        (x, y), (dx, dy) = piece.abcd[0].tolist(), piece.abcd[1].tolist()
        u, v = (piece.abcd @ np.array([[dx, -dy], [dy, dx]])).T.tolist()
        length_m, heading = piece.end - piece.s, float(np.arctan2(dy, dx))
        cubic = {"u": (0.0, 1.0, *u[2:]), "v": (0.0, 0.0, *v[2:]), "parameter_end": length_m}
        yield PlanPiece(x_m=x, y_m=y, heading_rad=heading, length_m=length_m, **cubic)


def _shapes(road: OdrRoad) -> Iterator[MapShape]:
    edges = [t for lane in road.lanes for t in (lane.inner_m, lane.outer_m)]
    low, high = np.min(edges, axis=0), np.max(edges, axis=0)
    across = [low + (high - low) * share for share in np.linspace(0, 1, SHAPE_PLACES)]
    # Shapes are heights along e_h.
    over_m = np.column_stack([road.over_plane(t) * road.axes[:, 2, 2] for t in across])
    return shapes(road.s_m, over_m, low, high - low)


def _links(network: Network, found: Mapping[str, OdrRoad], told: MapRoad) -> Iterator[tuple[LaneName, LaneName]]:
    """The links of the lanes of a connecting road with those of the roads at its ends, and of another one with those
    of the road behind it, as traffic drives."""
    road = found[told.id]
    there = found.get(road.after or "")
    if there is not None and not road.in_junction:
        pairs = ((lane, at) for lane in road.driving for at in there.driving)
        for lane, at in pairs:
            joined = lane.segment == at.segment or at.segment in {
                beyond.id for beyond in network.joined_to(network.lanes[str(lane.segment)])
            }
            ends = f"{road.name}.0.{lane.number}", f"{there.name}.0.{at.number}"
            if joined:
                yield ends if lane_ascends(told, 0, lane.number) else (ends[1], ends[0])
    for lane in road.driving if road.in_junction else ():
        segments = {lane.segment} | {at.id for at in network.joined_to(network.lanes[str(lane.segment)])}
        before, after = (
            f"{name}.0.{next(there.number for there in found[str(name)].lanes if there.segment in segments)}"
            for name in (road.before, road.after)
        )
        if not lane_ascends(told, 0, lane.number):
            before, after = after, before
        own = f"{road.name}.0.{lane.number}"
        yield before, own
        yield own, after


# The types and subtypes of our things; what is not listed is left out.
SYMBOLS = {
    "crosswalk": ("crosswalk", "pedestrian"),
    "stop_line": ("roadMark", "signalLines"),
    "gore": ("roadMark", "area"),
    "arrow_straight": ("roadMark", "arrowStraight"),
    "arrow_left": ("roadMark", "arrowLeft"),
    "arrow_right": ("roadMark", "arrowRight"),
    "arrow_straight_left": ("roadMark", "arrowStraightLeft"),
    "arrow_straight_right": ("roadMark", "arrowStraightRight"),
}
RAILS = {
    "guardrail": ("barrier", "guardRail"),
    "concrete": ("barrier", "jerseyBarrier"),
    "noise_wall": ("barrier", "wall"),
}
POSTS = {"lamp": ("pole", "streetLamp"), "sign": ("pole", "trafficSign"), "delineator": ("pole", "permanentDelineator")}
RAIL_WIDTH_M = {"guardrail": 0.1, "concrete": 0.6, "noise_wall": 0.2}
# Rails are straight in (s, t) over this length.
RAIL_STEP_M = 10.0


def add_objects(world: World, roads: Sequence[OdrRoad], elements: Mapping[str, Element]) -> None:
    """Add the objects of a world to the elements of its roads by their names."""
    groups: list[list[Element]] = [[] for _ in roads]
    scene, ground = world.scene, world.ground
    for symbol in scene.symbols:
        _add_symbol(world, symbol, roads, groups)
    for rail in scene.roadside.rails:
        if rail.kind in RAILS:
            _add_rail(world, rail, roads, groups)
    posts = zip(scene.roadside.posts, post_frames(ground, scene.roadside.posts), strict=True)
    for post, frame in posts:
        _add_upright(frame.origin, roads, groups, POSTS[post.kind], height=post.height_m, radius=0.1)
    heights_m = [model.height_m for model in scene.assets.tree_models]
    for tree, base in zip(scene.trees, world.site.trees_world, strict=True):
        _add_upright(
            base, roads, groups, ("tree", ""), height=heights_m[tree.model - 1] * tree.scale, radius=0.3 * tree.scale
        )
    for building in scene.roadside.buildings:
        frame = building_frame(building)
        sizes = {"width": building.width_m, "length": building.length_m, "height": building.height_m}
        base = on_ground(ground, frame.origin[None, :2])[0]
        _add_upright(base, roads, groups, ("building", building.kind), building.yaw_rad + np.pi / 2, **sizes)
    count = 0
    for group, road in zip(groups, roads, strict=True):
        if group:
            objects = add(elements[road.name], "objects")
            for found in group:
                found.set("id", str(count))
                objects.append(found)
                count += 1


def _object(kind: tuple[str, str], at: Float[np.ndarray, "3"], **attributes: str | float) -> Element:
    name = {"type": kind[0], "name": kind[1] or kind[0]} | ({"subtype": kind[1]} if kind[1] else {})
    return add(Element("objects"), "object", **name, s=at[0], t=at[1], **attributes)


def _add_symbol(world: World, symbol: Symbol, roads: Sequence[OdrRoad], groups: list[list[Element]]) -> None:
    form = shape(world.ground, symbol)
    kind = SYMBOLS[symbol.kind]
    outline = form.points_world(form.polygons[0] if symbol.kind.startswith("arrow") else form.outline)
    road = _nearest(roads, outline.mean(axis=0))
    if symbol.kind == "crosswalk":
        (x0, y0), (x1, y1) = form.outline.min(axis=0), form.outline.max(axis=0)
        rectangle = form.points_world(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
        # Its own place is the nearest one of the road, also of a crosswalk beyond the road's end.
        along = roads[road]
        i = int(np.linalg.norm(along.xy_world - rectangle.mean(axis=0)[:2], axis=1).argmin())
        t = float((rectangle.mean(axis=0) - along.line_world[i]) @ along.axes[i, 1])
        corners = (rectangle - along.line_world[i] - t * along.axes[i, 1]) @ along.axes[i].T
        words = {"name": kind[1], "subtype": kind[1]}
        groups[road].append(add_crosswalk(Element("objects"), 0, corners, float(along.s_m[i]), t, **words))
        return
    places = roads[road].places(outline)
    # Corners go counter-clockwise.
    x, y = places[:, 0], places[:, 1]
    if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() < 0:
        places = places[::-1]
    element = _object(kind, places.mean(axis=0), zOffset=0.0, height=0.0, orientation="none")
    corners = add(add(element, "outlines"), "outline", id="0", outer="true", closed="true")
    for i, (s, t, _) in enumerate(places):
        add(corners, "cornerRoad", id=str(i), s=s, t=t, dz=0.0, height=0.0)
    groups[road].append(element)


def _add_rail(world: World, rail: Rail, roads: Sequence[OdrRoad], groups: list[list[Element]]) -> None:
    low, high = sorted((rail.from_m, rail.to_m))
    for road, group in zip(roads, groups, strict=True):
        start, end = max(low, road.network_s.min()), min(high, road.network_s.max())
        if road.edges_of != rail.road or end - start < 1.0:
            continue
        stations = np.linspace(start, end, 2 + int((end - start) / RAIL_STEP_M))
        line = on_ground(world.ground, beside(world.ground, rail.road, rail.side, stations, rail.aside_m))
        places = road.places(line)
        places = places[np.argsort(places[:, 0])]
        width = RAIL_WIDTH_M[rail.kind]
        element = _object(RAILS[rail.kind], places[0], zOffset=places[0, 2], height=rail.height_m, orientation="none")
        for a, b in pairwise(places):
            ends = {"tStart": a[1], "tEnd": b[1], "zOffsetStart": a[2], "zOffsetEnd": b[2]}
            sizes = {"heightStart": rail.height_m, "heightEnd": rail.height_m, "widthStart": width, "widthEnd": width}
            add(element, "repeat", s=a[0], length=b[0] - a[0], distance=0.0, **ends, **sizes)
        group.append(element)


def _add_upright(
    base: Float[np.ndarray, "3"], roads: Sequence[OdrRoad], groups: list[list[Element]], kind: tuple[str, str],
    heading_rad: float | None = None, **sizes: float,
) -> None:  # fmt: skip
    road = _nearest(roads, base)
    place = roads[road].places(base[None])[0]
    turned = {}
    if heading_rad is not None:
        along = roads[road].axes[np.searchsorted(roads[road].s_m[:-1], place[0]), 0]
        turned = {"hdg": float(heading_rad - np.arctan2(along[1], along[0]))}
    groups[road].append(_object(kind, place, zOffset=place[2], orientation="none", **turned, **sizes))


def _nearest(roads: Sequence[OdrRoad], point: Float[np.ndarray, "3"]) -> int:
    """The road whose reference line is nearest; a lane that opens in a junction is none."""
    apart = [
        np.linalg.norm(road.xy_world - point[:2], axis=1).min() if road.name != "opening" else np.inf for road in roads
    ]
    return int(np.argmin(apart))
