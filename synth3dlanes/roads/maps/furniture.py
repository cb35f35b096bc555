"""Objects and signals of a given map that have a counterpart here: paint across and in lanes, crosswalks, islands."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.cubics import value
from synth3dlanes.roads.maps.document import number, passing_over
from synth3dlanes.roads.maps.plan import places
from synth3dlanes.scene.road_map import MAX_LANES, MapIsland, MapLane, MapPaint, MapRoad
from synth3dlanes.system.arrays import Points2
from synth3dlanes.system.schema import SymbolKind

# What the name, type or subtype of an object says, in small letters without other characters.
STOP_WORDS, YIELD_WORDS = ("stopline", "signallines"), ("yieldline", "givewayline", "waitingline")
ARROWS: dict[str, SymbolKind] = {
    "arrowstraightleft": "arrow_straight_left",
    "arrowstraightright": "arrow_straight_right",
    "arrowleft": "arrow_left",
    "arrowright": "arrow_right",
    # Names that RoadRunner writes.
    "arrowtype4l": "arrow_left",
    "arrowtype4r": "arrow_right",
    "arrowstraight": "arrow_straight",
}
# German signs of paint: 294 is a stop line, 341 a give-way line, 297 an arrow by its subtype.
STOP_SIGNAL, YIELD_SIGNAL, ARROW_SIGNAL = "294", "341", "297"
ARROW_SUBTYPES: dict[str, SymbolKind] = {
    "10": "arrow_left",
    "20": "arrow_right",
    "30": "arrow_straight",
    "40": "arrow_straight_left",
    "50": "arrow_straight_right",
}
ISLAND_M, MAX_ISLAND_M, MAX_CORNERS = 0.12, 1.0, 1000
# Greatest distance of things in files beyond an end of their road.
BEYOND_M = 1.0
# Ratio of its sides from which a crosswalk is crossed along the longer ones.
OBLONG = 1.2


@dataclass(frozen=True)
class Furniture:
    """What a road's objects and signals add to the map, and its objects that are neither paint nor islands."""

    paint: tuple[MapPaint, ...]
    islands: tuple[MapIsland, ...]
    others: tuple[Element, ...]


def read_furniture(element: Element, road: MapRoad, where: str, left_out: Counter[str]) -> Furniture:
    """The paint and the islands among the objects and signals of a road; `left_out` counts those without a shape."""
    paint, islands, others = list[MapPaint](), list[MapIsland](), list[Element]()
    for item in element.iterfind("objects/object"):
        with passing_over(item, left_out):
            kind = item.get("type", "none")
            words = "".join(c for c in f"{item.get('name', '')}{kind}{item.get('subtype', '')}".lower() if c.isalnum())
            arrow = next((found for word, found in ARROWS.items() if word in words), None)
            if "crosswalk" in words:
                outline = object_outline(item, road, where)
                if len(outline) == 4:
                    paint.append(MapPaint(kind="crosswalk", outline=_across(outline, item, road, where)))
                else:
                    left_out["crosswalks without four corners"] += 1
            elif any(word in words for word in (*STOP_WORDS, *YIELD_WORDS)):
                paint += _lines(
                    "give_way_line" if any(word in words for word in YIELD_WORDS) else "stop_line", item, road, where
                )
            elif arrow is not None:
                paint += [MapPaint(kind=arrow, lane=lane, s_m=s) for lane, s in _beneath(item, road, where)]
            elif kind == "trafficIsland":
                outline = object_outline(item, road, where)
                if 3 <= len(outline) <= MAX_CORNERS:
                    height_m = min(max(number(item, "height", where, ISLAND_M), 0.0), MAX_ISLAND_M)
                    islands.append(MapIsland(outline=outline, height_m=height_m))
                else:
                    left_out["islands without an outline"] += 1
            else:
                others.append(item)
    for signal in filter(is_paint, element.iterfind("signals/signal")):
        with passing_over(signal, left_out):
            kind = signal.get("type", "")
            if kind == ARROW_SIGNAL:
                arrow = ARROW_SUBTYPES[signal.get("subtype", "")]
                paint += [MapPaint(kind=arrow, lane=lane, s_m=s) for lane, s in _beneath(signal, road, where)]
            else:
                paint += _lines("stop_line" if kind == STOP_SIGNAL else "give_way_line", signal, road, where)
    return Furniture(tuple(paint), tuple(islands), tuple(others))


def drop_beyond(element: Element, length_m: float, where: str, left_out: Counter[str]) -> None:
    """Take the objects and signals out of a road that are told for stations beyond its ends, where it is not."""
    for group, tag in (("objects", "object"), ("signals", "signal"), ("signals", "signalReference")):
        for parent in element.iterfind(group):
            for item in parent.findall(tag):
                is_on = False
                with passing_over(item, left_out):
                    is_on = -BEYOND_M <= number(item, "s", where, 0.0) <= length_m + BEYOND_M
                    left_out[f"{tag}s beyond the ends of their roads"] += not is_on
                if not is_on:
                    parent.remove(item)


def is_paint(signal: Element) -> bool:
    """Whether a signal is paint."""
    kind = signal.get("type", "")
    return kind in (STOP_SIGNAL, YIELD_SIGNAL) or (kind == ARROW_SIGNAL and signal.get("subtype", "") in ARROW_SUBTYPES)


def section_index(road: MapRoad, s_m: float) -> int:
    """The number of the section at a station."""
    starts = [section.s_m for section in road.sections]
    return max(0, int(np.searchsorted(starts, s_m + 1e-9, side="right")) - 1)


def edges_at(
    road: MapRoad, section: int, s_m: float, end_m: float = math.inf
) -> Iterator[tuple[MapLane, float, float]]:
    """The lanes of a section by its number, with the t of their inner and outer edges at a station of the road. What
    begins at the end of the section, or at `end_m`, does not count."""
    (start_m, last_m), lanes = road.span_m(section), road.sections[section].lanes
    end_m = min(last_m, end_m)
    for sign in (1, -1):
        edge = value(road.lane_offsets, s_m, end_m)
        for lane in sorted((at for at in lanes if at.number * sign > 0), key=lambda at: abs(at.number)):
            outer = edge + sign * max(value(lane.widths, s_m - start_m, end_m - start_m), 0.0)
            yield lane, edge, outer
            edge = outer


LaneAcross = tuple[str, MapLane, float, float]


def driving_at(item: Element, road: MapRoad, where: str) -> tuple[float, list[LaneAcross]]:
    """The station of an object and the driving lanes there, with their names and the t of their edges."""
    s = min(max(number(item, "s", where, 0.0), 0.0), road.length_m)
    i = section_index(road, s)
    found = [
        (f"{road.id}.{i}.{lane.number}", lane, min(inner, outer), max(inner, outer))
        for lane, inner, outer in edges_at(road, i, s)
        if lane.kind == "driving"
    ]
    return s, found


def valid_lanes(item: Element, where: str) -> set[int] | None:
    """The numbers of the lanes that an object or a signal lists as valid; None if it lists none."""
    entries = item.findall("validity")
    if not entries:
        return None
    bounds = [sorted(int(number(entry, key, where, 0.0)) for key in ("fromLane", "toLane")) for entry in entries]
    return {n for low, high in bounds for n in range(max(low, -MAX_LANES), min(high, MAX_LANES) + 1)}


def is_facing(item: Element, lane: MapLane, road: MapRoad) -> bool:
    """Whether an object or a signal is for the direction of a lane's traffic, or for both."""
    facing = item.get("orientation", "none")
    return facing not in ("+", "-") or (facing == "+") == lane.ascends(road.keeps_left)


def _lines(kind: str, item: Element, road: MapRoad, where: str) -> Iterator[MapPaint]:
    """A line across lanes: those that the object lists as valid, or else those that it is wide enough to cross the
    middle of; of a mere point beside the road, all. Of lanes in both directions it is for those that it faces."""
    s, lanes = driving_at(item, road, where)
    valid, t = valid_lanes(item, where), number(item, "t", where, 0.0)
    half = max(number(item, "width", where, 0.0), number(item, "length", where, 0.0)) / 2

    def is_crossed(at: LaneAcross) -> bool:
        _, lane, low, high = at
        if valid is not None:
            return lane.number in valid
        return half <= 1.0 or abs((low + high) / 2 - t) <= half

    crossed = [at for at in lanes if at[3] > at[2] and is_crossed(at)]
    faced = [at for at in crossed if is_facing(item, at[1], road)]
    # Files of one direction's lines are told apart by where these lie: not all say the direction as the standard does.
    for name, *_ in faced or (crossed if half > 1.0 or valid is not None else ()):
        yield MapPaint.model_validate({"kind": kind, "lane": name, "s_m": s})


def _beneath(item: Element, road: MapRoad, where: str) -> Iterator[tuple[str, float]]:
    """The lane that an object lies on, and its station."""
    s, lanes = driving_at(item, road, where)
    t = number(item, "t", where, 0.0)
    for name, _, low, high in lanes:
        if low <= t <= high and high > low:
            yield name, s
            return


def object_outline(item: Element, road: MapRoad, where: str) -> tuple[tuple[float, float], ...]:
    """The corners of an object in the frame of the map: its outline, or the rectangle of its length and width."""
    s, t = number(item, "s", where, 0.0), number(item, "t", where, 0.0)
    on_road = list(item.iterfind(".//cornerRoad"))
    if on_road:
        at = np.array([[number(corner, key, where) for key in "st"] for corner in on_road])
        return _open(places(road.plan, at[:, 0], at[:, 1]))
    local = [[number(corner, key, where) for key in "uv"] for corner in item.iterfind(".//cornerLocal")]
    if not local:
        half = [number(item, key, where, 0.0) / 2 for key in ("length", "width")]
        if min(half) <= 0:
            return ()
        local = [[half[0] * a, half[1] * b] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    heading = float(plan_points(road.plan, np.array([s]))[0, 2]) + number(item, "hdg", where, 0.0)
    cos, sin = math.cos(heading), math.sin(heading)
    turned = np.array(local) @ np.array([[cos, sin], [-sin, cos]])
    return _open(places(road.plan, np.array([s]), np.array([t])) + turned)


def _open(corners: Points2) -> tuple[tuple[float, float], ...]:
    """The corners without a last one that repeats the first."""
    if len(corners) > 1 and np.allclose(corners[0], corners[-1], atol=1e-3):
        corners = corners[:-1]
    return tuple((float(x), float(y)) for x, y in corners)


def _across(
    outline: tuple[tuple[float, float], ...], item: Element, road: MapRoad, where: str
) -> tuple[tuple[float, float], ...]:
    """The corners of a crosswalk from the side on which its bars begin: its longer one, along which people walk, or of
    one that is nearly square the one most across the road."""
    corners = np.array(outline)
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*sides.T)
    first, second = lengths[0] + lengths[2], lengths[1] + lengths[3]
    if max(first, second) > OBLONG * min(first, second):
        begins = 0 if first > second else 1
    else:
        heading = float(plan_points(road.plan, np.array([number(item, "s", where, 0.0)]))[0, 2])
        along = np.abs(sides[:2] @ [math.cos(heading), math.sin(heading)]) / np.maximum(lengths[:2], 1e-9)
        begins = int(np.argmin(along))
    return outline[begins:] + outline[:begins]
