"""The network of a map: its roads have stations of their own, and the host drives along a route. World frame, metres;
the rules are in docs/network.md."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from synth3dlanes.geometry.frames import cross
from synth3dlanes.labels.labels import LaneGraph, Segment
from synth3dlanes.roads.lane_curves import KNOT_M, Course, LaneCurve, Piece, TableLine, measured
from synth3dlanes.roads.maps.cubics import SAME_M
from synth3dlanes.roads.network import APART_M, LINES_STEP_M, LanePattern, Nearby, Network
from synth3dlanes.roads.road_table import Indices, OnRoads, Ragged, RoadTable
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene.host import Camera
from synth3dlanes.scene.scene import Car
from synth3dlanes.system.arrays import AnyPoints3, AnyScalars, Points2, Points3, Scalars
from synth3dlanes.system.errors import InputError

# Points of the labels are this far apart, measured along each line from its beginning.
STEP_M = 1.0
# The surface's normal is measured over this length to both sides.
ACROSS_M = 0.5
# The host's direction is measured over this length to both sides.
TANGENT_M = 0.01
# Roads of maps turn: what lies at most this many times a reach from a place, from above, is near it.
AS_FAR = 2.0


class Junction(NamedTuple):
    """A junction: its connecting roads, the outline of its pavement where the map has one, and pairs of lanes, the
    first of which yields to the second."""

    id: str
    roads: tuple[Road, ...]
    outline: Points2
    yields: tuple[tuple[str, str], ...]


class _Samples(NamedTuple):
    """Points of lines one after the other: their lengths along them, their places, and where each line starts."""

    s: Scalars
    xy_world: Float[np.ndarray, "n 2"]
    starts: Int[np.ndarray, " _"]

    @classmethod
    def of(cls, parts: Sequence[tuple[Float[np.ndarray, " _"], Float[np.ndarray, "_ 2"]]]) -> "_Samples":
        """The points of each line."""
        starts = np.cumsum([0, *(len(s) for s, _ in parts)])
        lengths, points = zip((np.zeros(0), np.zeros((0, 2))), *parts, strict=True)
        return cls(np.concatenate(lengths), np.concatenate(points), starts)


class _Pieces(NamedTuple):
    """The pieces of all lines: those of each line by where they begin, their lines in the table, the signs of their
    stations, and the places of their knots, with where those of each piece begin."""

    all: list[Piece]
    of_line: Ragged
    lines: list[TableLine]
    along: Scalars
    knots_world: Float[np.ndarray, "k 2"]
    first_knot: Int[np.ndarray, " _"]


class _Index(NamedTuple):
    """Where roads are: the corners of a box around the pavement of each, the farthest that this is from places of its
    line, the stations of these, and a tree of them."""

    low: Float[np.ndarray, "r 2"]
    high: Float[np.ndarray, "r 2"]
    half_m: Float[np.ndarray, " r"]
    stations: list[Scalars]
    trees: list["scipy.spatial.cKDTree"]


@dataclass(frozen=True, eq=False, kw_only=True)
class MapNetwork(Network):
    """Roads with stations of their own. `given_paths` are its centre lines: on through links where there is only one
    way, up to a junction, and every connector through one; `courses` are those of lanes, `stretches` the roads of one
    section that all lines are on. `way` is the host's."""

    roads: tuple[Road, ...]
    given_paths: tuple[LaneCurve, ...]
    junctions: tuple[Junction, ...]
    courses: Mapping[str, Course]
    stretches: RoadTable
    way: LaneCurve

    @property
    def paths(self) -> tuple[LaneCurve, ...]:
        """The centre lines."""
        return self.given_paths

    @property
    def lane_width_m(self) -> float:
        """Width of the host's lane where its way begins."""
        return self.way.lanes[0].width_m

    @property
    def across(self) -> LanePattern:
        """Lanes lie one beside the other across the texture of every road."""
        return LanePattern(self.lane_width_m, 0, is_along=False)

    @property
    def host_stretches(self) -> list[tuple[Road, float, float]]:
        """The sections of the roads that the host drives on, junctions left out."""
        lanes = [lane for lane in self.way.lanes if lane.junction is None]
        found = {id(at): at for at in (self.road(lane.road).stretch_of(lane) for lane in lanes)}
        return [(at, at.start_m, at.end_m) for at in found.values()]

    @property
    def main(self) -> Road:
        """The road where the host's way begins."""
        return self.road(self.way.lanes[0].road)

    @cached_property
    def lanes(self) -> dict[str, NetworkLane]:
        """All lanes by id."""
        return {lane.id: lane for road in self.roads for lane in road.lanes}

    @cached_property
    def _path_of(self) -> dict[str, LaneCurve]:
        return {lane.id: path for path in self.paths for lane in path.lanes}

    @cached_property
    def _road_of(self) -> dict[str, Road]:
        return {road.id: road for road in self.roads}

    def road(self, name: str) -> Road:
        """A road by its id. Raises InputError for one that is too far from the host."""
        if name not in self._road_of:
            raise InputError(f"map: expected roads near the host, got {name}")
        return self._road_of[name]

    def path(self, lane: str) -> LaneCurve:
        """The centre line along a lane. Raises InputError for one that is too far from the host, or has no width."""
        if lane not in self._path_of:
            raise InputError(f"map: expected lanes of traffic near the host, with a width, got {lane}")
        return self._path_of[lane]

    # -- the host and the cars

    def host_points(self, camera: Camera, ahead_m: AnyScalars) -> AnyPoints3:
        """Points on the host's way, its offset from its lane included, at lengths ahead of its place."""
        way = self.way.shifted(camera.offset_m) if camera.offset_m else self.way
        return way.points_world(camera.y_m + ahead_m)

    def up(self, camera: Camera, foot_world: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """The unit normal of the surface at the host's place."""
        s = np.array([camera.y_m])
        left, right = (self.way.shifted(camera.offset_m + t_m).points_world(s)[0] for t_m in (-ACROSS_M, ACROSS_M))
        behind, ahead = self.host_points(camera, np.array([-ACROSS_M, ACROSS_M]))
        normal = cross(right - left, ahead - behind)
        return np.asarray(normal / np.linalg.norm(normal))

    def host_way(self, camera: Camera) -> LaneCurve:
        """The host's way."""
        return self.way

    def host_lines(self, camera: Camera) -> list[str]:
        """The centre lines that the host drives along, from its place on."""
        lanes = self.way.lanes[self.way.piece_at(camera.y_m) :]
        return list(dict.fromkeys(self.path(lane.id).id for lane in lanes))

    def host_lane(self, number: int, driven_m: float) -> NetworkLane:
        """The lane of the host's way at a length along it."""
        return self.way.lanes[self.way.piece_at(driven_m)]

    def host_on(self, camera: Camera, driven_m: float) -> Camera:
        """The host at another length of its way."""
        return camera.model_copy(update={"y_m": driven_m})

    def car_way(self, car: Car) -> tuple[LaneCurve, float]:
        """The way of a car through its lanes, as it drives, and the length along it of its place. Raises InputError as
        `path` does for its lane."""
        self.path(car.lane)
        lanes = [self.lanes[name] for name in (car.lane, *car.route) if name in self.lanes]
        way = self.way_through(lanes)
        return way, way.pieces[0].station(car.s_m)

    def car_on(self, car: Car, driven_m: float) -> Car:
        """A car at another length of its way."""
        way, _ = self.car_way(car)
        at = way.piece_at(driven_m)
        piece = way.pieces[at]
        s_m = float(piece.on(np.array([min(driven_m, piece.end_m)]))[0])
        return car.model_copy(update={"s_m": s_m, "lane": way.lanes[at].id, "route": car.route[at:]})

    def way_through(self, lanes: Sequence[NetworkLane]) -> LaneCurve:
        """The centre line along lanes that follow each other, as their traffic drives."""
        pieces = measured(self.courses[lane.id] for lane in lanes)
        first = lanes[0]
        ends = 0.0, pieces[-1].end_m
        return LaneCurve(first.id, "centerline", first.road, "none", (), pieces, *ends, lanes=tuple(lanes))

    def in_lane(self, lane: str, driven_m: AnyScalars) -> tuple[LaneCurve, AnyScalars]:
        """The centre line along a lane, and the lengths along it at stations of the lane's road."""
        path = self.path(lane)
        piece = next(piece for at, piece in zip(path.lanes, path.pieces, strict=True) if at.id == lane)
        return path, np.vectorize(piece.station, otypes=[float])(driven_m)

    def places_around(self, lane: str | None, s_m: float) -> Callable[[Points2], Points3]:
        """World points of places (right, ahead) in metres, as its traffic drives, from a station of the road of a lane;
        without a lane, from a length of the host's way."""
        way = self.way if lane is None else self.way_through([self.lanes[lane]])
        at_m = s_m if lane is None else way.pieces[0].station(s_m)
        return lambda places: way.points_beside(np.clip(at_m + places[:, 1], 0.0, way.end_m), places[:, 0])

    # -- labels

    @cached_property
    def _pieces(self) -> _Pieces:
        pieces = [piece for curve in self.curves for piece in curve.pieces]
        knots = [piece.knots_world for piece in pieces if piece.knots_world is not None]
        return _Pieces(
            pieces,
            Ragged.of([piece.start_m for piece in curve.pieces] for curve in self.curves),
            [piece.on_table for piece in pieces if piece.on_table is not None],
            np.array([piece.along for piece in pieces]),
            np.concatenate(knots),
            np.cumsum([0, *map(len, knots)]),
        )

    @cached_property
    def numbers(self) -> dict[str, int]:
        """The number of each line among `curves`, by its id."""
        return {curve.id: i for i, curve in enumerate(self.curves)}

    def _on(self, number: Indices, s: Scalars) -> tuple[Indices, Scalars]:
        """The pieces of lines, by the number of each, that are at lengths along them, and the stations of their roads
        there."""
        of, on = self._pieces, np.zeros(len(s))
        piece = of.of_line.at(number, s)
        order = np.argsort(piece, kind="stable")
        for some in np.split(order, np.flatnonzero(np.diff(piece[order])) + 1) if len(order) else ():
            at = of.all[piece[some[0]]]
            on[some] = at.on(np.minimum(s[some], at.end_m))
        return piece, on

    def xy_on(self, number: Indices, s: Scalars) -> Points2:
        """World (x, y) of lines, by the number of each, at lengths along them."""
        piece, on = self._on(number, s)
        road, t = self.stretches.on_lines(self._pieces.lines, piece, on)
        return self.stretches.xy(road, on, t)

    def points_on(self, number: Indices, s: Scalars, right_m: Scalars | float = 0.0) -> Points3:
        """Points on the road surface along lines, by the number of each, at lengths along them; `right_m` to the right
        of each line."""
        piece, on = self._on(number, s)
        return self.stretches.points(self._pieces.lines, piece, on, right_m * self._pieces.along[piece])

    def which_come(self, is_there: Callable[[Points2], Bool[np.ndarray, " k"]]) -> Bool[np.ndarray, " l"]:
        """Which lines have a place, of some at most KNOT_M apart, that is there."""
        of = self._pieces
        first = of.first_knot[of.of_line.first[:-1]]
        return np.asarray(np.logical_or.reduceat(is_there(of.knots_world), first))

    @cached_property
    def _known_samples(self) -> dict[int, tuple[Float[np.ndarray, " _"], Float[np.ndarray, "_ 2"]]]:
        """Points STEP_M apart of lines, and their ends, by the numbers of those that were asked for."""
        return {}

    def _samples(self, numbers: Sequence[int]) -> _Samples:
        """Points STEP_M apart of some lines, and their ends."""
        known = self._known_samples
        lengths = {
            i: np.append(np.arange(0.0, self.curves[i].end_m - APART_M, STEP_M), self.curves[i].end_m)
            for i in numbers
            if i not in known
        }
        if lengths:
            counts = [len(s) for s in lengths.values()]
            xy = self.xy_on(np.repeat(list(lengths), counts), np.concatenate(list(lengths.values())))
            places = np.split(xy, np.cumsum(counts)[:-1])
            known |= {i: (lengths[i], at) for i, at in zip(lengths, places, strict=True)}
        return _Samples.of([known[i] for i in numbers])

    def in_range(self, camera: Camera, lengths_m: Scalars) -> dict[LaneCurve, Float[np.ndarray, " _"]]:
        """The lengths of the points of every line that are within the greatest of these lengths of the host, and not
        farther behind it than the least, with those between them, in the line's order."""
        ((near, numbers, samples),), found = self._near(camera, np.array([camera.y_m]), lengths_m), {}
        for number, (first, end) in zip(numbers, pairwise(samples.starts), strict=True):
            inside = np.flatnonzero(near[first:end])
            if inside.size:
                found[self.curves[number]] = samples.s[first + inside[0] : first + inside[-1] + 1]
        return found

    def points_along(self, stations: Mapping[LaneCurve, Float[np.ndarray, " _"]]) -> list[Float[np.ndarray, "_ 3"]]:
        """Points on the road surface at lengths along lines, one line after the other."""
        counts = [len(s) for s in stations.values()]
        if not counts:
            return []
        number = np.repeat([self.numbers[curve.id] for curve in stations], counts)
        return np.split(self.points_on(number, np.concatenate(list(stations.values()))), np.cumsum(counts)[:-1])

    def known(self, camera: Camera, places_m: Scalars, lengths_m: Float[np.ndarray, " _"]) -> set[str]:
        """The ids of the lines that are in range of the host at any of some lengths of its way."""
        found = set[str]()
        for near, numbers, samples in self._near(camera, places_m, lengths_m):
            if numbers:
                is_seen = np.add.reduceat(near.astype(int), samples.starts[:-1]) > 1
                found |= {self.curves[number].id for number, is_one in zip(numbers, is_seen, strict=True) if is_one}
        return found

    def _near(
        self, camera: Camera, places_m: Scalars, lengths_m: Float[np.ndarray, " _"]
    ) -> Iterator[tuple[Bool[np.ndarray, " _"], list[int], _Samples]]:
        """For each length of the host's way: which samples of lines are in range, the numbers of these lines, and the
        samples."""
        steps, reach_m = np.array([-TANGENT_M, TANGENT_M]), float(lengths_m[-1])
        feet = self.host_points(camera, places_m - camera.y_m)[:, :2]
        for foot, y_m in zip(feet, places_m.tolist(), strict=True):
            behind, ahead = self.host_points(camera, y_m - camera.y_m + steps)[:, :2]
            numbers = np.flatnonzero(self.which_come(partial(_is_within, foot, reach_m + KNOT_M))).tolist()
            samples = self._samples(numbers)
            forward, to = (ahead - behind) / np.linalg.norm(ahead - behind), samples.xy_world - foot
            yield (to @ forward >= lengths_m[0]) & (np.hypot(*to.T) <= reach_m), numbers, samples

    def known_at(self, n_frames: int) -> int:
        """The number of instants of a clip that have between them all lines of any frame: all."""
        return n_frames

    def graph(self, centerlines: Sequence[str]) -> LaneGraph:
        """The lane graph of the labels: the lanes of the given centre lines."""
        given = set(centerlines)
        kept = {lane.id: path.id for path in self.paths if path.id in given for lane in path.lanes}
        numbered = {(lane.section, lane.number): lane.id for lane in self.lanes.values()}
        segments = []
        for lane in self.lanes.values():
            if lane.id in kept:
                left, right = (numbered.get((lane.section, lane.number + step)) for step in (-1, 1))
                segments.append(
                    Segment(
                        lane.id,
                        lane.road,
                        lane.number,
                        *lane.driven,
                        left if left in kept else None,
                        right if right in kept else None,
                        (kept[lane.id],),
                        lane.junction,
                    )
                )
        successors: dict[str, tuple[str, ...]] = {}
        for before, after in sorted(self.links):
            if before in kept and after in kept:
                successors[before] = (*successors.get(before, ()), after)
        yields = tuple(pair for at in self.junctions for pair in at.yields if pair[0] in kept and pair[1] in kept)
        return LaneGraph(tuple(segments), successors, None, yields)

    def neighbours(self, segment: Segment) -> tuple[str | None, str | None]:
        """The lanes to the left and the right of one of the lane graph, as its own traffic drives."""
        return segment.left, segment.right

    # -- places

    def xy_in_lanes(
        self, lanes: Sequence[NetworkLane], stations: Sequence[Float[np.ndarray, " _"]]
    ) -> list[Float[np.ndarray, "_ 2"]]:
        """World (x, y) of the middle of each of some lanes at stations of its road."""
        if not lanes:
            return []
        lines = [line for lane in lanes if (line := self.courses[lane.id].on_table) is not None]
        counts, s = [len(own) for own in stations], np.concatenate(stations)
        road, t = self.stretches.on_lines(lines, np.repeat(np.arange(len(lines)), counts), s)
        return np.split(self.stretches.xy(road, s, t), np.cumsum(counts)[:-1])

    def lane_lines(
        self, lane: NetworkLane, xy_world: Float[np.ndarray, "2"], reach_m: float
    ) -> tuple[Points3, Points3, Points3] | None:
        """A lane's middle, its left and its right edge, as its traffic drives: points i are beside each other. None
        where it is farther from a place than about `reach_m`."""
        road, (first_m, last_m) = self.road(lane.road), lane.driven
        s = np.linspace(first_m, last_m, max(2 + int(abs(last_m - first_m) / LINES_STEP_M), 3))
        middle, low, high = (road.stretch_of(lane).points(s, offset(s)) for offset in (lane.middle, *lane.edges))
        if not _is_near(middle, xy_world, reach_m):
            return None
        return (middle, low, high) if lane.ascends else (middle, high, low)

    def delimiters_near(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> dict[LaneCurve, Scalars]:
        """The stations of places along the painted lines that come within about `reach_m` of a place."""
        places = ((line, np.linspace(0.0, line.end_m, 2 + int(line.end_m / LINES_STEP_M))) for line in self.delimiters)
        return {line: s for line, s in places if _is_near(line.xy_world(s), xy_world, reach_m)}

    def along_host(self, driven_m: Scalars) -> Points3:
        """Points on the host's way at lengths along it; those beyond its ends are left out."""
        return self.way.points_world(np.unique(np.clip(driven_m, 0.0, self.way.end_m)))

    def road_stations(self, road: Road, camera: Camera, behind_m: float, ahead_m: float) -> Scalars:
        """Stations along a road, on both sides of where a section begins; none where it is farther than `ahead_m` from
        the host, from above."""
        own = self.road(road.id)
        begins = np.array([section.start_m for section in own.sections[1:]])
        s = np.union1d(own.stations, [begins - SAME_M, begins])
        away_m = np.hypot(*(road.xy(s, 0.0) - self.host_points(camera, np.zeros(1))[0, :2]).T)
        return s if (away_m < ahead_m).any() else s[:0]

    def nearby(
        self, xy_world: Float[np.ndarray, "n 2"], reach_m: AnyScalars
    ) -> tuple[Bool[np.ndarray, " n"], list[Nearby]]:
        """Which points may be within `reach_m` of a pavement, and where these are along every road that any may be
        near."""
        found, near = self.places(xy_world, float(reach_m.max(initial=0.0))), np.zeros(len(xy_world), dtype=bool)
        near[found.point] = True
        rows, ends = np.cumsum(near) - 1, np.flatnonzero(np.diff(found.road)) + 1
        listed = []
        for point, road, s, t in zip(*(np.split(values, ends) for values in found), strict=True):
            if len(point):
                which = np.zeros(int(near.sum()), dtype=bool)
                which[rows[point]] = True
                listed.append(Nearby(self.roads[road[0]], which, s, t))
        return near, listed

    def places(self, xy_world: Float[np.ndarray, "n 2"], reach_m: Float[np.ndarray, " r"] | float) -> OnRoads:
        """Where points are along every road whose pavement they may be within `reach_m` of, a number or that of each
        road: road by road, points in ascending order."""
        index, points, roads, guesses = self._index, [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)], [np.zeros(0)]
        reach = np.broadcast_to(reach_m, len(self.roads))[:, None]
        low, high, from_line_m = index.low - reach, index.high + reach, index.half_m + reach[:, 0]
        ends = xy_world.min(axis=0, initial=np.inf), xy_world.max(axis=0, initial=-np.inf)
        order = np.argsort(xy_world[:, 0])
        x = xy_world[order, 0]
        for i in np.flatnonzero(((low < ends[1]) & (high > ends[0])).all(axis=1)).tolist():
            first, end = np.searchsorted(x, [low[i, 0], high[i, 0]])
            y = xy_world[order[first:end], 1]
            at = np.sort(order[first:end][(y > low[i, 1]) & (y < high[i, 1])])
            if at.size:
                _, place = index.trees[i].query(xy_world[at], distance_upper_bound=from_line_m[i])
                is_near = place < index.trees[i].n
                points.append(at[is_near])
                roads.append(np.full(len(points[-1]), i))
                guesses.append(index.stations[i][place[is_near]])
        point, road = np.concatenate(points), np.concatenate(roads)
        s, t, is_foot = self.table.project(road, xy_world[point], np.concatenate(guesses))
        return OnRoads(point, road, s, t).of(is_foot)

    @cached_property
    def table(self) -> RoadTable:
        """All roads as arrays, numbered as in `roads`."""
        return RoadTable(self.roads, self.terrain)

    @property
    def boxes(self) -> tuple[Float[np.ndarray, "r 2"], Float[np.ndarray, "r 2"]]:
        """The lowest and the highest (x, y) of the pavement of every road."""
        return self._index.low, self._index.high

    @cached_property
    def _index(self) -> "_Index":
        stations = [road.stations for road in self.roads]
        starts = np.cumsum([0, *map(len, stations)])[:-1]
        s, road = np.concatenate(stations), np.repeat(np.arange(len(stations)), list(map(len, stations)))
        points, normals, _, _ = self.table.frames(road, s)
        offsets = self.table.edges(road, s)
        sides = np.stack([points + t[:, None] * normals for t in offsets], axis=1)
        step_m = np.array([own[1] - own[0] for own in stations])
        widest_m = np.maximum.reduceat(np.abs(offsets).max(axis=0), starts)
        return _Index(
            np.minimum.reduceat(sides.min(axis=1), starts) - step_m[:, None],
            np.maximum.reduceat(sides.max(axis=1), starts) + step_m[:, None],
            widest_m + step_m,
            stations,
            [scipy.spatial.cKDTree(own) for own in np.split(points, starts[1:])],
        )

    def around(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> "MapNetwork":
        """Itself: it has been read around its host."""
        return self


def _is_within(
    foot: Float[np.ndarray, "2"], reach_m: float, xy_world: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Which places are at most so far from a point."""
    return np.asarray(np.hypot(*(xy_world - foot).T) <= reach_m)


def _is_near(points: Float[np.ndarray, "n _"], xy_world: Float[np.ndarray, "2"], reach_m: float) -> bool:
    """Whether any of some points is within about `reach_m` of a place."""
    return bool((np.linalg.norm(points[:, :2] - xy_world, axis=1) < AS_FAR * reach_m).any())
