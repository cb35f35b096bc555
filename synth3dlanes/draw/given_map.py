"""The makers of roads that are a map: of a given one, the host's place on it; of all, its speed and the cars around
it. World frame, metres."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from synth3dlanes.draw.bodies import way_places
from synth3dlanes.draw.cars import SPEED_TRIES, BodySize, CarPlace, Traffic, draw_cars
from synth3dlanes.draw.draws import SCENE_DECIMALS, DrawsOf
from synth3dlanes.draw.fitted_terrain import GROUND_GRID_STEP_M, terrain_of
from synth3dlanes.draw.given_standing import map_trees, stand
from synth3dlanes.draw.makers import Roads, Stand, draw_camera, draw_hills, first_shot
from synth3dlanes.draw.riders import places_on_map
from synth3dlanes.geometry.polylines import spaced
from synth3dlanes.params.distributions import extent
from synth3dlanes.params.shots import Shots
from synth3dlanes.roads.from_map import bare_roads, map_network, route_way
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.maps.given_map import GivenMap
from synth3dlanes.roads.maps.part import MapPart, part_around
from synth3dlanes.roads.maps.places import MapStation, draw_place, read_place
from synth3dlanes.roads.maps.read import read_map
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import NetworkLane
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.scene.host import HostCamera, Shot
from synth3dlanes.scene.road_map import LaneName, RoadMap
from synth3dlanes.scene.roadside import Roadside
from synth3dlanes.scene.scene import Car, Scene, Tree
from synth3dlanes.system.streams import stream
from synth3dlanes.world import placement
from synth3dlanes.world.ground import Ground

# Draws of a place for each car, and how many times as likely lanes of the host's roads are as others.
TRIES, LIKELIER = 60, 3.0
# The most acceleration to the side (m/s^2), and the length over which a bend is measured.
SIDEWAYS, BEND_M = 3.0, 4.0
# What is left of a way at the end of a clip, and the narrowest lane with cars.
LEFT_M, NARROW_M = 6.0, 2.2


def map_roads(
    of: DrawsOf,
    roads: RoadMap,
    camera: HostCamera,
    shot: Shot,
    stand: Stand,
    ground_step_m: float = GROUND_GRID_STEP_M,
) -> Roads:
    """A map with the host on its route, on a terrain that meets the heights of the map's roads. In a clip the host
    drives no faster than the bends and the end of its way allow; cars drive along the lanes."""
    hills = draw_hills(of("terrain"))
    bare = bare_roads(roads, hills)
    terrain = terrain_of(bare, hills, ground_step_m)
    network = map_network(roads, bare, terrain, camera.y_m)
    if shot.speed_m_s and not shot.track:
        speed_m_s = _allowed(network.way, camera.y_m, shot.speed_m_s, shot.duration_s)
        shot = shot.model_copy(update={"speed_m_s": speed_m_s})
    fields = {"terrain": terrain, "road": None, "map": roads, "camera": camera, "shot": shot}
    return Roads(
        network,
        fields,
        stand,
        drive=lambda scene, ground: cars_on_map(scene, network, of, roads.links),
        ride=places_on_map,
    )


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


def red_lines(scene: Scene, network: Network) -> dict[LaneName, float]:
    """Where traffic may not go on, by lanes, as stations of their roads: at the stop lines of signals that are neither
    green nor off, or where the junction begins."""
    lines = {at.lane: at.s_m for at in scene.roads.paint if at.kind == "stop_line" and at.lane is not None}
    found: dict[LaneName, float] = {}
    for signal in scene.roadside.signals:
        if signal.state_at(0.0) not in ("green", "off"):
            for name in signal.lanes:
                if name in network.lanes:
                    lane = network.lanes[name]
                    found[name] = lines.get(name, lane.driven[int(lane.junction is None)])
    return found


def _line_ahead(way: LaneCurve, lines: Mapping[LaneName, float], front_m: float) -> float:
    """The length along a way at which the first of some lines before a place of it is; infinite without one."""
    at = (float(way.stations_on(lane.id, lines[lane.id])) for lane in way.lanes if lane.id in lines)
    return min((m for m in at if m >= front_m), default=math.inf)


def _allowed(way: LaneCurve, at_m: float, speed_m_s: float, duration_s: float, line_m: float = math.inf) -> float:
    """The speed with which a car can drive along a way for this time, if its middle must not pass a place."""
    if at_m + speed_m_s * duration_s > line_m:
        speed_m_s = max(line_m - at_m, 0.0) / max(duration_s, 1e-9)
    end_m = min(at_m + speed_m_s * duration_s, way.end_m)
    s = np.arange(at_m, end_m + 2 * BEND_M, BEND_M / 2)
    xy = way.xy_world(np.clip(s, 0, way.end_m))
    heading = np.unwrap(np.arctan2(*np.diff(xy, axis=0).T[::-1]))
    turn = np.abs(heading[2:] - heading[:-2]) / BEND_M
    turn = turn[(s[1:-2] < end_m) & (s[3:] <= way.end_m)]
    sharpest = max(float(turn.max()) if turn.size else 0.0, 1e-4)
    fastest = min(speed_m_s, (SIDEWAYS / sharpest) ** 0.5, max(way.end_m - LEFT_M - at_m, 0.0) / max(duration_s, 1e-9))
    return round(float(fastest), 3)


def cars_on_map(
    scene: Scene, network: Network, of: DrawsOf, links: Sequence[tuple[LaneName, LaneName]]
) -> tuple[Car, ...]:
    """Cars in the lanes as near to the host as stations of `cars.s_m` are to the paper's, which in a clip keep a speed
    through lanes that follow each other and touch nobody; those without room are left out."""
    shot, camera, is_clip = scene.shot, scene.camera, scene.shot.n_frames > 1
    looks, speeds = of("cars", "map_cars"), of("motion", "car_speeds")
    near, chances = _near(scene, network, max(map(abs, extent(of.params.cars.s_m))))
    lines, rng = red_lines(scene, network), looks.rng

    def places(size: BodySize) -> Iterator[CarPlace]:
        for _ in range(TRIES):
            lane = near[int(np.searchsorted(chances, rng.random() * chances[-1], side="right").clip(0, len(near) - 1))]
            s_m = round(lane.start_m + rng.random() * (lane.end_m - lane.start_m), SCENE_DECIMALS)
            route = _onward(network, lane, links, rng) if is_clip else ()
            way = network.way_through([lane, *(network.lanes[name] for name in route)])
            at_m = float(way.stations_on(lane.id, s_m))
            line_m = _line_ahead(way, lines, at_m + size[0] / 2) - size[0] / 2
            wishes = [speeds("car_speed_m_s") for _ in range(SPEED_TRIES // 4)] if is_clip else [0.0]
            possible = [_allowed(way, at_m, wish, shot.duration_s, line_m) if wish else 0.0 for wish in wishes]
            yield CarPlace(
                {"lane": lane.id, "s_m": s_m, "route": route},
                partial(way_places, way, at_m, offset_m=0.0, size=size),
                possible,
            )

    host = partial(way_places, network.way, camera.y_m, offset_m=camera.offset_m, size=placement.HOST_SIZE_M)
    traffic = Traffic(shot, host)
    return tuple(filter(None, draw_cars(looks, scene.assets, traffic, places))) if near else ()


def _near(scene: Scene, network: Network, reach_m: float) -> tuple[list[NetworkLane], np.ndarray]:
    """Lanes of traffic near the host, and the sums of their chances."""
    foot = network.host_points(scene.camera, np.zeros(1))[0, :2]
    own = {lane.road for lane in network.way.lanes}
    lanes = [lane for lane in network.lanes.values() if lane.width_m > NARROW_M and lane.end_m - lane.start_m > 1.0]
    start_m, end_m = (np.array([getattr(lane, end) for lane in lanes]) for end in ("start_m", "end_m"))
    counts = 2 + ((end_m - start_m) / 10).astype(int)
    which, s = np.repeat(np.arange(len(lanes)), counts), spaced(start_m, end_m, counts)
    is_near = np.hypot(*(network.xy_in_lanes(lanes, which, s) - foot).T) < reach_m
    found, chances = [], []
    for lane, n_near in zip(lanes, np.bincount(which[is_near], minlength=len(lanes)), strict=True):
        if n_near:
            found.append(lane)
            chances.append((lane.end_m - lane.start_m) * (LIKELIER if lane.road in own else 1.0))
    return found, np.cumsum(chances)


def _onward(
    network: Network, lane: NetworkLane, links: Sequence[tuple[str, str]], rng: np.random.Generator
) -> tuple[LaneName, ...]:
    """Lanes that follow a lane, each of those that follow one as likely."""
    route, length_m, at = list[LaneName](), 0.0, lane
    while length_m < 400.0 and len(route) < 60:
        after = [after for before, after in links if before == at.id and after in network.lanes]
        if not after:
            break
        at = network.lanes[after[int(rng.random() * len(after))]]
        route.append(at.id)
        length_m += at.end_m - at.start_m
    return tuple(route)
