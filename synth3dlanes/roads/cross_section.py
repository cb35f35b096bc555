"""Cross-sections of roads: lanes of many kinds beside each other, with widths that change, heights and banks of their
own. World frame, metres; t grows to the right of growing s."""

from collections.abc import Container
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np
from jaxtyping import Float

from synth3dlanes.roads.maps.cubics import Profile, holding
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.scene.road_map import MapLane, MapLaneKind, MapRoad, MapShape, Polynomial
from synth3dlanes.system.arrays import AnyScalars, Numbers, Spread

# Height of raised lanes over the pavement, the width of the seam at their edges that is not raised, and their kinds.
KERB_M, SEAM_M = 0.12, 0.005
RAISED: frozenset[MapLaneKind] = frozenset({"walkway", "kerb"})
# The number of widths of lanes that a process keeps as arrays.
WIDTHS_KEPT = 2**13


@lru_cache(maxsize=WIDTHS_KEPT)
def _width(cubics: tuple[Polynomial, ...]) -> Profile:
    """The profile of a width: all scenes on a map have the same ones."""
    return Profile(cubics)


@lru_cache(maxsize=WIDTHS_KEPT)
def greatest_and_mean(width: Profile, length_m: float) -> tuple[float, float]:
    """The greatest and the mean width of a lane of this length, by five places; of all scenes on a map, too."""
    widths_m = np.maximum(width(np.linspace(0.0, length_m, 5)), 0.0)
    return float(widths_m.max()), float(widths_m.mean())


@dataclass(frozen=True, eq=False)
class Shapes:
    """Heights over a banked plane at stations, by cubics of t to the left; even between stations."""

    given: tuple[MapShape, ...]

    @cached_property
    def rows(self) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k n"], Float[np.ndarray, "4 k n"]]:
        """The stations, and of each the starts in t of its cubics, infinite beyond the last one, and their
        coefficients."""
        by_station: dict[float, list[MapShape]] = {}
        for shape in sorted(self.given, key=lambda at: (at.s_m, at.t_m)):
            by_station.setdefault(shape.s_m, []).append(shape)
        most = max(map(len, by_station.values()))
        starts, table = np.full((len(by_station), most), np.inf), np.zeros((4, len(by_station), most))
        for i, row in enumerate(by_station.values()):
            starts[i, : len(row)] = [at.t_m for at in row]
            table[:, i, : len(row)] = np.array([[at.a, at.b, at.c, at.d] for at in row], float).T
        return np.array(list(by_station)), starts, table

    def __call__(self, s: AnyScalars, t_left: AnyScalars) -> AnyScalars:
        """Heights at places."""
        stations, starts, table = self.rows
        s, t_left = np.broadcast_arrays(s, t_left)
        after = np.clip(np.searchsorted(stations, s, side="right"), 1, max(len(stations) - 1, 1))
        before = after - 1
        after = np.minimum(after, len(stations) - 1)
        found = []
        for at in (before, after):
            row = np.clip((starts[at] <= t_left[..., None]).sum(axis=-1) - 1, 0, None)
            x, (a, b, c, d) = t_left - starts[at, row], table[:, at, row]
            found.append(a + x * (b + x * (c + x * d)))
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
        return [_width(lane.widths) for lane in self.lanes]

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
        """Offsets of one edge."""
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

    def height(self, s: Spread, t: Spread | float) -> AnyScalars:
        """World height of the surface without raised lanes at places, of a road with heights; before its start and
        beyond its end the height there."""
        assert self.heights is not None, "asked only of roads with heights"
        s = np.clip(s, self.start_m, self.end_m)
        s, t, z = np.broadcast_arrays(s, t, self.heights(s))
        if self.banks is None and self.shapes is None:
            return z
        bank, t = self.banks(s) if self.banks is not None else np.zeros(s.shape), self._banked(s, t)
        z = z - np.tan(bank) * t
        if self.shapes is not None:
            # Shapes are measured along the banked plane and stand square to it.
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

    def kerb(self, s: AnyScalars, t: AnyScalars | float) -> AnyScalars:
        """Height of raised lanes over the pavement at places."""
        found = np.zeros(s.shape)
        for left, right in self.raised:
            # Most places lie on the road's side of the inner edge.
            inner, outer, sign = (left, right, 1) if left >= self.n_left else (right, left, -1)
            beyond = sign * (t - self.edge(inner, s)) > SEAM_M
            if beyond.any():
                found[beyond & (sign * (self.edge(outer, s) - t) > SEAM_M)] = KERB_M
        return found

    @cached_property
    def paved(self) -> tuple[int, int]:
        """The numbers of the outermost edges of its pavement."""
        found = [i for i, lane in enumerate(self.lanes) if lane.kind != "none"] or [self.n_left]
        return found[0], found[-1] + 1 if self.lanes else found[-1]

    @cached_property
    def raised(self) -> list[tuple[int, int]]:
        """Runs of lanes that are raised beside each other: the numbers of their outer edges."""
        return self._runs(RAISED)

    @cached_property
    def medians(self) -> list[tuple[int, int]]:
        """The runs of medians."""
        return self._runs({"median"})

    @cached_property
    def level(self) -> list[tuple[int, int]]:
        """The runs of lanes of the pavement that are not raised."""
        return self._runs({lane.kind for lane in self.lanes} - RAISED - {"none"})

    def _runs(self, kinds: Container[MapLaneKind]) -> list[tuple[int, int]]:
        runs: list[tuple[int, int]] = []
        for i, lane in enumerate(self.lanes):
            if lane.kind in kinds:
                runs[-1:] = [(runs[-1][0], i + 1)] if runs and runs[-1][1] == i else [*runs[-1:], (i, i + 1)]
        return runs
