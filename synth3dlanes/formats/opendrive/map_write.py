"""OpenDRIVE of scenes on maps: their roads as they are, on the ground of the scene, with links, junctions and paint."""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from synth3dlanes.formats.opendrive.convention import MAJOR, MINOR, NO_NUMBER, USER_DATA
from synth3dlanes.formats.opendrive.map_signals import RoadPlace, add_signals, line_of, places_beside
from synth3dlanes.formats.opendrive.profiles import knots, pieces
from synth3dlanes.formats.opendrive.xml import Element, add, add_crosswalk, numbered
from synth3dlanes.roads.maps.cubics import steepened, times, value
from synth3dlanes.roads.maps.furniture import edges_at
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import Road
from synth3dlanes.scene.road_map import LaneName, MapLane, MapLaneKind, MapMark, MapRoad, PlanPiece, Polynomial, RoadMap
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.world import World

# How far the written heights (metres) and rolls (radians) may be from the scene's, and steps between their places.
HEIGHT_M, ROLL_RAD, STEP_M = 1e-3, 1e-4, 1.0
# A road gets lateral shapes where its surface is farther than this from the banked plane, at so many places across.
SHAPE_M, SHAPE_PLACES = 0.005, 9
KINDS: dict[MapLaneKind, str] = {
    "driving": "driving",
    "shoulder": "shoulder",
    "border": "border",
    "parking": "parking",
    "walkway": "sidewalk",
    "cycle": "biking",
    "median": "median",
    "restricted": "restricted",
    "kerb": "curb",
    "none": "none",
}
MARKS = {
    "none": "none",
    "solid": "solid",
    "dashed": "broken",
    "solid_solid": "solid solid",
    "solid_dashed": "solid broken",
    "dashed_solid": "broken solid",
    "dashed_dashed": "broken broken",
    "dots": "botts dots",
}
SIDES = {"left": 1, "center": 0, "right": -1}


class LaneJoint(NamedTuple):
    """A lane that traffic leaves, and one that it enters there: their road, section, number, and end."""

    one: tuple[str, int, int]
    leaves: str
    other: tuple[str, int, int]
    enters: str


class FileIds(NamedTuple):
    """The ids in the file of roads and junctions by ours."""

    roads: Mapping[str, str]
    junctions: Mapping[str, str]


def opendrive_of_map(world: World, name: str) -> str:
    """The OpenDRIVE file of a world on a map: its roads near the host; the inertial frame is the world frame."""
    roads, network = world.scene.map, world.network
    assert roads is not None, "asked only of maps"
    near = {road.id for road in network.roads}
    found = {road.id: road for road in roads.roads if road.id in near}
    touches = list(_touches(roads, found))
    root = ElementTree.Element("OpenDRIVE")
    xy = np.array([(piece.x_m, piece.y_m) for road in found.values() for piece in road.plan])
    (west, south), (east, north) = xy.min(axis=0), xy.max(axis=0)
    header = {"revMajor": MAJOR, "revMinor": MINOR, "name": name, "version": "1.00", "vendor": "synth3dlanes"}
    add(root, "header", **header, north=north, south=south, east=east, west=west)
    direct = _direct_junctions(found, touches)
    # Roads and junctions share the numbers: CARLA knows by them which of both a link leads to.
    roads_by = numbered(found)
    ids = FileIds(roads_by, numbered([*(at.id for at in roads.junctions), *direct.values()], roads_by.values()))
    for road in found.values():
        element = add(root, "road", name=road.id, length=road.length_m, id=ids.roads[road.id])
        element.set("junction", ids.junctions[road.junction] if road.junction else NO_NUMBER)
        element.set("rule", "LHT" if road.keeps_left else "RHT")
        _add_links(add(element, "link"), road, found, touches, direct, ids)
        view, s = add(element, "planView"), 0.0
        for piece in road.plan:
            _add_piece(view, piece, s)
            s += piece.length_m
        roll = _add_heights(element, road, network.road(road.id))
        # At a junction the lanes of its arms have no links: the connections of the junction tell them.
        own = [touch for touch in touches if road.junction is not None or not _enters_junction(touch, found)]
        _add_lanes(add(element, "lanes"), road, own, roll)
    elements = {element.get("name", ""): element for element in root.iterfind("road")}
    _add_paint(elements, roads, found, network)
    add_signals(elements, world, network)
    _add_junctions(root, roads, found, touches, direct, ids)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


# -- links


def _touches(roads: RoadMap, found: Mapping[str, MapRoad]) -> Iterable[LaneJoint]:
    for a, b in roads.links:
        (one, i, m), (other, j, n) = (_key(name) for name in (a, b))
        if one in found and other in found:
            ends = [_ascends(found[one], i, m), _ascends(found[other], j, n)]
            yield LaneJoint((one, i, m), "end" if ends[0] else "start", (other, j, n), "start" if ends[1] else "end")


def _enters_junction(touch: LaneJoint, found: Mapping[str, MapRoad]) -> bool:
    """Whether it is between a connecting road of a junction and another one."""
    return found[touch.one[0]].junction != found[touch.other[0]].junction


def _key(name: LaneName) -> tuple[str, int, int]:
    road, section, number = name.rsplit(".", 2)
    return road, int(section), int(number)


def _ascends(road: MapRoad, section: int, number: int) -> bool:
    lane = next(lane for lane in road.sections[section].lanes if lane.number == number)
    return (number < 0) ^ road.keeps_left ^ lane.against


def _is_within(touch: LaneJoint) -> bool:
    """Whether it is between two sections of a road."""
    (one, i, _), (other, j, _) = touch.one, touch.other
    return one == other and abs(i - j) == 1 and touch.leaves != touch.enters and (i < j) == (touch.leaves == "end")


def _beyond(road: str, end: str, touches: Iterable[LaneJoint]) -> dict[tuple[str, str], None]:
    """The ends of other roads that lanes lead to or come from at an end of a road."""
    found: dict[tuple[str, str], None] = {}
    for touch in touches:
        if _is_within(touch):
            continue
        sides = [(touch.one[0], touch.leaves), (touch.other[0], touch.enters)]
        for here, there in (sides, sides[::-1]):
            if here == (road, end):
                found[there] = None
    return found


def _direct_junctions(found: Mapping[str, MapRoad], touches: list[LaneJoint]) -> dict[tuple[str, str], str]:
    """The ids of direct junctions by ends of roads: where lanes lead from one road to several without connecting
    roads."""
    groups: dict[tuple[str, str], str] = {}
    for road in found.values():
        for end in ("start", "end"):
            beyond = [at for at in _beyond(road.id, end, touches) if found[at[0]].junction is None]
            if road.junction is None and len({name for name, _ in beyond}) > 1 and (road.id, end) not in groups:
                name = f"direct_{len(groups)}"
                groups |= dict.fromkeys([(road.id, end), *beyond], name)
    return groups


def _add_links(
    element: Element,
    road: MapRoad,
    found: Mapping[str, MapRoad],
    touches: list[LaneJoint],
    direct: Mapping[tuple[str, str], str],
    ids: FileIds,
) -> None:
    for tag, end in (("predecessor", "start"), ("successor", "end")):
        beyond = _beyond(road.id, end, touches)
        through = [name for name, _ in beyond if found[name].junction is not None]
        if (road.id, end) in direct:
            add(element, tag, elementType="junction", elementId=ids.junctions[direct[road.id, end]])
        elif road.junction is None and through:
            add(element, tag, elementType="junction", elementId=ids.junctions[str(found[through[0]].junction)])
        elif beyond:
            (name, contact), *_ = beyond
            add(element, tag, elementType="road", elementId=ids.roads[name], contactPoint=contact)


def _linked(road: str, i: int, number: int, end: str, touches: list[LaneJoint]) -> list[tuple[str, int]]:
    """The lanes, by road and number, that follow or precede a lane at an end of it."""
    here, found = (road, i, number), []
    for touch in touches:
        if touch.one == here and touch.leaves == end:
            found.append((touch.other[0], touch.other[2]))
        if touch.other == here and touch.enters == end:
            found.append((touch.one[0], touch.one[2]))
    return found


def _add_junctions(
    root: Element,
    roads: RoadMap,
    found: Mapping[str, MapRoad],
    touches: list[LaneJoint],
    direct: Mapping[tuple[str, str], str],
    ids: FileIds,
) -> None:
    for at in roads.junctions:
        if not any(road.junction == at.id for road in found.values()):
            continue
        junction = add(root, "junction", name=at.id, id=ids.junctions[at.id], type="default")
        entered: dict[tuple[str, str, str], list[tuple[int, int]]] = {}
        for touch in touches:
            (one, _, m), (other, _, n) = touch.one, touch.other
            if found[other].junction == at.id and found[one].junction != at.id:
                entered.setdefault((one, other, touch.enters), []).append((m, n))
        _add_connections(junction, entered, "connectingRoad", ids)
        pairs = {(_key(low)[0], _key(high)[0]) for low, high in at.yields}
        for low, high in sorted(pairs):
            add(junction, "priority", high=ids.roads[high], low=ids.roads[low])
    for name in dict.fromkeys(direct.values()):
        junction = add(root, "junction", name=name, id=ids.junctions[name], type="direct")
        parted: dict[tuple[str, str, str], list[tuple[int, int]]] = {}
        for touch in touches:
            ends = (touch.one[0], touch.leaves), (touch.other[0], touch.enters)
            if not _is_within(touch) and all(direct.get(end) == name for end in ends):
                parted.setdefault((touch.one[0], touch.other[0], touch.enters), []).append(
                    (touch.one[2], touch.other[2])
                )
        _add_connections(junction, parted, "linkedRoad", ids)


def _add_connections(
    junction: Element, entered: Mapping[tuple[str, str, str], list[tuple[int, int]]], key: str, ids: FileIds
) -> None:
    for count, ((one, other, contact), lanes) in enumerate(entered.items()):
        connection = add(junction, "connection", id=str(count), incomingRoad=ids.roads[one], contactPoint=contact)
        connection.set(key, ids.roads[other])
        for m, n in lanes:
            add(connection, "laneLink", **{"from": str(m), "to": str(n)})


# -- form


def _add_piece(view: Element, piece: PlanPiece, s: float) -> None:
    place = {"x": piece.x_m, "y": piece.y_m, "hdg": piece.heading_rad, "length": piece.length_m}
    geometry = add(view, "geometry", s=s, **place)
    if piece.u is not None and piece.v is not None:
        scale = piece.parameter_end ** np.arange(4)
        named = {f"{letter}U": float(u) for letter, u in zip("abcd", piece.u * scale, strict=True)}
        named |= {f"{letter}V": float(v) for letter, v in zip("abcd", piece.v * scale, strict=True)}
        add(geometry, "paramPoly3", **named, pRange="normalized")
    elif piece.curvature != piece.curvature_end:
        add(geometry, "spiral", curvStart=piece.curvature, curvEnd=piece.curvature_end)
    elif piece.curvature:
        add(geometry, "arc", curvature=piece.curvature)
    else:
        add(geometry, "line")


def _add_heights(element: Element, road: MapRoad, own: Road) -> Callable[[float, float, float], float] | None:
    """The heights and the rolls of a road; returns the share of widths on its plane that are seen from above, by
    station, None where it is level across."""
    profile, lateral = add(element, "elevationProfile"), add(element, "lateralProfile")
    if road.heights:
        _add_cubics(profile, "elevation", road.heights)
        given = steepened(road.banks, road.heights, road.length_m, -1)
        _add_cubics(lateral, "superelevation", given)
        for shape in road.shapes:
            add(lateral, "shape", s=shape.s_m, t=shape.t_m, a=shape.a, b=shape.b, c=shape.c, d=shape.d)
        return partial(_share, given) if given else None
    s = np.linspace(0, road.length_m, max(4, 1 + int(road.length_m / STEP_M)))
    low, high = own.left(s), own.right(s)
    high = np.maximum(high, low + 0.5)
    share = np.linspace(0, 1, SHAPE_PLACES)
    t = low + (high - low) * share[:, None]
    z = np.array([own.base_points(s, at)[:, 2] for at in t])
    mean_t, mean_z = t.mean(axis=0), z.mean(axis=0)
    fall = ((t - mean_t) * (z - mean_z)).sum(axis=0) / ((t - mean_t) ** 2).sum(axis=0)
    # Here t grows to the right, in OpenDRIVE to the left; rolls are positive with the left side higher.
    heights = tuple(_polynomials(s, mean_z - fall * mean_t, HEIGHT_M))
    # They turn a plane that climbs already, which is steeper across than it looks from above.
    level = 1 / np.hypot(1.0, np.gradient(mean_z - fall * mean_t, s))
    banks = tuple(_polynomials(s, -np.arctan(fall * level), ROLL_RAD))
    _add_cubics(profile, "elevation", heights)
    _add_cubics(lateral, "superelevation", banks)
    flat = np.cos(np.arctan(fall * level))
    over = (z - mean_z - fall * (t - mean_t)).T * flat[:, None]
    if np.abs(over).max() > SHAPE_M:
        left, wide = -high / flat, (high - low) / flat
        for i in knots(s, over, SHAPE_M):
            rows = np.vander(wide[i] * share, 4, increasing=True)
            abcd = np.linalg.lstsq(rows, over[i, ::-1], rcond=None)[0].tolist()
            add(lateral, "shape", s=s[i], t=left[i], **dict(zip("abcd", abcd, strict=True)))
    return partial(_share, banks)


def _share(banks: tuple[Polynomial, ...], from_m: float, x_m: float, end_m: float) -> float:
    """By stations of a section that begins at `from_m`, up to one where it ends."""
    return 1 / math.cos(value(banks, from_m + x_m, from_m + end_m))


def _polynomials(s: Scalars, values: Scalars, tolerance: float) -> Iterable[Polynomial]:
    for piece in pieces(s, values[:, None], tolerance):
        a, b, c, d = piece.abcd[:, 0].tolist()
        yield Polynomial(s_m=piece.s, a=a, b=b, c=c, d=d)


def _add_cubics(parent: Element, tag: str, cubics: Iterable[Polynomial], key: str = "s") -> None:
    for piece in cubics:
        add(parent, tag, **{key: piece.s_m}, a=piece.a, b=piece.b, c=piece.c, d=piece.d)


# -- lanes


def _add_lanes(
    element: Element, road: MapRoad, touches: list[LaneJoint], roll: Callable[[float, float, float], float] | None
) -> None:
    offsets = times(road.lane_offsets, partial(roll, 0.0), road.length_m) if roll else road.lane_offsets
    _add_cubics(element, "laneOffset", offsets or [Polynomial(s_m=0.0, a=0.0)])
    ends = [section.s_m for section in road.sections[1:]] + [road.length_m]
    for i, (section, end_m) in enumerate(zip(road.sections, ends, strict=True)):
        part = add(element, "laneSection", s=section.s_m)
        for side, sign in SIDES.items():
            lanes = [lane for lane in section.lanes if np.sign(lane.number) == sign]
            lanes = lanes or ([MapLane(number=0, kind="none")] if sign == 0 else [])
            group = add(part, side) if lanes else part
            for lane in sorted(lanes, key=lambda at: -at.number):
                widths = lane.widths
                if roll and widths and not lane.level:
                    widths = times(widths, partial(roll, section.s_m), end_m - section.s_m)
                _add_lane(group, road, i, lane.model_copy(update={"widths": widths}), touches)


def _add_lane(group: Element, road: MapRoad, i: int, lane: MapLane, touches: list[LaneJoint]) -> None:
    element = add(group, "lane", id=str(lane.number), type=KINDS[lane.kind], level=str(lane.level).lower())
    if lane.against:
        element.set("direction", "reversed")
    link = add(element, "link")
    if lane.kind == "driving" and lane.number:
        for tag, end in (("predecessor", "start"), ("successor", "end")):
            for _, number in dict.fromkeys(_linked(road.id, i, lane.number, end, touches)):
                add(link, tag, id=str(number))
    if lane.number:
        _add_cubics(element, "width", lane.widths or [Polynomial(s_m=0.0, a=0.0)], "sOffset")
    for mark in lane.marks:
        _add_mark(element, mark)
    if lane.kind == "driving" and lane.number:
        add(element, "userData", code=USER_DATA, value=f"{road.id}.{i}.{lane.number}")


def _add_mark(element: Element, mark: MapMark) -> None:
    width_m = 3 * mark.width_m if "_" in mark.kind else mark.width_m
    color = "yellow" if mark.yellow else "white"
    add(element, "roadMark", sOffset=mark.s_m, type=MARKS[mark.kind], weight="standard", color=color, width=width_m)


def _add_paint(elements: Mapping[str, Element], roads: RoadMap, found: Mapping[str, MapRoad], network: Network) -> None:
    """The paint in the lanes of roads, crosswalks at the roads beside them; islands are at the first road, in its
    frame."""
    groups = {name: Element("objects") for name in elements}
    all_roads = [network.road(name) for name in elements]
    lines = [line_of(road) for road in all_roads]
    first, start = groups[next(iter(found))], next(iter(found.values())).plan[0]
    for count, paint in enumerate(roads.paint):
        if paint.lane is not None and _key(paint.lane)[0] in found:
            name, i, number = _key(paint.lane)
            road = found[name]
            inner, outer = next(edges for lane, *edges in edges_at(road, i, paint.s_m) if lane.number == number)
            kind = {"stop_line": "StopLine", "give_way_line": "YieldLine"}.get(paint.kind)
            place = {"s": paint.s_m, "t": (inner + outer) / 2, "zOffset": 0.0, "hdg": 0.0}
            ascends = _ascends(road, i, number)
            words = {"id": str(count), "name": kind or paint.kind.replace("_", " "), "type": "roadMark"}
            size = {"width": abs(outer - inner), "length": 0.4} if kind else {"width": 0.5, "length": 4.0}
            at = add(groups[name], "object", **words, **place, **size, orientation="+" if ascends else "-")
            if kind:
                add(at, "validity", fromLane=str(number), toLane=str(number))
        elif paint.lane is None and paint.outline:
            corners = np.array(paint.outline)
            middle, start_xy = corners.mean(axis=0), np.array([start.x_m, start.y_m])
            at_start = start_xy, RoadPlace(next(iter(found)), 0.0, 0.0, start.heading_rad)
            beside = [(middle, place) for place in places_beside(middle, all_roads, lines)]
            origin, where = min(beside, key=lambda pair: abs(pair[1].t), default=at_start)
            along = np.array([math.cos(where.heading_rad), math.sin(where.heading_rad)])
            local = (corners - origin) @ np.stack([along, [-along[1], along[0]], [0.0, 0.0]], axis=1)
            add_crosswalk(groups[where.road], count, local, where.s, where.t, name=paint.kind)
    for count, island in enumerate(roads.islands, start=len(roads.paint)):
        words = {"id": str(count), "name": "island", "type": "trafficIsland", "orientation": "none"}
        at = add(first, "object", **words, s=0.0, t=0.0, zOffset=0.0, hdg=0.0, height=island.height_m)
        _add_outline(at, start, island.outline)
    for name, group in groups.items():
        if len(group):
            elements[name].append(group)


def _add_outline(element: Element, start: PlanPiece, corners: Iterable[tuple[float, float]]) -> None:
    outline = add(add(element, "outlines"), "outline", id="0", closed="true")
    cos, sin = math.cos(start.heading_rad), math.sin(start.heading_rad)
    for count, (x, y) in enumerate(corners):
        dx, dy = x - start.x_m, y - start.y_m
        local = {"u": cos * dx + sin * dy, "v": cos * dy - sin * dx, "z": 0.0, "height": 0.0}
        add(outline, "cornerLocal", id=str(count), **local)
