"""The curves of lanes along roads: centre lines of paths, and painted lines. World frame, metres."""

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from jaxtyping import Bool, Float

from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.labels.labels import Direction, LaneKind, Marking, Pair
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.system.arrays import AnyScalars, Points2, Points3

# Lengths along a curve are measured in steps of this length.
KNOT_M = 0.5
# Stations around a place of a curve for which lengths along it are measured.
AROUND_M = np.arange(-10.0, 10.01, 0.25)
# A line that ends closer than this to a station is not a neighbour there.
ENDED_M = 0.01


class LinePaint(NamedTuple):
    """The paint of a line that has its own, as those of maps: other ones are as the scene's `Markings` say."""

    yellow: bool
    width_m: float
    is_double: bool = False
    pair: Pair | None = None
    is_dotted: bool = False


class TableLine(NamedTuple):
    """A line along a road of one section from a station to another: the number of that in a table of roads, and those
    of the edges that it is in the middle of."""

    road: int
    edges: tuple[int, int]
    first_m: float
    last_m: float


@dataclass(frozen=True, eq=False)
class Piece:
    """A line along a road from one station of its curve to another. They are the road's own or, with `knots`, lengths:
    some of these, and the road's stations there, which fall where `along` is -1. Of maps it has its line in the
    network's table, and the places of its knots."""

    road: Road
    offset: Offset
    start_m: float
    end_m: float
    knots: tuple[AnyScalars, AnyScalars] | None = None
    along: float = 1.0
    on_table: TableLine | None = None
    knots_world: Float[np.ndarray, "k 2"] | None = None

    def on(self, s: AnyScalars) -> AnyScalars:
        """Stations of the road."""
        return s if self.knots is None else np.interp(s, *self.knots)

    def stations(self, road_s: npt.ArrayLike) -> AnyScalars:
        """The curve's stations at stations of the road."""
        if self.knots is None:
            return np.asarray(road_s)
        lengths_m, stations = self.knots
        return np.asarray(np.interp(np.asarray(road_s) * self.along, stations * self.along, lengths_m))


class Neighbour(NamedTuple):
    """A line beside a stretch of a curve, from one of its stations to another."""

    id: str
    is_right: bool
    start_m: float = -np.inf
    end_m: float = np.inf


def neighbours(left: str | None, right: str | None) -> tuple[Neighbour, ...]:
    """The lines beside a curve that has the same ones along all of it."""
    return tuple(Neighbour(name, is_right) for name, is_right in ((left, False), (right, True)) if name is not None)


@dataclass(frozen=True)
class LaneCurve:
    """The centre line of a path through the lanes, or a painted line, from `start_m` to `end_m`; its pieces follow each
    other. Stations are those of its roads or, if they have knots, lengths along the curve. `direction` is as in the
    labels; `is_inner` says whether a delimiter faces the oncoming traffic, or is the left edge of a road without any.
    `lanes` are those of a path, as s grows, each from a station of `lane_starts_m` on; its traffic goes with growing s
    if it `ascends`. `connector` and `junction` are as in the labels, and a line may have its own `paint`."""

    id: str
    kind: LaneKind
    road: str
    marking: Marking
    neighbours: tuple[Neighbour, ...]
    pieces: tuple[Piece, ...]
    start_m: float = -np.inf
    end_m: float = np.inf
    direction: Direction = "same"
    is_inner: bool = False
    lanes: tuple[NetworkLane, ...] = ()
    lane_starts_m: tuple[float, ...] = ()
    ascends: bool = True
    connector: bool | None = None
    junction: str | None = None
    paint: LinePaint | None = None

    def beside(self, is_right: bool, from_m: float, known: Container[str]) -> str | None:
        """The line on a side at a station, or the first that follows; of those that are known."""
        ahead = [
            at for at in self.neighbours if at.is_right == is_right and at.end_m > from_m + ENDED_M and at.id in known
        ]
        return min(ahead, key=lambda at: at.start_m).id if ahead else None

    @property
    def rightward(self) -> float:
        """1 where offsets from it grow to the right of its traffic, else -1."""
        return 1.0 if self.ascends != self.pieces[0].road.line.is_mirrored else -1.0

    def xy_world(self, s: AnyScalars) -> Float[np.ndarray, "n 2"]:
        """World (x, y) at stations."""
        if len(self.pieces) == 1:
            piece = self.pieces[0]
            on = piece.on(s)
            return piece.road.xy(on, piece.offset(on))
        xy = np.zeros((*s.shape, 2))
        for at, piece in self.parts_at(s):
            on = piece.on(np.minimum(s[at], piece.end_m))
            xy[at] = piece.road.xy(on, piece.offset(on))
        return xy

    def points_world(self, s: AnyScalars) -> Float[np.ndarray, "n 3"]:
        """Points on the road surface at stations."""
        return self.points_beside(s, np.zeros(s.shape))

    def points_beside(self, s: AnyScalars, t: AnyScalars) -> Float[np.ndarray, "n 3"]:
        """Points on the road surface at stations and offsets from the curve: to where t of its roads grows or, if
        stations are lengths along it, to the right of growing ones."""
        found = np.zeros((*s.shape, 3))
        for at, piece in self.parts_at(s):
            on = piece.on(np.minimum(s[at], piece.end_m))
            found[at] = piece.road.points(on, piece.offset(on) + t[at] * piece.along)
        return found

    def has(self, s: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """At which stations the line exists: within its ends, and not between two of its pieces."""
        inside = (s > self.start_m) & (s < self.end_m)
        for a, b in pairwise(self.pieces):
            inside &= (s >= b.start_m) | (s <= a.end_m)
        return np.asarray(inside)

    def lane_at(self, s: float) -> NetworkLane:
        """The lane of a path at a station."""
        return self.lanes[self.lane_number_at(s)]

    def lane_number_at(self, s: float) -> int:
        """The number of the lane of a path at a station; before the first one it, too."""
        return max(sum(s >= start_m for start_m in self.lane_starts_m) - 1, 0)

    def piece_at(self, s: float) -> Piece:
        """The piece at a station; before the first one it, too."""
        return self.pieces[max(sum(s >= piece.start_m for piece in self.pieces) - 1, 0)]

    def stations_on(self, lane: str, road_s: npt.ArrayLike) -> AnyScalars:
        """Stations of a path at stations of the road of one of its lanes."""
        start_m = next(at for own, at in zip(self.lanes, self.lane_starts_m, strict=True) if own.id == lane)
        return self.piece_at(start_m).stations(road_s)

    def places_from(self, s: float) -> Callable[[Points2], Points3]:
        """World points of places (right, ahead) in metres, as its traffic drives, from a station of it."""
        around, onwards = s + AROUND_M, 1.0 if self.ascends else -1.0
        length_m = lengths_along(self.xy_world(around))
        length_m -= np.interp(s, around, length_m)

        def points_world(places: Points2) -> Points3:
            at = np.interp(onwards * places[:, 1], length_m, around)
            return self.points_beside(np.clip(at, self.start_m, self.end_m), self.rightward * places[:, 0])

        return points_world

    def parts_at(self, s: AnyScalars) -> Iterator[tuple[Bool[np.ndarray, "*n"], Piece]]:
        """Which stations lie on each piece; the first and the last one have no outer ends."""
        ends = [-np.inf, *(piece.start_m for piece in self.pieces[1:]), np.inf]
        for piece, (low, high) in zip(self.pieces, pairwise(ends), strict=True):
            yield (s >= low) & (s < high), piece


def ways_through(lanes: Sequence[NetworkLane], links: Iterable[tuple[str, str]]) -> Iterator[list[NetworkLane]]:
    """Every way along links, from lanes that follow no other to lanes that no other follows; then once around each
    ring."""
    by_id, after = {lane.id: lane for lane in lanes}, dict[str, list[str]]()
    for before, behind in links:
        after.setdefault(before, []).append(behind)
    followers, seen = {name for names in after.values() for name in names}, set[str]()
    for first in (*(name for name in by_id if name not in followers), *by_id):
        left = [] if first in seen else [[first]]
        while left:
            way = left.pop()
            seen.update(way)
            onwards = [[*way, name] for name in after.get(way[-1], ()) if name not in way]
            left += onwards[::-1]
            if not onwards:
                yield [by_id[name] for name in way]


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


class Course(NamedTuple):
    """A line along a road from one of its stations to another: some stations, the places there, the lengths from above
    to these, and the line in the network's table, if it is there."""

    road: Road
    offset: Offset
    stations: Float[np.ndarray, " k"]
    xy_world: Float[np.ndarray, "k 2"]
    lengths_m: Float[np.ndarray, " k"]
    on_table: TableLine | None = None

    @classmethod
    def of(cls, road: Road, offset: Offset, first: float, last: float) -> "Course":
        """The course from a station to another."""
        stations = np.linspace(first, last, n_knots(first, last))
        xy_world = road.xy(stations, offset(stations))
        steps_m = np.hypot(*np.diff(xy_world, axis=0).T)
        return cls(road, offset, stations, xy_world, np.concatenate([[0.0], np.cumsum(steps_m)]))

    def turned(self) -> "Course":
        """The course in the other direction."""
        lengths_m = (self.lengths_m[-1] - self.lengths_m)[::-1]
        return self._replace(stations=self.stations[::-1], xy_world=self.xy_world[::-1], lengths_m=lengths_m)


def along(lanes: Sequence[NetworkLane], courses: Mapping[str, Course], against: bool = False) -> LaneCurve:
    """The centre line along lanes that follow each other as traffic drives, or against that."""
    first, parts = lanes[0], [courses[lane.id] for lane in lanes]
    if against:
        lanes, parts = lanes[::-1], [part.turned() for part in parts[::-1]]
    pieces = measured(parts)
    return LaneCurve(
        first.id,
        "centerline",
        first.road,
        "none",
        (),
        pieces,
        0.0,
        pieces[-1].end_m,
        first.direction,
        lanes=tuple(lanes),
        lane_starts_m=tuple(piece.start_m for piece in pieces),
        ascends=not against,
        connector=first.junction is not None,
        junction=first.junction,
    )


def n_knots(first: float, last: float) -> int:
    """The number of stations at which lengths along a course are measured."""
    return 2 + int(abs(last - first) / KNOT_M)


def measured(courses: Iterable[Course]) -> tuple[Piece, ...]:
    """The pieces of a curve along courses one after the other, whose stations are lengths from above."""
    pieces, length_m = [], 0.0
    for road, offset, stations, xy_world, lengths_m, on_table in courses:
        knots = length_m + lengths_m, stations
        along = 1.0 if stations[-1] > stations[0] else -1.0
        pieces.append(Piece(road, offset, length_m, float(knots[0][-1]), knots, along, on_table, xy_world))
        length_m = float(knots[0][-1])
    return tuple(pieces)
