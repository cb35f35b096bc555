"""Roads as one kind of network: roads, their lanes and painted lines, and the links between lanes. World frame, metres;
the rules are in docs/network.md."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.labels.labels import LaneGraph, Segment
from synth3dlanes.roads.lane_curves import LaneCurve, Neighbour, joined, neighbours
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Road, lift
from synth3dlanes.roads.terrain import gradient_at
from synth3dlanes.scene.host import Camera
from synth3dlanes.scene.scene import Car, Terrain
from synth3dlanes.system.arrays import AnyPoints2, AnyPoints3, AnyScalars, Points2, Points3, Scalars
from synth3dlanes.system.errors import InputError

# The lane graph ends at these stations.
GRAPH_END_M = 100.0
# A common station this close to a line's own end is left out: two coinciding points have no direction.
APART_M = 0.01
# The host drives between these stations, and a little beyond.
HOST_ROAD_M = 115.0
# Steps along a road in which its extent is measured.
EXTENT_STEP_M = 10.0
# Points of the middle and the edges of lanes are this far apart, and where a lane begins at the end of another that is
# on another road at least so far beyond that.
LINES_STEP_M, LEAST_GAP_M = 0.5, 0.25
# Stations around a place for which lengths along the road are measured.
AROUND_M = np.arange(-10.0, 10.01, 0.25)


class Nearby(NamedTuple):
    """Points that may be near a road: which of a query they are, and their places along it."""

    road: Road
    which: Bool[np.ndarray, " n"]
    s: AnyScalars
    t: AnyScalars


class LanePattern(NamedTuple):
    """How the lanes lie across the pavement's texture coordinates: their width, 1 where the middle of a lane is at 0
    and 0 where an edge is, and where a median of which width is; whether each place across is one along all roads."""

    width_m: float
    parity: int
    median_at_m: float = -1e6
    median_m: float = 0.0
    is_along: bool = True


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
    def host_stretches(self) -> list[tuple[Road, float, float]]:
        """The roads that the host drives on, each between two stations near it, junctions left out."""
        return [(self.main, -HOST_ROAD_M, HOST_ROAD_M)]

    @property
    def across(self) -> LanePattern:
        """The lanes of the main road across its texture."""
        own, median_m = self.main.carriageways[-1], sum(right_m - left_m for left_m, right_m in self.main.medians)
        return LanePattern(self.main.lane_width_m, own.n_lanes % 2, own.left_m - median_m / 2, median_m)

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
        left, right = (
            next((line.id for line in beside if Neighbour(named.id, not is_right) in line.neighbours), None)
            for is_right in (False, True)
        )
        pieces = joined((self.road(lane.road), lane.middle, lane.start_m) for lane in lanes)
        return LaneCurve(
            named.id,
            "centerline",
            named.road,
            "none",
            neighbours(left, right),
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

    def neighbours(self, segment: Segment) -> tuple[str | None, str | None]:
        """The lanes to the left and the right of one of the lane graph, as its own traffic drives."""
        is_oncoming = self.lanes[segment.id].direction == "oncoming"
        return (segment.right, segment.left) if is_oncoming else (segment.left, segment.right)

    def joined_to(self, lane: NetworkLane) -> list[NetworkLane]:
        """The lanes that a lane is linked to."""
        return [self.lanes[name] for link in self.links if lane.id in link for name in link if name != lane.id]

    def lift(self, xy_world: AnyPoints2, above_m: AnyScalars | float = 0.0) -> AnyPoints3:
        """3D points on the terrain, or `above_m` over it."""
        return lift(self.terrain, xy_world, above_m)

    def up(self, camera: Camera, foot_world: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """The unit normal of the surface at the host's place."""
        ((dx, dy),) = gradient_at(self.terrain, foot_world[None, :2])
        return np.asarray(np.array([-dx, -dy, 1.0]) / np.sqrt(dx * dx + dy * dy + 1))

    def host_points(self, camera: Camera, ahead_m: AnyScalars) -> AnyPoints3:
        """Points on the host's way, its offset from its lane included, at stations ahead of its place."""
        lane = self.host_lane(camera.lane, camera.y_m)
        s = self.stations(camera.y_m + ahead_m)
        return self.road(lane.road).points(s, lane.middle(s) + camera.offset_m * self.rightward)

    def host_way(self, camera: Camera) -> LaneCurve:
        """The path that the host drives on."""
        return self.path(self.host_lane(camera.lane, camera.y_m).id)

    def host_lines(self, camera: Camera) -> list[str]:
        """The centre lines that the host drives along, from its place on."""
        return [self.host_way(camera).id]

    def host_on(self, camera: Camera, driven_m: float) -> Camera:
        """The host at another station of its way; raise InputError where that leaves its road."""
        before = self.host_lane(camera.lane, camera.y_m)
        lane = self.path(before.id).lane_at(driven_m * self.onwards)
        if lane.road != before.road:
            raise InputError(f"camera.lane: expected a lane that stays on the main road in a clip, got {camera.lane}")
        return camera.model_copy(update={"y_m": driven_m, "lane": lane.number})

    def car_way(self, car: Car) -> tuple[LaneCurve, float]:
        """The path that a car drives on, and its station there as the host drives."""
        return self.path(car.lane), car.s_m

    def car_on(self, car: Car, driven_m: float) -> Car:
        """A car at another station of its way."""
        return car.model_copy(update={"s_m": driven_m, "lane": self.path(car.lane).lane_at(driven_m * self.onwards).id})

    def in_lane(self, lane: str, driven_m: AnyScalars) -> tuple[LaneCurve, AnyScalars]:
        """The first centre line along a lane, and its stations, as the host drives, at stations of cars in it."""
        return self.path(lane), driven_m

    def places_around(self, lane: str | None, s_m: float) -> Callable[[Points2], Points3]:
        """World points of places (right, ahead) in metres, as the host drives, from a station of the middle of a lane
        or, without a lane, of the main road's line."""
        at = None if lane is None else self.lanes[lane]
        road, middle = (self.main, Offset(0.0)) if at is None else (self.road(at.road), at.middle)
        driven_m = s_m + AROUND_M
        around = self.stations(driven_m)
        steps = np.diff(road.xy(around, middle(around)), axis=0)
        length_m = np.concatenate([[0.0], np.cumsum(np.hypot(*steps.T))])
        length_m -= np.interp(s_m, driven_m, length_m)

        def points_world(places: Points2) -> Points3:
            s = self.stations(np.interp(places[:, 1], length_m, driven_m))
            return road.points(s, middle(s) + places[:, 0] * self.rightward)

        return points_world

    def in_range(self, camera: Camera, lengths_m: Scalars) -> dict[LaneCurve, Float[np.ndarray, " _"]]:
        """The stations of the points of every line, at these lengths of road ahead of the host and at its ends between
        them, in driving order."""
        driven_m = {road.id: self.stations_along(road, camera.y_m, lengths_m) for road in self.roads}
        return {curve: self._points_of(curve, driven_m[curve.road]) for curve in self.curves}

    def points_along(self, stations: Mapping[LaneCurve, Float[np.ndarray, " _"]]) -> list[Float[np.ndarray, "_ 3"]]:
        """Points on the road surface at stations of lines, one line after the other."""
        return [curve.points_world(s) for curve, s in stations.items()]

    def _points_of(self, curve: LaneCurve, driven_m: Scalars) -> Float[np.ndarray, " m"]:
        s = self.stations(driven_m)
        low, high = min(s[0], s[-1]), max(s[0], s[-1])
        ends = np.array([end for end in (curve.start_m, curve.end_m) if low < end < high])
        kept = s[curve.has(s)]
        kept = kept[(np.abs(kept[:, None] - ends) > APART_M).all(axis=1)]
        return np.sort(np.concatenate([kept, ends]))[:: int(self.onwards)]

    def known(self, camera: Camera, places_m: Scalars, lengths_m: Float[np.ndarray, " _"]) -> set[str]:
        """The ids of the lines that are in range of the host at any of some stations."""
        hosts = (camera.model_copy(update={"y_m": float(y_m)}) for y_m in places_m)
        return {curve.id for host in hosts for curve, s in self.in_range(host, lengths_m).items() if len(s) > 1}

    def known_at(self, n_frames: int) -> int:
        """The number of instants of a clip, from its first frame to its last, that have between them all lines of any
        frame: a line comes into range or is passed, never both."""
        return min(n_frames, 2)

    def graph(self, centerlines: Sequence[str]) -> LaneGraph:
        """The lane graph of the labels; its segments list those of their centre lines that are given."""
        segments = []
        for lane in self.lanes.values():
            ends = np.clip([lane.start_m, lane.end_m], -GRAPH_END_M, GRAPH_END_M) * self.onwards + 0.0
            start_m, end_m = np.sort(ends)[:: 1 if lane.direction == "same" else -1].tolist()
            names = {n: f"{lane.section}_{n}" for n in (lane.number - 1, lane.number + 1)}
            left, right = (name if name in self.lanes else None for name in names.values())
            along = [path.id for path in self.paths if lane in path.lanes and path.id in centerlines]
            segments.append(Segment(lane.id, lane.road, lane.number, start_m, end_m, left, right, tuple(along)))
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

    def stations_near(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> Scalars:
        """Stations up to a distance before and beyond a place of the host, in ascending order."""
        driven_m = float(xy_world[1]) + np.arange(-reach_m, reach_m + LINES_STEP_M / 2, LINES_STEP_M)
        return np.sort(self.stations(driven_m))

    def lane_lines(
        self, lane: NetworkLane, xy_world: Float[np.ndarray, "2"], reach_m: float
    ) -> tuple[Points3, Points3, Points3] | None:
        """A lane's middle, its left and its right edge within about `reach_m` of a place of the host, as its traffic
        drives: points i are beside each other. None where it is farther away."""
        road = self.road(lane.road)
        s = np.unique(np.clip(self.stations_near(xy_world, reach_m), lane.start_m, lane.end_m))
        if len(s) < 2:
            return None
        lines = [road.points(s, offset(s)) for offset in (lane.middle, *lane.edges)]
        before = next((at for at in self.joined_to(lane) if at.road != lane.road and at.end_m == lane.start_m), None)
        if before is not None and s[0] <= lane.start_m:
            # It begins where the lane before it ends, on another road; its own first points may lie behind that.
            other = self.road(before.road)
            ahead = np.all([other.line.project(line[:, :2])[0] > s[0] + LEAST_GAP_M for line in lines], axis=0)
            starts = [other.points(s[:1], offset(s[:1])) for offset in (before.middle, *before.edges)]
            lines = [np.concatenate([start, line[ahead]]) for start, line in zip(starts, lines, strict=True)]
        middle, low, high = (line[:: 1 if lane.ascends else -1] for line in lines)
        return (middle, low, high) if lane.ascends != road.line.is_mirrored else (middle, high, low)

    def delimiters_near(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> dict[LaneCurve, Scalars]:
        """The stations of places along the painted lines within about `reach_m` of a place of the host."""
        s = self.stations_near(xy_world, reach_m)
        return {line: s[(s >= line.start_m) & (s <= line.end_m)] for line in self.delimiters}

    def along_host(self, driven_m: Scalars) -> Points3:
        """Points on the main road's line, at stations as the host drives."""
        return self.main.points(self.stations(driven_m), 0.0)

    def road_stations(self, road: Road, camera: Camera, behind_m: float, ahead_m: float) -> Scalars:
        """Stations of a road from behind the host to ahead of it, as it drives; none where the road is not there."""
        s = self.stations(np.arange(camera.y_m - behind_m, camera.y_m + ahead_m + 0.5))
        return np.asarray(s[(s >= road.start_m) & (s <= road.end_m)])

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
