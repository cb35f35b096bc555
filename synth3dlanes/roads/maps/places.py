"""Where the host is on a given map: drawn along its driving lanes by length, or given as ROAD:s:lane; and its route."""

from collections import deque
from typing import NamedTuple

import numpy as np

from synth3dlanes.roads.maps.cubics import value
from synth3dlanes.roads.maps.furniture import section_index
from synth3dlanes.roads.maps.given_map import GivenMap, LanePlace
from synth3dlanes.scene.road_map import LaneName
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import shown, unknown_key

# Length of the route ahead of the host and behind it, where the map reaches that far.
AHEAD_M, BEHIND_M = 450.0, 150.0
# Places are drawn where at least this length of the way is left, if there are any, in lanes of at least this width.
ONWARD_M, WIDE_M = 250.0, 2.0
TRIES, MAX_ROUTE = 200, 1000
# The least length of the way ahead of a host.
LEAST_AHEAD_M = 10.0
MM_DECIMALS = 3


class MapStation(NamedTuple):
    """A lane, and a station of its road."""

    lane: LaneName
    s_m: float


def draw_place(given: GivenMap, rng: np.random.Generator) -> MapStation:
    """A place in a driving lane, each metre of which is as likely as any other. Raises InputError for a map without
    driving lanes."""
    names = list(given.lanes)
    if not names:
        raise InputError(f"map {given.source}: expected driving lanes, got none")
    ends = given.lane_ends_m
    best, most_m = MapStation(names[0], given.lanes[names[0]].span_m[0]), -1.0
    for _ in range(TRIES):
        at = float(rng.random() * ends[-1])
        i = min(int(np.searchsorted(ends, at, side="right")), len(names) - 1)
        place = given.lanes[names[i]]
        low, high = place.span_m
        s_m = min(round(high - (float(ends[i]) - at), MM_DECIMALS), high)
        left_m = onward_m(given, MapStation(names[i], s_m)) if width_m(place, s_m) >= WIDE_M else 0.0
        if left_m > most_m:
            best, most_m = MapStation(names[i], max(s_m, low)), left_m
        if most_m >= ONWARD_M:
            break
    return best


def width_m(place: LanePlace, s_m: float) -> float:
    """The width of a lane at a station of its road."""
    return value(place.lane.widths, s_m - place.span_m[0])


def onward_m(given: GivenMap, at: MapStation) -> float:
    """Length of the way ahead of a place, up to where ways are followed."""
    place = given.lanes[at.lane]
    low, high = place.span_m
    beyond = max((given.reach_m[after] for after in given.following.get(at.lane, ())), default=0.0)
    return (high - at.s_m if place.ascends else at.s_m - low) + beyond


def read_place(given: GivenMap, text: str) -> MapStation:
    """The place that ROAD:s:lane says. Raises InputError for one that is not there."""
    parts = text.rsplit(":", 2)
    try:
        road_id, s_m, number = parts[0], float(parts[1]), int(parts[2])
    except (IndexError, ValueError):
        raise InputError(f"at: expected ROAD:s:lane, as 12:30.5:-1, got {shown(text)}") from None
    name = given.names.get(road_id, road_id)
    if name not in given.roads:
        known = unknown_key(road_id, given.names).replace("unknown key", "")
        raise InputError(f"at: expected a road of {given.source}, got {shown(road_id)}{known}")
    road = given.roads[name]
    if not 0 <= s_m <= road.length_m:
        raise InputError(f"at: expected a station of road {road_id} from 0 to {road.length_m:.2f}, got {s_m:g}")
    lane = f"{name}.{section_index(road, s_m)}.{number}"
    if lane not in given.lanes:
        there = [
            str(place.lane.number)
            for key, place in given.lanes.items()
            if key.rpartition(".")[0] == lane.rpartition(".")[0]
        ]
        raise InputError(
            f"at: expected a driving lane of road {road_id} there ({', '.join(there) or 'none'}), got {number}"
        )
    return MapStation(lane, s_m)


def draw_route(given: GivenMap, at: MapStation, rng: np.random.Generator) -> tuple[tuple[LaneName, ...], int]:
    """The lanes that the host drives along, some of them behind it, and the number of its own among them. Where ways
    part, each that goes on far enough is as likely. Raises InputError where the way ends at once."""
    place = given.lanes[at.lane]
    low, high = place.span_m
    driven_m = at.s_m - low if place.ascends else high - at.s_m
    route, before_m = deque([at.lane]), driven_m
    while before_m < BEHIND_M and len(route) < MAX_ROUTE:
        ways = [name for name in given.preceding.get(route[0], ()) if given.lanes[name].length_m > 0]
        if not ways:
            break
        route.appendleft(ways[int(rng.random() * len(ways))])
        before_m += given.lanes[route[0]].length_m
    number, ahead_m = len(route) - 1, place.length_m - driven_m
    while ahead_m < AHEAD_M and len(route) < 2 * MAX_ROUTE:
        ways = given.following.get(route[-1], [])
        wanted_m = min(AHEAD_M - ahead_m, max((given.reach_m[name] for name in ways), default=0.0))
        ways = [name for name in ways if given.reach_m[name] >= wanted_m]
        if not ways:
            break
        route.append(ways[int(rng.random() * len(ways))])
        ahead_m += given.lanes[route[-1]].length_m
    rounds = route.count(route[-1])
    if ahead_m < LEAST_AHEAD_M * rounds or len(route) >= 2 * MAX_ROUTE:
        raise InputError(
            f"map {given.source}: expected a way of {LEAST_AHEAD_M:g} m and more ahead of the host, got"
            f" {ahead_m:.3g} m in {len(route) - number} lanes at {at.lane}, s = {at.s_m:g}"
        )
    return tuple(route), number
