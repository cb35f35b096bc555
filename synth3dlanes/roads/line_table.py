"""Lines on roads, and answers for places on many of them in one call: of lines that share the stations of endless roads
each answers for itself; those whose stations are lengths along them, on roads of one section, are arrays. World frame,
metres.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.geometry.polylines import parted
from synth3dlanes.roads.lane_curves import KNOT_M, LaneCurve, Piece, TableLine
from synth3dlanes.roads.road_table import Indices, Ragged, RoadTable
from synth3dlanes.roads.roads import Road
from synth3dlanes.system.arrays import AnyScalars, Points2, Points3, Scalars

# Stations of each of some lines; of lines by themselves; and which places are near.
Stations = Sequence[Float[np.ndarray, " _"]]
LineStations = dict[LaneCurve, Float[np.ndarray, " _"]]
IsNear = Callable[[Points2], Bool[np.ndarray, " k"]]
# Two points of a line's labels that are closer than this coincide: they have no direction.
APART_M = 0.01
# The direction of the host's way is measured over this length to both sides.
TANGENT_M = 0.01
# Distance between points of labels along each line from its beginning.
POINTS_STEP_M = 1.0


class HostStation(NamedTuple):
    """A place of the host: its station as it drives, and the function that gives points of its way ahead of that."""

    driven_m: float
    ahead: Callable[[Scalars], Points3]


def foot_and_forward(at: HostStation) -> Float[np.ndarray, "2 2"]:
    """The place from above, and the unit vector of the host's way there."""
    behind, foot, ahead = at.ahead(np.array([-TANGENT_M, 0.0, TANGENT_M]))[:, :2]
    return np.array([foot, (ahead - behind) / np.linalg.norm(ahead - behind)])


@dataclass(frozen=True, eq=False)
class RoadLines:
    """Lines on roads. `onwards` is 1 where the host drives with growing stations, else -1."""

    curves: tuple[LaneCurve, ...]
    roads: Mapping[str, Road]
    onwards: float

    def xy_along(self, curves: Sequence[LaneCurve], stations: Stations) -> list[Float[np.ndarray, "_ 2"]]:
        """World (x, y) of each of some lines at stations."""
        return [curve.xy_world(s) for curve, s in zip(curves, stations, strict=True)]

    def points_beside(
        self, curves: Sequence[LaneCurve], stations: Stations, offsets: Stations
    ) -> list[Float[np.ndarray, "_ _ 3"]]:
        """Points on the road surface along each of some lines: at each of its stations those at all of these offsets to
        its right."""
        return [
            curve.points_beside(np.repeat(s, len(t)), np.tile(t, len(s))).reshape(len(s), len(t), 3)
            for curve, s, t in zip(curves, stations, offsets, strict=True)
        ]

    def in_range(self, at: HostStation, lengths_m: Scalars) -> LineStations:
        """The stations of every line's points at lengths of its road ahead of a place (negative: behind it), and at its
        ends between these, in driving order."""
        along = {curve.road for curve in self.curves}
        driven_m = {name: self.stations_along(self.roads[name], at.driven_m, lengths_m) for name in along}
        return {curve: self._points_of(curve, driven_m[curve.road]) for curve in self.curves}

    def around(self, driven_m: Scalars, is_near: IsNear) -> LineStations:
        """The stations of every line's points at those of the host's way around it."""
        s = driven_m * self.onwards
        return {curve: s[(s > curve.start_m) & (s < curve.end_m)] for curve in self.curves}

    def known(self, places: Sequence[HostStation], lengths_m: Scalars) -> set[str]:
        """The ids of the lines with more than one such point at any of some places, each ahead of the one before."""
        # Along a road a line comes into range or is passed, never both.
        ends = places[0], places[-1]
        return {line.id for at in ends for line, s in self.in_range(at, lengths_m).items() if len(s) > 1}

    def _points_of(self, curve: LaneCurve, driven_m: Scalars) -> Float[np.ndarray, " m"]:
        s = driven_m * self.onwards
        low, high = min(s[0], s[-1]), max(s[0], s[-1])
        ends = np.array([end for end in (curve.start_m, curve.end_m) if low < end < high])
        kept = s[curve.has(s)]
        kept = kept[(np.abs(kept[:, None] - ends) > APART_M).all(axis=1)]
        return np.sort(np.concatenate([kept, ends]))[:: int(self.onwards)]

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
        speed = road.speed((grid[1:] + grid[:-1]) / 2 * self.onwards)
        arc = np.concatenate([[0.0], np.cumsum(speed * np.abs(np.diff(grid)))])
        # On the inside of a bend a road is shorter than its stations.
        if arc[-1] < lengths_m[-1]:
            return self._along(road, driven_m, lengths_m, sign, 1.5 * reach)
        return np.interp(lengths_m, arc, grid)


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


class LineTable:
    """Lines by their numbers among `curves`, on the roads of one section of a `table`. What it tells of a line is what
    the `LaneCurve` of that number tells."""

    def __init__(self, curves: Sequence[LaneCurve], table: RoadTable) -> None:
        self.curves, self.table = tuple(curves), table

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

    def _on(self, curves: Sequence[LaneCurve], stations: Stations) -> tuple[Indices, Scalars, list[int]]:
        """The pieces of lines that are at lengths along each, the stations of their roads there, and how many
        each line has."""
        counts, s = [len(own) for own in stations], np.concatenate([np.zeros(0), *stations])
        number = np.repeat(np.array([self.numbers[curve.id] for curve in curves], dtype=int), counts)
        of, on = self._pieces, np.zeros(len(s))
        piece = of.of_line.at(number, s)
        asked, each = np.unique(piece, return_counts=True)
        for i, some in zip(asked.tolist(), parted(np.argsort(piece, kind="stable"), each), strict=True):
            at = of.all[i]
            on[some] = at.on(np.minimum(s[some], at.end_m))
        return piece, on, counts

    def xy_along(self, curves: Sequence[LaneCurve], stations: Stations) -> list[Float[np.ndarray, "_ 2"]]:
        """World (x, y) of each of some lines at lengths along it."""
        piece, on, counts = self._on(curves, stations)
        road, t = self.table.on_lines(self._pieces.lines, piece, on)
        return parted(self.table.xy(road, on, t), counts)

    def points_beside(
        self, curves: Sequence[LaneCurve], stations: Stations, offsets: Stations
    ) -> list[Float[np.ndarray, "_ _ 3"]]:
        """Points on the road surface along each of some lines: at each of its lengths those at all of these offsets to
        its right."""
        each = list(zip(stations, offsets, strict=True))
        piece, on, counts = self._on(curves, [np.repeat(s, len(t)) for s, t in each])
        right_m = np.concatenate([np.zeros(0), *(np.tile(t, len(s)) for s, t in each)])
        points = self.table.points(self._pieces.lines, piece, on, right_m * self._pieces.along[piece])
        return [own.reshape(len(s), len(t), 3) for own, (s, t) in zip(parted(points, counts), each, strict=True)]

    def which_come(self, is_there: IsNear) -> Bool[np.ndarray, " l"]:
        """Which lines have a place, of some at most KNOT_M apart, that is there."""
        of = self._pieces
        first = of.first_knot[of.of_line.first[:-1]]
        return np.asarray(np.logical_or.reduceat(is_there(of.knots_world), first))

    @cached_property
    def _known_samples(self) -> dict[int, tuple[Float[np.ndarray, " _"], Float[np.ndarray, "_ 2"]]]:
        """Points POINTS_STEP_M apart of lines, and their ends, by the numbers of those that were asked for."""
        return {}

    def _samples(self, numbers: Sequence[int]) -> _Samples:
        """Points POINTS_STEP_M apart of some lines, and their ends."""
        known = self._known_samples
        lengths = {
            i: np.append(np.arange(0.0, self.curves[i].end_m - APART_M, POINTS_STEP_M), self.curves[i].end_m)
            for i in numbers
            if i not in known
        }
        if lengths:
            places = self.xy_along([self.curves[i] for i in lengths], list(lengths.values()))
            known |= {i: (lengths[i], at) for i, at in zip(lengths, places, strict=True)}
        return _Samples.of([known[i] for i in numbers])

    def in_range(self, at: HostStation, lengths_m: Scalars) -> LineStations:
        """The stations of every line's points from the least of these lengths (negative: behind a place) to the
        greatest, with those between them, in the line's order."""
        near, numbers, samples = self._near(at, lengths_m)
        found = {}
        for number, (first, end) in zip(numbers, pairwise(samples.starts), strict=True):
            inside = np.flatnonzero(near[first:end])
            if inside.size:
                found[self.curves[number]] = samples.s[first + inside[0] : first + inside[-1] + 1]
        return found

    def around(self, driven_m: Scalars, is_near: IsNear) -> LineStations:
        """The stations of every line's points that are near the host."""
        numbers = np.flatnonzero(self.which_come(is_near)).tolist()
        samples = self._samples(numbers)
        counts, near = np.diff(samples.starts), is_near(samples.xy_world)
        parts = zip(numbers, parted(samples.s, counts), parted(near, counts), strict=True)
        return {self.curves[number]: s[kept] for number, s, kept in parts}

    def known(self, places: Sequence[HostStation], lengths_m: Scalars) -> set[str]:
        """The ids of the lines with more than one such point at any of some places."""
        found = set[str]()
        for at in places:
            near, numbers, samples = self._near(at, lengths_m)
            is_seen = np.add.reduceat(near.astype(int), samples.starts[:-1]) > 1 if numbers else ()
            found |= {self.curves[number].id for number, is_one in zip(numbers, is_seen, strict=True) if is_one}
        return found

    def _near(self, at: HostStation, lengths_m: Scalars) -> tuple[Bool[np.ndarray, " _"], list[int], _Samples]:
        """Which samples of lines are in range of a place, the numbers of these lines, and the samples."""
        (foot_world, forward), reach_m = foot_and_forward(at), float(lengths_m[-1])
        numbers = np.flatnonzero(self.which_come(partial(_is_within, foot_world, reach_m + KNOT_M))).tolist()
        samples = self._samples(numbers)
        to = samples.xy_world - foot_world
        return (to @ forward >= lengths_m[0]) & (np.hypot(*to.T) <= reach_m), numbers, samples


def _is_within(
    foot: Float[np.ndarray, "2"], reach_m: float, xy_world: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Which places are within this distance of a point."""
    return np.asarray(np.hypot(*(xy_world - foot).T) <= reach_m)
