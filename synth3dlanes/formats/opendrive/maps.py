"""Scenes on maps as OpenDRIVE describes them: their roads near the host on the ground of the scene, with paint, islands
and signals."""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.opendrive.described import (
    SHAPE_PLACES,
    Described,
    Element,
    add,
    add_crosswalk,
    lane_ascends,
    lane_key,
    shapes,
)
from synth3dlanes.roads.maps.cubics import steepened, times, value
from synth3dlanes.roads.maps.elements import ARROW_LIGHT, LIGHT
from synth3dlanes.roads.maps.furniture import edges_at
from synth3dlanes.roads.maps.profiles import cubics
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene.road_map import MapRoad, PlanPiece, RoadMap
from synth3dlanes.scene.traffic_elements import LensForm, SignKind, TrafficSign, TrafficSignal
from synth3dlanes.system.arrays import Points2
from synth3dlanes.world.world import World

# Types and subtypes by ASAM's catalogue of signals and the German signs; the value of a speed limit is its own.
NONE = "-1"
LIGHTS: dict[LensForm, tuple[str, str]] = {
    "ball": (LIGHT, NONE),
    "left": (ARROW_LIGHT, "10"),
    "right": (ARROW_LIGHT, "20"),
    "straight": (ARROW_LIGHT, "30"),
}
SIGNS: dict[SignKind, tuple[str, str]] = {
    "stop": ("206", NONE),
    "give_way": ("205", NONE),
    "priority": ("306", NONE),
    "no_entry": ("267", NONE),
    "no_u_turn": ("272", NONE),
    "left_only": ("209", "10"),
    "right_only": ("209", "20"),
    "ahead_only": ("209", "30"),
}
SPEED = "274"
# Step of the first search along roads, and the number of nearest places that are then measured exactly.
COARSE_STEP_M, NEAREST = 2.0, 6
# What is farther ahead of a place than this is not beside it.
BESIDE_M = 0.005


class RoadPlace(NamedTuple):
    """A place beside a road: its station and t, and the road's heading there."""

    road: str
    s: float
    t: float
    heading_rad: float


def add_signals(elements: Mapping[str, Element], world: World, network: Network) -> None:
    """Add signals and signs to the elements of roads by our ids: each beside the road that is nearest to its head,
    with the lanes of it that it governs, and references to it at the others. Those that govern none are left out."""
    roads = [network.road(name) for name in elements]
    lines = [line_of(road) for road in roads]
    groups: dict[str, list[Element]] = {}
    for number, item in enumerate(world.scene.roadside.free_elements):
        kind = _kind(item)
        governed: dict[str, list[NetworkLane]] = {}
        for lane in (network.lanes[name] for name in item.lanes if name in network.lanes):
            if lane.road in elements:
                governed.setdefault(lane.road, []).append(lane)
        right = np.array([math.cos(item.yaw_rad), math.sin(item.yaw_rad)])
        head = np.array([item.x_m, item.y_m]) + item.reach_m * right
        found = places_beside(head, roads, lines)
        if kind is None or not governed or not found:
            continue
        place = min(found, key=lambda at: abs(at.t))
        name, drives = str(number), item.yaw_rad + math.pi / 2
        is_along = math.cos(drives - place.heading_rad) > 0
        turn = math.remainder(drives - place.heading_rad - (0.0 if is_along else math.pi), 2 * math.pi)
        words = {"id": name, "name": item.form if isinstance(item, TrafficSignal) else item.kind, "country": "DE"}
        words |= {"type": kind[0], "subtype": kind[1], "orientation": "+" if is_along else "-"}
        words |= {"dynamic": "yes" if isinstance(item, TrafficSignal) else "no"}
        sizes = {"s": place.s, "t": place.t, "zOffset": item.height_m, "hOffset": turn}
        if kind[0] == SPEED and isinstance(item, TrafficSign):
            words["unit"], sizes["value"] = "km/h", float(item.kind.removeprefix("speed_"))
        signal = add(Element("signals"), "signal", **words, **sizes)
        groups.setdefault(place.road, []).append(signal)
        _add_validity(signal, governed.pop(place.road, []))
        for road, lanes in governed.items():
            # Where their traffic leaves or ends.
            reference = add(Element("signals"), "signalReference", id=name, s=lanes[0].driven[1], t=0.0)
            reference.set("orientation", "+" if lanes[0].ascends else "-")
            _add_validity(reference, lanes)
            groups.setdefault(road, []).append(reference)
    for road, items in groups.items():
        # References come last.
        add(elements[road], "signals").extend(sorted(items, key=lambda at: at.tag == "signalReference"))


def line_of(road: Road) -> Points2:
    s = np.linspace(0.0, road.end_m, 2 + int(road.end_m / COARSE_STEP_M))
    return road.xy(s, 0.0 * s)


def places_beside(point: Float[np.ndarray, "2"], roads: Sequence[Road], lines: Sequence[Points2]) -> list[RoadPlace]:
    """Where a point is beside some of the roads that come nearest to it."""
    order = np.argsort([np.linalg.norm(line - point, axis=1).min() for line in lines])[:NEAREST]
    return [at for i in order if (at := _beside(point, roads[i])) is not None]


def _add_validity(element: Element, lanes: Sequence[NetworkLane]) -> None:
    """The lanes of a road that a signal is valid for; lane 0 says none."""
    for number in sorted({int(lane.id.rsplit(".", 1)[1]) for lane in lanes}) or (0,):
        add(element, "validity", fromLane=str(number), toLane=str(number))


def _beside(point: Float[np.ndarray, "2"], road: Road) -> RoadPlace | None:
    """The place of a point beside a road; None of one before its beginning or behind its end."""
    s, (low, high) = 0.0, (0.0, road.end_m)
    for n in (2 + int(road.end_m / COARSE_STEP_M), 41, 41, 41):
        stations = np.linspace(low, high, n)
        s = float(stations[int(np.argmin(np.linalg.norm(road.xy(stations, 0.0 * stations) - point, axis=1)))])
        step_m = (high - low) / (n - 1)
        low, high = max(s - step_m, 0.0), min(s + step_m, road.end_m)
    ends = road.xy(np.clip(np.array([s - 0.02, s + 0.02]), 0.0, road.end_m), np.zeros(2))
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    ahead_m, right_m = (point - road.xy(np.array([s]), np.zeros(1))[0]) @ np.stack([along, [along[1], -along[0]]], -1)
    if abs(ahead_m) > BESIDE_M:
        return None
    return RoadPlace(road.id, s, -float(right_m), math.atan2(along[1], along[0]))


def _kind(item: TrafficSignal | TrafficSign) -> tuple[str, str] | None:
    """Type and subtype; None of signs that the standard leaves to countries."""
    if isinstance(item, TrafficSignal):
        return LIGHTS[item.form]
    return (SPEED, NONE) if item.kind.startswith("speed_") else SIGNS.get(item.kind)


# Tolerances of written heights and rolls, and the step between places where they are compared.
HEIGHT_M, ROLL_RAD, PROFILE_STEP_M = 1e-3, 1e-4, 1.0


def described_map(world: World) -> Described:
    """The roads of a map near the host."""
    roads, network = world.scene.map, world.network
    assert roads is not None, "asked only of maps"
    near = {road.id: road for road in network.roads}
    found = {road.id: _on_planes(road, near[road.id]) for road in roads.roads if road.id in near}

    def add_things(elements: Mapping[str, Element]) -> None:
        _add_paint(elements, roads, network)
        add_signals(elements, world, network)

    starts = np.array([(piece.x_m, piece.y_m) for road in found.values() for piece in road.plan])
    return Described(roads, found, starts, {}, add_things)


def _on_planes(road: MapRoad, own: Road) -> MapRoad:
    """A road as its file tells it: with the heights of the scene's ground where it has none, rolls about its climbing
    line, and widths on the rolled plane."""
    told = _laid(road, own)
    if not told.banks:
        return told
    flat = told.banks

    def wider(from_m: float, x_m: float, end_m: float) -> float:
        return 1 / math.cos(value(flat, from_m + x_m, from_m + end_m))

    sections = []
    for i, section in enumerate(road.sections):
        from_m, to_m = road.span_m(i)
        lanes = [
            lane.model_copy(update={"widths": times(lane.widths, partial(wider, from_m), to_m - from_m)})
            if lane.widths and not lane.level
            else lane
            for lane in section.lanes
        ]
        sections.append(section.model_copy(update={"lanes": tuple(lanes)}))
    offsets = times(road.lane_offsets, partial(wider, 0.0), road.length_m)
    return told.model_copy(update={"sections": tuple(sections), "lane_offsets": offsets})


def _laid(road: MapRoad, own: Road) -> MapRoad:
    """A road with heights, rolls and shapes: its own, or those of the ground that it lies on."""
    if road.heights:
        return road.model_copy(update={"banks": steepened(road.banks, road.heights, road.length_m, -1)})
    s = np.linspace(0, road.length_m, max(4, 1 + int(road.length_m / PROFILE_STEP_M)))
    low, high = own.left(s), own.right(s)
    high = np.maximum(high, low + 0.5)
    share = np.linspace(0, 1, SHAPE_PLACES)
    t = low + (high - low) * share[:, None]
    z = np.array([own.base_points(s, at)[:, 2] for at in t])
    mean_t, mean_z = t.mean(axis=0), z.mean(axis=0)
    fall = ((t - mean_t) * (z - mean_z)).sum(axis=0) / ((t - mean_t) ** 2).sum(axis=0)
    # They turn a plane that climbs already, which is steeper across than it looks from above.
    level = 1 / np.hypot(1.0, np.gradient(mean_z - fall * mean_t, s))
    flat = np.cos(np.arctan(fall * level))
    over = (z - mean_z - fall * (t - mean_t)).T * flat[:, None]
    # Here t grows to the right, in OpenDRIVE to the left; rolls are positive with the left side higher.
    profiles = {
        "heights": tuple(cubics(s, mean_z - fall * mean_t, HEIGHT_M)),
        "banks": tuple(cubics(s, -np.arctan(fall * level), ROLL_RAD)),
        "shapes": tuple(shapes(s, over[:, ::-1], -high / flat, (high - low) / flat)),
    }
    return road.model_copy(update=profiles)


def _add_paint(elements: Mapping[str, Element], roads: RoadMap, network: Network) -> None:
    """The paint in the lanes of roads, crosswalks at the roads beside them; islands are at the first road, in its
    frame."""
    found = {road.id: road for road in roads.roads if road.id in elements}
    groups = {name: Element("objects") for name in elements}
    all_roads = [network.road(name) for name in elements]
    lines = [line_of(road) for road in all_roads]
    first, start = groups[next(iter(found))], next(iter(found.values())).plan[0]
    for count, paint in enumerate(roads.paint):
        if paint.lane is not None and lane_key(paint.lane)[0] in found:
            name, i, number = lane_key(paint.lane)
            road = found[name]
            inner, outer = next(edges for lane, *edges in edges_at(road, i, paint.s_m) if lane.number == number)
            kind = {"stop_line": "StopLine", "give_way_line": "YieldLine"}.get(paint.kind)
            place = {"s": paint.s_m, "t": (inner + outer) / 2, "zOffset": 0.0, "hdg": 0.0}
            ascends = lane_ascends(road, i, number)
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
