"""Roads as one kind of network: roads on reference lines, their lanes and painted lines, and the links between lanes.
World frame, metres; the rules are in docs/network.md.

A place is (road, s, t), see reference_line.py. It lies on the terrain or, on a raised road, at a height over it.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby, pairwise
from typing import Literal, NamedTuple, cast

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.arrays import AnyPoints2, AnyPoints3, AnyScalars
from synth3dlanes.geometry import terrain as ground
from synth3dlanes.geometry.reference_line import ReferenceLine
from synth3dlanes.labels import Direction, LaneGraph, LaneKind, Marking, RoadName, Segment
from synth3dlanes.scene import Terrain

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")

# Straight pieces between `Ramp.stations` are nowhere farther than this from the ramp: less than paint floats.
RAMP_SAG_M = 0.001
# The lane graph ends at these stations.
GRAPH_END_M = 100.0
# Where roads part, places of the branch are looked for up to this far behind the station on the other road, this deep
# in that one's pavement, and up to so many times its opening beside it.
BEFORE_M, OVERLAP_M, WIDER = 20.0, 1.0, 1.5
# An offset this close to the middle between two carriageways counts as on it, and that as of the right one.
HAIR_M = 1e-6
# Steps along a road in which its extent is measured.
EXTENT_STEP_M = 10.0


@dataclass(frozen=True)
class Offset:
    """t(s) of a line beside a reference line: a constant, and what moves it along the road."""

    base_m: float
    moves: Callable[[AnyScalars], AnyScalars] | None = None

    def __call__(self, s: AnyScalars) -> AnyScalars:
        """The offsets at stations."""
        return np.full(s.shape, self.base_m) if self.moves is None else np.asarray(self.base_m + self.moves(s))

    def shifted(self, t_m: float) -> "Offset":
        """The line `t_m` beside it."""
        return replace(self, base_m=self.base_m + t_m)

    @property
    def order(self) -> tuple[float, bool]:
        """Sorts lanes as t grows: one that opens lies beyond its neighbour, where it begins."""
        return self.base_m, self.moves is not None


@dataclass(frozen=True)
class Ramp:
    """A road's rise over the terrain, from a station on, to a height that it keeps."""

    start_m: float
    length_m: float
    height_m: float

    def __call__(self, s: AnyScalars) -> AnyScalars:
        """Height over the terrain at stations."""
        u = np.clip((s - self.start_m) / self.length_m, 0, 1)
        return np.asarray(self.height_m * u * u * (3 - 2 * u))

    @property
    def stations(self) -> Float[np.ndarray, " _"]:
        """Stations from its start to its end, as far apart as its curvature allows."""
        # A piece of length d is off by d^2 / 8 times the curvature, which is 6 height / length^2 at both ends.
        pieces = int(np.ceil(np.sqrt(6 * self.height_m / (8 * RAMP_SAG_M))))
        return self.start_m + self.length_m * np.linspace(0, 1, max(pieces, 1) + 1)


@dataclass(frozen=True)
class NetworkLane:
    """A lane between two stations of its road, a node of the lane graph: `number` of its section from the host's left.
    Its traffic drives as the host does, or is `oncoming`."""

    id: str
    road: str
    section: str
    number: int
    middle: Offset
    width_m: float
    start_m: float
    end_m: float
    direction: Direction = "same"


class Carriageway(NamedTuple):
    """Lanes of one direction beside each other: offsets of its edges, and how many they are."""

    left_m: float
    right_m: float
    n_lanes: int
    direction: Direction


@dataclass(frozen=True, eq=False)
class Parting:
    """Where a road begins: beside another, on whose right side (as t grows) it leaves. `gap_m` is the free width
    between the lanes of both at stations, and `station` the first one with such a gap, as opposed to `gap_m`.
    `rise_m` is how high the road may rise there: its embankment has room for it."""

    road: "Road"
    gap_m: Callable[[AnyScalars], AnyScalars]
    station: Callable[[float], float]
    rise_m: float

    def may_hold(self, branch: "Road", s: AnyScalars, t: AnyScalars, reach_m: AnyScalars) -> Bool[np.ndarray, " n"]:
        """Which places of the road may be within `reach_m` of a branch's pavement, and are not deep in its own."""
        width_m = branch.lane_width_m
        low_m = self.road.right(s) - width_m - OVERLAP_M
        high_m = self.road.right.base_m + reach_m + WIDER * (self.gap_m(s + BEFORE_M) + width_m)
        return np.asarray((s > branch.start_m - BEFORE_M) & (t > low_m) & (t < high_m))


@dataclass(frozen=True, eq=False)
class Road:
    """A road on its reference line over the stations [start_m, end_m]. Its cross-section, as t grows: the left edge of
    its pavement, a shoulder, lanes and perhaps a median between them, a shoulder, and the right edge."""

    id: str
    line: ReferenceLine
    terrain: Terrain
    left: Offset
    right: Offset
    shoulder_m: float
    lanes: tuple[NetworkLane, ...]
    start_m: float = -np.inf
    end_m: float = np.inf
    ramp: Ramp | None = None
    parting: Parting | None = None

    @property
    def lane_width_m(self) -> float:
        """Width of its lanes."""
        return self.lanes[0].width_m

    @cached_property
    def carriageways(self) -> tuple[Carriageway, ...]:
        """Its carriageways where it begins, from the left."""
        first = sorted((at for at in self.lanes if at.start_m == self.start_m), key=lambda lane: lane.middle.order)
        found = []
        for direction, group in groupby(first, key=lambda lane: lane.direction):
            lanes = list(group)
            half_m = lanes[0].width_m / 2
            ends = lanes[0].middle.base_m - half_m, lanes[-1].middle.base_m + half_m
            found.append(Carriageway(*ends, len(lanes), direction))
        return tuple(found)

    @property
    def medians(self) -> list[tuple[float, float]]:
        """Offsets between which carriageways are apart from each other, without width where one line divides them."""
        return [(a.right_m, b.left_m) for a, b in pairwise(self.carriageways)]

    def is_oncoming(self, t: float) -> bool:
        """Whether the traffic next to an offset is oncoming."""
        beyond = sum(t + HAIR_M > (low_m + high_m) / 2 for low_m, high_m in self.medians)
        return self.carriageways[beyond].direction == "oncoming"

    def lanes_at(self, s: float) -> list[NetworkLane]:
        """Its lanes at a station, as t grows."""
        here = [lane for lane in self.lanes if lane.start_m <= s < lane.end_m]
        return sorted(here, key=lambda lane: lane.middle.order)

    def xy(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints2:
        """World (x, y) of places."""
        return self.line.xy(s, t)

    def points(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints3:
        """Points on its surface."""
        return lift(self.terrain, self.xy(s, t), self.raised(s))

    def raised(self, s: AnyScalars) -> AnyScalars:
        """Height of its surface over the terrain at stations."""
        return np.zeros(np.shape(s)) if self.ramp is None else self.ramp(s)

    def edge(self, side: Side, s: AnyScalars, out_m: AnyScalars | float = 0.0) -> AnyScalars:
        """Offsets `out_m` outside an edge of its pavement."""
        return self.left(s) - out_m if side == "left" else self.right(s) + out_m

    def outside(self, s: AnyScalars, t: AnyScalars) -> AnyScalars:
        """Distance of places from its pavement, negative on it; infinite before its start and beyond its end."""
        beside = np.maximum(self.left(s) - t, t - self.right(s))
        if np.isfinite(self.start_m) or np.isfinite(self.end_m):
            beside = np.where((s >= self.start_m) & (s <= self.end_m), beside, np.inf)
        return np.asarray(beside)

    def may_reach(self, xy_world: AnyPoints2, reach_m: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """Which points may be within `reach_m` of its pavement."""
        return self.line.near(xy_world, self.left.base_m - reach_m, self.right.base_m + reach_m)

    def in_lanes(self, s: AnyScalars, t: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """Which places lie between its shoulders."""
        return np.asarray(self.outside(s, t) < -self.shoulder_m)

    def speed(self, s: AnyScalars) -> AnyScalars:
        """Metres per station of its line and, before its start, of that of the road where it begins."""
        speed = self.line.speed(s)
        return speed if self.parting is None else np.where(s < self.start_m, self.parting.road.speed(s), speed)


@dataclass(frozen=True, eq=False)
class Piece:
    """A line from one station of a road to another."""

    road: Road
    offset: Offset
    start_m: float
    end_m: float


@dataclass(frozen=True)
class LaneCurve:
    """The centre line of a path through the lanes, or a painted line, from `start_m` to `end_m`; its pieces follow each
    other. `direction` is as in the labels; `is_inner` says whether a delimiter faces the oncoming traffic, or is the
    left edge of a road without any. `lanes` are those of a path, as s grows."""

    id: str
    kind: LaneKind
    road: str
    marking: Marking
    left: str | None
    right: str | None
    pieces: tuple[Piece, ...]
    start_m: float = -np.inf
    end_m: float = np.inf
    direction: Direction = "same"
    is_inner: bool = False
    lanes: tuple[NetworkLane, ...] = ()

    def xy_world(self, s: AnyScalars) -> Float[np.ndarray, "n 2"]:
        """World (x, y) at stations."""
        if len(self.pieces) == 1:
            piece = self.pieces[0]
            return piece.road.xy(s, piece.offset(s))
        xy = np.zeros((*s.shape, 2))
        for at, piece in self._parts(s):
            on = np.minimum(s[at], piece.end_m)
            xy[at] = piece.road.xy(on, piece.offset(on))
        return xy

    def points_world(self, s: AnyScalars) -> Float[np.ndarray, "n 3"]:
        """Points on the road surface at stations."""
        return lift(self.pieces[0].road.terrain, self.xy_world(s), self.raised(s))

    def raised(self, s: AnyScalars) -> AnyScalars:
        """Height of the road surface above the terrain at stations."""
        height_m = np.zeros(s.shape)
        for at, piece in self._parts(s):
            height_m[at] = piece.road.raised(s[at])
        return height_m

    def shifted(self, t_m: float) -> "LaneCurve":
        """The curve `t_m` beside it."""
        return replace(
            self, pieces=joined((piece.road, piece.offset.shifted(t_m), piece.start_m) for piece in self.pieces)
        )

    def has(self, s: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """At which stations it is: within its ends, and not between two of its pieces."""
        inside = (s > self.start_m) & (s < self.end_m)
        for a, b in pairwise(self.pieces):
            inside &= (s >= b.start_m) | (s <= a.end_m)
        return np.asarray(inside)

    def lane_at(self, s: float) -> NetworkLane:
        """The lane of a path at a station."""
        return next(lane for lane in reversed(self.lanes) if s >= lane.start_m)

    def _parts(self, s: AnyScalars) -> Iterator[tuple[Bool[np.ndarray, "*n"], Piece]]:
        """Which stations lie on each piece; the first and the last one have no outer ends."""
        ends = [-np.inf, *(piece.start_m for piece in self.pieces[1:]), np.inf]
        for piece, (low, high) in zip(self.pieces, pairwise(ends), strict=True):
            yield (s >= low) & (s < high), piece


class Nearby(NamedTuple):
    """Points that may be near a road: which of a query they are, and their places along it."""

    road: Road
    which: Bool[np.ndarray, " n"]
    s: AnyScalars
    t: AnyScalars


@dataclass(frozen=True, eq=False)
class Network:
    """Roads, the first of which is the host's, with their painted lines, and links (lane, lane) as traffic drives. A
    road comes after the one where it begins. The host drives with growing s where `onwards` is 1, against it where it
    is -1; stations as it drives grow ahead of it."""

    terrain: Terrain
    roads: tuple[Road, ...]
    delimiters: tuple[LaneCurve, ...]
    links: tuple[tuple[str, str], ...]
    onwards: float = 1.0

    @property
    def main(self) -> Road:
        """The road whose stations scenes use."""
        return self.roads[0]

    @property
    def rightward(self) -> float:
        """1 where t grows to the right as the host drives, else -1."""
        return -self.onwards if self.main.line.is_mirrored else self.onwards

    @cached_property
    def lanes(self) -> dict[str, NetworkLane]:
        """All lanes by id: the host's, then oncoming ones; a section's from the host's left."""
        lanes = (lane for road in self.roads for lane in road.lanes)
        return {lane.id: lane for lane in sorted(lanes, key=lambda lane: lane.direction == "oncoming")}

    @cached_property
    def paths(self) -> tuple[LaneCurve, ...]:
        """The centre line of every way through the links, as t grows. It has the id of its last lane where roads split,
        of its first where they merge."""
        ways = list(_ways(list(_as_t_grows(self)), self.links))
        at = -1 if len({way[-1].id for way in ways}) >= len({way[0].id for way in ways}) else 0
        return tuple(self._path(way[at], sorted(way, key=lambda lane: lane.start_m)) for way in ways)

    def _path(self, named: NetworkLane, lanes: list[NetworkLane]) -> LaneCurve:
        beside = [line for line in self.delimiters if line.end_m >= named.end_m]
        left = next((line.id for line in beside if line.right == named.id), None)
        right = next((line.id for line in beside if line.left == named.id), None)
        pieces = joined((self.road(lane.road), lane.middle, lane.start_m) for lane in lanes)
        return LaneCurve(
            named.id,
            "centerline",
            named.road,
            "none",
            left,
            right,
            pieces,
            direction=named.direction,
            lanes=tuple(lanes),
        )

    @cached_property
    def curves(self) -> tuple[LaneCurve, ...]:
        """All centre lines, then all delimiters."""
        return (*self.paths, *self.delimiters)

    def road(self, name: str) -> Road:
        """A road by its id."""
        return next(road for road in self.roads if road.id == name)

    def branches(self, road: Road) -> list[Road]:
        """The roads that begin beside a road."""
        return [other for other in self.roads if other.parting is not None and other.parting.road is road]

    def path(self, lane: str) -> LaneCurve:
        """The first centre line along a lane."""
        return next(path for path in self.paths if any(lane == at.id for at in path.lanes))

    def stations(self, s: AnyScalars) -> AnyScalars:
        """Stations of stations as the host drives, and vice versa."""
        return s * self.onwards

    def lanes_at(self, s: float) -> list[NetworkLane]:
        """The lanes of all roads at a station: the host's from its left, then oncoming ones."""
        return [lane for lane in self.lanes.values() if lane.start_m <= s < lane.end_m]

    def host_lane(self, number: int, driven_m: float) -> NetworkLane:
        """The host's lane `number` from its left, at a station as it drives."""
        return self.lanes_at(driven_m * self.onwards)[number - 1]

    def successors(self, lane: str) -> list[NetworkLane]:
        """The lanes that follow a lane."""
        return [self.lanes[after] for before, after in self.links if before == lane]

    def joined_to(self, lane: NetworkLane) -> list[NetworkLane]:
        """The lanes that a lane is linked to."""
        return [self.lanes[name] for link in self.links if lane.id in link for name in link if name != lane.id]

    def lift(self, xy_world: AnyPoints2, above_m: AnyScalars | float = 0.0) -> AnyPoints3:
        """3D points on the terrain, or `above_m` over it."""
        return lift(self.terrain, xy_world, above_m)

    def graph(self, centerlines: Sequence[str]) -> LaneGraph:
        """The lane graph of the labels; its segments list those of their centre lines that are given."""
        segments = []
        for lane in self.lanes.values():
            ends = np.clip([lane.start_m, lane.end_m], -GRAPH_END_M, GRAPH_END_M) * self.onwards + 0.0
            start_m, end_m = np.sort(ends)[:: 1 if lane.direction == "same" else -1].tolist()
            names = {n: f"{lane.section}_{n}" for n in (lane.number - 1, lane.number + 1)}
            left, right = (name if name in self.lanes else None for name in names.values())
            along = [path.id for path in self.paths if lane in path.lanes and path.id in centerlines]
            segments.append(
                Segment(lane.id, cast(RoadName, lane.road), lane.number, start_m, end_m, left, right, tuple(along))
            )
        successors = {before: tuple(lane.id for lane in self.successors(before)) for before, _ in sorted(self.links)}
        starts = [round(float(road.ramp.start_m * self.onwards), 4) + 0.0 for road in self.roads if road.ramp]
        return LaneGraph(tuple(segments), successors, starts[0] if starts else None)

    def stations_along(self, road: Road, driven_m: float, lengths_m: AnyScalars) -> AnyScalars:
        """Stations as the host drives, at the given lengths of a road ahead of `driven_m`; sorted lengths, negative
        behind it."""
        if lengths_m[0] < 0:
            behind, ahead = lengths_m[lengths_m < 0], lengths_m[lengths_m >= 0]
            before = self._along(road, driven_m, -behind[::-1], -1)[::-1]
            return np.concatenate([before, self._along(road, driven_m, ahead)])
        return self._along(road, driven_m, lengths_m)

    def _along(
        self, road: Road, driven_m: float, lengths_m: AnyScalars, sign: int = 1, reach: float = 1.05
    ) -> AnyScalars:
        """Stations at lengths ahead of `driven_m`, or behind it with the sign -1."""
        grid = driven_m + sign * np.linspace(0, reach * lengths_m[-1], 8 * int(lengths_m[-1]) + 9)
        speed = road.speed(self.stations((grid[1:] + grid[:-1]) / 2))
        arc = np.concatenate([[0.0], np.cumsum(speed * np.abs(np.diff(grid)))])
        # On the inside of a bend a road is shorter than its stations.
        if arc[-1] < lengths_m[-1]:
            return self._along(road, driven_m, lengths_m, sign, 1.5 * reach)
        return np.interp(lengths_m, arc, grid)

    def nearby(
        self, xy_world: Float[np.ndarray, "n 2"], reach_m: AnyScalars
    ) -> tuple[Bool[np.ndarray, " n"], list[Nearby]]:
        """Which points may be within `reach_m` of a pavement, and where these are along every road that any may be
        near."""
        masks = {road.id: road.may_reach(xy_world, reach_m) for road in self.roads}
        near = np.logical_or.reduce(list(masks.values()))
        xy = xy_world[near]
        found: dict[str, Nearby] = {}
        for road in self.roads:
            guess = None
            if road.parting is None:
                which = np.logical_or.reduce([masks[at.id][near] for at in (road, *self.branches(road))])
            elif beside := found.get(road.parting.road.id):
                close = road.parting.may_hold(road, beside.s, beside.t, reach_m[near][beside.which])
                which, guess = beside.which.copy(), beside.s[close]
                which[which] = close
            else:
                continue
            if which.any():
                found[road.id] = Nearby(road, which, *road.line.project(xy[which], guess))
        return near, list(found.values())

    def around(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> "Network":
        """The part of the network within `reach_m` of a point, from above."""
        low, high = self._extents
        near = ((low < xy_world + reach_m) & (high > xy_world - reach_m)).all(axis=1)
        if near.all():
            return self
        chosen = [road for road, is_near in zip(self.roads, near, strict=True) if is_near]
        kept = {road.id for road in chosen} | {road.parting.road.id for road in chosen if road.parting}
        roads = tuple(road for road in self.roads if road.id in kept)
        delimiters = tuple(line for line in self.delimiters if all(piece.road.id in kept for piece in line.pieces))
        links = tuple(link for link in self.links if all(self.lanes[lane].road in kept for lane in link))
        return replace(self, roads=roads, delimiters=delimiters, links=links)

    @cached_property
    def _extents(self) -> Float[np.ndarray, "2 roads 2"]:
        """The lowest and the highest (x, y) of all roads' pavements; infinite for roads without ends."""
        found = np.zeros((2, len(self.roads), 2))
        found[0], found[1] = -np.inf, np.inf
        for i, road in enumerate(self.roads):
            if np.isfinite(road.end_m - road.start_m):
                s = np.linspace(road.start_m, road.end_m, 2 + int((road.end_m - road.start_m) / EXTENT_STEP_M))
                xy = np.concatenate([road.xy(s, road.left(s)), road.xy(s, road.right(s))])
                found[:, i] = xy.min(axis=0) - EXTENT_STEP_M, xy.max(axis=0) + EXTENT_STEP_M
        return found


def lift(terrain: Terrain, xy_world: AnyPoints2, above_m: AnyScalars | float = 0.0) -> AnyPoints3:
    """3D points on the terrain, or `above_m` over it."""
    z = ground.height_at(terrain, xy_world) + above_m
    return np.concatenate([xy_world, np.asarray(z)[..., None]], -1)


def joined(parts: Iterable[tuple[Road, Offset, float]]) -> tuple[Piece, ...]:
    """The pieces of a curve from where each begins. One ends where the next begins or, on another road, beside that
    place."""
    merged: list[tuple[Road, Offset, float]] = []
    for road, offset, start_m in parts:
        if not merged or (road, offset) != merged[-1][:2]:
            merged.append((road, offset, start_m))
    pieces = []
    for (road, offset, start_m), (after, beyond, next_m) in pairwise(merged):
        end_m = next_m
        if after is not road:
            at = np.array([next_m])
            end_m = min(next_m, float(road.line.project(after.xy(at, beyond(at)))[0][0]))
        pieces.append(Piece(road, offset, start_m, end_m))
    road, offset, start_m = merged[-1]
    return (*pieces, Piece(road, offset, start_m, np.inf))


def _as_t_grows(network: Network) -> Iterator[NetworkLane]:
    """All lanes, those of a section as t grows."""
    for _, group in groupby(network.lanes.values(), key=lambda lane: lane.section):
        yield from list(group)[:: int(network.rightward)]


def _ways(lanes: Sequence[NetworkLane], links: Sequence[tuple[str, str]]) -> Iterator[list[NetworkLane]]:
    """All ways from lanes that follow no other to lanes that no other follows."""
    by_id = {lane.id: lane for lane in lanes}

    def onward(way: list[NetworkLane]) -> Iterator[list[NetworkLane]]:
        after = [by_id[b] for a, b in links if a == way[-1].id and by_id[b] not in way]
        if not after:
            yield way
        for lane in after:
            yield from onward([*way, lane])

    followers = {after for _, after in links}
    for lane in lanes:
        if lane.id not in followers:
            yield from onward([lane])
