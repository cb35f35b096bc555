"""Town -> TownMap: the streets and junctions of a town, grown from its first junction. World frame, metres."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.draw.draws import Draw
from synth3dlanes.draw.town.junctions import Arm, crossing, setbacks, turn_of
from synth3dlanes.draw.town.paint import islands_of, paint_of, painted
from synth3dlanes.draw.town.plan import PlanPose, chain, end_of, sampled
from synth3dlanes.draw.town.roundabouts import Ring, ring_for, ring_setbacks, roundabout
from synth3dlanes.draw.town.rules import JunctionRules, links_of
from synth3dlanes.draw.town.streets import NO_POCKET, Pocket, Street, StreetForm
from synth3dlanes.geometry.polylines import distances_between
from synth3dlanes.scene.road_map import MapIsland, MapJunction, MapMarkKind, MapPaint, MapRoad, PlanPiece, RoadMap
from synth3dlanes.scene.scene import Markings
from synth3dlanes.scene.town import Control, JunctionKind, Town
from synth3dlanes.system.arrays import Points2

Rng = np.random.Generator
# Length of the straight at a junction, and of the spirals and the arc of a bend.
STRAIGHT_M, SPIRAL_M, ARC_M = 20.0, 25.0, 30.0
# Least distance between middles of streets, farther than SHARED_M from the junctions that they share.
APART_M, SHARED_M = 42.0, 55.0
LEAST_ISLAND_M = 6.0
# Shares of the bends, and whether there are further junctions, of one attempt after the other.
ATTEMPTS = (*[(1.0, True)] * 6, *[(0.5, True)] * 3, *[(0.0, True)] * 3, (1.0, False), (0.5, False), (0.0, False))
QUARTER = np.pi / 2


class Planned(NamedTuple):
    """An arm before its street is laid out: its angle at the junction, its street's profile and turn lanes there."""

    angle: float
    profile: StreetForm
    pocket: Pocket
    is_main: bool


@dataclass(frozen=True)
class TownMap:
    """The streets of a town and its junctions with their rules, the first of them first."""

    town: Town
    streets: tuple[Street, ...]
    junctions: tuple[JunctionRules, ...]

    @cached_property
    def links(self) -> tuple[tuple[str, str], ...]:
        """All links between lanes."""
        found = [link for street in self.streets for link in street.links]
        return tuple(found + [link for rules in self.junctions for link in links_of(rules.junction)])

    def road_map(self, route: Sequence[str]) -> RoadMap:
        """The town as a map, with the host's route."""
        roads: list[MapRoad] = [painted(street, self.town.has_crosswalks) for street in self.streets]
        junctions, paint, islands = [], list[MapPaint](), list[MapIsland]()
        for rules in self.junctions:
            junction = rules.junction
            roads += [at.road(junction.id) for at in junction.connectors]
            roads += [
                corner.road(f"{junction.id}k{i}", junction.id)
                for i, corner in enumerate(junction.corners)
                if max(corner.walkways_m) > 0
            ]
            junctions.append(MapJunction(id=junction.id, outline=junction.outline, yields=rules.yields))
            paint += paint_of(rules, self.town.has_crosswalks)
            islands += junction.islands
        islands += islands_of(self.streets, self.town.has_crosswalks)
        return RoadMap(
            roads=tuple(roads),
            links=self.links,
            junctions=tuple(junctions),
            paint=tuple(paint),
            islands=tuple(islands),
            route=tuple(route),
        )


def lay_out(town: Town, markings: Markings, own: Draw, rng: Rng) -> TownMap:
    """The map of a town. Where streets come too close to each other, they are drawn anew, then with smaller bends, at
    last with none and without further junctions."""
    for bend, has_more in ATTEMPTS:
        bends = tuple(round(bend * angle, 6) for angle in town.bends_rad)
        changed = town.model_copy(update={"bends_rad": bends, "n_more": town.n_more if has_more else 0})
        found = _Growth(changed, markings, own, rng).grown()
        if _are_apart(found.streets):
            break
    return replace(found, town=town)


class _Growth:
    """A town that grows, junction by junction."""

    def __init__(self, town: Town, markings: Markings, own: Draw, rng: Rng) -> None:
        self.town, self.own, self.rng = town, own, rng
        self.main = self._profile(town.n_lanes, town.median_m, markings)
        self.side = self._profile(town.n_side, 0.0, markings)
        self.streets: list[Street] = []
        self.junctions: list[JunctionRules] = []

    def grown(self) -> TownMap:
        """The whole town."""
        town = self.town
        kind: JunctionKind = "t" if town.junction == "staggered" else town.junction
        planned, control = self._planned(kind, town.control, town.turn_lanes != "none"), town.control
        mains = [i for i, arm in enumerate(planned) if arm.is_main]
        if town.junction == "staggered":
            planned[mains[1]] = planned[mains[1]]._replace(pocket=NO_POCKET)
        first = self._place(PlanPose(0.0, 0.0, 0.0), planned, None)
        linked = {}
        if town.junction == "staggered":
            linked[mains[1]] = "stagger"
        for i in self.rng.permutation(len(planned))[: town.n_more].tolist():
            linked.setdefault(i, "link")
        for i in range(len(planned)):
            self._extend(first, i, planned, linked.get(i, ""))
        self.junctions[0] = self._built(first, planned, control)
        return TownMap(town, tuple(self.streets), tuple(self.junctions))

    def _profile(self, n_lanes: int, median_m: float, markings: Markings) -> StreetForm:
        town = self.town
        double: tuple[MapMarkKind, ...] = ("solid_solid",)
        single: tuple[MapMarkKind, ...] = ("dashed", "solid") if n_lanes == 1 else ("solid",)
        among = double if markings.left_double else single
        return StreetForm(
            n_lanes=n_lanes,
            lane_m=town.lane_width_m,
            median_m=median_m,
            parking=town.parking,
            walkway_m=town.walkway_m,
            divider=among[int(self.rng.random() * len(among))],
            yellow=markings.left_yellow,
            edge_lines=self.own.at("edge_lines", self.rng.random()),
        )

    def _planned(self, kind: JunctionKind, control: Control, turn_lanes: bool) -> list[Planned]:
        """The arms of a junction, counter-clockwise from the one at -90 degrees, from which the main road comes."""
        town = self.town
        four = kind == "crossing" or (kind.startswith("roundabout") and self.own.at("four_arms", self.rng.random()))
        side = town.angle_rad + (np.pi if not four and self.rng.random() < 0.5 else 0.0)
        sides = [side, side + np.pi] if four else [side]
        angles = sorted(
            [(-QUARTER, True), (QUARTER, True), *(((at + QUARTER) % (2 * np.pi) - QUARTER, False) for at in sides)]
        )
        found = []
        for angle, is_main in angles:
            ways = {turn_of(angle + np.pi, other) for other, _ in angles if other != angle}
            has = turn_lanes and (is_main or control == "signals")
            right = has and town.turn_lanes == "both" and "right" in ways and "straight" in ways
            pocket = Pocket(has and "left" in ways and "straight" in ways, right, town.pocket_m)
            plain = kind.startswith("roundabout") or not (pocket.left or pocket.right)
            found.append(Planned(angle, self.main if is_main else self.side, NO_POCKET if plain else pocket, is_main))
        return found

    def _place(self, at: PlanPose, planned: Sequence[Planned], came: Street | None) -> "_Placed":
        """Reserve a junction's place in the list, and the setbacks of its arms. `at` is its middle, or the end of
        the street that came there, if one did."""
        crosses = [arm.profile.cross(arm.pocket, near=True) for arm in planned]
        angles = [arm.angle for arm in planned]
        ring = None
        if self.town.junction.startswith("roundabout") and came is None:
            n_lanes = 2 if self.town.junction == "roundabout_2" else 1
            ring = ring_for(angles, crosses, n_lanes, max(self.town.island_m, LEAST_ISLAND_M))
        backs = ring_setbacks(ring, crosses) if ring else setbacks(angles, crosses, self.town.corner_m)
        # The first arm of a junction at the end of a street is that street.
        middle = at if came is None else at.moved(backs[0], 0.0, np.pi - angles[0])
        poses = [middle.moved(0.0, 0.0, angle).moved(back) for angle, back in zip(angles, backs, strict=True)]
        placed = _Placed(len(self.junctions), middle, poses, ring, [came] + [None] * (len(planned) - 1))
        self.junctions.append(None)  # type: ignore[arg-type]
        return placed

    def _built(self, placed: "_Placed", planned: Sequence[Planned], control: Control) -> JunctionRules:
        arms = [
            Arm(street, i > 0 or placed.number == 0, pose)
            for i, (street, pose) in enumerate(zip(placed.streets, placed.poses, strict=True))
            if street is not None
        ]
        name = f"j{placed.number}"
        if placed.ring:
            junction = roundabout(name, placed.middle, arms, placed.ring)
        else:
            junction = crossing(name, placed.middle, arms, self.town.corner_m)
        return JunctionRules(junction, control, tuple(i for i, arm in enumerate(planned) if arm.is_main))

    def _extend(self, placed: "_Placed", i: int, planned: Sequence[Planned], link: str) -> None:
        """Lay out the street of an arm, and a junction at its end."""
        arm, pose = planned[i], placed.poses[i]
        bends = self.town.bends_rad
        bend = bends[i] if placed.number == 0 and i < len(bends) else 0.0
        key = {"": "open_street_m", "link": "link_street_m", "stagger": "staggered_m"}[link]
        length_m = round(self.own.at(key, self.rng.random()), 3)
        pocket = NO_POCKET if link == "stagger" else arm.pocket
        length_m += pocket.length_m if pocket.left or pocket.right else 0.0
        plan = _plan(pose, length_m, bend if link != "stagger" else 0.0)
        street = Street(f"s{len(self.streets)}", arm.profile, plan, pocket, NO_POCKET if link else None)
        self.streets.append(street)
        placed.streets[i] = street
        if not link:
            return
        kind: JunctionKind = "t" if link == "stagger" else self.own.at("further", self.rng.random())
        control: Control = self.town.control
        if link != "stagger" and not self.town.junction.startswith("roundabout"):
            has_signals = control == "signals" and self.own.at("further_signals", self.rng.random())
            control = "signals" if has_signals else "priority"
        beyond = self._beyond(arm, kind, planned if link == "stagger" else None)
        child = self._place(end_of(plan), beyond, street)
        for j in range(1, len(beyond)):
            self._extend(child, j, beyond, "")
        self.junctions[child.number] = self._built(child, beyond, control)

    def _beyond(self, came: Planned, kind: JunctionKind, first: Sequence[Planned] | None) -> list[Planned]:
        """The arms of a junction at the end of a street, that street first; of the second part of a staggered one with
        the side street on the other side than at the first."""
        if first is not None:
            # The main street leaves the first part at 90 degrees.
            side = next(arm.angle for arm in first if not arm.is_main)
            angles = [float((side + QUARTER) % (2 * np.pi))]
        elif kind == "crossing":
            angles = [QUARTER, -QUARTER]
        else:
            angles = [QUARTER if self.rng.random() < 0.5 else -QUARTER]
        sides = [Planned(angle, self.side, NO_POCKET, False) for angle in angles]
        # The street that goes on is the main one here, even where it is a side street of the first junction.
        ahead, here = (Planned(angle, came.profile, NO_POCKET, True) for angle in (0.0, np.pi))
        return [here, *sorted([ahead, *sides], key=lambda arm: (arm.angle - np.pi) % (2 * np.pi))]


@dataclass
class _Placed:
    """A junction that is being built: its number, middle, the poses of its arms, its ring, and the streets laid."""

    number: int
    middle: PlanPose
    poses: list[PlanPose]
    ring: Ring | None
    streets: list[Street | None]


def _plan(pose: PlanPose, length_m: float, bend_rad: float) -> tuple[PlanPiece, ...]:
    """A street's plan: straight at both ends, a bend between where there is room for it."""
    rest_m = length_m - 2 * STRAIGHT_M - 2 * SPIRAL_M - ARC_M
    if not bend_rad or rest_m < 0:
        return chain(pose, [(length_m, 0.0, 0.0)])
    curvature = bend_rad / (SPIRAL_M + ARC_M)
    parts = [
        (STRAIGHT_M, 0.0, 0.0),
        (SPIRAL_M, 0.0, curvature),
        (ARC_M, curvature, curvature),
        (SPIRAL_M, curvature, 0.0),
        (rest_m + STRAIGHT_M, 0.0, 0.0),
    ]
    return chain(pose, parts)


def _are_apart(streets: Sequence[Street]) -> bool:
    """Whether streets are apart from each other, but near the junctions that they share."""
    lines = [sampled(street.plan, 8.0) for street in streets]
    ends = [line[:1] if street.end is None else line[[0, -1]] for street, line in zip(streets, lines, strict=True)]
    for i, one in enumerate(lines):
        for j, other in enumerate(lines[:i]):
            shared = [a for a in ends[i] for b in ends[j] if np.linalg.norm(a - b) < SHARED_M]
            far = [_beyond(line, shared) for line in (one, other)]
            if all(map(len, far)) and distances_between(*far).min() < APART_M:
                return False
    return True


def _beyond(line: Points2, places: Sequence[Float[np.ndarray, "2"]]) -> Float[np.ndarray, "_ 2"]:
    """The points of a line that are away from some places."""
    for place in places:
        line = line[np.linalg.norm(line - place, axis=1) > SHARED_M]
    return line
