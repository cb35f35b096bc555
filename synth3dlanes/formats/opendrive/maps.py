"""Scenes on maps as OpenDRIVE describes them: their roads near the host on the ground of the scene, with paint, islands
and signals."""

import math
from collections.abc import Iterable, Mapping
from functools import partial

import numpy as np

from synth3dlanes.formats.opendrive.described import SHAPE_PLACES, Described, lane_ascends, lane_key, shapes
from synth3dlanes.formats.opendrive.map_signals import RoadPlace, add_signals, line_of, places_beside
from synth3dlanes.formats.opendrive.xml import Element, add, add_crosswalk
from synth3dlanes.roads.maps.cubics import steepened, times, value
from synth3dlanes.roads.maps.furniture import edges_at
from synth3dlanes.roads.maps.profiles import cubics
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import Road
from synth3dlanes.scene.road_map import MapRoad, PlanPiece, RoadMap
from synth3dlanes.world.world import World

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
