"""Lines on roads of one section, whose stations are lengths along them, as arrays: answers for places on many lines in
one call. World frame, metres. What a call tells of a line is what the `LaneCurve` of that number tells of it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.roads.lane_curves import KNOT_M, LaneCurve, Piece, TableLine
from synth3dlanes.roads.road_lines import APART_M, HostPlace
from synth3dlanes.roads.road_table import Indices, Ragged, RoadTable
from synth3dlanes.system.arrays import Points2, Points3, Scalars

# Distance between points of labels along each line from its beginning.
POINTS_STEP_M = 1.0


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
    """Lines by their numbers among `curves`, on the roads of one section of a `table`."""

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
        road, t = self.table.on_lines(self._pieces.lines, piece, on)
        return self.table.xy(road, on, t)

    def points_on(self, number: Indices, s: Scalars, right_m: Scalars | float = 0.0) -> Points3:
        """Points on the road surface along lines, by the number of each, at lengths along them; `right_m` to the right
        of each line."""
        piece, on = self._on(number, s)
        return self.table.points(self._pieces.lines, piece, on, right_m * self._pieces.along[piece])

    def which_come(self, is_there: Callable[[Points2], Bool[np.ndarray, " k"]]) -> Bool[np.ndarray, " l"]:
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
            counts = [len(s) for s in lengths.values()]
            xy = self.xy_on(np.repeat(list(lengths), counts), np.concatenate(list(lengths.values())))
            places = np.split(xy, np.cumsum(counts)[:-1])
            known |= {i: (lengths[i], at) for i, at in zip(lengths, places, strict=True)}
        return _Samples.of([known[i] for i in numbers])

    def _numbered(self, curves: Iterable[LaneCurve], counts: Sequence[int]) -> Indices:
        """The number of each of some lines, as often as it is asked for."""
        return np.repeat([self.numbers[curve.id] for curve in curves], counts)

    def xy_along(
        self, curves: Sequence[LaneCurve], stations: Sequence[Float[np.ndarray, " _"]]
    ) -> list[Float[np.ndarray, "_ 2"]]:
        """World (x, y) of each of some lines at lengths along it."""
        counts = [len(s) for s in stations]
        if not counts:
            return []
        return np.split(self.xy_on(self._numbered(curves, counts), np.concatenate(stations)), np.cumsum(counts)[:-1])

    def points_along(self, stations: Mapping[LaneCurve, Float[np.ndarray, " _"]]) -> list[Float[np.ndarray, "_ 3"]]:
        """Points on the road surface at lengths along lines, one line after the other."""
        nothing = [np.zeros(1)] * len(stations)
        return [at[:, 0] for at in self.points_beside(list(stations), list(stations.values()), nothing)]

    def points_beside(
        self,
        curves: Sequence[LaneCurve],
        stations: Sequence[Float[np.ndarray, " _"]],
        offsets: Sequence[Float[np.ndarray, " _"]],
    ) -> list[Float[np.ndarray, "_ _ 3"]]:
        """Points on the road surface along each of some lines: at each of its lengths those at all of these offsets to
        its right."""
        if not curves:
            return []
        s = [np.repeat(at, len(t)) for at, t in zip(stations, offsets, strict=True)]
        t = np.concatenate([np.tile(t, len(at)) for at, t in zip(stations, offsets, strict=True)])
        counts = list(map(len, s))
        points = self.points_on(self._numbered(curves, counts), np.concatenate(s), t)
        each = zip(np.split(points, np.cumsum(counts)[:-1]), stations, offsets, strict=True)
        return [own.reshape(len(at), len(t), 3) for own, at, t in each]

    def in_range(self, at: HostPlace, lengths_m: Scalars) -> dict[LaneCurve, Float[np.ndarray, " _"]]:
        """The stations of every line's points from the least of these lengths (negative: behind a place) to the
        greatest, with those between them, in the line's order."""
        near, numbers, samples = self._near(at, lengths_m)
        found = {}
        for number, (first, end) in zip(numbers, pairwise(samples.starts), strict=True):
            inside = np.flatnonzero(near[first:end])
            if inside.size:
                found[self.curves[number]] = samples.s[first + inside[0] : first + inside[-1] + 1]
        return found

    def known(self, places: Sequence[HostPlace], lengths_m: Scalars) -> set[str]:
        """The ids of the lines with more than one such point at any of some places."""
        found = set[str]()
        for at in places:
            near, numbers, samples = self._near(at, lengths_m)
            is_seen = np.add.reduceat(near.astype(int), samples.starts[:-1]) > 1 if numbers else ()
            found |= {self.curves[number].id for number, is_one in zip(numbers, is_seen, strict=True) if is_one}
        return found

    def _near(self, at: HostPlace, lengths_m: Scalars) -> tuple[Bool[np.ndarray, " _"], list[int], _Samples]:
        """Which samples of lines are in range of a place, the numbers of these lines, and the samples."""
        foot_world, forward, reach_m = at.foot_world, at.forward, float(lengths_m[-1])
        numbers = np.flatnonzero(self.which_come(partial(_is_within, foot_world, reach_m + KNOT_M))).tolist()
        samples = self._samples(numbers)
        to = samples.xy_world - foot_world
        return (to @ forward >= lengths_m[0]) & (np.hypot(*to.T) <= reach_m), numbers, samples

    def xy_in(
        self, lines: Sequence[TableLine], stations: Sequence[Float[np.ndarray, " _"]]
    ) -> list[Float[np.ndarray, "_ 2"]]:
        """World (x, y) of each of some lines of the table at stations of its road."""
        if not lines:
            return []
        counts, s = [len(own) for own in stations], np.concatenate(stations)
        road, t = self.table.on_lines(lines, np.repeat(np.arange(len(lines)), counts), s)
        return np.split(self.table.xy(road, s, t), np.cumsum(counts)[:-1])


def _is_within(
    foot: Float[np.ndarray, "2"], reach_m: float, xy_world: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Which places are within this distance of a point."""
    return np.asarray(np.hypot(*(xy_world - foot).T) <= reach_m)
