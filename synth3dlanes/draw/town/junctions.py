"""Junctions where streets meet: setbacks of the arms, kerbs round the corners, connectors from lane to lane, and the
outline of the pavement. Roundabouts are in `roundabouts.py`. World frame, metres; arms are counter-clockwise."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from synth3dlanes.draw.town.plan import PlanPose, chain, connection, sampled, wrapped
from synth3dlanes.draw.town.streets import KERB_M, Cross, LaneAt, Street, smooth
from synth3dlanes.scene.road_map import (
    GroundPoint,
    MapIsland,
    MapLane,
    MapMark,
    MapRoad,
    MapSection,
    PlanPiece,
    Polynomial,
)

Turn = Literal["left", "straight", "right"]
# A way that turns by more than this is a turn; between arms farther apart than that the kerb has no corner.
TURN_FROM_RAD, STRAIGHT_SIDE_RAD = np.radians(35.0), np.radians(150.0)
# Distance of the beginning of an arm behind its corners, and its least distance from the junction's middle.
SETBACK_M, LEAST_SETBACK_M = 0.5, 5.0
OUTLINE_STEP_M = 0.5
# Greatest distance from the beginning of a kerb's arc to where the kerbs would meet: acute corners have smaller radii.
LONGEST_TANGENT_M = 15.0


class Arm(NamedTuple):
    """A street at a junction: which of its ends, and the pose of its reference line there, looking away."""

    street: Street
    at_start: bool
    pose: PlanPose

    @property
    def cross(self) -> Cross:
        """The cross section, looking away."""
        return self.street.cross_at(self.at_start)

    def lanes(self, incoming: bool) -> list[LaneAt]:
        """The lanes of one direction, from the driver's left."""
        return self.street.lanes_at(self.at_start, incoming)

    def lane_pose(self, lane: LaneAt, incoming: bool) -> PlanPose:
        """Where a lane ends or begins, and its traffic's heading there."""
        return self.pose.moved(0.0, lane.offset_m, np.pi if incoming else 0.0)

    def edge(self, side: str) -> PlanPose:
        """The pavement's edge on a side, looking away."""
        return self.pose.moved(0.0, self.cross.edge(side))


@dataclass(frozen=True)
class Connector:
    """A lane through a junction: its road's id and plan, widths at both ends, and the arms that it leads from and to
    (None within a roundabout)."""

    id: str
    plan: tuple[PlanPiece, ...]
    widths_m: tuple[float, float]
    before: tuple[str, ...]
    after: tuple[str, ...]
    from_arm: int | None
    to_arm: int | None
    turn: Turn
    marks: tuple[MapMark, ...] = ()

    @property
    def lane(self) -> str:
        """The name of its lane."""
        return f"{self.id}.0.-1"

    @property
    def length_m(self) -> float:
        """Its length."""
        return sum(piece.length_m for piece in self.plan)

    def road(self, junction: str) -> MapRoad:
        """The connector as a road of a map: its lane's middle is the plan."""
        first, last = self.widths_m
        half = smooth(0.0, self.length_m, first / 2, last / 2)
        lane = MapLane(number=-1, kind="driving", widths=(smooth(0.0, self.length_m, first, last),))
        zero = MapLane(number=0, kind="none", marks=self.marks)
        section = MapSection(s_m=0.0, lanes=(zero, lane))
        return MapRoad(id=self.id, plan=self.plan, sections=(section,), lane_offsets=(half,), junction=junction)


class Corner(NamedTuple):
    """The kerb between two arms: its plan from the one to the other, and the width of the walkway at both ends."""

    plan: tuple[PlanPiece, ...]
    walkways_m: tuple[float, float]

    def road(self, id: str, junction: str) -> MapRoad:
        """The kerb and the walkway behind it as a road of a map."""
        length_m = sum(piece.length_m for piece in self.plan)
        lanes = (
            MapLane(number=0, kind="none"),
            MapLane(number=-1, kind="kerb", widths=(Polynomial(s_m=0.0, a=KERB_M),)),
            MapLane(number=-2, kind="walkway", widths=(smooth(0.0, length_m, *self.walkways_m),)),
        )
        return MapRoad(id=id, plan=self.plan, sections=(MapSection(s_m=0.0, lanes=lanes),), junction=junction)


@dataclass(frozen=True)
class TownJunction:
    """A junction as built."""

    id: str
    middle: PlanPose
    arms: tuple[Arm, ...]
    connectors: tuple[Connector, ...]
    corners: tuple[Corner, ...]
    islands: tuple[MapIsland, ...] = ()
    is_roundabout: bool = False

    @property
    def outline(self) -> tuple[GroundPoint, ...]:
        """The pavement from above, counter-clockwise."""
        points: list[GroundPoint] = []
        for arm, corner in zip(self.arms, self.corners, strict=True):
            right = arm.edge("right")
            points.append((round(right.x, 6), round(right.y, 6)))
            points += [(round(x, 6), round(y, 6)) for x, y in sampled(corner.plan, OUTLINE_STEP_M)[:-1].tolist()]
        return tuple(points)


def setbacks(angles: Sequence[float], crosses: Sequence[Cross], corner_m: float) -> list[float]:
    """How far from the junction's middle each arm begins: behind the corners on both of its sides."""
    found = [LEAST_SETBACK_M] * len(angles)
    for i, j, alpha, left, right in _sides(angles, crosses):
        if alpha < STRAIGHT_SIDE_RAD:
            (at_i, at_j), (_, tangent_m) = _meeting(alpha, left, right), _arc(alpha, corner_m)
            found[i] = max(found[i], at_i + tangent_m + SETBACK_M)
            found[j] = max(found[j], at_j + tangent_m + SETBACK_M)
    return [float(setback) for setback in found]


def crossing(id: str, middle: PlanPose, arms: Sequence[Arm], corner_m: float) -> TownJunction:
    """The junction of some arms, whose poses are `setbacks` from its middle."""
    angles, crosses = [arm.pose.heading for arm in arms], [arm.cross for arm in arms]
    corners = []
    for i, j, alpha, left, right in _sides(angles, crosses):
        start, end = arms[i].edge("left").moved(0.0, 0.0, np.pi), arms[j].edge("right")
        walkways_m = crosses[i].left.get("walkway", 0.0), crosses[j].right.get("walkway", 0.0)
        if alpha >= STRAIGHT_SIDE_RAD:
            corners.append(Corner(connection(start, end), walkways_m))
            continue
        (at_i, at_j), (radius_m, tangent_m) = _meeting(alpha, left, right), _arc(alpha, corner_m)
        back_i, back_j = (np.hypot(arm.pose.x - middle.x, arm.pose.y - middle.y) for arm in (arms[i], arms[j]))
        bend = -1 / radius_m
        parts = [
            (back_i - at_i - tangent_m, 0.0, 0.0),
            (radius_m * (np.pi - alpha), bend, bend),
            (back_j - at_j - tangent_m, 0.0, 0.0),
        ]
        corners.append(Corner(chain(start, parts), walkways_m))
    return TownJunction(id, middle, tuple(arms), tuple(_connectors(id, arms, corner_m)), tuple(corners))


def turn_of(heading_in: float, heading_out: float) -> Turn:
    """The kind of a way through a junction by its change of heading."""
    by = wrapped(heading_out - heading_in)
    return "straight" if abs(by) < TURN_FROM_RAD else "left" if by > 0 else "right"


def allowed_turns(lanes: Sequence[LaneAt], ways: set[Turn]) -> list[set[Turn]]:
    """What the lanes of an arm, from the left, may do where these ways lead on: turn lanes turn, the outer ones of the
    others turn too where there is no turn lane, and all go straight where that is possible."""
    keys = [lane.key for lane in lanes]
    found: list[set[Turn]] = [set() for _ in lanes]
    plain = [i for i, key in enumerate(keys) if key.startswith("lane")]
    if "turn_left" in keys and "left" in ways:
        found[keys.index("turn_left")] = {"left"}
    if "turn_right" in keys and "right" in ways:
        found[keys.index("turn_right")] = {"right"}
    left_free, right_free = "left" in ways and "turn_left" not in keys, "right" in ways and "turn_right" not in keys
    if "straight" in ways:
        for i in plain:
            found[i] |= {"straight"}
        found[plain[0]] |= {"left"} if left_free else set()
        found[plain[-1]] |= {"right"} if right_free else set()
        return found
    # At the stem of a T: the left half turns left, the right half right, a lane in the middle both where it is alone.
    to_left = len(plain) if not right_free else 0 if not left_free else (len(plain) + 1) // 2
    for place, i in enumerate(plain):
        found[i] |= {"left"} if place < to_left else {"right"}
    if len(plain) == 1 and left_free and right_free:
        found[plain[0]] = {"left", "right"}
    return [turns & ways for turns in found]


def _connectors(junction: str, arms: Sequence[Arm], corner_m: float) -> list[Connector]:
    """All connectors of a junction."""
    found: list[Connector] = []
    for i, arm in enumerate(arms):
        heading_in = arm.pose.heading + np.pi
        ways = {j: turn_of(heading_in, other.pose.heading) for j, other in enumerate(arms) if j != i}
        incoming = arm.lanes(incoming=True)
        turns = allowed_turns(incoming, set(ways.values()))
        for j, turn in ways.items():
            outgoing = arms[j].lanes(incoming=False)
            users = [lane for lane, its in zip(incoming, turns, strict=True) if turn in its]
            for place, lane in enumerate(users):
                # Right turns keep to the right, others to the left.
                at = len(outgoing) - len(users) + place if turn == "right" else place
                out = outgoing[min(max(at, 0), len(outgoing) - 1)]
                start, end = arm.lane_pose(lane, incoming=True), arms[j].lane_pose(out, incoming=False)
                # A turn goes round the kerb on its side.
                side = arm.cross.edge("left" if turn == "right" else "right")
                radius_m, _ = _arc(abs(wrapped(arms[j].pose.heading - arm.pose.heading)), corner_m)
                widest_m = np.inf if turn == "straight" else radius_m + abs(side - lane.offset_m)
                found.append(
                    Connector(
                        f"{junction}c{len(found)}",
                        connection(start, end, widest_m),
                        (lane.width_m, out.width_m),
                        (lane.name,),
                        (out.name,),
                        i,
                        j,
                        turn,
                    )
                )
    return found


def _sides(angles: Sequence[float], crosses: Sequence[Cross]) -> list[tuple[int, int, float, float, float]]:
    """Neighbouring arms, the angle between them, and how far the pavement reaches from their axes between them."""
    found = []
    for i, j in pairwise([*range(len(angles)), 0]):
        alpha = (angles[j] - angles[i]) % (2 * np.pi)
        found.append((i, j, float(alpha), crosses[i].edge("left"), -crosses[j].edge("right")))
    return found


def _meeting(alpha: float, left: float, right: float) -> tuple[float, float]:
    """How far along both axes the edges of two arms meet."""
    sin, cos = np.sin(alpha), np.cos(alpha)
    return float((right + left * cos) / sin), float((left + right * cos) / sin)


def _arc(alpha: float, corner_m: float) -> tuple[float, float]:
    """The radius of the kerb between two arms, and how far before the meeting of their edges it begins."""
    radius_m = min(corner_m, LONGEST_TANGENT_M * float(np.tan(alpha / 2)))
    return radius_m, radius_m / float(np.tan(alpha / 2))
