"""Roads of maps: sections of lanes of many kinds, with widths that change, heights and banks of their own. World frame,
metres; t grows to the right of growing s."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import EllipsisType

import numpy as np
from jaxtyping import Float

from synth3dlanes.roads.map_lines import Chain
from synth3dlanes.roads.maps.cubics import holding
from synth3dlanes.roads.roads import NetworkLane, Offset, Road, lift
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.road_map import MapLane, MapLaneKind, MapRoad, MapShape, MapSpan, Polynomial
from synth3dlanes.system.arrays import AnyPoints3, AnyScalars, Numbers

# Height of raised lanes over the pavement, the width of the seam at their edges that is not raised, and their kinds.
KERB_M, SEAM_M = 0.12, 0.005
RAISED: frozenset[MapLaneKind] = frozenset({"walkway", "kerb"})
# Width that is assumed where a road has no lanes of traffic.
LANE_WIDTH_M = 3.5


@dataclass(frozen=True, eq=False)
class Profile:
    """A value along a road, by cubics of the distance from where each begins; before the first one it goes on."""

    pieces: tuple[Polynomial, ...]

    @cached_property
    def table(self) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "4 k"]]:
        """Where each cubic begins, and its coefficients."""
        pieces = sorted(self.pieces, key=lambda piece: piece.s_m) or [Polynomial(s_m=0.0, a=0.0)]
        rows = [[piece.a, piece.b, piece.c, piece.d] for piece in pieces]
        return np.array([piece.s_m for piece in pieces]), np.array(rows, float).T

    @cached_property
    def constant(self) -> float | None:
        """Its value if it is the same everywhere, as most widths are; else None."""
        _, table = self.table
        return None if table[1:].any() or np.ptp(table[0]) else float(table[0, 0])

    def __call__(self, s: AnyScalars) -> AnyScalars:
        """Values at stations."""
        if self.constant is not None:
            return np.full(s.shape, self.constant)
        starts, table = self.table
        # Most have one piece, and no time is to be lost with looking for it.
        which = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, None) if len(starts) > 1 else 0
        x, (a, b, c, d) = s - starts[which], table[:, which]
        return np.asarray(a + x * (b + x * (c + x * d)))


@dataclass(frozen=True, eq=False)
class Shapes:
    """Heights over a banked plane at stations, by cubics of t to the left; even between stations."""

    given: tuple[MapShape, ...]

    @cached_property
    def _rows(self) -> tuple[Float[np.ndarray, " k"], list[tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 4"]]]]:
        """The stations, and of each the starts in t of its cubics and their coefficients."""
        by_station: dict[float, list[MapShape]] = {}
        for shape in sorted(self.given, key=lambda at: (at.s_m, at.t_m)):
            by_station.setdefault(shape.s_m, []).append(shape)
        rows = [
            (np.array([at.t_m for at in row]), np.array([[at.a, at.b, at.c, at.d] for at in row], float))
            for row in by_station.values()
        ]
        return np.array(list(by_station)), rows

    def __call__(self, s: AnyScalars, t_left: AnyScalars) -> AnyScalars:
        """Heights at places."""
        stations, rows = self._rows
        s, t_left = np.broadcast_arrays(s, t_left)
        after = np.clip(np.searchsorted(stations, s, side="right"), 1, max(len(stations) - 1, 1))
        before = after - 1
        after = np.minimum(after, len(stations) - 1)
        found = np.zeros((2, *s.shape))
        for k, which in enumerate((before, after)):
            for i in np.unique(which):
                here, (starts, table) = which == i, rows[i]
                row = np.clip(np.searchsorted(starts, t_left[here], side="right") - 1, 0, None)
                x, (a, b, c, d) = t_left[here] - starts[row], np.moveaxis(table[row], -1, 0)
                found[k][here] = a + x * (b + x * (c + x * d))
        length = np.maximum(stations[after] - stations[before], 1e-9)
        share = np.clip((s - stations[before]) / length, 0, 1)
        return np.asarray(found[0] + share * (found[1] - found[0]))


@dataclass(frozen=True, eq=False)
class CrossSection:
    """A road between two stations: its lanes from the left, edge i on the left of lane i, and what moves and lifts
    them. What begins at its end does not count here: its values there are those from below."""

    start_m: float
    end_m: float
    lanes: tuple[MapLane, ...]
    offset: Profile
    heights: Profile | None = None
    banks: Profile | None = None
    shapes: Shapes | None = None

    @classmethod
    def of(cls, road: MapRoad, number: int) -> "CrossSection":
        """A section of a road of a map. A lane of number 0, which has no width, is left out."""
        section, span = road.sections[number], road.span_m(number)
        offset, heights, banks = (
            Profile(tuple(holding(cubics, *span))) for cubics in (road.lane_offsets, road.heights, road.banks)
        )
        return cls(
            *span,
            tuple(sorted((lane for lane in section.lanes if lane.number), key=lambda lane: -lane.number)),
            offset,
            heights if road.heights else None,
            banks if road.banks else None,
            Shapes(road.shapes) if road.shapes else None,
        )

    @cached_property
    def widths(self) -> list[Profile]:
        """The widths of its lanes."""
        return [Profile(lane.widths) for lane in self.lanes]

    @cached_property
    def n_left(self) -> int:
        """How many lanes are left of the reference line; also the number of the edge on that line."""
        return sum(lane.number > 0 for lane in self.lanes)

    def edges(self, s: AnyScalars) -> Numbers:
        """Offsets of all edges (the first axis), from the left; none lies left of its left neighbour."""
        x = s - self.start_m
        widths = np.array([np.maximum(width(x), 0.0) for width in self.widths]).reshape(len(self.lanes), *s.shape)
        edges = np.concatenate([np.zeros((1, *s.shape)), np.cumsum(widths, axis=0)])
        return np.asarray(edges - edges[self.n_left] - self.offset(s))

    def edge(self, number: int, s: AnyScalars) -> AnyScalars:
        """Offsets of one of them."""
        low, high = sorted((number, self.n_left))
        x, sign = s - self.start_m, 1 if number > self.n_left else -1
        across: AnyScalars | float = 0.0
        for width in self.widths[low:high]:
            across = across + (np.maximum(width(x), 0.0) if width.constant is None else max(width.constant, 0.0))
        return np.asarray(sign * across - self.offset(s))

    def edge_line(self, number: int) -> Offset:
        """The line of an edge."""
        return Offset(0.0, partial(self.edge, number))

    def middle_line(self, lane: int) -> Offset:
        """The line of the middle of a lane."""
        return Offset(0.0, partial(self._middle, lane))

    def _middle(self, lane: int, s: AnyScalars) -> AnyScalars:
        return (self.edge(lane, s) + self.edge(lane + 1, s)) / 2

    def height(self, s: AnyScalars, t: AnyScalars | float) -> AnyScalars:
        """World height of the surface without raised lanes at places, of a road with heights; before its start and
        beyond its end the height there."""
        assert self.heights is not None, "asked only of roads with heights"
        s, t = np.broadcast_arrays(np.clip(s, self.start_m, self.end_m), t)
        z = self.heights(s)
        if self.banks is None and self.shapes is None:
            return z
        bank, t = self.banks(s) if self.banks is not None else np.zeros(s.shape), self._banked(s, t)
        z = z - np.tan(bank) * t
        if self.shapes is not None:
            # They lie on the banked plane, and stand on it.
            z = z + self.shapes(s, -t / np.cos(bank)) / np.cos(bank)
        return np.asarray(z)

    def _banked(self, s: AnyScalars, t: AnyScalars) -> AnyScalars:
        """Offsets without the widths of level lanes: these have the height of their inner edge, and what lies beyond
        the outermost lane goes on as that does."""
        if not any(lane.level for lane in self.lanes):
            return t
        edges, last, found = self.edges(s), len(self.lanes) - 1, np.array(t)
        for i, lane in enumerate(self.lanes):
            if lane.level:
                low = np.full(s.shape, -np.inf) if i == 0 and lane.number > 0 else edges[i]
                high = np.full(s.shape, np.inf) if i == last and lane.number < 0 else edges[i + 1]
                found -= np.clip(t, low, high) - (high if lane.number > 0 else low)
        return found

    @cached_property
    def paved(self) -> tuple[int, int]:
        """The numbers of the outermost edges of its pavement."""
        found = [i for i, lane in enumerate(self.lanes) if lane.kind != "none"] or [self.n_left]
        return found[0], found[-1] + 1 if self.lanes else found[-1]

    @cached_property
    def raised(self) -> list[tuple[int, int]]:
        """Runs of lanes that are raised beside each other: the numbers of their outer edges."""
        runs: list[tuple[int, int]] = []
        for i, lane in enumerate(self.lanes):
            if lane.kind in RAISED:
                runs[-1:] = [(runs[-1][0], i + 1)] if runs and runs[-1][1] == i else [*runs[-1:], (i, i + 1)]
        return runs


@dataclass(frozen=True, eq=False, kw_only=True)
class SectionRoad(Road):
    """A road of sections over the stations [start_m, end_m], on the terrain or at the heights of its sections (world z
    of its line), turned about that by their banks (radians, positive where its right side is lower)."""

    plan: Chain
    sections: tuple[CrossSection, ...]
    bridges: tuple[MapSpan, ...] = ()
    tunnels: tuple[MapSpan, ...] = ()
    junction: str | None = None

    @property
    def lane_width_m(self) -> float:
        """Width of its first lane of traffic."""
        return self.lanes[0].width_m if self.lanes else LANE_WIDTH_M

    @cached_property
    def is_raised(self) -> bool:
        """Whether it leaves the terrain anywhere."""
        return self.has_heights or self.has_kerbs

    @property
    def has_heights(self) -> bool:
        """Whether it has heights of its own."""
        return self.sections[0].heights is not None

    @cached_property
    def stretches(self) -> tuple["SectionRoad", ...]:
        """The road within each of its sections. Where one ends, the road itself is as the next one begins."""
        if len(self.sections) == 1:
            return (self,)
        return tuple(
            replace(self, start_m=at.start_m, end_m=at.end_m, sections=(at,), line=line, plan=line).with_edges()
            for at in self.sections
            for line in [self.plan.within(at.start_m, at.end_m)]
        )

    def with_edges(self) -> "SectionRoad":
        """The road between the edges of the pavement of its own sections."""
        left, right = (Offset(0.0, partial(self.paved, side)) for side in (0, 1))
        return replace(self, left=left, right=right)

    def stretch_of(self, lane: NetworkLane) -> "SectionRoad":
        """The road within the section of one of its lanes."""
        return self.stretches[int(lane.id.rsplit(".", 2)[1])]

    def lines_of(self, lane: NetworkLane) -> tuple[Offset, Offset, Offset]:
        """The lines of a lane's middle and of its edges, from the left."""
        number = lane.id.rpartition(".")[2]
        (across,) = self.stretch_of(lane).sections
        at = next(i for i, given in enumerate(across.lanes) if given.number == int(number))
        return lane.middle, across.edge_line(at), across.edge_line(at + 1)

    def section_at(self, s: AnyScalars) -> np.ndarray:
        """The numbers of the sections at stations."""
        return np.clip(np.searchsorted(self._starts, s, side="right") - 1, 0, None)

    @cached_property
    def _starts(self) -> Float[np.ndarray, " k"]:
        return np.array([section.start_m for section in self.sections])

    def _sections_at(self, s: AnyScalars) -> Iterator[tuple[CrossSection, np.ndarray | EllipsisType]]:
        """The sections at stations, and at which of these each is."""
        if len(self.sections) == 1:
            yield self.sections[0], ...
            return
        at = self.section_at(s)
        for i in np.unique(at):
            yield self.sections[i], at == i

    def paved(self, which: int, s: AnyScalars) -> AnyScalars:
        """Offsets of the left (0) or right (1) edge of its pavement."""
        found = np.zeros(s.shape)
        for section, here in self._sections_at(s):
            found[here] = section.edge(section.paved[which], s[here])
        return found

    def points(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints3:
        """Points on its surface."""
        points = self.base_points(s, t)
        if self.has_kerbs:
            points[..., 2] += self.kerb(s, t)
        return points

    def base_points(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints3:
        """Points on its surface without raised lanes."""
        xy = self.xy(s, t)
        if not self.has_heights:
            return lift(self.terrain, xy)
        return np.concatenate([xy, self._own_height(s, t)[..., None]], -1)

    @cached_property
    def has_kerbs(self) -> bool:
        """Whether any of its lanes is raised."""
        return any(section.raised for section in self.sections)

    def raised(self, s: AnyScalars, t: AnyScalars | float = 0.0) -> AnyScalars:
        """Height of its surface over the terrain at places."""
        kerb_m = self.kerb(s, t)
        if not self.has_heights:
            return kerb_m
        return np.asarray(self._own_height(s, t) + kerb_m - height_at(self.terrain, self.xy(s, t)))

    def _own_height(self, s: AnyScalars, t: AnyScalars | float) -> AnyScalars:
        s, t = np.broadcast_arrays(s, t)
        found = np.zeros(s.shape)
        for section, here in self._sections_at(s):
            found[here] = section.height(s[here], t[here])
        return found

    def kerb(self, s: AnyScalars, t: AnyScalars | float) -> AnyScalars:
        """Height of raised lanes over the pavement at places."""
        found = np.zeros(np.shape(s))
        if not self.has_kerbs:
            return found
        t = np.broadcast_to(t, found.shape)
        for section, here in self._sections_at(s):
            for left, right in section.raised:
                # Most places lie on the road's side of the inner edge.
                is_right = left >= section.n_left
                inner, outer = (left, right) if is_right else (right, left)
                sign = 1 if is_right else -1
                beyond = sign * (t[here] - section.edge(inner, s[here])) > SEAM_M
                if beyond.any():
                    beyond &= sign * (section.edge(outer, s[here]) - t[here]) > SEAM_M
                    found[here] = np.where(beyond, KERB_M, found[here])
        return found
