"""Signals and signs of scenes on maps as OpenDRIVE's signals."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.opendrive.xml import Element, add
from synth3dlanes.roads.maps.elements import ARROW_LIGHT, LIGHT
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import NetworkLane, Road
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
