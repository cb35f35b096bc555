"""The maker of given maps: the host's place on one, and what its file says of what stands there. World frame,
metres."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from synth3dlanes.draw.draws import SCENE_DECIMALS, Draw, DrawsOf
from synth3dlanes.draw.makers import Roads, draw_camera, first_shot, map_roads
from synth3dlanes.draw.roadside import coloured, floor_plan
from synth3dlanes.params.shots import Shots
from synth3dlanes.roads.from_map import route_way
from synth3dlanes.roads.maps.elements import OVERHEAD_M, GivenBody, GivenElement, GivenRail
from synth3dlanes.roads.maps.given_map import GivenMap
from synth3dlanes.roads.maps.part import MapPart, MapStation, draw_place, part_around, read_place
from synth3dlanes.roads.maps.read import read_map
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.scene.roadside import MAX_BUILDINGS, MAX_RAILS, Building, Rail, Roadside
from synth3dlanes.scene.scene import Scene, Tree
from synth3dlanes.scene.traffic_elements import MAX_FREE, Phase, SignalState, TrafficSign, TrafficSignal
from synth3dlanes.system.streams import stream
from synth3dlanes.world.ground import Ground

# Distance of poles from the pavement of traffic. A pole that a file has on the pavement is moved beside it and gets an
# arm, at most ARM_M long; room is looked for in steps of ARM_STEP_M.
OFF_M, ARM_M, ARM_STEP_M, GRAZES_M = 0.3, 25.0, 0.25, 1.0
# Heads and boards within SAME_PLACE_M are above each other, ABOVE_M apart, up to HIGHEST_M.
SAME_PLACE_M, ABOVE_M, HIGHEST_M = 0.6, 0.06, 9.0
HIGH_M = {TrafficSignal: 1.24, TrafficSign: 1.1}
# What lights show: of the group that has its turn, and of the others.
GO: tuple[tuple[SignalState, float], ...] = (("green", 0.85), ("amber", 0.15))
WAIT: tuple[tuple[SignalState, float], ...] = (("red", 0.94), ("red_amber", 0.06))
# Linear red, green and blue of barriers.
RAIL_COLORS = {"guardrail": (0.36, 0.37, 0.38), "concrete": (0.4, 0.39, 0.37)}
# Places along a rail from which its distance is measured.
RAIL_STEP_M = 10.0
# Least distance of walls and trunks from pavements.
WALL_M, TRUNK_M = 0.3, 0.6
T = TypeVar("T", TrafficSignal, TrafficSign, Building)


class MapPlace(NamedTuple):
    """A map file, and a place on it for all scenes; None where each scene has one of its own."""

    map: GivenMap
    at: MapStation | None = None

    def draw(self, rng: np.random.Generator) -> MapPart:
        """The part of the map around the place, or around one that is drawn."""
        return part_around(self.map, self.at or draw_place(self.map, rng), rng)

    def roads(self, of: DrawsOf, shots: Shots, assets: Assets) -> Roads:
        """The maker of a given map: a place on it with what its file says of what stands there."""
        shot, part = first_shot(shots, of("motion")), self.draw(stream(*of.drawn, "map"))
        camera = draw_camera(of("camera"), 1, host_length(part))

        def beside(scene: Scene, ground: Ground) -> Roadside:
            return stand(part, scene, ground, of("roadside", "map_standing"))

        def grow(scene: Scene, ground: Ground, trees: tuple[Tree, ...]) -> tuple[Tree, ...]:
            return (*trees, *map_trees(part, scene, ground, of("trees", "map_trees")))

        return replace(map_roads(of, part.map, camera, shot, beside), grow=grow, has_to_fit=False)

    def description(self) -> dict[str, object]:
        """The part of `dataset.json` that says which map."""
        at = {} if self.at is None else {"at": {"lane": self.at.lane, "s_m": self.at.s_m}}
        return {"file": self.map.source, "digest": self.map.digest, **at}


def place_on_map(path: Path, at: str = "") -> MapPlace:
    """The map in a file, with the place that `at` (ROAD:s:lane) says, if any. Raises InputError or FormatError in one
    line for another file, a place that is not there, and a map on which no host has a place."""
    given = read_map(path)
    place = MapPlace(given, read_place(given, at) if at else None)
    # Refused here, not once for each scene.
    place.draw(stream(0, "map", 0, "map"))
    return place


def host_length(part: MapPart) -> float:
    """How far the host is along the middle of the lanes of its route, seen from above."""
    return round(float(route_way(part.map).pieces[part.lane].stations(part.s_m)), SCENE_DECIMALS)


def stand(part: MapPart, scene: Scene, ground: Ground, draw: Draw) -> Roadside:
    """The signals, signs and buildings of a part of a map. One group of signals of each junction has its turn: in
    clips, in which the phases do not change, that of the host's way, else any."""
    rng = draw.rng
    show = _shown(part.elements, frozenset(part.map.route), scene.shot.n_frames > 1, rng)
    placed = _mounted(list(_moved([item.element for item in part.elements], ground)))
    signals, signs = list[TrafficSignal](), list[TrafficSign]()
    for item, state in zip(placed, show, strict=True):
        if isinstance(item, TrafficSign):
            signs.append(item)
        elif item is not None:
            signals.append(item.model_copy(update={"phases": (Phase(state=state),)}))
    buildings = [_building(body, rng) for body in part.bodies if body.kind == "building"]
    clear = [at for at in buildings if ground.paved.is_clear(floor_plan(at), WALL_M).all()]
    return Roadside(
        rails=_rails(part, ground.network),
        signals=_nearest(signals, MAX_FREE),
        signs=_nearest(signs, MAX_FREE),
        buildings=_nearest(clear, MAX_BUILDINGS),
    )


def _rails(part: MapPart, network: Network) -> tuple[Rail, ...]:
    """The barriers of the roads of a scene, which are fewer than those of the part; as many as a scene may have, those
    nearest to the host."""
    roads = {road.id: road for road in network.roads}

    def away_m(item: GivenRail) -> float:
        s = np.linspace(item.from_m, item.to_m, 2 + int((item.to_m - item.from_m) / RAIL_STEP_M))
        return float(np.hypot(*roads[item.road].xy(s, 0 * s).T).min())

    near = sorted((item for item in part.rails if item.road in roads), key=away_m)
    return tuple(map(_rail, near[:MAX_RAILS]))


def _rail(item: GivenRail) -> Rail:
    ends = {key: round(value, SCENE_DECIMALS) for key, value in (("from_m", item.from_m), ("to_m", item.to_m))}
    form = {"kind": item.kind, "road": item.road, "side": "median", "color": RAIL_COLORS[item.kind]}
    return Rail.model_validate(form | ends | {"aside_m": round(-item.t_m, SCENE_DECIMALS), "height_m": item.height_m})


def _nearest(items: Sequence[T], most: int) -> tuple[T, ...]:
    """The nearest items to the host, at most as many as a scene may have."""
    return tuple(sorted(items, key=lambda at: math.hypot(at.x_m, at.y_m))[:most])


def map_trees(part: MapPart, scene: Scene, ground: Ground, looks: Draw) -> tuple[Tree, ...]:
    """The trees of a part of a map, as high as there; where they would stand on pavement they are left out."""
    models, found = scene.assets.tree_models, list[Tree]()
    for body in part.bodies:
        if body.kind == "tree" and ground.paved.is_clear(np.array([[body.x_m, body.y_m]]), TRUNK_M)[0]:
            model, yaw_rad = looks("model"), looks("yaw_deg")
            scale = round(body.size_m[2] / models[model - 1].height_m, SCENE_DECIMALS)
            found.append(Tree(model=model, x_m=body.x_m, y_m=body.y_m, yaw_rad=yaw_rad, scale=scale))
    return tuple(found)


def _shown(
    elements: Sequence[GivenElement], route: frozenset[str], is_clip: bool, rng: np.random.Generator
) -> list[SignalState]:
    """What each element shows, if it is a signal."""
    groups: dict[str, dict[str, bool]] = {}
    for item in elements:
        if isinstance(item.element, TrafficSignal):
            of = groups.setdefault(item.junction or item.group, {})
            of[item.group] = of.get(item.group, False) or not route.isdisjoint(item.element.lanes)
    found: dict[tuple[str, str], SignalState] = {}
    for junction, of in groups.items():
        names = list(of)
        turn, u_go, u_wait = rng.random(3)
        # One alone at its place has its turn as often as not.
        has_turn = {names[int(turn * len(names))]} if len(names) > 1 or turn < 0.5 else set()
        if is_clip and any(of.values()):
            has_turn = {name for name in names if of[name]}
        for name in names:
            states = GO if name in has_turn else WAIT
            u = 0.0 if is_clip else u_go if states is GO else u_wait
            found[junction, name] = states[int(u >= states[0][1])][0]
    return [found.get((item.junction or item.group, item.group), "off") for item in elements]


def _moved(items: Sequence[TrafficSignal | TrafficSign], ground: Ground) -> Iterator[TrafficSignal | TrafficSign]:
    """Signals and signs with their poles off the pavement of traffic: one whose place is on it hangs on an arm from
    beside it, or has no pole where that is too far."""
    if not items:
        return
    places = np.array([(item.x_m, item.y_m) for item in items])
    yaw_rad = np.array([item.yaw_rad for item in items])
    right = np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=-1)
    steps = np.arange(ARM_STEP_M, ARM_M, ARM_STEP_M)
    # From the right first, as poles stand.
    aside = np.stack([steps, -steps], -1).ravel()
    stays = ground.paved.off_carriageways(places) > OFF_M
    beside = places[~stays, None] + aside[:, None] * right[~stays, None]
    is_free = iter((ground.paved.off_carriageways(beside.reshape(-1, 2)) > OFF_M).reshape(beside.shape[:2]))
    for item, xy, across, has_room in zip(items, places, right, stays.tolist(), strict=True):
        if has_room:
            yield item
            continue
        free = np.flatnonzero(next(is_free))
        overhead = {"height_m": max(item.height_m, OVERHEAD_M)}
        if not free.size:
            yield item.model_copy(update=overhead | {"has_pole": False})
            continue
        by_m = float(aside[free[0]])
        x, y = (xy + by_m * across).round(SCENE_DECIMALS).tolist()
        # A pole that merely grazes the pavement moves as a whole.
        hangs = {} if abs(by_m) <= GRAZES_M else overhead | {"reach_m": round(-by_m, 3)}
        yield item.model_copy(update={"x_m": x, "y_m": y} | hangs)


def _mounted(items: Sequence[TrafficSignal | TrafficSign]) -> list[TrafficSignal | TrafficSign | None]:
    """Signals and signs with those at one place over each other, on one pole; None of what would be too high."""
    found, taken = list[TrafficSignal | TrafficSign | None](), list[tuple[float, float, float, float]]()
    for item in items:
        x = item.x_m + item.reach_m * math.cos(item.yaw_rad)
        y = item.y_m + item.reach_m * math.sin(item.yaw_rad)
        here = sorted((low, high) for at_x, at_y, low, high in taken if math.hypot(at_x - x, at_y - y) < SAME_PLACE_M)
        low, size_m = item.height_m, HIGH_M[type(item)]
        for other_low, other_high in here:
            if low < other_high + ABOVE_M and other_low < low + size_m + ABOVE_M:
                low = other_high + ABOVE_M
        if low + size_m > HIGHEST_M and here:
            found.append(None)
            continue
        taken.append((x, y, low, low + size_m))
        found.append(item.model_copy(update={"height_m": round(low, 3)}))
    return found


def _building(body: GivenBody, rng: np.random.Generator) -> Building:
    length_m, width_m, height_m = body.size_m
    yaw_rad = math.remainder(body.heading_rad - math.pi / 2, 2 * math.pi)
    return coloured("block", (body.x_m, body.y_m), yaw_rad, (width_m, length_m, height_m), rng)
