"""Write a world's roads as an OpenDRIVE file."""

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.opendrive.convention import MAJOR, MARK_TYPES, MINOR, NO_NUMBER, USER_DATA
from synth3dlanes.formats.opendrive.marks import Mark, marks
from synth3dlanes.formats.opendrive.objects import add_objects
from synth3dlanes.formats.opendrive.profiles import knots, pieces
from synth3dlanes.formats.opendrive.roads import JUNCTION, Lane, Road, roads, stems
from synth3dlanes.world import World

Values = Float[np.ndarray, " m"]
Element = ElementTree.Element

# How far the written reference line, heights and widths (metres) and rolls (radians) may be from the world's.
LINE_M, HEIGHT_M, WIDTH_M, ROLL_RAD = 1e-3, 1e-3, 1e-3, 1e-4
# A road gets lateral shapes if its surface is farther than this from the banked plane, fitted at this many places across
# and to about this error.
SHAPE_M, SHAPE_PLACES = 0.005, 9


def opendrive(world: World, name: str) -> str:
    """The OpenDRIVE file of a world; its inertial frame is the world frame."""
    found = roads(world.plan)
    numbers = {road.name: i for i, road in enumerate(found, 1)} | {JUNCTION: len(found) + 1}
    root = ElementTree.Element("OpenDRIVE")
    xy = np.concatenate([road.xy_world for road in found])
    (west, south), (east, north) = xy.min(axis=0), xy.max(axis=0)
    header = {"revMajor": MAJOR, "revMinor": MINOR, "name": name, "version": "1.00", "vendor": "synth3dlanes"}
    _add(root, "header", **header, north=north, south=south, east=east, west=west)
    elements = [_add_road(root, world, road, found, numbers) for road in found]
    add_objects(world, found, elements)
    if any(road.in_junction for road in found):
        _add_junction(root, world, found, numbers)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _add(parent: Element, tag: str, **attributes: str | float) -> Element:
    """A new child; numbers are written to a micrometre or better."""
    texts = {key: value if isinstance(value, str) else number(value) for key, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, texts)


def _add_road(root: Element, world: World, road: Road, found: list[Road], numbers: Mapping[str, int]) -> Element:
    by_name = {other.name: other for other in found}
    length = float(road.s_m[-1])
    of = {"junction": str(numbers[JUNCTION]) if road.in_junction else NO_NUMBER}
    rule = "LHT" if road.is_left_hand else "RHT"
    element = _add(root, "road", name=road.name, length=length, id=str(numbers[road.name]), **of, rule=rule)
    link = _add(element, "link")
    for tag, other, contact in (("predecessor", road.before, "end"), ("successor", road.after, "start")):
        if other == JUNCTION:
            _add(link, tag, elementType="junction", elementId=str(numbers[JUNCTION]))
        elif other:
            _add(link, tag, elementType="road", elementId=str(numbers[other]), contactPoint=contact)
    _add_line(element, road)
    profile = _add(element, "elevationProfile")
    for piece in pieces(road.s_m, road.elevation_m[:, None], HEIGHT_M):
        _add(profile, "elevation", s=piece.s, **_abcd(piece.abcd[:, 0]))
    lateral = _add(element, "lateralProfile")
    for piece in pieces(road.s_m, road.roll_rad[:, None], ROLL_RAD):
        _add(lateral, "superelevation", s=piece.s, **_abcd(piece.abcd[:, 0]))
    _add_shapes(lateral, road)
    lanes = _add(element, "lanes")
    for piece in pieces(road.s_m, road.center_m[:, None], WIDTH_M):
        _add(lanes, "laneOffset", s=piece.s, **_abcd(piece.abcd[:, 0]))
    section = _add(lanes, "laneSection", s=0.0)
    found_marks = marks(world, road)
    sides = {"left": 1, "center": 0, "right": -1}
    for tag, side in sides.items():
        on_side = [lane for lane in road.lanes if np.sign(lane.number) == side]
        if side == 0:
            center = _add(_add(section, tag), "lane", id="0", type="none", level="false")
            _add_marks(center, road, found_marks[0])
        elif on_side:
            group = _add(section, tag)
            for lane in on_side:
                _add_lane(group, road, lane, _linked(world, road, lane, by_name), found_marks[lane.number])
    return element


def _add_line(element: Element, road: Road) -> None:
    view = _add(element, "planView")
    for piece in pieces(road.s_m, road.xy_world, LINE_M, unit_speed=True):
        (x, y), (dx, dy) = piece.abcd[0], piece.abcd[1]
        heading = float(np.arctan2(dy, dx))
        to_local = np.array([[dx, -dy], [dy, dx]])
        (_, _, c_u, d_u), (_, _, c_v, d_v) = (piece.abcd @ to_local).T
        length = piece.end - piece.s
        geometry = _add(view, "geometry", s=piece.s, x=x, y=y, hdg=heading, length=length)
        u = {"aU": 0.0, "bU": 1.0, "cU": c_u, "dU": d_u}
        v = {"aV": 0.0, "bV": 0.0, "cV": c_v, "dV": d_v}
        _add(geometry, "paramPoly3", **u, **v, pRange="arcLength")


def _add_shapes(lateral: Element, road: Road) -> None:
    edges = [t for lane in road.lanes for t in (lane.inner_m, lane.outer_m)]
    low, high = np.min(edges, axis=0), np.max(edges, axis=0)
    shares = np.linspace(0, 1, SHAPE_PLACES)
    over = np.column_stack([road.over_plane(low + (high - low) * share) for share in shares])
    if np.abs(over).max() <= SHAPE_M:
        return
    for i in knots(road.s_m, over, SHAPE_M):
        abcd = np.polynomial.polynomial.polyfit((high[i] - low[i]) * shares, over[i], 3)
        _add(lateral, "shape", s=road.s_m[i], t=low[i], **_abcd(abcd))


def _add_lane(group: Element, road: Road, lane: Lane, ends: tuple[int | None, int | None], found: list[Mark]) -> None:
    element = _add(group, "lane", id=str(lane.number), type=lane.kind, level="false")
    link = _add(element, "link")
    for tag, number_there in zip(("predecessor", "successor"), ends, strict=True):
        if number_there is not None:
            _add(link, tag, id=str(number_there))
    width = np.abs(lane.outer_m - lane.inner_m)
    for piece in pieces(road.s_m, width[:, None], WIDTH_M):
        _add(element, "width", sOffset=piece.s, **_abcd(piece.abcd[:, 0]))
    _add_marks(element, road, found)
    if lane.segment:
        _add(element, "userData", code=USER_DATA, value=lane.segment)


def _add_marks(element: Element, road: Road, found: list[Mark]) -> None:
    for mark in found:
        kind = MARK_TYPES[mark.kind]
        change = "both" if kind in ("broken", "botts dots") else "none"
        common = {"sOffset": mark.s_m, "type": kind, "weight": "standard", "color": mark.color}
        if mark.kind == "none":
            _add(element, "roadMark", **common, laneChange="both" if element.get("type") == "driving" else "none")
            continue
        total_m = 3 * mark.width_m if mark.kind == "double" else mark.width_m
        entry = _add(element, "roadMark", **common, width=total_m, laneChange=change)
        lines = _add(entry, "type", name=kind, width=total_m)
        for aside_m in (-mark.width_m, mark.width_m) if mark.kind == "double" else (0.0,):
            sizes = {"length": mark.dash_m, "space": mark.gap_m, "tOffset": aside_m, "sOffset": mark.first_m}
            _add(lines, "line", **sizes, width=mark.width_m, color=mark.color)


def _linked(
    world: World, road: Road, lane: Lane, by_name: Mapping[str, Road]
) -> tuple[int | None, int | None]:
    """The numbers of the lanes before and behind a lane of a connecting road."""
    if not road.in_junction:
        return None, None
    return tuple(_number_in(by_name[str(end)], world, lane) for end in (road.before, road.after))  # type: ignore[return-value]


def _number_in(other: Road, world: World, lane: Lane) -> int | None:
    """The number that a connecting road's lane has in the road at its end."""
    if lane.segment is None:
        outer = [there.number for there in other.lanes if there.kind == lane.kind and there.number * lane.number > 0]
        return outer[0] if outer else None
    name = stems(world.plan).get(lane.segment, lane.segment) if other.name == "stem" else lane.segment
    return next(there.number for there in other.lanes if there.segment == name)


def _add_junction(root: Element, world: World, found: list[Road], numbers: Mapping[str, int]) -> None:
    by_name = {road.name: road for road in found}
    junction = _add(root, "junction", name=JUNCTION, id=str(numbers[JUNCTION]), type="default")
    count = 0
    for road in found:
        if not road.in_junction:
            continue
        for incoming, contact, is_ahead in ((road.before, "start", True), (road.after, "end", False)):
            lanes = [lane for lane in road.driving if (lane.number > 0) == (is_ahead == road.is_left_hand)]
            if not lanes:
                continue
            ids = {"incomingRoad": str(numbers[str(incoming)]), "connectingRoad": str(numbers[road.name])}
            entry = _add(junction, "connection", id=str(count), **ids, contactPoint=contact)
            count += 1
            for lane in lanes:
                there = _number_in(by_name[str(incoming)], world, lane)
                _add(entry, "laneLink", **{"from": str(there), "to": str(lane.number)})


def _abcd(coefficients: Float[np.ndarray, "4"]) -> dict[str, float]:
    return dict(zip("abcd", coefficients.tolist(), strict=True))


def number(value: float) -> str:
    """A number with ten digits; small ones, which are noise, as 0."""
    return f"{value + 0.0:.10g}" if abs(value) > 1e-12 else "0"
