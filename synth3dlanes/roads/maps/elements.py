"""Signals, signs, buildings and trees of a given map that have a counterpart here, in the frame of the map."""

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal, NamedTuple, get_args
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.document import number, passing_over
from synth3dlanes.roads.maps.furniture import driving_at, is_facing, is_paint, object_outline, valid_lanes
from synth3dlanes.roads.maps.plan import places
from synth3dlanes.scene.road_map import LaneName, MapRoad
from synth3dlanes.scene.traffic_elements import MAX_LANES, LensForm, Phase, SignKind, TrafficSign, TrafficSignal
from synth3dlanes.system.schema import Name

# A light with three lenses; one whose lenses are arrows, by its subtype (ASAM's catalogue of signals).
LIGHT, ARROW_LIGHT = "1000001", "1000011"
ARROW_FORMS: dict[str, LensForm] = {"": "ball", "-1": "ball", "10": "left", "20": "right", "30": "straight"}
# Signs by their German numbers, which files of other countries use too, and by those of the United States.
GERMAN_SIGNS: dict[str, SignKind] = {
    "205": "give_way",
    "206": "stop",
    "267": "no_entry",
    "272": "no_u_turn",
    "306": "priority",
    "209-10": "left_only",
    "209-20": "right_only",
    "209-30": "ahead_only",
}
SIGNS: dict[str, SignKind] = {
    **GERMAN_SIGNS,
    "R1-1": "stop",
    "R1-2": "give_way",
    "R5-1": "no_entry",
    "R3-1": "no_right_turn",
    "R3-2": "no_left_turn",
    "R3-4": "no_u_turn",
}
# Signs of speed limits, and limits by the subtypes of the German ones where a file has no value.
SPEED_SIGNS, SPEED_SUBTYPES = ("274", "274.1", "R2-1"), {str(50 + n): 10 * n for n in range(1, 14)}
SPEEDS: dict[int, SignKind] = {
    int(kind.removeprefix("speed_")): kind for kind in get_args(SignKind) if kind.startswith("speed_")
}
# An object that is a sign of a speed limit without a size, as CARLA's towns have them.
SPEED_OBJECT = re.compile(r"speed_?(?:limit)?_?(\d+)(?:assembly)?", re.IGNORECASE)
# Lower edges of heads and boards: between these as told; else as usual beside the road and over it.
LOW_M, HIGH_M = 1.0, 12.0
HEAD_M, OVERHEAD_M, SIGN_M, FREE_M = 2.3, 5.2, 2.1, 4.5
# Some files have turns against the road in degrees: larger ones than this are left out.
MOST_TURN = 2 * math.pi
TREES, BUILDINGS, NO_TYPES = ("tree", "vegetation"), ("building",), ("", "-1", "none")
# Barriers are rails if they are this long at least, and at most this wide, this far from parallel to the road and this
# far beside its line; their heights.
BARRIERS, SOLID_WORDS = ("barrier", "guardrail", "railing"), ("concrete", "jersey", "wall")
LEAST_RAIL_M, MOST_RAIL_M, MOST_ASLANT_M, MOST_ASIDE_M, RAIL_HEIGHTS_M = 4.0, 1.5, 0.5, 100.0, (0.6, 1.2)
LEAST_BUILDING_M, MOST_BUILDING_M, LEAST_HEIGHT_M, MOST_HEIGHT_M = 1.0, 300.0, 0.5, 200.0


class GivenElement(NamedTuple):
    """A signal or sign of a file. The signals of a `group` show the same; at a `junction` only one group is green."""

    element: TrafficSignal | TrafficSign
    junction: str = ""
    group: str = ""


class GivenBody(NamedTuple):
    """A building or a tree of a file: its middle, the heading of its length, and length, width and height (of a tree
    the last one alone)."""

    kind: Literal["building", "tree"]
    x_m: float
    y_m: float
    heading_rad: float
    size_m: tuple[float, float, float]


class GivenRail(NamedTuple):
    """A barrier of a file along a road between two stations: the t of its middle, and its height."""

    kind: Literal["guardrail", "concrete"]
    road: Name
    from_m: float
    to_m: float
    t_m: float
    height_m: float


class GovernedLane(NamedTuple):
    """A lane that a signal governs, and the heading of its traffic there."""

    name: LaneName
    heading_rad: float


class FileRoad(NamedTuple):
    """A road as it is in a file, as ours, its objects that are no paint, and where problems are."""

    element: Element
    road: MapRoad
    objects: tuple[Element, ...]
    where: str


def read_elements(
    roads: Sequence[FileRoad], controllers: Mapping[str, str], left_out: Counter[str]
) -> tuple[GivenElement, ...]:
    """The signals and signs of a file. `signalReference`s of other roads say what else a signal governs; `controllers`
    are those of signals, by their ids."""
    also: dict[str, list[GovernedLane]] = {}
    for at in roads:
        for item in at.element.iterfind("signals/signalReference"):
            with passing_over(item, left_out):
                also.setdefault(item.get("id", ""), []).extend(_governed(item, at.road, at.where))
    junctions = {lane: name for at in roads for lane, name in _junctions(at)}
    found = list[GivenElement]()
    for at in roads:
        for item in at.element.iterfind("signals/signal"):
            with passing_over(item, left_out):
                if is_paint(item):
                    continue
                name = item.get("id", "")
                read = _element(item, at.road, [*_governed(item, at.road, at.where), *also.get(name, ())], at.where)
                if read is None:
                    left_out[f"signals of type {item.get('type', 'none')}"] += 1
                elif isinstance(read, TrafficSign):
                    found.append(GivenElement(read))
                else:
                    junction = next((junctions[lane] for lane in read.lanes if lane in junctions), "")
                    axis = f"axis {round(read.yaw_rad / (math.pi / 4)) % 4}" if junction else f"alone {len(found)}"
                    found.append(GivenElement(read, junction, controllers.get(name, axis)))
        for item in at.objects:
            limit = _speed_of_object(item)
            if limit is not None:
                with passing_over(item, left_out):
                    governed = _governed(item, at.road, at.where)
                    found.append(GivenElement(_sign(limit, item, at.road, governed, at.where)))
    return tuple(found)


def _speed_of_object(item: Element) -> SignKind | None:
    """What an object shows whose name says that it is the sign of a speed limit that we have."""
    told = SPEED_OBJECT.fullmatch(item.get("name", ""))
    return SPEEDS.get(int(told[1])) if told else None


def read_rails(at: FileRoad) -> Iterator[GivenRail]:
    """The barriers of a road that lead along it."""
    for item in at.objects:
        # Counted by `read_bodies`.
        with passing_over(item, Counter()):
            yield from _rails(item, at)


def _rails(item: Element, at: FileRoad) -> Iterator[GivenRail]:
    """An object of type barrier, guardRail or railing: along its repeats, or as long as it is."""
    words = f"{item.get('type', '')} {item.get('subtype', '')} {item.get('name', '')}".lower()
    if item.get("type", "").lower() not in BARRIERS:
        return
    kind: Literal["guardrail", "concrete"] = "concrete" if any(word in words for word in SOLID_WORDS) else "guardrail"
    repeats = item.findall("repeat")
    for place in repeats or [item]:
        s, length_m = number(place, "s", at.where, 0.0), number(place, "length", at.where, 0.0)
        t = [number(place, key, at.where, number(item, "t", at.where, 0.0)) for key in ("tStart", "tEnd")]
        width_m = max(number(place, key, at.where, 0.0) for key in ("width", "widthStart", "widthEnd"))
        height_m = max(number(one, key, at.where, 0.0) for one in (item, place) for key in ("height", "heightStart"))
        from_m, to_m = max(s, 0.0), min(s + length_m, at.road.length_m)
        is_along = abs(t[1] - t[0]) <= MOST_ASLANT_M and width_m <= MOST_RAIL_M
        is_beside = max(map(abs, t)) <= MOST_ASIDE_M
        if is_along and is_beside and to_m - from_m >= LEAST_RAIL_M:
            height_m = min(max(height_m, RAIL_HEIGHTS_M[0]), RAIL_HEIGHTS_M[1])
            yield GivenRail(kind, at.road.id, from_m, to_m, (t[0] + t[1]) / 2, height_m)


def read_bodies(at: FileRoad, left_out: Counter[str]) -> Iterator[GivenBody]:
    """The buildings and trees of a road; `left_out` counts the other objects that are no signs."""
    for item in at.objects:
        with passing_over(item, left_out):
            kind, height_m = item.get("type", "none"), _height(item, at.where)
            if kind.lower() in TREES and height_m >= LEAST_HEIGHT_M:
                x, y, heading = _place(item, at.road, at.where)
                yield GivenBody("tree", x, y, heading, (0.0, 0.0, height_m))
            elif (building := _building(item, at, height_m)) is not None:
                yield building
            elif _speed_of_object(item) is None and next(_rails(item, at), None) is None:
                left_out[f"objects of type {kind if kind not in NO_TYPES else item.get('name', kind)}"] += 1


def _building(item: Element, at: FileRoad, height_m: float) -> GivenBody | None:
    """A building: the smallest rectangle round its outline."""
    if item.get("type") not in BUILDINGS or height_m < LEAST_HEIGHT_M:
        return None
    corners = object_outline(item, at.road, at.where)
    box = shapely.get_coordinates(shapely.minimum_rotated_rectangle(shapely.multipoints(np.reshape(corners, (-1, 2)))))
    sides = np.diff(box[:3], axis=0)
    sizes_m = np.hypot(*sides.T).tolist()
    if len(box) < 5 or not LEAST_BUILDING_M <= min(sizes_m) <= max(sizes_m) <= MOST_BUILDING_M:
        return None
    x, y = box[:4].mean(axis=0).tolist()
    return GivenBody("building", x, y, math.atan2(*sides[1][::-1]), (sizes_m[1], sizes_m[0], height_m))


def _height(item: Element, where: str) -> float:
    """The height of an object: its own, or that of its corners."""
    corners = [corner for tag in ("cornerRoad", "cornerLocal") for corner in item.iter(tag)]
    return min(max(number(at, "height", where, 0.0) for at in (item, *corners)), MOST_HEIGHT_M)


def _governed(item: Element, road: MapRoad, where: str) -> list[GovernedLane]:
    """The lanes that a signal, or a reference to one, says that it is valid for; else those that it faces."""
    s, lanes = driving_at(item, road, where)
    valid = valid_lanes(item, where)
    heading = float(plan_points(road.plan, np.array([s]))[0, 2])
    return [
        GovernedLane(name, heading if lane.ascends(road.keeps_left) else heading + math.pi)
        for name, lane, low, high in lanes
        if high > low and (lane.number in valid if valid is not None else is_facing(item, lane, road))
    ]


def _junctions(at: FileRoad) -> Iterator[tuple[LaneName, str]]:
    """The junction that each lane of a road is in or leads to."""
    road, inside = at.road, at.element.get("junction", "-1")
    for i, section in enumerate(road.sections):
        for lane in section.lanes:
            is_up = lane.ascends(road.keeps_left)
            after = at.element.find(f"link/{'successor' if is_up else 'predecessor'}")
            if inside not in NO_TYPES:
                yield f"{road.id}.{i}.{lane.number}", inside
            elif after is not None and after.get("elementType") == "junction":
                yield f"{road.id}.{i}.{lane.number}", after.get("elementId", "")


def _element(item: Element, road: MapRoad, lanes: list[GovernedLane], where: str) -> TrafficSignal | TrafficSign | None:
    """A signal of a file as one of ours; None if there is no such."""
    kind, subtype = item.get("type", "").strip(), item.get("subtype", "").strip()
    form = "ball" if kind == LIGHT else ARROW_FORMS.get(subtype) if kind == ARROW_LIGHT else None
    if form is not None:
        place = _mounting(item, road, lanes, HEAD_M, where)
        return TrafficSignal.model_validate(place | {"phases": (Phase(state="off"),), "form": form})
    sign: SignKind | None = SIGNS.get(kind) or SIGNS.get(f"{kind}-{subtype}")
    if kind in SPEED_SIGNS:
        value = number(item, "value", where, 0.0)
        limit = int(value) if value > 0 else SPEED_SUBTYPES.get(subtype, 0)
        sign = SPEEDS.get(limit)
    return None if sign is None else _sign(sign, item, road, lanes, where)


def _sign(kind: SignKind, item: Element, road: MapRoad, lanes: list[GovernedLane], where: str) -> TrafficSign:
    return TrafficSign.model_validate(_mounting(item, road, lanes, SIGN_M, where) | {"kind": kind})


def _mounting(item: Element, road: MapRoad, lanes: list[GovernedLane], usual_m: float, where: str) -> dict[str, object]:
    """Place, direction, height and lanes. The direction is the file's, and of both that along which its traffic
    drives: files differ in which of these they tell."""
    x, y, heading = _place(item, road, where)
    if lanes:
        drives = math.atan2(*(sum(f(lane.heading_rad) for lane in lanes) for f in (math.sin, math.cos)))
        if math.cos(heading - drives) < 0:
            heading += math.pi
    elif item.get("orientation", "+") == "-":
        heading += math.pi
    t = number(item, "t", where, 0.0)
    is_over = any(low < t < high for _, _, low, high in driving_at(item, road, where)[1])
    height_m = number(item, "zOffset", where, 0.0)
    if not LOW_M <= height_m <= HIGH_M:
        height_m = usual_m
    if is_over and height_m < FREE_M:
        height_m = OVERHEAD_M
    named = tuple(dict.fromkeys(lane.name for lane in lanes))[:MAX_LANES]
    yaw_rad = math.remainder(heading - math.pi / 2, 2 * math.pi)
    return {"x_m": x, "y_m": y, "yaw_rad": yaw_rad, "height_m": height_m, "lanes": named}


def _place(item: Element, road: MapRoad, where: str) -> tuple[float, float, float]:
    """Where an object or a signal is, and its heading."""
    s, t = number(item, "s", where, 0.0), number(item, "t", where, 0.0)
    turn = number(item, "hOffset" if item.tag == "signal" else "hdg", where, 0.0)
    ((x, y),) = places(road.plan, np.array([s]), np.array([t]))
    heading = float(plan_points(road.plan, np.array([s]))[0, 2])
    return float(x), float(y), heading + (turn if abs(turn) <= MOST_TURN else 0.0)
