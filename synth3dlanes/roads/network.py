"""Roads as a network: roads, their lanes, the links between these, the lines along them, and the way of the host. World
frame, metres; the rules are in docs/network.md."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.geometry.frames import cross
from synth3dlanes.labels.labels import LaneGraph, Segment
from synth3dlanes.roads.lane_curves import Course, LaneCurve, along
from synth3dlanes.roads.line_table import HostStation, LineStations, LineTable, RoadLines
from synth3dlanes.roads.road_table import RoadIndex
from synth3dlanes.roads.roads import NetworkLane, Road, lift
from synth3dlanes.roads.terrain import gradient_at
from synth3dlanes.scene.host import HostCamera
from synth3dlanes.scene.road_map import MapIsland
from synth3dlanes.scene.scene import Car, Terrain
from synth3dlanes.system.arrays import AnyPoints2, AnyPoints3, AnyScalars, Points2, Points3, Scalars
from synth3dlanes.system.errors import InputError

# The lane graph ends at these stations of roads that have no end, or this far behind where their last lanes begin.
GRAPH_END_M, LAST_LANE_M = 100.0, 10.0
# Distance between points of the middle and the edges of lanes, and the least gap behind the point where a lane begins
# at the end of another road's.
LINES_STEP_M, LEAST_GAP_M = 0.5, 0.25
# The normal of a surface that roads make is measured over this length to both sides.
ACROSS_M = 0.5
# Ratio of the search radius to a reach along roads: roads turn.
SEARCH_RATIO = 2.0


class LanePattern(NamedTuple):
    """How the lanes lie across the pavement's texture coordinates: their width, 1 where the middle of a lane is at 0
    and 0 where an edge is, and where a median of which width is; whether each place across is one along all roads."""

    width_m: float
    parity: int
    median_at_m: float = -1e6
    median_m: float = 0.0
    is_along: bool = True


class Junction(NamedTuple):
    """A junction: its connecting roads, and the outline of its pavement where it is known."""

    id: str
    roads: tuple[Road, ...]
    outline: Points2


class HostLine(NamedTuple):
    """A centre line on which the host may drive, between two of its stations: of its route or, where it keeps a lane,
    along that one."""

    line: LaneCurve
    start_m: float = -np.inf
    end_m: float = np.inf


@dataclass(frozen=True, eq=False)
class Network:
    """Roads with lanes, in the order of the labels, links (lane, lane) as traffic drives, the centre lines of the ways
    through these, painted lines and junctions. A road comes after the one where it begins.

    `lines` answers for many of all centre lines and delimiters at once. `way` is the line whose stations, as the host
    drives, scenes use for the host, `host_lines` are those that it may drive on, from its left. The surface there
    `is_terrain`, or what the roads make of it. `host_stretches` are the roads near the host that it drives on, each
    between two stations, junctions left out. `yields` are pairs of lanes, the first of which yields to the second, None
    where the roads know of none. `removed` are the lines that were painted where others hold now. `courses` are those
    of lanes that routes may use. `closed` is where road works let nobody drive: quadrangles from above."""

    terrain: Terrain
    roads: tuple[Road, ...]
    lanes: Mapping[str, NetworkLane]
    links: tuple[tuple[str, str], ...]
    paths: tuple[LaneCurve, ...]
    delimiters: tuple[LaneCurve, ...]
    way: LaneCurve
    lines: LineTable | RoadLines
    across: LanePattern
    host_lines: tuple[HostLine, ...] = ()
    is_terrain: bool = True
    host_stretches: tuple[tuple[Road, float, float], ...] = ()
    junctions: tuple[Junction, ...] = ()
    yields: tuple[tuple[str, str], ...] | None = None
    islands: tuple[MapIsland, ...] = ()
    removed: tuple[LaneCurve, ...] = ()
    courses: Mapping[str, Course] = field(default_factory=dict)
    closed: Float[np.ndarray, "k 4 2"] = field(default_factory=partial(np.zeros, (0, 4, 2)))

    # -- roads, lanes and lines

    @property
    def main(self) -> Road:
        """The road where the way of the host begins."""
        return self.road(self.way.road)

    @property
    def onwards(self) -> float:
        """1 where the host drives with growing s, -1 where it drives against it."""
        return 1.0 if self.way.ascends else -1.0

    @property
    def rightward(self) -> float:
        """1 where t grows to the right as the host drives, else -1."""
        return self.way.rightward

    @property
    def curves(self) -> tuple[LaneCurve, ...]:
        """All centre lines, then all delimiters."""
        return self.lines.curves

    @cached_property
    def _road_of(self) -> dict[str, Road]:
        return {road.id: road for road in self.roads}

    @cached_property
    def _path_of(self) -> dict[str, LaneCurve]:
        return {lane.id: path for path in reversed(self.paths) for lane in path.lanes}

    def road(self, name: str) -> Road:
        """A road by its id. Raises InputError for one that is too far from the host."""
        if name not in self._road_of:
            raise InputError(f"map: expected roads near the host, got {name}")
        return self._road_of[name]

    def path(self, lane: str) -> LaneCurve:
        """The first centre line along a lane. Raises InputError for one that is too far from the host, or has no
        width."""
        if lane not in self._path_of:
            raise InputError(f"map: expected lanes of traffic near the host, with a width, got {lane}")
        return self._path_of[lane]

    @cached_property
    def has_partings(self) -> bool:
        """Whether any road is a branch."""
        return any(road.parting for road in self.roads)

    def branches(self, road: Road) -> list[Road]:
        """The branches of a road: those that begin beside it."""
        return [other for other in self.roads if other.parting is not None and other.parting.road is road]

    def is_on_other(self, road: Road, xy_world: Points2, s: Scalars) -> Bool[np.ndarray, " n"]:
        """Which points, at these stations of a road, lie on the pavement of another one, of roads that share them."""
        found = np.zeros(len(xy_world), dtype=bool)
        for other in self.roads:
            if other is not road:
                near = other.may_reach(xy_world, np.zeros(len(xy_world)))
                found[near] |= other.outside(*other.line.project(xy_world[near], s[near])) <= 0
        return found

    def stations(self, s: AnyScalars) -> AnyScalars:
        """Stations of stations as the host drives, and vice versa."""
        return s * self.onwards

    def lanes_at(self, s: float) -> list[NetworkLane]:
        """The lanes of all roads at a station that they share: the host's from its left, then oncoming ones."""
        return [lane for lane in self.lanes.values() if lane.start_m <= s < lane.end_m]

    def successors(self, lane: str) -> list[NetworkLane]:
        """The lanes that follow a lane."""
        return [self.lanes[after] for before, after in self.links if before == lane]

    def joined_to(self, lane: NetworkLane) -> list[NetworkLane]:
        """The lanes that a lane is linked to."""
        return [self.lanes[name] for link in self.links if lane.id in link for name in link if name != lane.id]

    @cached_property
    def index(self) -> RoadIndex:
        """Its roads as arrays, numbered as in `roads`, and where they are; of roads with both ends."""
        return RoadIndex(self.roads, self.terrain)

    def lift(self, xy_world: AnyPoints2, above_m: AnyScalars | float = 0.0) -> AnyPoints3:
        """3D points on the terrain, or `above_m` over it."""
        return lift(self.terrain, xy_world, above_m)

    # -- the host and the cars

    def host_ways(self, driven_m: float) -> list[LaneCurve]:
        """The centre lines that the host may drive on at a station as it drives, from its left."""
        return [at.line for at in self.host_lines if at.start_m <= driven_m * self.onwards < at.end_m]

    def host_lane(self, number: int, driven_m: float) -> NetworkLane:
        """The lane of the host at a station as it drives, of those from its left."""
        return self.host_ways(driven_m)[number - 1].lane_at(driven_m * self.onwards)

    def host_way(self, camera: HostCamera) -> LaneCurve:
        """The centre line that the host drives on."""
        return self.host_ways(camera.y_m)[camera.lane - 1]

    def host_points(self, camera: HostCamera, ahead_m: AnyScalars) -> AnyPoints3:
        """Points on the host's way, its offset from its lane included, at stations ahead of its place."""
        way = self.host_way(camera)
        return way.points_beside(
            self.stations(camera.y_m + ahead_m), np.full(ahead_m.shape, camera.offset_m * way.rightward)
        )

    def up(self, camera: HostCamera, foot_world: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """The unit normal of the surface at the host's place."""
        if self.is_terrain:
            ((dx, dy),) = gradient_at(self.terrain, foot_world[None, :2])
            return np.asarray(np.array([-dx, -dy, 1.0]) / np.sqrt(dx * dx + dy * dy + 1))
        s, aside_m = np.full(2, camera.y_m), camera.offset_m + np.array([-ACROSS_M, ACROSS_M])
        left, right = self.way.points_beside(s, aside_m)
        behind, ahead = self.host_points(camera, np.array([-ACROSS_M, ACROSS_M]))
        normal = cross(right - left, ahead - behind)
        return np.asarray(normal / np.linalg.norm(normal))

    def paths_ahead(self, camera: HostCamera) -> list[str]:
        """The centre lines of lanes that the host drives along, from its place on: a route leads along several."""
        way = self.host_way(camera)
        if any(way is path for path in self.paths):
            return [way.id]
        lanes = way.lanes[way.lane_number_at(camera.y_m) :]
        return list(dict.fromkeys(self.path(lane.id).id for lane in lanes))

    def host_on(self, camera: HostCamera, driven_m: float) -> HostCamera:
        """The host at another station of its way; raise InputError where the lane that it keeps leaves its road."""
        s = driven_m * self.onwards
        numbers = {way.lane_at(s).id: i for i, way in enumerate(self.host_ways(driven_m), 1)}
        lane = self.host_way(camera).lane_at(s).id
        if lane not in numbers:
            raise InputError(f"camera.lane: expected a lane that stays on the main road in a clip, got {camera.lane}")
        return camera.model_copy(update={"y_m": driven_m, "lane": numbers[lane]})

    def car_way(self, car: Car) -> tuple[LaneCurve, float]:
        """The centre line that a car drives on, through the lanes of its route or, of lanes without courses, that along
        its lane, and its station there. Raises InputError as `path` does for its lane."""
        way = self.path(car.lane)
        if car.lane in self.courses:
            way = self.way_through([self.lanes[name] for name in (car.lane, *car.route) if name in self.lanes])
        return way, float(way.stations_on(car.lane, car.s_m * self.onwards))

    def car_on(self, car: Car, s: float) -> Car:
        """A car at another station of its way."""
        way, _ = self.car_way(car)
        at, on = way.lane_number_at(s), float(way.piece_at(s).on(np.array([s]))[0])
        return car.model_copy(update={"s_m": on * self.onwards, "lane": way.lanes[at].id, "route": car.route[at:]})

    def way_through(self, lanes: Sequence[NetworkLane]) -> LaneCurve:
        """The centre line along lanes that follow each other, as their traffic drives."""
        return along(lanes, self.courses)

    # -- labels

    @cached_property
    def graph_end_m(self) -> float:
        """The station, and less than 0 the other one, at which the lane graph ends on roads that have no end."""
        ends = [abs(s) for lane in self.lanes.values() for s in lane.driven if np.isfinite(s)]
        return max(GRAPH_END_M, max(ends, default=0.0) + LAST_LANE_M)

    @property
    def line_table(self) -> LineTable:
        """Its lines as arrays, if their stations are lengths along them; numbered as in `curves`."""
        assert isinstance(self.lines, LineTable), "asked only of lines on roads of one section"
        return self.lines

    def xy_in_lanes(self, lanes: Sequence[NetworkLane], which: Int[np.ndarray, " n"], s: Scalars) -> Points2:
        """World (x, y) of the middles of lanes with courses, by the number of each, at stations of its road."""
        lines = [line for lane in lanes if (line := self.courses[lane.id].on_table) is not None]
        table = self.line_table.table
        road, t = table.on_lines(lines, which, s)
        return table.xy(road, s, t)

    def points_along(self, stations: LineStations) -> list[Float[np.ndarray, "_ 3"]]:
        """Points on the road surface at stations of lines, one line after the other."""
        on_line = [np.zeros(1)] * len(stations)
        return [points[:, 0] for points in self.lines.points_beside([*stations], [*stations.values()], on_line)]

    def in_range(self, camera: HostCamera, lengths_m: Scalars) -> LineStations:
        """The stations of the points of every line in range of the host, up to the greatest of these lengths ahead of
        it and the least, if that is negative, behind it."""
        return self.lines.in_range(self._host_at(camera, camera.y_m), lengths_m)

    def known(self, camera: HostCamera, places_m: Scalars, lengths_m: Float[np.ndarray, " _"]) -> set[str]:
        """The ids of the lines that are in range of the host at any of some stations, each ahead of the one before."""
        return self.lines.known([self._host_at(camera, y_m) for y_m in places_m.tolist()], lengths_m)

    def _host_at(self, camera: HostCamera, driven_m: float) -> HostStation:
        return HostStation(driven_m, lambda ahead_m: self.host_points(camera, driven_m - camera.y_m + ahead_m))

    def graph(self, centerlines: Sequence[str]) -> LaneGraph:
        """The lane graph of the labels: the lanes of the given centre lines."""
        given, along = set(centerlines), dict[str, list[str]]()
        for path in self.paths:
            for lane in path.lanes if path.id in given else ():
                along.setdefault(lane.id, []).append(path.id)
        numbered = {(lane.section, lane.number): lane.id for lane in self.lanes.values()}
        segments = []
        for lane in self.lanes.values():
            if lane.id in along:
                ends = [s if np.isfinite(s) else float(np.copysign(self.graph_end_m, s)) for s in lane.driven]
                start_m, end_m = (s * self.onwards + 0.0 for s in ends)
                beside = (numbered.get((lane.section, lane.number + step)) for step in (-1, 1))
                left, right = (name if name in along else None for name in beside)
                paths = tuple(along[lane.id])
                segments.append(
                    Segment(lane.id, lane.road, lane.number, start_m, end_m, left, right, paths, lane.junction)
                )
        pairs = [(before, after) for before, after in self.links if before in along and after in along]
        successors = {before: tuple(b for a, b in pairs if a == before) for before, _ in sorted(pairs)}
        starts = [round(float(road.ramp.start_m * self.onwards), 4) + 0.0 for road in self.roads if road.ramp]
        yields = None if self.yields is None else tuple(at for at in self.yields if at[0] in along and at[1] in along)
        return LaneGraph(tuple(segments), successors, starts[0] if starts else None, yields)

    def neighbours(self, segment: Segment) -> tuple[str | None, str | None]:
        """The lanes to the left and the right of one of the lane graph, as its own traffic drives."""
        lane = self.lanes[segment.id]
        rightward = 1.0 if lane.ascends != self.road(lane.road).line.is_mirrored else -1.0
        middle = np.clip([lane.start_m, lane.end_m], -self.graph_end_m, self.graph_end_m).mean(keepdims=True)

        def across(name: str) -> float:
            return float(self.lanes[name].middle(middle)[0]) * rightward

        beside = {across(name) > across(lane.id): name for name in (segment.left, segment.right) if name is not None}
        return beside.get(False), beside.get(True)

    # -- what is near a place

    def stations_between(
        self, start_m: float, end_m: float, xy_world: Float[np.ndarray, "2"], reach_m: float
    ) -> Scalars:
        """Stations from one to another; without either end, those within a distance of a place of the host."""
        if np.isfinite(end_m - start_m):
            return np.linspace(start_m, end_m, max(2 + int((end_m - start_m) / LINES_STEP_M), 3))
        near = np.arange(-reach_m, reach_m + LINES_STEP_M / 2, LINES_STEP_M)
        return np.unique(np.clip(self.main.line.guess(xy_world) + near, start_m, end_m))

    def lane_lines(
        self, lane: NetworkLane, xy_world: Float[np.ndarray, "2"], reach_m: float
    ) -> tuple[Points3, Points3, Points3] | None:
        """A lane's middle, its left and its right edge as its traffic drives, of a lane without ends within about
        `reach_m` of a place of the host: points i are beside each other. None where it is farther away."""
        road = self.road(lane.road).stretch_of(lane)
        s = self.stations_between(lane.start_m, lane.end_m, xy_world, reach_m)
        lines = [road.points(s, offset(s)) for offset in (lane.middle, *lane.edges)]
        if len(s) < 2 or not _is_near(lines[0], xy_world, reach_m):
            return None
        if road.parting is not None and s[0] <= lane.start_m:
            # It begins where the lane before it ends, on the other road; its own first points may lie behind that.
            other = road.parting.road
            before = next((at for at in self.joined_to(lane) if at.road == other.id), None)
            if before is not None:
                ahead = np.all([other.line.project(line[:, :2])[0] > s[0] + LEAST_GAP_M for line in lines], axis=0)
                starts = [other.points(s[:1], offset(s[:1])) for offset in (before.middle, *before.edges)]
                lines = [np.concatenate([start, line[ahead]]) for start, line in zip(starts, lines, strict=True)]
        middle, low, high = (line[:: 1 if lane.ascends else -1] for line in lines)
        return (middle, low, high) if lane.ascends != road.line.is_mirrored else (middle, high, low)

    def delimiters_near(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> LineStations:
        """The stations of places along the painted lines that come within about `reach_m` of a place of the host; of a
        line without ends, those within this distance."""
        places = ((at, self.stations_between(at.start_m, at.end_m, xy_world, reach_m)) for at in self.delimiters)
        return {line: s for line, s in places if len(s) > 1 and _is_near(line.xy_world(s), xy_world, reach_m)}


def _is_near(points: Float[np.ndarray, "n _"], xy_world: Float[np.ndarray, "2"], reach_m: float) -> bool:
    """Whether any of some points is within about `reach_m` of a place."""
    return bool((np.linalg.norm(points[:, :2] - xy_world, axis=1) < SEARCH_RATIO * reach_m).any())
