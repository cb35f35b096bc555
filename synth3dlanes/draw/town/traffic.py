"""The traffic of a town: cars at the start, the host's drive to its place, and the ways of all through a clip, in
which people come to crosswalks. World frame, metres and seconds."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.draw.crossing import STEP_S, Crosser
from synth3dlanes.draw.draws import Draw, DrawsOf
from synth3dlanes.draw.town.drive import STANDING_M_S, CrosswalkKey, Driver, Gate, TownTraffic, gates_of
from synth3dlanes.draw.town.lanes import LaneLines, Route, lanes_along, street_lanes
from synth3dlanes.draw.town.layout import TownMap
from synth3dlanes.draw.town.paint import CROSSWALK_M, line_m
from synth3dlanes.draw.town.rules import JunctionWay, LightGroup, Lights
from synth3dlanes.draw.town.streets import Street
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.world.placement import HOST_SIZE_M, footprint, touches_any

# Crosswalks farther from the host's way in the clip are left out; people keep this far from a crosswalk's sides.
MAX_FROM_HOST_M, INSIDE_M = 55.0, 0.4
Rng = np.random.Generator
# Distance before its place at which the host starts, and the most time that it takes to get there.
RUN_UP_M, PATIENCE_S = 80.0, 150.0
# Least free length between cars at the start, and the most cars.
LEAST_GAP_M, MAX_CARS = 7.0, 60
# Bodies are apart by this in every direction.
APART_M = 0.12
# In a clip the host stops at this distance before the end of its way, where the map ends.
BEFORE_END_M = 6.0
# The most junctions on a route.
MOST_JUNCTIONS = 4


class Meeting(NamedTuple):
    """Somebody at a crosswalk, and the lights of the lanes that lead across it."""

    key: CrosswalkKey
    crosser: Crosser
    groups: tuple[LightGroup, ...]


def draw_meetings(town_map: TownMap, host_places: Points2, of: DrawsOf, duration_s: float) -> Iterator[Meeting]:
    """Who comes to the crosswalks near the host, each on a strip of its own."""
    people = of("people")
    people("per_100_m")
    n, own = people("crossing"), of("people", "people_crossing")
    for rules in town_map.junctions if town_map.town.has_crosswalks else ():
        for number, arm in enumerate(rules.junction.arms):
            near_m, far_m = CROSSWALK_M
            middle = arm.pose.moved((near_m + far_m) / 2)
            if np.linalg.norm(host_places - [middle.x, middle.y], axis=1).min() > MAX_FROM_HOST_M:
                continue
            has_signals = rules.control == "signals" and not rules.junction.is_roundabout
            groups = {rules.group(number, lane.key) for lane in arm.lanes(incoming=True)} if has_signals else set()
            for i in range(n):
                speed_m_s, (from_left, at, share) = own("speed_m_s"), own.rng.random(3).tolist()
                strip = (i + 0.4 + 0.2 * at) / n
                ahead_m = near_m + INSIDE_M + strip * (far_m - near_m - 2 * INSIDE_M)
                kerbs = [arm.pose.moved(ahead_m, arm.cross.edge(side)) for side in ("left", "right")]
                places = np.array([(pose.x, pose.y) for pose in kerbs])
                places = places if from_left < 0.5 else places[::-1]
                yield Meeting(
                    (rules.junction.id, number),
                    Crosser.draw(places, speed_m_s, share, duration_s),
                    tuple(sorted(groups)),
                )


class CarBody(NamedTuple):
    """A car's model and size."""

    model: int
    scale: float
    length_m: float
    width_m: float


@dataclass(frozen=True)
class MovingCar:
    """A car of a scene: its body, its route, its speed at the scene's instant, and its length along the route at times
    from then on."""

    body: CarBody
    lanes: tuple[str, ...]
    speed_m_s: float
    track: tuple[tuple[float, float], ...]


class TownDrive(NamedTuple):
    """What a simulation leaves: the host's route and track, all other cars, the lights of the junctions, whose shifts
    are those at the scene's instant, and the people at crosswalks in a clip."""

    host: MovingCar
    cars: tuple[MovingCar, ...]
    lights: dict[str, Lights]
    crossers: tuple[Crosser, ...]


class HostPlan(NamedTuple):
    """The host's route, where on it the scene begins, and how far it keeps to the right of the middle of its lane."""

    lanes: tuple[str, ...]
    at_m: float
    offset_m: float = 0.0


class Usual(NamedTuple):
    """What all cars of a town have in common: the parameters; the mean time between two cars that enter a street; a
    number in [0, 1) from which, with the car's own, its speed follows; the seed of all random numbers of the traffic;
    and its density as a share of the densest."""

    own: Draw
    arrival_s: float
    u: float
    seed: int
    flow: float

    @classmethod
    def draw(cls, own: Draw, rng: Rng, flow: float) -> "Usual":
        """The values of one town."""
        return cls(own, own("arrival_s"), own.rng.random(), int(rng.integers(2**62)), flow)


def plan_host(town_map: TownMap, lines: LaneLines, own: Draw, rng: Rng) -> HostPlan:
    """A way of the host through the first junction with the turn that was drawn, and its place before, in or behind."""
    town, rules = town_map.town, town_map.junctions[0]
    ways = [way for way in rules.ways if way.turn == town.host_turn]
    ways = ways or list(rules.ways)
    order = [ways[i] for i in rng.permutation(len(ways)).tolist()]
    found: HostPlan | None = None
    ways_on = _WaysOn(town_map, own)
    for way in order:
        lanes = ways_on.onward(_before(town_map, way.lanes[0]) + list(way.lanes[1:]), rng)
        route = lines.route(lanes)
        first, last = route.place[way.lanes[1]], route.place[way.lanes[-1]]
        enters_m, leaves_m = route.starts[first], route.starts[last]
        if town.host_place == "before":
            at_m = enters_m - town.host_m - 2.0
        elif town.host_place == "in":
            at_m = enters_m + town.host_m / 60.0 * (leaves_m - enters_m)
        else:
            at_m = leaves_m + town.host_m + 2.0
        if at_m >= 12.0:
            return HostPlan(lanes, at_m)
        found = found or HostPlan(lanes, 12.0)
    assert found is not None, "a junction has ways"
    return found


def simulate(
    lines: LaneLines,
    host: HostPlan,
    draw_body: Callable[[bool], CarBody],
    usual: Usual,
    duration_s: float,
    meetings: Callable[[], Iterable[Meeting]],
) -> TownDrive:
    """Traffic until the host is at its place, and from then on for a clip, in which it meets people at crosswalks.
    Where the host does not get there, with fewer cars. `draw_body` draws a car that is long only if it may be."""
    for share in (1.0, 0.4, 0.0):
        fewer = usual._replace(flow=usual.flow * share)
        found = _Simulation(lines.town_map, lines, host, draw_body, fewer).run(duration_s, meetings)
        if found is not None:
            return found
    raise AssertionError("a host alone gets to its place")


class _Simulation:
    def __init__(
        self,
        town_map: TownMap,
        lines: LaneLines,
        host: HostPlan,
        draw_body: Callable[[bool], CarBody],
        usual: Usual,
    ) -> None:
        self.town_map, self.lines, self.flow = town_map, lines, usual.flow
        self.rng = np.random.default_rng(usual.seed)
        self.draw_body, self.usual, self.ways_on = draw_body, usual, _WaysOn(town_map, usual.own)
        self.has_crosswalks = town_map.town.has_crosswalks
        self.lights = {
            each.junction.id: Lights.draw(each, usual.own, self.rng)
            for each in town_map.junctions
            if each.control == "signals"
        }
        # This stream chooses a third of [0, 1), as in earlier versions, and `u` the place in it.
        self.wish_m_s = usual.own.at("speed_m_s", (int(self.rng.integers(3)) + usual.u) / 3)
        self.traffic = TownTraffic(lines, self.lights)
        self.bodies: dict[int, CarBody] = {}
        self._gates: dict[tuple[str, ...], tuple[Gate, ...]] = {}
        start_m = max(host.at_m - RUN_UP_M, 6.0)
        self.host = self._driver(host.lanes, start_m, HOST_SIZE_M[0], 0.0)
        self.host.is_host = True
        self.host.speed_m_s = 0.7 * self.host.limits[self.host.lane]
        self.traffic.drivers.append(self.host)
        self.at_m, self.host_offset_m = host.at_m, host.offset_m
        self._fill()

    def run(self, duration_s: float, meetings: Callable[[], Iterable[Meeting]]) -> TownDrive | None:
        """Drive; None if the host does not get to its place."""
        entries = self._entries()
        waits = {entry: float(self.rng.exponential(self.usual.arrival_s / max(self.flow, 0.05))) for entry in entries}
        traffic = self.traffic
        while self.host.at_m < self.at_m:
            if traffic.time_s > PATIENCE_S:
                return None
            traffic.step()
            for entry in entries:
                waits[entry] -= STEP_S
                if waits[entry] < 0 and self.flow > 0:
                    waits[entry] = float(self.rng.exponential(self.usual.arrival_s / self.flow))
                    self._come(entry)
            traffic.drivers = [driver for driver in traffic.drivers if driver.is_host or not driver.is_done]
        self.host.at_m = self.at_m
        self.host.stops_m = self.host.route.length_m - BEFORE_END_M
        self._remove_touching([driver.at_m for driver in traffic.drivers])
        tracks = {id(driver): [(0.0, driver.at_m)] for driver in traffic.drivers}
        speeds = {
            id(driver): driver.speed_m_s if driver.speed_m_s > STANDING_M_S else 0.0 for driver in traffic.drivers
        }
        shift_s = traffic.time_s
        met = [*meetings()] if duration_s else []
        for meeting in met:
            traffic.meet(*meeting)
        for n in range(int(np.ceil(duration_s / STEP_S - 1e-9))):
            traffic.step()
            for driver in traffic.drivers:
                tracks[id(driver)].append((round((n + 1) * STEP_S, 3), driver.at_m))
        keep = self._apart(tracks)
        lights = {
            name: at._replace(shift_s=round((at.shift_s + shift_s) % at.cycle_s, 3)) for name, at in self.lights.items()
        }
        moving = [self._moving(driver, speeds[id(driver)], tracks[id(driver)]) for driver in keep]
        return TownDrive(moving[0], tuple(moving[1:]), lights, tuple(meeting.crosser for meeting in met))

    def _moving(self, driver: Driver, speed_m_s: float, track: Sequence[tuple[float, float]]) -> MovingCar:
        rounded = tuple((time_s, round(at_m, 4)) for time_s, at_m in track)
        body = self.bodies.get(id(driver), CarBody(0, 1.0, *HOST_SIZE_M))
        return MovingCar(body, driver.route.lanes, speed_m_s, rounded)

    def _driver(self, lanes: tuple[str, ...], at_m: float, length_m: float, speed_m_s: float) -> Driver:
        route = self.lines.route(lanes)
        if lanes not in self._gates:
            self._gates[lanes] = gates_of(route, self.town_map.junctions, self.has_crosswalks)
        wish_m_s = self.wish_m_s * float(self.rng.uniform(0.85, 1.08))
        return Driver(route, self._gates[lanes], length_m, wish_m_s, at_m, speed_m_s)

    def _add(self, lanes: Sequence[str], at_m: float, speed_m_s: float) -> bool:
        """Add a car on its way from these lanes on, if there is room for it."""
        route = self.ways_on.onward(list(lanes), self.rng)
        is_straight = all(self._is_straight(lane) for lane in route)
        body = self.draw_body(is_straight)
        driver = self._driver(route, at_m, body.length_m, speed_m_s)
        here = {driver.route.lanes[k] for k in (driver.lane, max(driver.lane - 1, 0))}
        aways_m = np.linalg.norm(np.stack([other.xy for other in self.traffic.drivers]) - driver.xy, axis=-1)
        for other, away_m in zip(self.traffic.drivers, aways_m.tolist(), strict=True):
            touching_m = (driver.length_m + other.length_m) / 2
            if away_m < touching_m + LEAST_GAP_M:
                near = not here.isdisjoint(other.route.lanes[other.lane :])
                if near or away_m < min(touching_m, 2.5):
                    return False
        driver.speed_m_s = min(driver.speed_m_s, driver.limits[driver.lane])
        self.bodies[id(driver)] = body
        self.traffic.drivers.append(driver)
        return True

    def _is_straight(self, lane: str) -> bool:
        connector = self.lines.connectors.get(lane)
        return connector is None or (connector.turn == "straight" and connector.from_arm is not None)

    def _fill(self) -> None:
        """Cars along all streets, and in turn lanes."""
        for street in self.town_map.streets:
            for side, key in lanes_along(street):
                names = street_lanes(street, side, key)
                names = names if side == "right" else names[::-1]
                route = self.lines.route(tuple(names))
                at_m = float(self.rng.uniform(4, 40))
                while at_m < route.length_m - 5 and len(self.traffic.drivers) < MAX_CARS:
                    if self.flow > 0 and self.rng.random() < 0.8:
                        k = next(k for k, start in enumerate(route.starts[1:]) if at_m < start)
                        self._add(names[k:], at_m - route.starts[k], float(self.rng.uniform(3, 10)))
                    at_m += LEAST_GAP_M + 5 + float(self.rng.exponential(55 * (1.1 - self.flow)))
            for names in self._pockets(street):
                length_m = self.lines[names[0]].length_m
                at_m = length_m - line_m(self.has_crosswalks) - 4
                while at_m > 4 and self.rng.random() < 0.7 * self.flow + 0.1 and self.flow > 0:
                    self._add(names, at_m, 0.0)
                    at_m -= 8.0

    def _pockets(self, street: Street) -> list[list[str]]:
        """The turn lanes of a street, where they have their width."""
        found = []
        for section, side, pocket in ((0, "left", street.start), (len(street.pieces) - 1, "right", street.end)):
            names = street.names(section)[side]
            if pocket is not None:
                found += [[names[key]] for key in ("turn_left", "turn_right") if key in names]
        return found

    def _entries(self) -> list[tuple[str, ...]]:
        """The lanes by which cars come: from the far ends of streets, and into turn lanes."""
        found = []
        for street in self.town_map.streets:
            found += [tuple(names) for names in self._pockets(street)]
            if street.end is None:
                for side, key in lanes_along(street):
                    if side == "left":
                        names = street_lanes(street, side, key)
                        found.append(tuple(names[::-1]))
        return found

    def _come(self, entry: tuple[str, ...]) -> None:
        if len(self.traffic.drivers) < MAX_CARS:
            self._add(entry, 5.0, 7.0)

    def _remove_touching(self, at: Sequence[float]) -> None:
        drivers = self.traffic.drivers
        touching = _touching([self._bodies_at(driver, np.array([m])) for driver, m in zip(drivers, at, strict=True)])
        self.traffic.drivers = [driver for driver, bad in zip(drivers, touching, strict=True) if not bad]

    def _apart(self, tracks: dict[int, list[tuple[float, float]]]) -> list[Driver]:
        """The cars that touch no other one at any time and are on their routes to the end; the host first."""
        drivers = self.traffic.drivers
        on = [
            driver
            for driver in drivers
            if driver.is_host or tracks[id(driver)][-1][1] < driver.route.length_m - driver.length_m / 2
        ]
        places = []
        for driver in on:
            times, lengths = np.array(tracks[id(driver)]).T
            fine = np.linspace(0, times[-1], 4 * (len(times) - 1) + 1)
            places.append(self._bodies_at(driver, np.interp(fine, times, lengths)))
        return [driver for driver, bad in zip(on, _touching(places), strict=True) if not bad]

    def _bodies_at(self, driver: Driver, lengths_m: np.ndarray) -> np.ndarray:
        body = self.bodies.get(id(driver), CarBody(0, 1.0, *HOST_SIZE_M))
        return body_places(driver.route, lengths_m, body, self.host_offset_m if driver.is_host else 0.0)


def body_places(route: Route, lengths_m: Scalars, body: CarBody, offset_m: float = 0.0) -> Float[np.ndarray, "n 4 2"]:
    """The corners of a car at lengths along its route, `offset_m` to the right of it, with the room that it needs."""
    xy, heading = route.at(lengths_m)
    right = np.stack([heading[:, 1], -heading[:, 0]], -1)
    return footprint(xy + offset_m * right, heading, body.length_m + 2 * APART_M, body.width_m + 2 * APART_M)


def _touching(places: Sequence[np.ndarray]) -> list[bool]:
    """Which cars touch an earlier car that stays, by their footprints at all times. The first car always stays."""
    found: list[bool] = []
    for i, mine in enumerate(places):
        stays = [places[j] for j in range(i) if not found[j]]
        found.append(bool(stays) and touches_any(mine, np.stack(stays)))
    return found


def _before(town_map: TownMap, lane: str) -> list[str]:
    """The lanes that lead to a lane before a junction, from the beginning of its street, and itself."""
    before = {b: a for street in town_map.streets for a, b in street.links}
    found = [lane]
    while found[0] in before:
        found.insert(0, before[found[0]])
    return found


class _WaysOn:
    """How lanes go on in a town: along streets, and at junctions by ways that are drawn by their turns."""

    def __init__(self, town_map: TownMap, own: Draw) -> None:
        self.after = {a: b for street in town_map.streets for a, b in street.links}
        self.turns = own.weights("turn")
        self.ways: dict[str, list[JunctionWay]] = {}
        for rules in town_map.junctions:
            for way in rules.ways:
                self.ways.setdefault(way.lanes[0], []).append(way)

    def onward(self, lanes: Sequence[str], rng: Rng) -> tuple[str, ...]:
        """A route from its lanes on."""
        found, passed = list(lanes), 0
        while True:
            last = found[-1]
            if last in self.after:
                found.append(self.after[last])
            elif last in self.ways and passed < MOST_JUNCTIONS:
                ways = self.ways[last]
                weights = np.array([self.turns.get(way.turn, 0.0) for way in ways])
                weights = weights if weights.any() else np.ones(len(weights))
                way = ways[int(rng.choice(len(weights), p=weights / weights.sum()))]
                if not set(found).isdisjoint(way.lanes[1:]):
                    break
                found += way.lanes[1:]
                passed += 1
            else:
                break
        return tuple(found)
