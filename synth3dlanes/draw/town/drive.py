"""A small simulation of traffic: cars follow each other, keep to speeds that bends allow, obey signals and priority,
and enter a junction only where their way is free. World frame, metres and seconds; lengths are of cars' middles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.draw.crossing import STEP_S, Crosser
from synth3dlanes.draw.town.junctions import Arm
from synth3dlanes.draw.town.lanes import LaneLines, Route
from synth3dlanes.draw.town.paint import CROSSWALK_M, line_m
from synth3dlanes.draw.town.rules import Conflict, JunctionRules, LightGroup, Lights
from synth3dlanes.draw.town.streets import LaneAt
from synth3dlanes.system.arrays import Points2

# The intelligent driver model: acceleration, comfortable deceleration, time gap, standing gap; and the hardest braking.
ACCELERATION_M_S2, DECELERATION_M_S2, HEADWAY_S, GAP_M, HARDEST_BRAKING_M_S2 = 1.8, 2.2, 1.2, 2.2, 7.0
# Sideways acceleration in bends, and how far ahead a driver looks for bends.
SIDEWAYS_M_S2, LOOK_AHEAD_M = 2.6, 70.0
# Distance at which a car stops before a line, and before an occupied zone of a junction; the time for which a zone must
# be free before a car enters it and after it has left.
BEFORE_LINE_M, BEFORE_ZONE_M, APART_S = 0.6, 1.0, 1.0
# After PATIENCE_S at standstill, which is below STANDING_M_S, a car goes before others that stand.
PATIENCE_S, STANDING_M_S = 3.0, 0.3
# A car that stands farther before the line than this is not the first: it waits for those in front of it.
FIRST_IN_LINE_M = 6.0
# A car begins to brake for a stop this much earlier than its braking distance demands.
BRAKING_ROOM_M = 12.0
# A car that cannot stop within this deceleration goes on at amber.
AMBER_BRAKING_M_S2 = 3.0
# People at a crosswalk wait for cars that are faster than ROLLING_M_S and at most FAR_M away.
ROLLING_M_S, FAR_M = 2.0, 70.0
# A crosswalk by its junction and arm.
CrosswalkKey = tuple[str, int]


class Zone(NamedTuple):
    """Where a car's way is too close to another lane: lengths along its route, and along that lane."""

    from_m: float
    to_m: float
    conflict: Conflict


class CrosswalkWay(NamedTuple):
    """A crosswalk on a route: lengths along the route, the sides of the lane there, and whether it is behind the
    junction."""

    key: CrosswalkKey
    from_m: float
    to_m: float
    sides: Points2
    is_behind: bool


class Gate(NamedTuple):
    """The line before a junction on a route: where bodies stop, where its lanes begin and end, the zones in it, the
    signal, and the crosswalks before and behind it."""

    line_m: float
    start_m: float
    end_m: float
    zones: tuple[Zone, ...]
    group: LightGroup
    rules: JunctionRules
    lanes: tuple[str, ...]
    crosswalks: tuple[CrosswalkWay, ...] = ()

    @property
    def has_signals(self) -> bool:
        """Whether lights say when to enter."""
        return self.rules.control == "signals" and not self.rules.junction.is_roundabout


@dataclass(eq=False)
class Driver:
    """A car in the simulation: its route, size, and state. Its front stops at `stops_m` of its route."""

    route: Route
    gates: tuple[Gate, ...]
    length_m: float
    wish_m_s: float
    at_m: float
    speed_m_s: float
    is_host: bool = False
    stops_m: float = math.inf
    gate: int = 0
    entered: bool = False
    stood_s: float = 0.0
    lane: int = 0
    limits: list[float] = field(default_factory=list)
    _placed: tuple[float, Float[np.ndarray, "2"]] | None = None

    def __post_init__(self) -> None:
        self.limits = [min(self.wish_m_s, math.sqrt(SIDEWAYS_M_S2 / max(bend, 1e-4))) for bend in self.route.sharpest]
        self.place()
        while self.gate < len(self.gates) and self.at_m > self.gates[self.gate].line_m - self.length_m / 2:
            if self.at_m < self.gates[self.gate].end_m + self.length_m / 2:
                self.entered = True
                break
            self.gate += 1

    def place(self) -> None:
        """Note on which of its lanes it is."""
        starts = self.route.starts
        while self.lane + 2 < len(starts) and starts[self.lane + 1] <= self.at_m:
            self.lane += 1

    @property
    def xy(self) -> Float[np.ndarray, "2"]:
        """Where its middle is."""
        if self._placed is None or self._placed[0] != self.at_m:
            self._placed = self.at_m, self.route.xy(np.array([self.at_m]))[0]
        return self._placed[1]

    @property
    def is_done(self) -> bool:
        """Whether it is at the end of its route."""
        return self.at_m > self.route.length_m - self.length_m / 2 - 1


def gates_of(route: Route, rules: tuple[JunctionRules, ...], has_crosswalks: bool) -> tuple[Gate, ...]:
    """The lines on a route, in order."""
    owners = {at.lane: each for each in rules for at in each.junction.connectors}
    found: list[Gate] = []
    k = 0
    while k < len(route.lanes):
        each = owners.get(route.lanes[k])
        if each is None:
            k += 1
            continue
        first = k
        while k < len(route.lanes) and owners.get(route.lanes[k]) is each:
            k += 1
        inside = route.lanes[first:k]
        zones = tuple(
            Zone(route.starts[first + n] + at.from_m, route.starts[first + n] + at.to_m, at)
            for n, lane in enumerate(inside)
            for at in each.conflicts
            if at.lane == lane and at.other not in inside
        )
        start, end = (next(at for at in each.junction.connectors if at.lane == inside[n]) for n in (0, -1))
        assert start.from_arm is not None, "routes enter junctions from arms"
        keys = {lane.name: lane.key for lane in each.junction.arms[start.from_arm].lanes(incoming=True)}
        group = each.group(start.from_arm, keys[start.before[0]])
        # The line is on the lane before: it is part of the route, or the car begins in the junction.
        line = route.starts[first] - line_m(has_crosswalks) - BEFORE_LINE_M
        start_m, end_m, ways = route.starts[first], route.starts[k], list[CrosswalkWay]()
        if has_crosswalks:
            near_m, far_m = CROSSWALK_M
            for number, name, lengths_m in (
                (start.from_arm, start.before[0], (start_m - far_m, start_m - near_m)),
                (end.to_arm, end.after[0], (end_m + near_m, end_m + far_m)),
            ):
                assert number is not None, "routes leave junctions by arms"
                arm, is_behind = each.junction.arms[number], lengths_m[0] > start_m
                lane = next(lane for lane in arm.lanes(incoming=not is_behind) if lane.name == name)
                ways.append(CrosswalkWay((each.junction.id, number), *lengths_m, _sides(arm, lane), is_behind))
        found.append(Gate(line, start_m, end_m, zones, group, each, inside, tuple(ways)))
    return tuple(found)


def _sides(arm: Arm, lane: LaneAt) -> Points2:
    """Points at both sides of a lane at the crosswalk of its arm."""
    at = [arm.pose.moved(sum(CROSSWALK_M) / 2, lane.offset_m + by * lane.width_m / 2) for by in (-1, 1)]
    return np.array([(pose.x, pose.y) for pose in at])


class TownTraffic:
    """All cars on the streets of a town, and in clips the people at its crosswalks."""

    def __init__(self, lines: LaneLines, lights: dict[str, Lights]) -> None:
        self.lines, self.lights = lines, lights
        self.drivers: list[Driver] = []
        self.crossers: dict[CrosswalkKey, list[Crosser]] = {}
        self.time_s = 0.0
        self._on: dict[str, list[tuple[Driver, float]]] = {}
        self._bound_for: dict[str, list[Driver]] = {}
        self._groups: dict[CrosswalkKey, Sequence[LightGroup]] = {}

    def meet(self, key: CrosswalkKey, crosser: Crosser, groups: Sequence[LightGroup]) -> None:
        """Let somebody come to a crosswalk, whose vehicles these lights stop."""
        self._on = self._occupied()
        self._groups[key] = groups
        crosser.begin(partial(self._may_cross, key, crosser))
        self.crossers.setdefault(key, []).append(crosser)

    def step(self) -> None:
        """Move all by STEP_S."""
        self._on, self._bound_for = self._occupied(), self._coming()
        for key, crossers in self.crossers.items():
            for crosser in crossers:
                crosser.step(partial(self._may_cross, key, crosser))
        wanted_m_s2 = [self._acceleration(driver) for driver in self.drivers]
        for driver, acceleration_m_s2 in zip(self.drivers, wanted_m_s2, strict=True):
            speed_m_s = max(0.0, driver.speed_m_s + acceleration_m_s2 * STEP_S)
            driver.at_m += (driver.speed_m_s + speed_m_s) / 2 * STEP_S
            driver.speed_m_s = speed_m_s
            driver.stood_s = driver.stood_s + STEP_S if speed_m_s < STANDING_M_S else 0.0
            driver.place()
            self._pass(driver)
        self.time_s += STEP_S

    def _pass(self, driver: Driver) -> None:
        if driver.gate >= len(driver.gates):
            return
        gate = driver.gates[driver.gate]
        if not driver.entered and driver.at_m + driver.length_m / 2 > gate.line_m + BEFORE_LINE_M:
            driver.entered = True
        if driver.at_m - driver.length_m / 2 > gate.end_m:
            driver.gate, driver.entered = driver.gate + 1, False

    def _occupied(self) -> dict[str, list[tuple[Driver, float]]]:
        """For each lane, the cars whose bodies are on it, and where their middles are along it."""
        found: dict[str, list[tuple[Driver, float]]] = {}
        for driver in self.drivers:
            starts, half = driver.route.starts, driver.length_m / 2
            k = driver.lane
            while k > 0 and starts[k] > driver.at_m - half:
                k -= 1
            while k < len(driver.route.lanes) and starts[k] < driver.at_m + half:
                found.setdefault(driver.route.lanes[k], []).append((driver, driver.at_m - starts[k]))
                k += 1
        return found

    def _coming(self) -> dict[str, list[Driver]]:
        """For each junction, the cars whose next junction it is, or that are in it."""
        found: dict[str, list[Driver]] = {}
        for driver in self.drivers:
            if driver.gate < len(driver.gates):
                found.setdefault(driver.gates[driver.gate].rules.junction.id, []).append(driver)
        return found

    def _acceleration(self, driver: Driver) -> float:
        starts, limit_m_s = driver.route.starts, driver.limits[driver.lane]
        k = driver.lane + 1
        while k < len(driver.limits) and starts[k] - driver.at_m < LOOK_AHEAD_M:
            before_m = max(starts[k] - driver.at_m - driver.length_m / 4, 0.0)
            limit_m_s = min(limit_m_s, math.sqrt(driver.limits[k] ** 2 + 2 * 1.8 * before_m))
            k += 1
        wanted_m_s2 = _following(driver.speed_m_s, limit_m_s, *self._leader(driver))
        for stop_m in (self._stop(driver), _stop_at_end(driver)):
            if stop_m is not None:
                wanted_m_s2 = min(wanted_m_s2, _following(driver.speed_m_s, limit_m_s, stop_m + GAP_M, 0.0))
        if driver.speed_m_s > limit_m_s:
            wanted_m_s2 = min(wanted_m_s2, (limit_m_s - driver.speed_m_s) / STEP_S)
        return max(wanted_m_s2, -HARDEST_BRAKING_M_S2)

    def _leader(self, driver: Driver) -> tuple[float, float]:
        """The gap to the next car on the same way, and its speed."""
        gap_m, speed_m_s = LOOK_AHEAD_M, driver.speed_m_s + 5.0
        starts = driver.route.starts
        k = driver.lane
        while k < len(driver.route.lanes) and starts[k] - driver.at_m < LOOK_AHEAD_M:
            for other, at_m in self._on.get(driver.route.lanes[k], ()):
                ahead_m = starts[k] + at_m - driver.at_m
                if other is driver or ahead_m <= 0:
                    continue
                free_m = ahead_m - (driver.length_m + other.length_m) / 2
                if free_m < gap_m:
                    gap_m, speed_m_s = free_m, other.speed_m_s
            k += 1
        return gap_m, speed_m_s

    def _stop(self, driver: Driver) -> float | None:
        """The distance to the point where it has to stop, for a line or for an occupied zone; None if it need not."""
        if driver.gate >= len(driver.gates):
            return None
        gate = driver.gates[driver.gate]
        front_m = driver.at_m + driver.length_m / 2
        if driver.entered:
            stops = [self._occupied_zone(driver, gate, front_m)]
            for way in gate.crosswalks:
                if way.is_behind and way.from_m > front_m and self._goes_before(way, driver):
                    stops.append(max(way.from_m - BEFORE_ZONE_M - front_m, 0.0))
            return min((at_m for at_m in stops if at_m is not None), default=None)
        before_m = gate.line_m - front_m
        if _is_far(driver, before_m):
            return None
        if self._may_enter(driver, gate, before_m):
            return None
        return max(before_m, 0.0)

    def _may_enter(self, driver: Driver, gate: Gate, before_m: float) -> bool:
        if gate.has_signals:
            state = self.lights[gate.rules.junction.id].state(gate.group, self.time_s)
            braking_m_s2 = driver.speed_m_s**2 / (2 * max(before_m, 0.1))
            if state in ("red", "red_amber", "off") or (state == "amber" and braking_m_s2 < AMBER_BRAKING_M_S2):
                return False
        elif self._must_stop(driver, gate, before_m):
            return False
        if any(self._lets_cross_at(driver, gate, way, before_m) for way in gate.crosswalks):
            return False
        return self._has_room_behind(driver, gate) and all(self._is_free(driver, gate, zone) for zone in gate.zones)

    def _must_stop(self, driver: Driver, gate: Gate, before_m: float) -> bool:
        """Whether it is at a stop sign and has not stood yet."""
        return gate.rules.control == "stop" and gate.group == "minor" and not (driver.stood_s > 0.5 and before_m < 3)

    def _has_room_behind(self, driver: Driver, gate: Gate) -> bool:
        """Whether the lane behind the junction has room for it, unless traffic moves there."""
        place = driver.route.place[gate.lanes[-1]] + 1
        if place >= len(driver.route.lanes):
            return True
        room_m = driver.length_m + GAP_M
        for lane in (*gate.lanes, driver.route.lanes[place]):
            for other, at_m in self._on.get(lane, ()):
                its_m = driver.route.starts[driver.route.place[lane]] + at_m
                is_ahead = other is not driver and its_m > driver.at_m and at_m > -other.length_m
                if is_ahead and other.speed_m_s < 2.0 and its_m - other.length_m / 2 - gate.end_m < room_m:
                    return False
        return True

    def _is_free(self, driver: Driver, gate: Gate, zone: Zone) -> bool:
        """Whether it may drive through a zone: no car is there then that is in the junction or goes first."""
        lane, half = zone.conflict.other, driver.length_m / 2
        if zone.to_m < driver.at_m - half:
            return True
        mine = _time(zone.from_m - half - driver.at_m, driver), _time(zone.to_m + half - driver.at_m, driver)
        yields = (zone.conflict.lane, lane) in gate.rules.yields
        for other in self._bound_for[gate.rules.junction.id]:
            place = other.route.place.get(lane)
            if other is driver or place is None:
                continue
            its = other.gates[other.gate]
            start, reach = other.route.starts[place], other.length_m / 2
            from_m, to_m = start + zone.conflict.other_from_m - reach, start + zone.conflict.other_to_m + reach
            if other.at_m > to_m:
                continue
            theirs = _time(from_m - other.at_m, other), _time(to_m - other.at_m, other)
            if not other.entered and (not yields or not self._goes_first(driver, other, its)):
                continue
            if theirs[0] - APART_S < mine[1] and mine[0] - APART_S < theirs[1]:
                return False
        return True

    def _goes_first(self, driver: Driver, other: Driver, gate: Gate) -> bool:
        """Whether a car that has priority and has not entered takes it."""
        if gate.has_signals:
            state = self.lights[gate.rules.junction.id].state(gate.group, self.time_s)
            if state not in ("green", "amber"):
                return False
        if other.stood_s == 0:
            return True
        if gate.line_m - other.at_m - other.length_m / 2 > FIRST_IN_LINE_M:
            return False
        mine = (driver.stood_s - PATIENCE_S, -self.drivers.index(driver))
        return driver.stood_s < PATIENCE_S or mine < (other.stood_s - PATIENCE_S, -self.drivers.index(other))

    def _occupied_zone(self, driver: Driver, gate: Gate, front_m: float) -> float | None:
        """How far ahead the next zone is in which another car's body is."""
        nearest = None
        for zone in gate.zones:
            if zone.to_m < front_m or (zone.from_m < front_m - 1.0):
                continue
            for other, at_m in self._on.get(zone.conflict.other, ()):
                reach = other.length_m / 2
                is_in = zone.conflict.other_from_m < at_m + reach and at_m - reach < zone.conflict.other_to_m
                if other is not driver and is_in:
                    before_m = max(zone.from_m - BEFORE_ZONE_M - front_m, 0.0)
                    nearest = before_m if nearest is None else min(nearest, before_m)
        return nearest

    # -- people at crosswalks

    def _lets_cross_at(self, driver: Driver, gate: Gate, way: CrosswalkWay, before_m: float) -> bool:
        """Whether it waits at its line for somebody at a crosswalk."""
        if way.is_behind:
            return self._goes_before(way, driver) and not self._has_room_inside(driver, gate, way)
        braking_m_s2 = driver.speed_m_s**2 / (2 * max(before_m, 0.1))
        waits = braking_m_s2 < DECELERATION_M_S2 and not gate.has_signals
        return self._goes_before(way, driver) or (
            waits and any(at.wants_to_cross for at in self.crossers.get(way.key, ()))
        )

    def _goes_before(self, way: CrosswalkWay, driver: Driver) -> bool:
        """Whether somebody who crosses is on a car's lane, or will be before the car has passed."""
        return any(
            at.started and at.gone_m < at.within(way.sides)[1] and not _passes_before(driver, way, at)
            for at in self.crossers.get(way.key, ())
        )

    def _may_cross(self, key: CrosswalkKey, crosser: Crosser) -> bool:
        """Whether somebody may cross now: lights keep vehicles away until the other side is reached, and every vehicle
        that comes passes before or can stop."""
        if groups := self._groups[key]:
            lights, over_s = self.lights[key[0]], crosser.seconds_to(crosser.across_m)
            times_s = self.time_s + np.append(np.arange(0.0, over_s, 0.5), over_s)
            if any(lights.state(group, time_s) != "red" for group in groups for time_s in times_s.tolist()):
                return False
        return all(
            self._lets(driver, gate, way, crosser)
            for driver in self.drivers
            for gate in driver.gates[driver.gate :]
            for way in gate.crosswalks
            if way.key == key
        )

    def _lets(self, driver: Driver, gate: Gate, way: CrosswalkWay, crosser: Crosser) -> bool:
        """Whether a car is past a crosswalk, passes it before somebody is on its lane, or can stop before it."""
        half, has_entered = driver.length_m / 2, driver.entered and gate is driver.gates[driver.gate]
        front_m = driver.at_m + half
        if (
            driver.at_m - half > way.to_m
            or way.from_m - front_m > FAR_M
            or crosser.gone_m > crosser.within(way.sides)[1]
        ):
            return True
        if _passes_before(driver, way, crosser):
            return True
        if front_m > way.from_m or (has_entered and not way.is_behind):
            return False
        stop_m = gate.line_m
        if way.is_behind and self._has_room_inside(driver, gate, way):
            stop_m = way.from_m - BEFORE_ZONE_M
        elif has_entered:
            return False
        return stop_m - front_m > driver.speed_m_s**2 / (2 * DECELERATION_M_S2) + driver.speed_m_s * 2 * STEP_S - 0.5

    def _has_room_inside(self, driver: Driver, gate: Gate, way: CrosswalkWay) -> bool:
        """Whether a car alone fits between the crosswalks before and behind a junction."""
        if way.from_m - BEFORE_ZONE_M - driver.length_m < gate.start_m:
            return False
        return not any(other is not driver for lane in gate.lanes for other, _ in self._on.get(lane, ()))


def _passes_before(driver: Driver, way: CrosswalkWay, crosser: Crosser) -> bool:
    """Whether a car at its speed is past a crosswalk before somebody is on its lane."""
    if driver.speed_m_s < ROLLING_M_S:
        return False
    past_s = (way.to_m + driver.length_m / 2 - driver.at_m) / driver.speed_m_s
    return past_s + APART_S < crosser.seconds_to(crosser.within(way.sides)[0])


def _is_far(driver: Driver, before_m: float) -> bool:
    """Whether it need not brake yet for a place that is this far before its front."""
    return before_m > driver.speed_m_s**2 / (2 * DECELERATION_M_S2) + BRAKING_ROOM_M


def _stop_at_end(driver: Driver) -> float | None:
    """The distance to the place where it stops for good; None while that is far."""
    before_m = driver.stops_m - driver.at_m - driver.length_m / 2
    return None if _is_far(driver, before_m) else max(before_m, 0.0)


def _following(speed_m_s: float, limit_m_s: float, gap_m: float, leader_m_s: float) -> float:
    """The acceleration of the intelligent driver model."""
    free = 1 - (speed_m_s / max(limit_m_s, 0.5)) ** 4
    wanted_m = GAP_M + max(
        0.0,
        speed_m_s * HEADWAY_S
        + speed_m_s * (speed_m_s - leader_m_s) / (2 * math.sqrt(ACCELERATION_M_S2 * DECELERATION_M_S2)),
    )
    return ACCELERATION_M_S2 * (free - (wanted_m / max(gap_m, 0.1)) ** 2)


def _time(way_m: float, driver: Driver) -> float:
    """Seconds until a car has driven a distance, if it speeds up to the speed of turning; less than 0 if it has."""
    if way_m <= 0:
        return -1.0
    speed_m_s, top_m_s = driver.speed_m_s, max(driver.speed_m_s, min(driver.wish_m_s, 7.0))
    reach_m = (top_m_s**2 - speed_m_s**2) / (2 * ACCELERATION_M_S2)
    if way_m < reach_m:
        return (math.sqrt(speed_m_s**2 + 2 * ACCELERATION_M_S2 * way_m) - speed_m_s) / ACCELERATION_M_S2
    return (top_m_s - speed_m_s) / ACCELERATION_M_S2 + (way_m - reach_m) / top_m_s
