"""The rules of a junction: its ways from lane to lane, where these cross or merge, which yields to which, and when its
signals are green: phases one after the other, each for a group of lanes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from synth3dlanes.draw.draws import Draw
from synth3dlanes.draw.town.junctions import Connector, TownJunction, Turn, turn_of
from synth3dlanes.draw.town.plan import sampled
from synth3dlanes.geometry.polylines import distances_between
from synth3dlanes.scene.town import Control
from synth3dlanes.scene.traffic_elements import Phase, SignalState

# Lanes before a junction whose signals change together.
LightGroup = Literal["major", "major_left", "minor"]
# Ways closer than this cannot be driven at the same time: the width of a truck and some air.
TOUCH_M, WAY_STEP_M = 2.75, 0.5
# An arm is on the right of another between these angles.
RIGHT_RAD = np.radians(30.0), np.radians(150.0)
AMBER_S, RED_AMBER_S, CLEAR_S = 3.0, 1.0, 2.0


class Conflict(NamedTuple):
    """Where a lane of a junction is too close to another one: lengths along the first and along the second."""

    lane: str
    other: str
    from_m: float
    to_m: float
    other_from_m: float
    other_to_m: float


class JunctionWay(NamedTuple):
    """A way through a junction: the arms, the lane before it, its lanes, the lane behind it, and its turn."""

    from_arm: int
    to_arm: int
    lanes: tuple[str, ...]
    turn: Turn

    @property
    def inside(self) -> tuple[str, ...]:
        """Its lanes in the junction."""
        return self.lanes[1:-1]


@dataclass(frozen=True)
class JunctionRules:
    """A junction with its control. `major` are the arms of the priority road."""

    junction: TownJunction
    control: Control
    major: tuple[int, ...]

    def has_arrow(self, arm: int) -> bool:
        """Whether the left turn lane of an arm has a signal of its own, an arrow."""
        if self.control != "signals" or arm not in self.major:
            return False
        return "turn_left" in self.junction.arms[arm].cross.left

    @cached_property
    def conflicts(self) -> tuple[Conflict, ...]:
        """All pairs of lanes that cross or merge, each both ways."""
        found = []
        connectors = self.junction.connectors
        points = [sampled(at.plan, WAY_STEP_M) for at in connectors]
        boxes = [(each.min(axis=0), each.max(axis=0)) for each in points]
        for i, one in enumerate(connectors):
            for j in range(i):
                other = connectors[j]
                apart = np.maximum(boxes[i][0] - boxes[j][1], boxes[j][0] - boxes[i][1]).max()
                if apart > TOUCH_M or set(one.before) & set(other.before) or _follow(one, other):
                    continue
                distance = distances_between(points[i], points[j])
                at_one, at_other = (np.flatnonzero((distance < TOUCH_M).any(axis=axis)) for axis in (1, 0))
                if len(at_one):
                    spans = _span(one, at_one, len(points[i])), _span(other, at_other, len(points[j]))
                    found.append(Conflict(one.lane, other.lane, *spans[0], *spans[1]))
                    found.append(Conflict(other.lane, one.lane, *spans[1], *spans[0]))
        return tuple(found)

    @cached_property
    def yields(self) -> tuple[tuple[str, str], ...]:
        """Pairs of lanes that cross or merge; the first yields to the second. Every pair that no signal keeps apart is
        there once."""
        places = {at.lane: i for i, at in enumerate(self.junction.connectors)}
        found = set()
        for at in self.conflicts:
            one, other = (self.junction.connectors[places[lane]] for lane in (at.lane, at.other))
            if self._are_kept_apart(one, other) or self._gives_way(other, one):
                continue
            # Without a rule, as for opposite left turns that cross, the later one in the list yields.
            if self._gives_way(one, other) or places[at.lane] > places[at.other]:
                found.add((at.lane, at.other))
        return tuple(sorted(found))

    def group(self, arm: int, key: str) -> LightGroup:
        """Which lights the lane `key` before the junction has."""
        if arm not in self.major:
            return "minor"
        return "major_left" if key == "turn_left" and self.has_arrow(arm) else "major"

    def _are_kept_apart(self, one: Connector, other: Connector) -> bool:
        """Whether the lights of two connectors are green at different times."""
        if self.control != "signals" or self.junction.is_roundabout:
            return False
        return self._group_before(one) != self._group_before(other)

    def _group_before(self, connector: Connector) -> LightGroup:
        assert connector.from_arm is not None, "lanes of crossings come from arms"
        lanes = self.junction.arms[connector.from_arm].lanes(incoming=True)
        return self.group(connector.from_arm, next(lane.key for lane in lanes if lane.name == connector.before[0]))

    def _gives_way(self, one: Connector, other: Connector) -> bool:
        """Whether `one` yields to `other` by a rule of the road."""
        if self.junction.is_roundabout:
            # To the ring: those who enter it, and those who leave it across its outer lane.
            is_ring = other.from_arm is None and other.to_arm is None
            return is_ring and (one.from_arm is not None or one.to_arm is not None)
        assert one.from_arm is not None, "lanes of crossings come from arms"
        assert other.from_arm is not None, "lanes of crossings come from arms"
        ranks = one.from_arm in self.major, other.from_arm in self.major
        if self.control in ("priority", "stop") and ranks[0] != ranks[1]:
            return ranks[1]
        arms = self.junction.arms
        angle = (arms[other.from_arm].pose.heading - arms[one.from_arm].pose.heading) % (2 * np.pi)
        if self.control == "equal" and RIGHT_RAD[0] < angle < RIGHT_RAD[1]:
            return True
        is_opposite = RIGHT_RAD[1] <= angle <= 2 * np.pi - RIGHT_RAD[1]
        return bool(is_opposite and one.turn == "left" and other.turn != "left")

    @cached_property
    def ways(self) -> tuple[JunctionWay, ...]:
        """All ways from an arm to another one."""
        connectors = self.junction.connectors
        by_lane = {at.lane: at for at in connectors}
        found = []
        for start in connectors:
            if start.from_arm is None:
                continue
            for chain in self._onward([start], by_lane):
                arms = self.junction.arms
                last = chain[-1]
                assert last.to_arm is not None, "a way leads to an arm"
                turn = turn_of(arms[start.from_arm].pose.heading + np.pi, arms[last.to_arm].pose.heading)
                if start.from_arm != last.to_arm and self._is_usual(start, turn):
                    lanes = (*start.before, *(at.lane for at in chain), *last.after)
                    found.append(JunctionWay(start.from_arm, last.to_arm, lanes, turn))
        return tuple(found)

    def _onward(self, chain: list[Connector], by_lane: dict[str, Connector]) -> list[list[Connector]]:
        if chain[-1].to_arm is not None:
            return [chain]
        found = []
        for name in chain[-1].after:
            # Once round at most.
            if by_lane[name] not in chain:
                found += self._onward([*chain, by_lane[name]], by_lane)
        return found

    def _is_usual(self, start: Connector, turn: Turn) -> bool:
        """Whether drivers take a turn from this lane: in roundabouts the right one of two lanes is not for left turns,
        the left one not for right turns."""
        if not self.junction.is_roundabout:
            return True
        assert start.from_arm is not None, "ways start at arms"
        lanes = [lane.name for lane in self.junction.arms[start.from_arm].lanes(incoming=True)]
        place = lanes.index(start.before[0])
        return len(lanes) == 1 or turn == "straight" or (turn == "left") == (place == 0)


def turns_of_lane(ways: Sequence[JunctionWay], lane: str) -> set[Turn]:
    """What the traffic of a lane before a junction may do."""
    return {way.turn for way in ways if way.lanes[0] == lane}


def _follow(one: Connector, other: Connector) -> bool:
    return other.lane in one.after or one.lane in other.after


def _span(connector: Connector, at: np.ndarray, n: int) -> tuple[float, float]:
    step_m = connector.length_m / (n - 1)
    return max(0.0, (int(at[0]) - 1) * step_m), min(connector.length_m, (int(at[-1]) + 1) * step_m)


def links_of(junction: TownJunction) -> list[tuple[str, str]]:
    """The links of a junction's lanes."""
    found: set[tuple[str, str]] = set()
    for at in junction.connectors:
        found |= {(name, at.lane) for name in at.before} | {(at.lane, name) for name in at.after}
    return sorted(found)


class Lights(NamedTuple):
    """The green times of a junction's groups, one after the other, from `shift_s` seconds before time 0."""

    groups: tuple[LightGroup, ...]
    green_s: tuple[float, ...]
    shift_s: float

    @classmethod
    def draw(cls, rules: JunctionRules, own: Draw, rng: np.random.Generator) -> "Lights":
        """The lights of a junction."""
        has_arrow = any(rules.has_arrow(i) for i in rules.major)
        groups: tuple[LightGroup, ...] = ("major", "major_left", "minor") if has_arrow else ("major", "minor")
        green_s = tuple(round(own.at(f"green_{group}_s", rng.random()), 1) for group in groups)
        cycle_s = sum(green_s) + len(groups) * (AMBER_S + CLEAR_S)
        return cls(groups, green_s, round(float(rng.uniform(0, cycle_s)), 1))

    def phases(self, group: LightGroup) -> tuple[Phase, ...]:
        """What the signals of a group show through a cycle, which begins with the first group's green."""
        before_s = 0.0
        for other, green_s in zip(self.groups, self.green_s, strict=True):
            if other == group:
                break
            before_s += green_s + AMBER_S + CLEAR_S
        else:
            raise ValueError(f"group: expected one of {', '.join(self.groups)}, got {group}")
        after_s = self.cycle_s - before_s - green_s - AMBER_S - RED_AMBER_S
        own: list[tuple[SignalState, float]] = [("green", green_s), ("amber", AMBER_S)]
        if before_s < RED_AMBER_S:
            order = [*own, ("red", after_s), ("red_amber", RED_AMBER_S)]
        else:
            order = [("red", before_s - RED_AMBER_S), ("red_amber", RED_AMBER_S), *own, ("red", after_s + RED_AMBER_S)]
        return tuple(Phase(state=state, seconds=round(seconds, 3)) for state, seconds in order if seconds > 0.01)

    @property
    def cycle_s(self) -> float:
        """Seconds of a cycle."""
        return sum(self.green_s) + len(self.groups) * (AMBER_S + CLEAR_S)

    def state(self, group: LightGroup, time_s: float) -> SignalState:
        """What a group shows at a time."""
        left_s = (time_s + self.shift_s) % self.cycle_s
        for phase in self.phases(group):
            if left_s < phase.seconds:
                return phase.state
            left_s -= phase.seconds
        return "red"
