"""Roundabouts: one or two lanes round an island, counter-clockwise; every lane enters and leaves along an arc that
touches the ring. World frame, metres."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from synth3dlanes.draw.town.junctions import Arm, Connector, Corner, TownJunction
from synth3dlanes.draw.town.plan import PlanPose, chain
from synth3dlanes.draw.town.streets import LANES, Cross
from synth3dlanes.scene.road_map import MapIsland, MapMark

# The ring's lanes by their number, and the pavement beyond them on both sides.
RING_LANE_M = {1: 5.0, 2: 4.2}
EDGE_M = 0.4
# Radii of the arcs of the outermost lanes and of the kerbs beside them.
ENTRY_M, KERB_ENTRY_M = 14.0, 13.0
# The least length of the ring between two arms, and the step by which the radius grows until it is reached.
BETWEEN_M, GROWTH_M = 4.0, 1.0
# Gap between a splitter island and the lanes, and its least area.
SPLITTER_GAP_M, LEAST_SPLITTER_M2 = 0.45, 3.0
SETBACK_M = 1.0


class Touch(NamedTuple):
    """An arc that leads from a line along an arm's axis to the ring: how far from the middle it begins, the angle
    between the axis and where it touches, and its radius."""

    begins_m: float
    angle: float
    radius_m: float


class Ring(NamedTuple):
    """The lanes of a roundabout: radii of their middles, from the outermost lane inwards, and their width."""

    radii_m: tuple[float, ...]
    lane_m: float

    @property
    def outer_m(self) -> float:
        """Radius of the outer kerb."""
        return self.radii_m[0] + self.lane_m / 2 + EDGE_M

    @property
    def inner_m(self) -> float:
        """Radius of the island."""
        return self.radii_m[-1] - self.lane_m / 2 - EDGE_M


def arc_to_ring(offset_m: float, radius_m: float, ring_m: float) -> Touch:
    """The arc from a line beside an arm's axis that touches a circle from outside."""
    ahead_m = np.sqrt((ring_m + radius_m) ** 2 - (offset_m + radius_m) ** 2)
    return Touch(float(ahead_m), float(np.arctan2(offset_m + radius_m, ahead_m)), radius_m)


def ring_for(angles: Sequence[float], crosses: Sequence[Cross], n_lanes: int, island_m: float) -> Ring:
    """The smallest ring round an island of at least this radius on which the arms have room."""
    lane_m = RING_LANE_M[n_lanes]
    for step in range(60):
        first_m = island_m + GROWTH_M * step + EDGE_M + (n_lanes - 0.5) * lane_m
        ring = Ring(tuple(first_m - lane_m * i for i in range(n_lanes)), lane_m)
        if _has_room(ring, angles, crosses):
            return ring
    raise AssertionError("a large ring has room for any arms that are apart")


def ring_setbacks(ring: Ring, crosses: Sequence[Cross]) -> list[float]:
    """How far from the middle each arm begins."""
    return [max(at.begins_m for at in _kerbs(ring, cross)) + SETBACK_M for cross in crosses]


def roundabout(id: str, middle: PlanPose, arms: Sequence[Arm], ring: Ring) -> TownJunction:
    """The roundabout of some arms, whose poses are `ring_setbacks` from its middle."""
    events, ways = _ways(id, middle, arms, ring)
    connectors = [*ways]
    for level, radius_m in enumerate(ring.radii_m):
        on_ring = sorted(events[level])
        for k, (angle, _, _) in enumerate(on_ring):
            by = (on_ring[(k + 1) % len(on_ring)][0] - angle) % (2 * np.pi)
            pose = PlanPose(middle.x, middle.y, angle).moved(radius_m, 0.0, np.pi / 2)
            plan = chain(pose, [(by * radius_m, 1 / radius_m, 1 / radius_m)])
            marks = (MapMark(kind="dashed"),) if level == 0 and len(ring.radii_m) > 1 else ()
            name = f"{id}r{level}_{k}"
            connectors.append(Connector(name, plan, (ring.lane_m,) * 2, (), (), None, None, "straight", marks))
    connectors = _linked(id, connectors, events)
    corners = [_corner(middle, ring, arms[i], arms[(i + 1) % len(arms)]) for i in range(len(arms))]
    islands = [_middle_island(middle, ring), *_splitters(middle, ring, arms)]
    return TownJunction(id, middle, tuple(arms), tuple(connectors), tuple(corners), tuple(islands), is_roundabout=True)


def _touches(ring: Ring, cross: Cross, side: str) -> list[tuple[Touch, int]]:
    """The arcs of an arm's lanes on a side, from the driver's left, with the number of the ring's lane that they touch
    from the outermost one. The arcs have one centre."""
    widths = cross.left if side == "left" else cross.right
    offsets_m = [abs(cross.middle(side, key)) for key in LANES if key in widths]
    levels = [min(len(offsets_m) - 1 - i, len(ring.radii_m) - 1) for i in range(len(offsets_m))]
    centre_m = ENTRY_M + offsets_m[-1]
    return [
        (arc_to_ring(offset_m, centre_m - offset_m, ring.radii_m[level]), level)
        for offset_m, level in zip(offsets_m, levels, strict=True)
    ]


# For each ring lane: angle, the connector's place in the list, and whether it enters.
Events = list[list[tuple[float, int, bool]]]


def _ways(id: str, middle: PlanPose, arms: Sequence[Arm], ring: Ring) -> tuple[Events, list[Connector]]:
    """The connectors into the ring and out of it, and where they touch it."""
    events: Events = [[] for _ in ring.radii_m]
    found: list[Connector] = []
    for i, arm in enumerate(arms):
        back_m = float(np.hypot(arm.pose.x - middle.x, arm.pose.y - middle.y))
        for incoming in (True, False):
            arcs = _touches(ring, arm.cross, "left" if incoming else "right")
            for lane, (at, level) in zip(arm.lanes(incoming), arcs, strict=True):
                angle = (arm.pose.heading + (at.angle if incoming else -at.angle)) % (2 * np.pi)
                pose = arm.lane_pose(lane, incoming)
                line, bend = (back_m - at.begins_m, 0.0, 0.0), -1 / at.radius_m
                arc = (at.radius_m * (np.pi / 2 - at.angle), bend, bend)
                if incoming:
                    plan = chain(pose, [line, arc])
                    widths = (lane.width_m, ring.lane_m)
                else:
                    start = PlanPose(middle.x, middle.y, angle).moved(ring.radii_m[level], 0.0, np.pi / 2)
                    plan, widths = chain(start, [arc, line]), (ring.lane_m, lane.width_m)
                before, after = ((lane.name,), ()) if incoming else ((), (lane.name,))
                arms_of = (i, None) if incoming else (None, i)
                events[level].append((angle, len(found), incoming))
                found.append(
                    Connector(f"{id}c{len(found)}", plan, widths, before, after, arms_of[0], arms_of[1], "right")
                )
    return events, found


def _linked(id: str, connectors: Sequence[Connector], events: Events) -> list[Connector]:
    """The connectors with the lanes before and after each: ring lanes run from one event to the next."""
    before: dict[str, list[str]] = {at.id: list(at.before) for at in connectors}
    after: dict[str, list[str]] = {at.id: list(at.after) for at in connectors}
    for level, unsorted in enumerate(events):
        on_ring = sorted(unsorted)
        for k, (_, number, enters) in enumerate(on_ring):
            way, here, last = f"{id}c{number}", f"{id}r{level}_{k}", f"{id}r{level}_{(k - 1) % len(on_ring)}"
            pairs = [(last, here), (way, here) if enters else (last, way)]
            for one, other in pairs:
                after[one].append(f"{other}.0.-1")
                before[other].append(f"{one}.0.-1")
    return [replace(at, before=tuple(before[at.id]), after=tuple(after[at.id])) for at in connectors]


def _kerbs(ring: Ring, cross: Cross) -> tuple[Touch, Touch]:
    """The arcs of the kerbs on the left and the right of an arm, looking away."""
    left, right = cross.edge("left"), -cross.edge("right")
    return arc_to_ring(left, KERB_ENTRY_M, ring.outer_m), arc_to_ring(right, KERB_ENTRY_M, ring.outer_m)


def _has_room(ring: Ring, angles: Sequence[float], crosses: Sequence[Cross]) -> bool:
    for i, angle in enumerate(angles):
        j = (i + 1) % len(angles)
        between = (angles[j] - angle) % (2 * np.pi)
        kerbs = _kerbs(ring, crosses[i])[0].angle + _kerbs(ring, crosses[j])[1].angle
        lanes = max(at.angle for at, _ in _touches(ring, crosses[i], "left"))
        lanes += max(at.angle for at, _ in _touches(ring, crosses[j], "right"))
        if (between - max(kerbs, lanes)) * ring.radii_m[-1] < BETWEEN_M:
            return False
    return True


def _corner(middle: PlanPose, ring: Ring, arm: Arm, other: Arm) -> Corner:
    """The kerb from one arm to the next: in along the arm, round the ring, and out again."""
    first, last = _kerbs(ring, arm.cross)[0], _kerbs(ring, other.cross)[1]
    backs = [float(np.hypot(at.pose.x - middle.x, at.pose.y - middle.y)) for at in (arm, other)]
    between = (other.pose.heading - arm.pose.heading) % (2 * np.pi) - first.angle - last.angle
    bend = -1 / KERB_ENTRY_M
    parts = [
        (backs[0] - first.begins_m, 0.0, 0.0),
        (KERB_ENTRY_M * (np.pi / 2 - first.angle), bend, bend),
        (ring.outer_m * between, 1 / ring.outer_m, 1 / ring.outer_m),
        (KERB_ENTRY_M * (np.pi / 2 - last.angle), bend, bend),
        (backs[1] - last.begins_m, 0.0, 0.0),
    ]
    start = arm.edge("left").moved(0.0, 0.0, np.pi)
    walkways_m = arm.cross.left.get("walkway", 0.0), other.cross.right.get("walkway", 0.0)
    return Corner(chain(start, parts), walkways_m)


def _middle_island(middle: PlanPose, ring: Ring) -> MapIsland:
    angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    x, y = middle.x + ring.inner_m * np.cos(angles), middle.y + ring.inner_m * np.sin(angles)
    return MapIsland(outline=tuple(zip(x.round(6).tolist(), y.round(6).tolist(), strict=True)), surface="grass")


def _splitters(middle: PlanPose, ring: Ring, arms: Sequence[Arm]) -> list[MapIsland]:
    """Islands between the traffic that enters and that which leaves."""
    found = []
    for arm in arms:
        sides = []
        for side, sign in (("left", 1), ("right", -1)):
            # The arc of the innermost lane's inner edge, moved into the island by the gap.
            at, _ = _touches(ring, arm.cross, side)[0]
            centre_m = at.radius_m + abs(arm.cross.middle(side, "lane1"))
            lane_m = (arm.cross.left if side == "left" else arm.cross.right)["lane1"]
            radius_m = at.radius_m + lane_m / 2 + SPLITTER_GAP_M
            turned = np.linspace(0, np.pi / 2 - at.angle, 30)
            ahead, beside = at.begins_m - radius_m * np.sin(turned), centre_m - radius_m * np.cos(turned)
            keep = (np.hypot(ahead, beside) > ring.outer_m + SPLITTER_GAP_M) & (beside >= 0.3)
            sides.append(np.stack([ahead, sign * beside], -1)[keep])
        if min(map(len, sides)) < 2:
            continue
        outline = np.concatenate([sides[0], sides[1][::-1]])
        area = np.abs(np.sum(np.cross(outline, np.roll(outline, -1, axis=0)))) / 2
        if area < LEAST_SPLITTER_M2:
            continue
        axis = PlanPose(middle.x, middle.y, arm.pose.heading)
        places = [axis.moved(float(a), float(b)) for a, b in outline]
        found.append(MapIsland(outline=tuple((round(at.x, 6), round(at.y, 6)) for at in places)))
    return found
