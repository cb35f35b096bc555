"""The cars of a scene: their looks, and places in lanes clear of each other and of the host, all through a clip."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.draw.bodies import way_places
from synth3dlanes.draw.colors import sold_color
from synth3dlanes.draw.draws import SCENE_DECIMALS, Draw, DrawsOf
from synth3dlanes.geometry.polylines import spaced
from synth3dlanes.params.distributions import extent
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import NetworkLane
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.scene.road_map import LaneName
from synth3dlanes.scene.scene import Car, Scene
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.system.errors import DrawError
from synth3dlanes.world import placement

# Free length and width around a car, and draws of a place for each.
CAR_GAP_M, TRIES = (1.0, 0.3), 300
# Least distance of parked cars from where roads part.
PARKING_BEFORE_M = 20.0
# No car gains more on another than the gap between them from one checked instant to the next.
CHECK_EVERY_S = 0.05
# Every 20th of these instants is checked first: it shows most collisions.
FIRST_OF = 20
# The number of speeds drawn for a car before it takes another car's speed.
SPEED_TRIES = 8

# On maps: draws of a place for each car, and the weight of lanes of the host's roads, if that of others is 1.
TRIES_ON_MAPS, HOST_ROADS_WEIGHT = 60, 3.0
# The most acceleration to the side (m/s^2), and the length over which a bend is measured.
SIDEWAYS_M_S2, BEND_M = 3.0, 4.0
# The least length of a car's way beyond its place at the end of a clip, and the narrowest lane with cars.
REST_OF_WAY_M, NARROWEST_LANE_M = 6.0, 2.2

BodySize = tuple[float, float]
# The corners of a car at distances that it has driven.
Way = Callable[[Scalars], Float[np.ndarray, "t 4 2"]]


class CarPlace(NamedTuple):
    """A place for a car: the fields of it, its way from there on, and speeds, one of which it takes."""

    fields: dict[str, Any]
    way: Way
    speeds: list[float]


class Traffic:
    """Host and cars on their ways through a clip, to which cars are added one by one; none touches what is closed."""

    def __init__(self, scene: Scene, network: Network) -> None:
        shot, camera = scene.shot, scene.camera
        self.times_s = np.linspace(0, shot.duration_s, 1 + int(np.ceil(shot.duration_s / CHECK_EVERY_S)))
        start_m, driven_m = camera.y_m * network.onwards, shot.speed_m_s * self.times_s
        host = way_places(network.host_way(camera), start_m, driven_m, camera.offset_m, placement.HOST_SIZE_M)
        closed = np.repeat(network.closed[:, None], len(self.times_s), axis=1)
        self.ways, self.speeds = np.concatenate([host[None], closed]), [shot.speed_m_s]

    def join(self, way: Way, speeds: list[float]) -> float | None:
        """Add a car with the first of these speeds at which it never touches another; return that speed, None without
        one."""
        if len(self.times_s) > 1 and placement.touches_any(way(self.times_s[:1]), self.ways[:, :1]):
            return None
        few_s, few_ways = self.times_s[::FIRST_OF], self.ways[:, ::FIRST_OF]
        for speed in dict.fromkeys(speeds):
            if len(few_s) > 1 and placement.touches_any(way(speed * few_s), few_ways):
                continue
            own = way(speed * self.times_s)
            if not placement.touches_any(own, self.ways):
                self.ways = np.concatenate([self.ways, own[None]])
                self.speeds.append(speed)
                return speed
        return None


def car_look(looks: Draw, assets: Assets, model: int, scale: float, added: Sequence[Draw] = ()) -> dict[str, Any]:
    """Model and colours of a car. `added` are streams of their own for saturation and palette."""
    paints, sold = added or (looks, looks)
    (color,) = zip(*looks.rows(("color",), 3), strict=True)
    gloss, saturation, palette = looks("gloss"), paints("saturation"), sold("palette")
    u_paint, u_shade = sold.rng.random(2)
    if palette == "sold":
        color, saturation = sold_color(assets.car_models[model - 1], u_paint, u_shade), 1.0
    return {"model": model, "scale": scale, "color": color, "gloss": gloss, "saturation": saturation}


def draw_cars(
    looks: Draw,
    assets: Assets,
    traffic: Traffic,
    places: Callable[[BodySize], Iterator[CarPlace]],
    added: Sequence[Draw] = (),
) -> Iterator[Car | None]:
    """The cars, each at the first free one of the places for its length and width and the gap around it; None for each
    that finds none."""
    for _ in range(looks("n")):
        model, scale = looks("model"), looks("scale")
        look = car_look(looks, assets, model, scale, added)
        body = assets.car_models[model - 1]
        for at in places((body.length_m * scale + CAR_GAP_M[0], body.width_m * scale + CAR_GAP_M[1])):
            speed_m_s = traffic.join(at.way, at.speeds)
            if speed_m_s is not None:
                yield Car(**look, **at.fields, speed_m_s=speed_m_s)
                break
        else:
            yield None


def cars_along_road(scene: Scene, network: Network, of: DrawsOf) -> tuple[Car, ...]:
    """The cars in the lanes of the road beside each other, within the stations of `cars.s_m`, or parked. The first car
    without room and all after it are left out.

    Raises DrawError if fewer cars are left than `cars.n` allows.
    """
    # What the paper does not draw has streams of its own, so that it changes none of the paper's draws.
    looks, at, parking = of("cars"), of("cars", "car_places"), of("cars", "parked_cars")
    added, speeds = (of("cars", "car_saturation"), of("cars", "car_palette")), of("motion", "car_speeds")
    parked, is_clip, traffic = parking("parked"), scene.shot.n_frames > 1, Traffic(scene, network)

    def places(size: BodySize) -> Iterator[CarPlace]:
        is_parked = parking.rng.random() < parked
        drawn_m_s = [speeds("car_speed_m_s") for _ in range(SPEED_TRIES)] if is_clip else [0.0]
        for _ in range(TRIES):
            s_m = at("s_m")
            lanes = network.lanes_at(s_m * network.onwards)
            lane, offset_m = lanes[int(at.rng.random() * len(lanes))].id, 0.0
            if is_parked and (found := _parking(network, s_m, size[1], parking.rng)):
                lane, offset_m = found
            way = partial(way_places, network.path(lane), s_m * network.onwards, offset_m=offset_m, size=size)
            wanted = [0.0] if offset_m or not is_clip else [*drawn_m_s, *traffic.speeds]
            yield CarPlace({"lane": lane, "s_m": s_m, "offset_m": offset_m}, way, wanted)

    cars = list[Car]()
    for car in draw_cars(looks, scene.assets, traffic, places, added):
        if car is None and len(cars) < looks.least("n"):
            raise DrawError(
                f"cars.n: no room for car {len(cars) + 1} within cars.s_m of scene {scene.index}; with a range such as "
                f"[1, {looks.least('n')}], cars without room are left out"
            )
        if car is None:
            break
        cars.append(car)
    return tuple(cars)


def _parking(network: Network, s_m: float, width_m: float, rng: np.random.Generator) -> tuple[str, float] | None:
    """A lane at whose outer shoulder a car can stand, and its offset there to the driver's right; None without room.

    Nobody parks where roads part, or left of the host's lanes.
    """
    road, s = network.main, s_m * network.onwards
    left, right = road.lanes_at(s)[0], road.lanes_at(s)[-1]
    outermost = [right.id] if all(s <= at.start_m - PARKING_BEFORE_M for at in network.branches(road)) else []
    outermost += [left.id] if left.direction == "oncoming" else []
    if not outermost or road.shoulder_m < width_m:
        return None
    offset_m = network.rightward * (road.lane_width_m + road.shoulder_m) / 2
    return outermost[int(rng.random() * len(outermost))], round(offset_m, SCENE_DECIMALS)


# -- on maps


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


def allowed_speed(way: LaneCurve, at_m: float, speed_m_s: float, duration_s: float, line_m: float = math.inf) -> float:
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
    fastest = min(
        speed_m_s, (SIDEWAYS_M_S2 / sharpest) ** 0.5, max(way.end_m - REST_OF_WAY_M - at_m, 0.0) / max(duration_s, 1e-9)
    )
    return round(float(fastest), 3)


def cars_on_map(
    scene: Scene, network: Network, of: DrawsOf, links: Sequence[tuple[LaneName, LaneName]]
) -> tuple[Car, ...]:
    """Cars in the lanes as near to the host as stations of `cars.s_m` are to the paper's, which in a clip keep a speed
    through lanes that follow each other and touch nobody; those without room are left out."""
    shot, is_clip = scene.shot, scene.shot.n_frames > 1
    looks, speeds = of("cars", "map_cars"), of("motion", "car_speeds")
    near, chances = _near(scene, network, max(map(abs, extent(of.params.cars.s_m))))
    lines, rng = red_lines(scene, network), looks.rng

    def places(size: BodySize) -> Iterator[CarPlace]:
        for _ in range(TRIES_ON_MAPS):
            lane = near[int(np.searchsorted(chances, rng.random() * chances[-1], side="right").clip(0, len(near) - 1))]
            s_m = round(lane.start_m + rng.random() * (lane.end_m - lane.start_m), SCENE_DECIMALS)
            route = _onward(network, lane, links, rng) if is_clip else ()
            way = network.way_through([lane, *(network.lanes[name] for name in route)])
            at_m = float(way.stations_on(lane.id, s_m))
            line_m = _line_ahead(way, lines, at_m + size[0] / 2) - size[0] / 2
            wishes = [speeds("car_speed_m_s") for _ in range(SPEED_TRIES // 4)] if is_clip else [0.0]
            possible = [allowed_speed(way, at_m, wish, shot.duration_s, line_m) if wish else 0.0 for wish in wishes]
            yield CarPlace(
                {"lane": lane.id, "s_m": s_m, "route": route},
                partial(way_places, way, at_m, offset_m=0.0, size=size),
                possible,
            )

    return tuple(filter(None, draw_cars(looks, scene.assets, Traffic(scene, network), places))) if near else ()


def _near(scene: Scene, network: Network, reach_m: float) -> tuple[list[NetworkLane], np.ndarray]:
    """Lanes of traffic near the host, and the sums of their chances."""
    foot = network.host_points(scene.camera, np.zeros(1))[0, :2]
    own = {lane.road for lane in network.way.lanes}
    lanes = [
        lane for lane in network.lanes.values() if lane.width_m > NARROWEST_LANE_M and lane.end_m - lane.start_m > 1.0
    ]
    start_m, end_m = (np.array([getattr(lane, end) for lane in lanes]) for end in ("start_m", "end_m"))
    counts = 2 + ((end_m - start_m) / 10).astype(int)
    which, s = np.repeat(np.arange(len(lanes)), counts), spaced(start_m, end_m, counts)
    is_near = np.hypot(*(network.xy_in_lanes(lanes, which, s) - foot).T) < reach_m
    found, chances = [], []
    for lane, n_near in zip(lanes, np.bincount(which[is_near], minlength=len(lanes)), strict=True):
        if n_near:
            found.append(lane)
            chances.append((lane.end_m - lane.start_m) * (HOST_ROADS_WEIGHT if lane.road in own else 1.0))
    return found, np.cumsum(chances)


def _onward(
    network: Network, lane: NetworkLane, links: Sequence[tuple[str, str]], rng: np.random.Generator
) -> tuple[LaneName, ...]:
    """The lane and lanes that follow each other from it on; where several follow one, each is as likely."""
    route, length_m, at = list[LaneName](), 0.0, lane
    while length_m < 400.0 and len(route) < 60:
        after = [after for before, after in links if before == at.id and after in network.lanes]
        if not after:
            break
        at = network.lanes[after[int(rng.random() * len(after))]]
        route.append(at.id)
        length_m += at.end_m - at.start_m
    return tuple(route)
