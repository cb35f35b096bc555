"""The roads of a network as OpenDRIVE files tell them: on planes rolled about their climbing lines, with shapes over
these; roads without sections in parts, each with its lanes beside a reference line of its own, the paint along their
edges, and a junction where roads part.

A point of such a road lies at (s, t, h): s is the length of the reference line seen from above, t the distance to its
left and h the height, both measured on the rolled plane. World frame, metres and radians.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.geometry.polylines import distances_between, lengths_along
from synth3dlanes.labels.labels import MIRRORED
from synth3dlanes.roads.from_map import bare_road
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.line_forms import Chain, plan_line
from synth3dlanes.roads.maps.cubics import Profile, steepened, value
from synth3dlanes.roads.maps.lanes import widened
from synth3dlanes.roads.maps.profiles import cubics, knots, pieces
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene.road_map import (
    LaneName,
    MapLane,
    MapLaneKind,
    MapMark,
    MapMarkKind,
    MapRoad,
    MapSection,
    MapShape,
    PlanPiece,
)
from synth3dlanes.scene.scene import Markings
from synth3dlanes.system.arrays import Numbers, Points2, Points3, Scalars
from synth3dlanes.world.paint import is_dotted, is_double, line_width_m, paint_color, pair_of
from synth3dlanes.world.world import World

# Tolerances of written heights and rolls, and the step between places where they are compared.
HEIGHT_M, ROLL_RAD, PROFILE_STEP_M = 1e-3, 1e-4, 0.25
# A road gets lateral shapes where its surface is farther than this from the rolled plane; the number of places across
# the road at which it is measured.
SHAPE_M, SHAPE_PLACES = 0.005, 9
# Tolerance of widths on rolled planes.
WIDENED_M = 1e-4
# The search for the road nearest to a point begins at places of its line this far apart; its climb is measured over
# CLIMB_M to both sides.
COARSE_STEP_M, CLIMB_M = 2.0, 0.01
# The most steps of the search for a point's station, each of which leaves a share of the error in bends, and the step
# after which it ends.
FOOT_STEPS, SETTLED_M = 20, 1e-6
# A point farther than this ahead of the found place is not beside the road; the number of nearest roads that are tried.
BESIDE_M, NEAREST = 0.005, 6


@dataclass(frozen=True, eq=False)
class WrittenRoad:
    """A road as its file tells it, and the segments of our lane graph by the names of its lanes. It runs along a road
    of the network, the `source`, between two stations of that, and along its edges if it `has_edges`."""

    told: MapRoad
    segments: Mapping[LaneName, str]
    source: str
    span_m: tuple[float, float]
    has_edges: bool = True

    @cached_property
    def _line(self) -> Chain:
        return plan_line(self.told.plan)

    @cached_property
    def _profiles(self) -> tuple[Profile, Profile]:
        return Profile(self.told.heights), Profile(self.told.banks)

    @cached_property
    def line_world(self) -> Points2:
        """Places of its reference line from above."""
        return self._line.frames(
            np.linspace(0.0, self.told.length_m, 2 + int(self.told.length_m / COARSE_STEP_M))
        ).points_world

    @cached_property
    def tree(self) -> "scipy.spatial.cKDTree":
        """A search tree of the places of its reference line."""
        return scipy.spatial.cKDTree(self.line_world)

    def frames(self, s: Scalars) -> tuple[Points3, Float[np.ndarray, "n 3 3"]]:
        """Its reference line, and the unit vectors of s, t and h there as rows: heading, then climb, then roll."""
        xy, normals, _, _ = self._line.frames(s)
        heights, rolls = self._profiles
        climb = (heights(s + CLIMB_M) - heights(s - CLIMB_M)) / (2 * CLIMB_M)
        along = np.column_stack([-normals[:, 1], normals[:, 0], climb]) / np.hypot(1.0, climb)[:, None]
        left = np.column_stack([-normals, np.zeros(len(s))])
        up, sin, cos = np.cross(along, left), np.sin(rolls(s))[:, None], np.cos(rolls(s))[:, None]
        return np.column_stack([xy, heights(s)]), np.stack([along, cos * left + sin * up, cos * up - sin * left], 1)

    def places(self, points_world: Points3) -> Points3:
        """(s, t, h) of world points, measured at the ends for points before and behind the road."""
        return self.feet(points_world)[0]

    def feet(self, points_world: Points3) -> tuple[Points3, Scalars]:
        """(s, t, h) of world points, and how far ahead of that place each point is: 0 but before and behind the road
        and inside its sharp bends."""
        s = np.clip(self._line.project(points_world[:, :2])[0], 0.0, self.told.length_m)
        for _ in range(FOOT_STEPS):
            line, axes = self.frames(s)
            to = np.einsum("nij,nj->ni", axes, points_world - line)
            before, ahead = s, to[:, 0] * np.hypot(axes[:, 0, 0], axes[:, 0, 1])
            s = np.clip(s + ahead, 0.0, self.told.length_m)
            if np.abs(s - before).max(initial=0.0) < SETTLED_M:
                break
        return np.column_stack([s, to[:, 1:]]), to[:, 0]


class RoadPlace(NamedTuple):
    """A road, and (s, t, h) of a point there."""

    road: WrittenRoad
    sth: Float[np.ndarray, "3"]

    @property
    def heading_rad(self) -> float:
        """The road's heading there."""
        _, axes = self.road.frames(self.sth[:1])
        return math.atan2(axes[0, 0, 1], axes[0, 0, 0])


def beside(roads: Sequence[WrittenRoad], points_world: Points3) -> list[RoadPlace]:
    """Where each point is beside a road: the nearest of those that it is neither before nor behind, or else the end of
    the nearest of all."""
    away_m = np.array([road.tree.query(points_world[:, :2])[0] for road in roads])
    found, left = dict[int, RoadPlace](), np.arange(len(points_world))
    for nearest in np.argsort(away_m, axis=0)[:NEAREST]:
        beyond = list[int]()
        for k in np.unique(nearest[left]):
            numbers = left[nearest[left] == k]
            for i, sth, ahead_m in zip(numbers.tolist(), *roads[k].feet(points_world[numbers]), strict=True):
                if abs(ahead_m) < BESIDE_M:
                    found[i] = RoadPlace(roads[k], sth)
                else:
                    found.setdefault(i, RoadPlace(roads[k], sth))
                    beyond.append(i)
        left = np.array(beyond, dtype=int)
    return [found[i] for i in range(len(points_world))]


def lane_ascends(road: MapRoad, section: int, number: int) -> bool:
    """Whether the traffic of a lane goes with growing s."""
    lane = next(lane for lane in road.sections[section].lanes if lane.number == number)
    return lane.ascends(road.keeps_left)


def on_planes(flat: MapRoad, own: Road, raised: Callable[[Scalars], Scalars]) -> MapRoad:
    """A road from above as its file tells it: with the heights of the ground where it has none, rolls about its
    climbing line, and widths on the rolled plane. `own` are its places, which are `raised` over its surface."""
    told = flat.model_copy(update=_given(flat) if flat.heights else _fitted(own, raised))
    if not told.banks:
        return told
    return widened(told, lambda s_m, end_m: 1 / math.cos(value(told.banks, s_m, end_m)), exact=WIDENED_M)


def _given(road: MapRoad) -> dict[str, object]:
    """The rolls of a road with heights of its own."""
    return {"banks": steepened(road.banks, road.heights, road.length_m, -1)}


def _fitted(own: Road, raised: Callable[[Scalars], Scalars]) -> dict[str, object]:
    """Heights, rolls and shapes of a road on the ground: the plane nearest to it at each station, and what is left."""
    s = np.linspace(0, own.end_m, max(4, 1 + int(own.end_m / PROFILE_STEP_M)))
    low = own.left(s)
    high = np.maximum(own.right(s), low + 0.5)
    t = low + (high - low) * np.linspace(0, 1, SHAPE_PLACES)[:, None]

    def surface_m(s: Numbers) -> Numbers:
        return np.array([own.base_points(*at)[:, 2] + raised(at[0]) for at in zip(s, t, strict=True)])

    z = surface_m(np.broadcast_to(s, t.shape))
    mean_t, mean_z = t.mean(axis=0), z.mean(axis=0)
    fall = ((t - mean_t) * (z - mean_z)).sum(axis=0) / ((t - mean_t) ** 2).sum(axis=0)
    line_m = mean_z - fall * mean_t
    climb = np.gradient(line_m, s)
    # A roll turns a plane that climbs already: it is steeper across than it looks from above, and moves along.
    level = 1 / np.hypot(1.0, climb)
    # Here t grows to the right, in OpenDRIVE to the left; rolls are positive with the left side higher.
    roll = -np.arctan(fall * level)
    flat = np.cos(roll)
    ahead = t * np.tan(roll) * climb * level
    over = (surface_m(s + ahead) - line_m + t * np.tan(roll) * level) * flat * level
    return {
        "heights": tuple(cubics(s, line_m, HEIGHT_M)),
        "banks": tuple(cubics(s, roll, ROLL_RAD)),
        "shapes": tuple(_shapes(s, over.T[:, ::-1], -high / flat, (high - low) / flat)),
    }


def _shapes(s: Scalars, over_m: Numbers, left: Scalars, width_m: Scalars) -> Iterator[MapShape]:
    """Lateral shapes of a road whose surface is at its stations `over_m` over its rolled plane, at SHAPE_PLACES places
    from `left` on across `width_m`; none where that is little everywhere."""
    if np.abs(over_m).max() <= SHAPE_M:
        return
    share = np.linspace(0, 1, SHAPE_PLACES)
    for i in knots(s, over_m, SHAPE_M):
        rows = np.vander(width_m[i] * share, 4, increasing=True)
        a, b, c, d = np.linalg.lstsq(rows, over_m[i], rcond=None)[0].tolist()
        yield MapShape(s_m=float(s[i]), t_m=float(left[i]), a=a, b=b, c=c, d=d)


# Greatest distance of a delimiter from the edge that it runs along: lanes that leave a road turn aside at once, which
# moves their lines against those before.
ON_EDGE_M = 0.1
# Shorter stretches are left out.
SHORT_M = 0.5
# Dashes are counted anew after this length, and lengths are measured in these steps.
MARK_M, LENGTH_STEP_M = 50.0, 0.5
# From the first to the last place of a stretch that have to be near, as shares of it.
PROBES = np.array([0.2, 0.5, 0.8])

# Towards which lane numbers, which increase to the left, a mark may be crossed: from the side of its dashes.
LANE_CHANGES = {"dashed": "both", "dots": "both", "solid_dashed": "increase", "dashed_solid": "decrease"}
DOUBLE: frozenset[MapMarkKind] = frozenset({"solid_solid", "solid_dashed", "dashed_solid"})
# The pattern of a stripe: the lengths of its dashes and gaps, and where the first dash begins.
Pattern = tuple[float, float, float]


class PaintedMark(MapMark):
    """A mark with its paint in place: of each stripe the t from the edge, the lengths of dashes and gaps, and where the
    first dash begins. A solid stripe is one dash."""

    stripes: tuple[tuple[float, float, float, float], ...]
    lane_change: str


class LaneEdge(NamedTuple):
    """The outer edge of a lane by its number, or lane 0: stations of the road, those in the file, and its places. The
    file's road runs as the host drives or, if it `is_oncoming`, the other way."""

    number: int
    road_s: Scalars
    s_m: Scalars
    xy_world: Points2
    is_oncoming: bool


def marks(world: World, edge: LaneEdge) -> Iterator[MapMark]:
    """All marks of an edge, and `none` between them; nothing where it is not painted at all."""
    painted = [mark for line in world.network.delimiters for mark in _of(line, world.scene.markings, edge)]
    reached = 0.0
    for mark, end_m in sorted(painted, key=lambda at: at[0].s_m):
        if mark.s_m > reached + SHORT_M:
            yield MapMark(s_m=reached, kind="none")
        # From the left; on lanes to the left of lane 0 the inner stripe comes first.
        yield mark.model_copy(update={"kind": MIRRORED.get(mark.kind, mark.kind)}) if edge.number > 0 else mark
        reached = end_m
    if painted and edge.s_m[-1] > reached + SHORT_M:
        yield MapMark(s_m=reached, kind="none")


def _of(line: LaneCurve, markings: Markings, edge: LaneEdge) -> Iterator[tuple[PaintedMark, float]]:
    """The marks of a delimiter along an edge, each with its end, if it runs there; of stripes that differ, the left one
    is named first."""
    _, road_s, s_m, edge_xy, is_oncoming = edge
    at = np.flatnonzero((road_s >= line.start_m - 1e-6) & (road_s <= line.end_m + 1e-6))
    if len(at) < 2 or s_m[at[-1]] - s_m[at[0]] < SHORT_M:
        return
    probes = at[((len(at) - 1) * PROBES).astype(int)]
    # Stations of different roads differ, so the whole line is looked at.
    there = line.xy_world(np.sort(road_s[at]))
    apart_m = distances_between(edge_xy[probes], there).min(axis=1)
    if apart_m.max() > ON_EDGE_M:
        return
    width_m = line_width_m(line, markings)

    def painted(kind: MapMarkKind, s_m: float, length_m: float, dashes: Pattern = (0.0, 0.0, 0.0)) -> PaintedMark:
        solid = (length_m, 0.0, 0.0)
        patterns: dict[float, Pattern] = {0.0: solid if kind == "solid" else dashes}
        if kind in DOUBLE:
            right, left = (dashes if kind == dashed else solid for dashed in ("solid_dashed", "dashed_solid"))
            patterns = {-width_m: right, width_m: left}
        return PaintedMark(
            s_m=s_m,
            kind=kind,
            yellow=paint_color(line, markings) == "yellow",
            width_m=width_m,
            stripes=tuple((t_m, *pattern) for t_m, pattern in patterns.items()),
            lane_change=LANE_CHANGES.get(kind, "none"),
        )

    start_m, end_m = float(s_m[at[0]]), float(s_m[at[-1]])
    pair, ascends = pair_of(line, markings), road_s[at[-1]] > road_s[at[0]]
    if line.marking == "solid" and pair is None:
        yield painted("solid_solid" if is_double(line, markings) else "solid", start_m, end_m - start_m), end_m
        return
    kind: MapMarkKind = "dots" if is_dotted(line, markings) else "dashed"
    if pair:
        kind = MIRRORED[pair] if is_oncoming else pair
    cycle_m, dash_m = markings.dash_cycle_m, markings.dash_fraction * markings.dash_cycle_m
    length_m = _lengths(line, road_s[at])
    # Dashes begin at multiples of their cycle along the line from station 0; seen from behind, they end there.
    first_m = length_m[0] + (-length_m[0] - (0 if ascends else dash_m)) % cycle_m
    # Marks begin with a dash, and are so short that the line is nowhere much longer or shorter than the road.
    begins_m = np.arange(first_m, length_m[-1], cycle_m * max(1, round(MARK_M / cycle_m)))
    begins_m = np.unique([*(begins_m if len(begins_m) else [first_m]), max(first_m + 1e-3, length_m[-1])])
    places_m = np.interp(begins_m, length_m, s_m[at])
    for i, (place_m, next_m) in enumerate(pairwise(places_m)):
        scale = (next_m - place_m) / (begins_m[i + 1] - begins_m[i])
        from_m = place_m if i else start_m
        dashes = float(scale * dash_m), float(scale * (cycle_m - dash_m)), float(place_m - from_m)
        yield painted(kind, float(from_m), float(next_m - from_m), dashes), float(next_m)


def _lengths(line: LaneCurve, road_s: Scalars) -> Scalars:
    """Lengths along a line, in the order of these stations, from station 0."""
    to_start = np.clip(np.linspace(0, road_s[0], 2 + int(abs(road_s[0]) / LENGTH_STEP_M)), line.start_m, line.end_m)
    before, along = (np.linalg.norm(np.diff(line.points_world(s), axis=0), axis=1) for s in (to_start, road_s))
    start_m = np.sign(road_s[0]) * before.sum() * np.sign(road_s[-1] - road_s[0])
    return np.asarray(start_m + np.concatenate([[0.0], np.cumsum(along)]))


# Least reach of a file to either side of the scene's middle, and the step between fitted places.
REACH_M, FIT_STEP_M = 250.0, 0.1
MIN_END_M = 10.0
# Distance between the lanes of roads that part at which the junction ends.
APART_M = 0.06
JUNCTION = "junction"
# Strips whose width exceeds this nowhere are left out.
LEAST_WIDTH_M = 1e-6
# How far the written reference line and widths may be from the world's.
LINE_M, WIDTH_M = 1e-3, 1e-3
# A width, or an offset, which may depend on the station.
Width = float | Callable[[Scalars], Scalars]


@dataclass(frozen=True)
class WrittenStrip:
    """A strip of a road of the network: its type, its lane, its width."""

    kind: MapLaneKind
    segment: str | None
    width_m: Width


WrittenStrips = tuple[WrittenStrip, ...]


@dataclass(frozen=True)
class WrittenPart:
    """A part of a road of the network: its stations, its reference line, its strips as t grows, the number of those
    before lane 0, the offset of lane 0 from the line, the parts before and behind it in ascending stations, and whether
    it is a connecting road of a junction. It runs as the host drives or, if it `is_oncoming`, the other way."""

    name: str
    span_m: tuple[float, float]
    road: Road
    line: Offset
    strips: WrittenStrips
    n_left: int
    lane_0_m: Width
    before: str | None = None
    after: str | None = None
    is_oncoming: bool = False
    in_junction: bool = False

    def lanes(self, network: Network) -> dict[LaneName, str]:
        """Its segments of the lane graph by the names of its lanes in the file."""
        return {
            f"{self.name}.0.{self.number(network, i)}": strip.segment
            for i, strip in enumerate(self.strips)
            if strip.segment is not None
        }

    def leftward(self, network: Network) -> int:
        """1 where t grows to the left of its reference line, seen in its direction, else -1."""
        return int(-network.rightward * (-1 if self.is_oncoming else 1))

    def number(self, network: Network, strip: int) -> int:
        """The number of the lane that a strip is in the file."""
        return self.leftward(network) * (strip - self.n_left + (strip >= self.n_left))

    def told(self, world: World) -> WrittenRoad:
        """The part as its file tells it."""
        network, (low_m, high_m) = world.network, self.span_m
        ascends = (network.onwards > 0) != self.is_oncoming
        s = np.linspace(low_m, high_m, int(np.ceil((high_m - low_m) / FIT_STEP_M)) + 1)[:: 1 if ascends else -1]
        xy, line = self.road.xy(s, self.line(s)), self.line(s)
        s_m = lengths_along(xy)
        edges = np.cumsum([np.zeros(len(s)), *(_at(strip.width_m, s) for strip in self.strips)], axis=0)
        edges += _at(self.lane_0_m, s) - edges[self.n_left]

        def lane(number: int, kind: MapLaneKind, outer: int, width_m: Scalars | None = None) -> MapLane:
            edge = LaneEdge(number, s, s_m, self.road.xy(s, line + edges[outer]), self.is_oncoming)
            # The line between both directions belongs to the lanes of the host's where these are another road's.
            is_theirs = number == 0 and self.is_oncoming and self.in_junction
            return MapLane(
                number=number,
                kind=kind,
                widths=() if width_m is None else tuple(cubics(s_m, width_m, WIDTH_M)),
                marks=() if is_theirs else tuple(marks(world, edge)),
            )

        lanes = [
            lane(self.number(network, i), strip.kind, i + (i >= self.n_left), edges[i + 1] - edges[i])
            for i, strip in enumerate(self.strips)
        ]
        flat = MapRoad(
            id=self.name,
            plan=tuple(_plan(s_m, xy)),
            sections=(
                MapSection(
                    s_m=0.0,
                    lanes=tuple(sorted([*lanes, lane(0, "none", self.n_left)], key=lambda lane: -lane.number)),
                ),
            ),
            lane_offsets=tuple(cubics(s_m, self.leftward(network) * edges[self.n_left], WIDTH_M)),
            junction=JUNCTION if self.in_junction else None,
            keeps_left=network.rightward < 0,
        )

        def raised(at: Scalars) -> Scalars:
            return self.road.raised(np.interp(at, s_m, s))

        return WrittenRoad(
            told=on_planes(flat, bare_road(flat, network.terrain), raised),
            segments=self.lanes(network),
            source=self.road.id,
            span_m=self.span_m,
            has_edges=not self.is_oncoming and self.line.moves is None,
        )


def _plan(s_m: Scalars, xy_world: Points2) -> Iterator[PlanPiece]:
    for piece in pieces(s_m, xy_world, LINE_M, unit_speed=True):
        (x, y), (dx, dy) = piece.abcd[0].tolist(), piece.abcd[1].tolist()
        u, v = (piece.abcd @ np.array([[dx, -dy], [dy, dx]])).T.tolist()
        length_m, heading = piece.end - piece.s, float(np.arctan2(dy, dx))
        cubic = {"u": (0.0, 1.0, *u[2:]), "v": (0.0, 0.0, *v[2:]), "parameter_end": length_m}
        yield PlanPiece(x_m=x, y_m=y, heading_rad=heading, length_m=length_m, **cubic)


def part_links(network: Network, parts: Sequence[WrittenPart]) -> tuple[tuple[LaneName, LaneName], ...]:
    """The links between the lanes of parts that follow each other, as traffic drives."""
    by_name, found = {part.name: part for part in parts}, dict[tuple[LaneName, LaneName], None]()
    for part in parts:
        for there, is_after in ((part.before, False), (part.after, True)):
            for name, segment in part.lanes(network).items():
                joined = {segment, *(lane.id for lane in network.joined_to(network.lanes[segment]))}
                for other, beyond in by_name[there].lanes(network).items() if there in by_name else ():
                    if beyond in joined:
                        goes_on = network.lanes[segment].ascends == is_after
                        found[(name, other) if goes_on else (other, name)] = None
    return tuple(found)


def _driving(lanes: Sequence[NetworkLane]) -> WrittenStrips:
    return tuple(WrittenStrip("driving", lane.id, lane.width_m) for lane in lanes)


def parts(network: Network) -> list[WrittenPart]:
    """The parts of all roads of a network. Where others part from the host's, these are its part before that, the
    connecting roads of a junction up to where the lanes have parted, and the roads beyond; with a median, also one for
    oncoming traffic."""
    road, found = network.main, list[WrittenPart]()
    partings = [(branch, branch.parting) for branch in network.branches(road) if branch.parting]
    parted_m = max((parting.station(APART_M) for _, parting in partings), default=0.0)
    end_m = max(REACH_M, parted_m + MIN_END_M)
    first, beyond = ([lane for lane in road.lanes_at(s) if lane.direction == "same"] for s in (-REACH_M, parted_m))
    oncoming = _driving([lane for lane in road.lanes_at(-REACH_M) if lane.direction == "oncoming"])
    shoulder = WrittenStrip("shoulder", None, road.shoulder_m)
    facing, own = road.carriageways[0], road.carriageways[-1]
    left, middle_m = (shoulder, *oncoming), (facing.left_m + own.right_m) / 2
    if oncoming and own.left_m - facing.right_m > APART_M:
        median = WrittenStrip("median", None, (own.left_m - facing.right_m) / 2)
        line, half_m = Offset((facing.left_m + facing.right_m) / 2), (facing.right_m - facing.left_m) / 2
        strips = (*left, median)
        found = [
            WrittenPart("oncoming", (-REACH_M, end_m), road, line, strips, len(strips) - 1, half_m, is_oncoming=True)
        ]
        oncoming, left, middle_m = (), (median,), (own.left_m + own.right_m) / 2

    def part(name: str, span_m: tuple[float, float], left: WrittenStrips, right: WrittenStrips) -> WrittenPart:
        return WrittenPart(name, span_m, road, Offset(middle_m), (*left, *right), len(left), own.left_m - middle_m)

    before, after = first[0].section, beyond[0].section
    if not partings:
        whole = part(before, (-REACH_M, end_m), left, (*_driving(first), shoulder))
        return [*found, *(_along_works(network, whole) if network.links else [whole])]
    junction, apart = (0.0, parted_m), (parted_m, end_m)
    # A lane that opens begins on its neighbour's; connecting roads are for one direction.
    opening = [lane for lane in beyond if lane.middle.moves]
    connecting = [
        WrittenPart("opening", junction, road, lane.middle, _driving([lane]), 0, -lane.width_m / 2) for lane in opening
    ]
    if oncoming:
        connecting.append(replace(part("facing", junction, left, ()), is_oncoming=True))
    through = _driving([lane for lane in beyond if lane not in opening])
    connecting.append(part("through", junction, () if oncoming else left, through))
    branch, parting = partings[0]
    lanes, line, edge_m = branch.lanes_at(parted_m), Offset(0.0), branch.carriageways[0].left_m
    # The room between both roads is shared until both have their whole shoulders.
    inner = WrittenStrip("shoulder", None, lambda s: np.clip(parting.gap_m(s) / 2, 0, road.shoulder_m))
    name, strips = lanes[0].section, (*_driving(lanes), shoulder)
    return [
        *found,
        *(replace(at, before=before, after=after, in_junction=True) for at in connecting),
        part(before, (-REACH_M, 0.0), left, (*_driving(first), shoulder)),
        WrittenPart("leaving", junction, branch, line, strips, 0, edge_m, before, name, in_junction=True),
        part(after, apart, left, (*_driving(beyond), inner)),
        WrittenPart(name, apart, branch, line, (inner, *strips), 1, edge_m),
    ]


def _at(width_m: Width, s: Scalars) -> Scalars:
    return np.broadcast_to(width_m(s) if callable(width_m) else width_m, s.shape)


def _between(low: Offset, high: Offset) -> Callable[[Scalars], Scalars]:
    """The width between two lines."""
    return lambda s: high(s) - low(s)


def _moved(width_m: Width, lane_0: Width, was_m: Width, s: Scalars) -> Scalars:
    """The width of the strip left of lane 0 where that moves."""
    return _at(width_m, s) + _at(lane_0, s) - _at(was_m, s)


def _along_works(network: Network, whole: WrittenPart) -> list[WrittenPart]:
    """A road without exit in its sections along road works, one behind the other. Where the outermost lines are not at
    the edges of the lanes, what is between is no lane."""
    road, found = network.main, list[WrittenPart]()
    starts = sorted({lane.start_m for lane in road.lanes if np.isfinite(lane.start_m)})
    ends = [whole.span_m[0], *starts, max(whole.span_m[1], starts[-1] + MIN_END_M)]
    for span_m in pairwise(ends):
        middle = np.array([(span_m[0] + span_m[1]) / 2])
        lanes = [lane for lane in road.lanes_at(float(middle[0])) if lane.direction == "same"]
        lines = [
            line.pieces[0].offset
            for line in network.delimiters
            if line.direction == "same" and line.start_m < span_m[1] and line.end_m > span_m[0]
        ]
        first, *_, last = sorted(lines, key=lambda line: float(line(middle)[0]))
        strips = (
            WrittenStrip("none", None, _between(first, lanes[0].edges[0])),
            *(WrittenStrip("driving", lane.id, _between(*lane.edges)) for lane in lanes),
            WrittenStrip("none", None, _between(lanes[-1].edges[1], last)),
            WrittenStrip("shoulder", None, _between(last, road.right)),
        )
        s = np.linspace(*span_m, 200)
        there = [at for at in strips if at.kind != "none" or _at(at.width_m, s).max() > LEAST_WIDTH_M]
        lane_0 = _between(whole.line, first)
        left = list(whole.strips[: whole.n_left])
        left[-1] = replace(left[-1], width_m=partial(_moved, left[-1].width_m, lane_0, whole.lane_0_m))
        found.append(replace(whole, name=lanes[0].section, span_m=span_m, strips=(*left, *there), lane_0_m=lane_0))
    names = [None, *(at.name for at in found), None]
    linked = [replace(at, before=names[i], after=names[i + 2]) for i, at in enumerate(found)]
    return linked[:: int(network.onwards)]
