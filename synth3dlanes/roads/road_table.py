"""Roads with sections as arrays: answers for places on many roads in one call. World frame, metres.

A road is known by its number. What a call tells of a place is what the `Road` of that number tells of it.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from synth3dlanes.geometry.polylines import parted, spaced
from synth3dlanes.roads.cross_section import KERB_M, SEAM_M, CrossSection, Shapes
from synth3dlanes.roads.lane_curves import TableLine, n_knots
from synth3dlanes.roads.line_forms import Spiral, spiral_frames
from synth3dlanes.roads.maps.cubics import Profile
from synth3dlanes.roads.reference_line import MAX_STEP_M, MIN_SHARE, SETTLED_M, LineFrames, dot
from synth3dlanes.roads.roads import Road
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.scene import Terrain
from synth3dlanes.system.arrays import AnyPoints2, AnyScalars, Points2, Points3, Scalars

# Steps of a projection, and how far from the perpendicular through a foot its point may be.
MOST_STEPS, FOOT_M = 12, 1e-3
# More than any distance between a place and a road near it; the width of the rows in which places are sorted.
FAR_AWAY_M, ROW_M = 1e5, 25.0

Indices = Int[np.ndarray, " n"]


class OnRoads(NamedTuple):
    """Places of points along roads: the number of each point and of its road, its station and its offset."""

    point: Indices
    road: Indices
    s: Scalars
    t: Scalars

    def of(self, which: Bool[np.ndarray, " n"]) -> "OnRoads":
        """Some of the places."""
        at = np.flatnonzero(which)
        return OnRoads(*(values.take(at) for values in self))


class OnLines(NamedTuple):
    """Places of lines: their stations, the numbers of the pieces that these are on, and the lines there."""

    s: Scalars
    piece: Indices
    frames: LineFrames

    def take(self, which: Indices) -> "OnLines":
        """Some of the places."""
        frames = LineFrames(*(values.take(which, axis=0) for values in self.frames))
        return OnLines(self.s.take(which), self.piece.take(which), frames)


@dataclass(frozen=True, eq=False)
class Ragged:
    """Rows of several owners one after the other, those of an owner from `first[owner]` on, each from its start on."""

    first: Int[np.ndarray, " m"]
    starts: Float[np.ndarray, " k"]
    keys: np.ndarray

    @classmethod
    def of(cls, starts: Iterable[Sequence[float] | np.ndarray]) -> "Ragged":
        """The rows of owners, by where each begins in ascending order."""
        rows = list(starts)
        counts = np.array([len(row) for row in rows], dtype=int)
        flat = np.concatenate([np.zeros(0), *rows])
        return cls(np.cumsum([0, *counts]), flat, _keys(np.repeat(np.arange(len(rows)), counts), flat))

    def at(self, owner: Indices, s: Scalars) -> Indices:
        """The number of the row that holds at a station: of those that begin at or before it the last, else the very
        first."""
        first = self.first[owner]
        last = self.first[owner + 1] - 1
        found, several = first.copy(), last > first
        if several.any():
            row = np.searchsorted(self.keys, _keys(owner[several], s[several]), side="right") - 1
            found[several] = np.clip(row, first[several], last[several])
        return found


def _keys(owner: Indices, s: Scalars) -> np.ndarray:
    """Indices that are sorted by owner first: complex ones are, by their real parts."""
    keys = np.zeros(len(s), dtype=complex)
    keys.real, keys.imag = owner, s
    return keys


class _Cubics:
    """Many `Profile`s."""

    def __init__(self, profiles: Sequence[Profile]) -> None:
        tables = [profile.table for profile in profiles]
        self._rows = Ragged.of(starts for starts, _ in tables)
        self._numbers = np.concatenate([np.zeros((4, 0)), *(numbers for _, numbers in tables)], axis=1)
        first, counts = self._rows.first[:-1], np.diff(self._rows.first)
        self._varies = (counts > 1) | self._numbers[1:, first].any(axis=0)

    def same(self, profile: Indices) -> Scalars:
        """The value of a profile that is the same everywhere, else NaN."""
        return np.where(self._varies.take(profile), np.nan, self._numbers[0].take(self._rows.first.take(profile)))

    def __call__(self, profile: Indices, s: Scalars) -> Scalars:
        """The value of a profile at each station."""
        # Most are constant.
        found, varying = (
            self._numbers[0].take(self._rows.first.take(profile)),
            np.flatnonzero(self._varies.take(profile)),
        )
        if varying.size:
            profile, s = profile.take(varying), s.take(varying)
            row = self._rows.at(profile, s)
            x, (a, b, c, d) = s - self._rows.starts.take(row), self._numbers.take(row, axis=1)
            found[varying] = a + x * (b + x * (c + x * d))
        return found


class _ManyShapes:
    """Many `Shapes`."""

    def __init__(self, shapes: Sequence[Shapes | None]) -> None:
        rows = [of.rows if of else (np.zeros(1), np.zeros((1, 1)), np.zeros((4, 1, 1))) for of in shapes]
        self._stations = Ragged.of(stations for stations, _, _ in rows)
        most = max((starts.shape[1] for _, starts, _ in rows), default=0)
        self._starts = np.full((len(self._stations.starts), most), np.inf)
        self._numbers = np.zeros((4, *self._starts.shape))
        for first, (_, starts, table) in zip(self._stations.first, rows, strict=False):
            here = slice(first, first + len(starts)), slice(starts.shape[1])
            self._starts[here], self._numbers[:, *here] = starts, table

    def __call__(self, shape: Indices, s: Scalars, t_left: Scalars) -> Scalars:
        """The height of shapes at a place each."""
        of, last = self._stations, self._stations.first[shape + 1] - 1
        before = np.maximum(np.minimum(of.at(shape, s), last - 1), of.first[shape])
        after = np.minimum(before + 1, last)
        z_before, z_after = (self._at(row, t_left) for row in (before, after))
        length_m = np.maximum(of.starts[after] - of.starts[before], 1e-9)
        share = np.clip((s - of.starts[before]) / length_m, 0, 1)
        return np.asarray(z_before + share * (z_after - z_before))

    def _at(self, row: Indices, t_left: Scalars) -> Scalars:
        column = np.clip((self._starts[row] <= t_left[:, None]).sum(axis=1) - 1, 0, None)
        x, (a, b, c, d) = t_left - self._starts[row, column], self._numbers[:, row, column]
        return np.asarray(a + x * (b + x * (c + x * d)))


class _SectionTable:
    """Sections of roads as arrays, by the number of each."""

    def __init__(self, sections: Sequence[CrossSection]) -> None:
        nothing = Profile(())
        self._all = sections
        self._start_m, self._end_m = (np.array([getattr(at, end) for at in sections]) for end in ("start_m", "end_m"))
        self._n_left = np.array([at.n_left for at in sections])
        self._paved = np.array([at.paved for at in sections]).T
        self._first_lane = np.array([*accumulate((len(at.lanes) for at in sections), initial=0)])
        # Runs of raised lanes by their inner and outer edges.
        runs = [[(low, high) if low >= at.n_left else (high, low) for low, high in at.raised] for at in sections]
        self._first_run = np.array([*accumulate(map(len, runs), initial=0)])
        self._runs = np.array([run for own in runs for run in own], dtype=int).reshape(-1, 2)
        self._widths = _Cubics([width for at in sections for width in at.widths])
        # Edges by section, and the offsets of those that are the same everywhere, as most are; else NaN.
        counts = np.diff(self._first_lane) + 1
        section, self._first_edge = np.repeat(np.arange(len(counts)), counts), np.cumsum(counts) - counts
        edge = np.arange(len(section)) - self._first_edge.take(section)
        self._same_across = self._summed(section, edge, lambda lane, _: self._widths.same(lane))
        self._offsets = _Cubics([at.offset for at in sections])
        self._heights = _Cubics([at.heights or nothing for at in sections])
        self._banks = _Cubics([at.banks or nothing for at in sections])
        self._is_banked = np.array([at.banks is not None for at in sections])
        self.has_heights = np.array([at.heights is not None for at in sections])
        self._shapes = _ManyShapes([at.shapes for at in sections])
        self._is_shaped = self.has_heights & np.array([at.shapes is not None for at in sections], dtype=bool)
        self._has_level = self.has_heights & np.array([any(lane.level for lane in at.lanes) for at in sections], bool)

    def edge(self, section: Indices, edge: Indices, s: Scalars) -> Scalars:
        """The offset of an edge of a section at each station."""
        return self._across(section, edge, s) - self._offsets(section, s)

    def paved_edges(self, section: Indices, s: Scalars) -> tuple[Scalars, Scalars]:
        """The offsets of the left and the right edge of the pavement at each station."""
        offset = self._offsets(section, s)
        left, right = (self._across(section, edge.take(section), s) - offset for edge in self._paved)
        return left, right

    def _across(self, section: Indices, edge: Indices, s: Scalars) -> Scalars:
        """The offset of an edge from the one on the line."""
        across = self._same_across.take(self._first_edge.take(section) + edge)
        varying = np.flatnonzero(np.isnan(across))
        if varying.size:
            section, edge, s = (values.take(varying) for values in (section, edge, s))
            x = s - self._start_m.take(section)
            across[varying] = self._summed(section, edge, lambda lane, at: self._widths(lane, x.take(at)))
        return across

    def _summed(self, section: Indices, edge: Indices, width: Callable[[Indices, Indices], Scalars]) -> Scalars:
        """The widths of the lanes between edges and those on the line, by a function of the numbers of lanes and of
        these edges; negative left of the line."""
        middle = self._n_left.take(section)
        low, high = np.minimum(edge, middle), np.maximum(edge, middle)
        across, lane = np.zeros(len(edge)), self._first_lane.take(section) + low
        for i in range(int((high - low).max(initial=0))):
            at = np.flatnonzero(low + i < high)
            across[at] += np.maximum(width(lane.take(at) + i, at), 0.0)
        return np.where(edge > middle, across, -across)

    def kerb(self, section: Indices, s: Scalars, t: Scalars) -> Scalars:
        """The height of raised lanes over the pavement at places."""
        found, first = np.zeros(len(s)), self._first_run.take(section)
        counts = self._first_run.take(section + 1) - first
        for i in range(int(counts.max(initial=0))):
            at = np.flatnonzero(counts > i)
            inner, outer = self._runs.take(first.take(at) + i, axis=0).T
            out = np.sign(outer - inner)
            # Most places lie on the road's side of the inner edge.
            beyond = out * (t.take(at) - self.edge(section.take(at), inner, s.take(at))) > SEAM_M
            at, outer, out = at[beyond], outer[beyond], out[beyond]
            within = out * (self.edge(section.take(at), outer, s.take(at)) - t.take(at)) > SEAM_M
            found[at[within]] = KERB_M
        return found

    def height(self, section: Indices, s: Scalars, t: Scalars) -> Scalars:
        """The height of the surface without raised lanes at places; 0 in sections without heights."""
        at = np.clip(s, self._start_m.take(section), self._end_m.take(section))
        z, banked, shaped = self._heights(section, at), self._is_banked.take(section), self._is_shaped.take(section)
        bank = np.zeros(len(s))
        if banked.any():
            bank[banked] = self._banks(section[banked], at[banked])
            z[banked] -= np.tan(bank[banked]) * t[banked]
        if shaped.any():
            fall = np.cos(bank[shaped])
            z[shaped] += self._shapes(section[shaped], at[shaped], -t[shaped] / fall) / fall
        for i in np.unique(section[self._has_level[section]]):
            here = section == i
            z[here] = self._all[i].height(s[here], t[here])
        return z


@lru_cache(maxsize=2)
def _section_table(sections: tuple[CrossSection, ...]) -> _SectionTable:
    """The table of sections: the tables of roads, of stretches of these and of them without lanes have the same."""
    return _SectionTable(sections)


class RoadTable:
    """The lines, sections and heights of roads as arrays."""

    def __init__(self, roads: Sequence[Road], terrain: Terrain) -> None:
        self.roads, self._terrain = tuple(roads), terrain
        lines = [line for road in roads for line in road.line.parts]
        self._lines = lines
        self._pieces = Ragged.of(road.line.starts for road in roads)
        self._spirals = np.array([line.numbers if isinstance(line, Spiral) else (0.0,) * 7 for line in lines])
        self._is_other = np.array([not isinstance(line, Spiral) for line in lines])
        self._is_straight = ~self._is_other & (self._spirals[:, 3:5] == 0).all(axis=1)
        self.start_m, self.end_m = (np.array([getattr(road, end) for road in roads]) for end in ("start_m", "end_m"))
        self._by_road = Ragged.of([section.start_m for section in road.sections] for road in roads)
        self._sections = _section_table(tuple(section for road in roads for section in road.sections))
        self._ramps = [(i, road.ramp) for i, road in enumerate(roads) if road.ramp is not None]

    def frames(self, road: Indices, s: Scalars) -> LineFrames:
        """Each road's line at a station."""
        return self.lines_at(road, s).frames

    def lines_at(self, road: Indices, s: Scalars) -> OnLines:
        """Each road's line at a station, with where that is."""
        piece = self._pieces.at(road, s)
        x = s - self._pieces.starts.take(piece)
        found, other = spiral_frames(self._spirals.take(piece, axis=0), x), self._is_other.take(piece)
        for i in np.unique(piece[other]):
            at = piece == i
            for whole, part in zip(found, self._lines[i].frames(x[at]), strict=True):
                whole[at] = part
        return OnLines(s, piece, found)

    def xy(self, road: Indices, s: Scalars, t: Scalars) -> Points2:
        """World (x, y) of places."""
        points, normals, _, _ = self.frames(road, s)
        return np.asarray(points + t[:, None] * normals)

    def project(
        self, road: Indices, xy_world: Points2, guess: OnLines
    ) -> tuple[Scalars, Scalars, Bool[np.ndarray, " n"]]:
        """(s, t) of points on the road of each, by Newton's method as `ReferenceLine.project` finds them, and which of
        them are feet of their points: inside a bend it may find none."""
        s, t, is_foot = guess.s.copy(), np.zeros(len(road)), np.ones(len(road), dtype=bool)
        left, at = np.arange(len(road)), guess
        for _ in range(MOST_STEPS):
            points, normals, speed, turn = at.frames
            to = xy_world - points
            t[left] = aside = dot(to, normals)
            along = to[:, 1] * normals[:, 0] - to[:, 0] * normals[:, 1]
            step = np.clip(along / np.maximum(speed - turn * aside, MIN_SHARE * speed), -MAX_STEP_M, MAX_STEP_M)
            s[left] = reached = at.s + step
            # On a straight piece one step is all of the way.
            is_there = self._is_straight.take(at.piece) & (np.abs(step) < MAX_STEP_M)
            straight = np.flatnonzero(is_there)
            is_there[straight] = self._pieces.at(road[straight], reached[straight]) == at.piece[straight]
            is_left = np.flatnonzero(~is_there & (np.abs(step) > SETTLED_M))
            left, along, road, xy_world = (values.take(is_left, axis=0) for values in (left, along, road, xy_world))
            if not left.size:
                break
            at = self.lines_at(road, reached.take(is_left))
        is_foot[left] = np.abs(along) < FOOT_M
        return s, t, is_foot

    def section(self, road: Indices, s: Scalars) -> Indices:
        """The number of the section at each station."""
        return self._by_road.at(road, s)

    def edge(self, section: Indices, edge: Indices, s: Scalars) -> Scalars:
        """The offset of an edge of a section at each station."""
        return self._sections.edge(section, edge, s)

    def knots(self, lines: Sequence[TableLine]) -> Iterator[tuple[AnyScalars, AnyPoints2, AnyScalars]]:
        """The stations of the knots of lines, each from its first station to its last one, their places, and the
        lengths from above to these."""
        if not lines:
            return
        first, last = (np.array([getattr(line, end) for line in lines]) for end in ("first_m", "last_m"))
        counts = np.array([n_knots(line.first_m, line.last_m) for line in lines])
        s = spaced(first, last, counts)
        road, t = self.on_lines(lines, np.repeat(np.arange(len(lines)), counts), s)
        xy, steps_m = self.xy(road, s, t), np.zeros(len(s))
        steps_m[1:] = np.hypot(*np.diff(xy, axis=0).T)
        steps_m[np.cumsum(counts) - counts] = 0.0
        for own_s, own_xy, own_steps_m in zip(*(parted(values, counts) for values in (s, xy, steps_m)), strict=True):
            yield own_s, own_xy, np.cumsum(own_steps_m)

    def points(self, lines: Sequence[TableLine], which: Indices, s: Scalars, aside_m: Scalars | float = 0.0) -> Points3:
        """Points on the surface along lines, by the number of each, at stations; `aside_m` to their right."""
        road, t = self.on_lines(lines, which, s)
        t = t + aside_m
        points = self.base_points(road, s, t)
        points[:, 2] += self._sections.kerb(self.section(road, s), s, t)
        return points

    def on_lines(self, lines: Sequence[TableLine], which: Indices, s: Scalars) -> tuple[Indices, Scalars]:
        """The roads and the offsets of lines at stations."""
        road, low, high = np.array([(line.road, *line.edges) for line in lines], dtype=int).reshape(-1, 3)[which].T
        section = self.section(road, s)
        t = self.edge(section, low, s)
        between = low != high
        t[between] = (t[between] + self.edge(section[between], high[between], s[between])) / 2
        return road, t

    def edges(self, road: Indices, s: Scalars) -> tuple[Scalars, Scalars]:
        """The offsets of the left and the right edge of the pavement of each road at a station."""
        return self._sections.paved_edges(self.section(road, s), s)

    def nearest(self, at: OnRoads) -> tuple[Scalars, Scalars, Scalars]:
        """The stations and offsets on the pavement of its road that are nearest to each place, and how far away."""
        on = np.clip(at.s, self.start_m[at.road], self.end_m[at.road])
        across = np.clip(at.t, *self.edges(at.road, on))
        return on, across, np.hypot(at.s - on, at.t - across)

    def base_points(self, road: Indices, s: Scalars, t: Scalars) -> Points3:
        """Points on the surface of each road without raised lanes."""
        xy, section = self.xy(road, s, t), self.section(road, s)
        z = self._sections.height(section, s, t)
        low = ~self._sections.has_heights[section]
        z[low] = height_at(self._terrain, xy[low])
        for i, ramp in self._ramps:
            z[road == i] += ramp(s[road == i])
        return np.column_stack([xy, z])

    def over_terrain(self, road: Indices, s: Scalars, t: Scalars, terrain_m: Scalars) -> Scalars:
        """How high the surface of each road without raised lanes is over the terrain, whose heights are given."""
        section = self.section(road, s)
        own = self._sections
        return np.where(own.has_heights.take(section), own.height(section, s, t) - terrain_m, 0.0)


def _in_boxes(
    xy_world: Float[np.ndarray, "n 2"], low: Float[np.ndarray, "r 2"], high: Float[np.ndarray, "r 2"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """The numbers of points and of the boxes that they are in."""
    if not len(xy_world):
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    # Points in rows of the plan, by x in each: a box has one run of each row that it meets.
    corner = xy_world.min(axis=0)
    x, y = (xy_world - corner).T
    row, length_m = np.floor(y / ROW_M), x.max() + 1.0
    keys = row * length_m + x
    order = np.argsort(keys)
    keys = keys[order]
    first, last = (
        np.floor(np.clip((ends[:, 1] - corner[1]) / ROW_M, -1, row.max() + 1)).astype(int) for ends in (low, high)
    )
    first, last = np.maximum(first, 0), np.minimum(last, int(row.max()))
    n_rows = np.maximum(last - first + 1, 0)
    box = np.repeat(np.arange(len(low)), n_rows)
    start = (first[box] + np.arange(len(box)) - np.repeat(np.cumsum(n_rows) - n_rows, n_rows)) * length_m
    begin, end = (
        np.searchsorted(keys, start + np.clip(ends[box, 0] - corner[0], 0, length_m - 0.5)) for ends in (low, high)
    )
    counts = np.maximum(end - begin, 0)
    box = np.repeat(box, counts)
    point = order[np.arange(len(box)) + np.repeat(begin - np.cumsum(counts) + counts, counts)]
    y = xy_world[point, 1]
    is_in = (y > low[box, 1]) & (y < high[box, 1])
    return point[is_in], box[is_in]


class _Index(NamedTuple):
    """Where roads are: the corners of a box around the pavement of each, the farthest that this is from places of its
    line, these, and a tree of them, roads one above the other FAR_AWAY_M from each other."""

    low: Float[np.ndarray, "r 2"]
    high: Float[np.ndarray, "r 2"]
    half_m: Float[np.ndarray, " r"]
    places: OnLines
    tree: "scipy.spatial.cKDTree"


class RoadIndex:
    """Which roads places are near, and where along these they are; of roads with both ends. `table` numbers them."""

    def __init__(self, roads: Sequence[Road], terrain: Terrain) -> None:
        self.roads, self.table = tuple(roads), RoadTable(roads, terrain)

    def places(self, xy_world: Float[np.ndarray, "n 2"], reach_m: Float[np.ndarray, " r"] | float) -> OnRoads:
        """Where points are along every road whose pavement they may be within `reach_m` of, a number or that of each
        road: road by road, points in ascending order."""
        index, reach = self._index, np.broadcast_to(reach_m, len(self.roads))[:, None]
        low, high, from_line_m = index.low - reach, index.high + reach, index.half_m + reach[:, 0]
        point, road = _in_boxes(xy_world, low, high)
        above = np.column_stack([xy_world[point], FAR_AWAY_M * road])
        away_m, place = index.tree.query(above, distance_upper_bound=max(from_line_m.max(initial=0.0), 0.0))
        found = np.flatnonzero(away_m < from_line_m[road])
        found = found[np.argsort(road[found] * len(xy_world) + point[found])]
        point, road = point.take(found), road.take(found)
        guesses = index.places.take(np.asarray(place).take(found))
        s, t, is_foot = self.table.project(road, xy_world.take(point, axis=0), guesses)
        return OnRoads(point, road, s, t).of(is_foot)

    @property
    def boxes(self) -> tuple[Float[np.ndarray, "r 2"], Float[np.ndarray, "r 2"]]:
        """The lowest and the highest (x, y) of the pavement of every road."""
        return self._index.low, self._index.high

    @cached_property
    def _index(self) -> _Index:
        stations = [road.stations for road in self.roads]
        starts = np.cumsum([0, *map(len, stations)])[:-1]
        s, road = np.concatenate(stations), np.repeat(np.arange(len(stations)), list(map(len, stations)))
        places = self.table.lines_at(road, s)
        points, normals, _, _ = places.frames
        offsets = self.table.edges(road, s)
        sides = np.stack([points + t[:, None] * normals for t in offsets], axis=1)
        step_m = np.array([own[1] - own[0] for own in stations])
        widest_m = np.maximum.reduceat(np.abs(offsets).max(axis=0), starts)
        return _Index(
            np.minimum.reduceat(sides.min(axis=1), starts) - step_m[:, None],
            np.maximum.reduceat(sides.max(axis=1), starts) + step_m[:, None],
            widest_m + step_m,
            places,
            scipy.spatial.cKDTree(np.column_stack([points, FAR_AWAY_M * road])),
        )
