"""The graded ground of a map: roads with heights of their own where they lie on the ground, the slopes beside them, the
ground below decks and over tunnels. World frame, metres; heights are over the terrain, without kerbs."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from synth3dlanes.roads.network import Network
from synth3dlanes.roads.reference_line import GUESS_STEP_M
from synth3dlanes.roads.road_table import OnRoads
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.world.spans import BERM_M, CEILING_M, COVER_M, DECK_M, EMBANKMENT_SLOPE, VALLEY_M, WALL_M, Span

# Distance from points of areas within which roads with heights are searched.
ROAD_SEARCH_M = 3.0
# How far beyond a raised road's edge its embankment may reach.
EMBANKMENT_M = 40.0
# A road's height over the terrain changes by less than this between the stations at which it is computed.
BETWEEN_M = 0.5
# Gap between the ground and the lower side of a deck above it; distance within which a tunnel covers places.
BELOW_DECK_M, COVERED_M = 0.3, 0.5
# Limits of the ground: the size of the cells for which they are computed, and a height beyond all others. They follow
# from rows of places across roads, at SHARES of their width; between these, a road is higher by less than ROUGH_M.
CELL_M, NOWHERE_M, ROUGH_M, SHARES = 4.0, 1e4, 0.1, (0.0, 0.25, 0.5, 0.75, 1.0)
# The lowest road within a square of FLOOR_CELLS x FLOOR_CELLS cells around a place is below all pavement there.
FLOOR_CELLS = 5
# Places are processed in groups of this number: larger groups take more memory, and no less time for each.
PLACES_AT_ONCE = 40_000
# Places at most this far from pavement count as on it.
EDGE_M = 1e-4


@dataclass(frozen=True, eq=False)
class _Bounds:
    """Heights between which the ground may be at places: at least `low`, at most `high`, each by the road that is
    `_away_m` from there, and at most `deck`, below decks; over tunnels at least `cover`."""

    low: Scalars
    high: Scalars
    low_away_m: Scalars
    high_away_m: Scalars
    deck: Scalars
    cover: Scalars

    @classmethod
    def of(cls, n: int) -> "_Bounds":
        """The bounds of n places that nothing bounds yet."""
        none, lowest = np.full(n, np.inf), np.full(n, -np.inf)
        return cls(lowest.copy(), none.copy(), none.copy(), none.copy(), none.copy(), lowest.copy())

    def beside(self, at: Int[np.ndarray, " m"], away_m: Scalars, raised_m: Scalars) -> None:
        """Places at a distance from pavement of this height; of equal bounds of a place the first one counts."""
        fall_m = np.maximum(away_m - BERM_M, 0.0) / EMBANKMENT_SLOPE
        _tighten(np.maximum, self.low, self.low_away_m, at, raised_m - fall_m, away_m)
        _tighten(np.minimum, self.high, self.high_away_m, at, raised_m + fall_m, away_m)

    def covers(self, at: Int[np.ndarray, " m"], away_m: Scalars, top_m: Scalars) -> None:
        """Places at a distance from a tunnel with this height of the ground over it."""
        low_m = top_m - np.maximum(away_m - BERM_M, 0.0) / EMBANKMENT_SLOPE
        _tighten(np.maximum, self.low, self.low_away_m, at, low_m, away_m)
        is_over = away_m < COVERED_M
        np.maximum.at(self.cover, at[is_over], top_m[is_over])

    def below(self, at: Int[np.ndarray, " m"], most_m: Scalars) -> None:
        """Places below and beside a deck."""
        np.minimum.at(self.deck, at, most_m)

    def ground(self, covered: Bool[np.ndarray, " n"], paved: Scalars) -> Scalars:
        """The heights: of pavement, but where that is covered by a tunnel; else 0, the terrain, where that may be, and
        otherwise the nearest height that may be. Between two roads whose slopes would cross, the ground leads evenly
        from one to the other."""
        found = np.clip(0.0, self.low, np.maximum(self.low, self.high))
        cross = self.low > self.high
        low_m, high_m = self.low_away_m[cross], self.high_away_m[cross]
        share = low_m / np.maximum(low_m + high_m, 1e-9)
        found[cross] = self.low[cross] + share * (self.high[cross] - self.low[cross])
        found = np.minimum(found, self.deck)
        found = np.where(covered, np.maximum(found, self.cover), found)
        is_in_tunnel = covered & (paved < self.cover - COVER_M)
        return np.where(np.isfinite(paved) & ~is_in_tunnel, paved, found)


def _tighten(
    closer: np.ufunc,
    bounds: Float[np.ndarray, " k"],
    away_m: Float[np.ndarray, " k"],
    at: Int[np.ndarray, " m"],
    new: Float[np.ndarray, " m"],
    new_away_m: Float[np.ndarray, " m"],
) -> None:
    """Move bounds at places to values that are closer, and with them the distances of the roads that these are by."""
    before = bounds[at]
    closer.at(bounds, at, new)
    leads = np.flatnonzero((new == bounds[at]) & (new != before))[::-1]
    away_m[at[leads]] = new_away_m[leads]


class _Rows(NamedTuple):
    """Rows of places across the pavement of roads with heights, GUESS_STEP_M apart or closer: the number of the road of
    each, (x, y), how high the pavement is there, of tunnels the ground over them, and how deep, of decks the ground
    below them, and whether a row is on a deck; and how far places of a row are apart at most."""

    road: Int[np.ndarray, " n"]
    xy_world: Float[np.ndarray, "n k 2"]
    low_m: Float[np.ndarray, "n k"]
    high_m: Float[np.ndarray, "n k"]
    is_deck: Bool[np.ndarray, " n"]
    apart_m: float


@dataclass(frozen=True, eq=False)
class GradedGround:
    """The graded ground of the roads of a network and of their decks and tunnels."""

    network: Network
    spans: Sequence[Span]

    def above(self, xy_world: Points2, covered: Bool[np.ndarray, " n"], are_paved: bool = True) -> Scalars:
        """Height of roads where they lie on the ground, and of what they are laid on: from the edges of their pavement
        the ground falls or rises until it meets the terrain. It stays below decks, and goes over tunnels where places
        are `covered`. Without `are_paved`, hardly any place is on pavement: then it takes less time."""
        found = np.zeros(len(xy_world))
        if self._has_heights.any():
            above = self._above if are_paved else self._between_roads
            for first in range(0, len(found), PLACES_AT_ONCE):
                some = slice(first, first + PLACES_AT_ONCE)
                found[some] = above(xy_world[some], covered[some])
        return found

    def _above(self, xy_world: Points2, covered: Bool[np.ndarray, " n"]) -> Scalars:
        """What `above` says of some places."""
        found = np.zeros(len(xy_world))
        # On pavement, where most places are, only the roads there are asked.
        paved, own_reach_m = np.full(len(xy_world), -np.inf), np.where(self._has_heights, 0.0, -np.inf)
        found_there = self.network.index.places(xy_world, own_reach_m)
        places, away_m = self._nearest(found_there, on_ground=True)
        is_on = away_m < EDGE_M
        np.maximum.at(paved, places.point[is_on], self._raised(xy_world, places.of(is_on), away_m[is_on]))
        is_paved = np.isfinite(paved) & ~covered
        found[is_paved], rest = paved[is_paved], ~is_paved
        found[rest] = self._between_roads(xy_world[rest], covered[rest])
        return found

    def _between_roads(self, xy_world: Points2, covered: Bool[np.ndarray, " n"]) -> Scalars:
        """What `above` says of places by all roads whose slopes may reach them."""
        found = self.network.index.places(xy_world, self._slopes_reach_m)
        # Most places are near no road.
        near, heights = _mask(len(xy_world), found.point), np.zeros(len(xy_world))
        found = found._replace(point=(np.cumsum(near) - 1)[found.point])
        heights[near] = self._near_roads(xy_world[near], covered[near], found)
        return heights

    def _near_roads(self, xy_world: Points2, covered: Bool[np.ndarray, " n"], found: OnRoads) -> Scalars:
        """What `_between_roads` says of places that are found to be near roads."""
        bounds, paved = _Bounds.of(len(xy_world)), np.full(len(xy_world), -np.inf)
        places, away_m = self._nearest(found, on_ground=True)
        raised_m = self._raised(xy_world, places, away_m)
        is_off = away_m >= EDGE_M
        bounds.beside(places.point[is_off], away_m[is_off], raised_m[is_off])
        np.maximum.at(paved, places.point[~is_off], raised_m[~is_off])
        if self.spans:
            z, near = height_at(self.network.terrain, xy_world), set(found.road.tolist())
            for span in self.spans:
                if (number := self._numbers[span.road.id]) not in near:
                    continue
                own = found.of(found.road == number)
                if span.is_tunnel:
                    bounds.covers(own.point, *self._over_tunnel(span, own.s, own.t))
                else:
                    own = own.of(span.holds(own.s))
                    bounds.below(own.point, _below_deck(span, own.s, own.t) - z[own.point])
        return bounds.ground(covered, paved)

    def mean(
        self, xy_world: Points2, junction: Int[np.ndarray, " n"] | None = None, on_ground: bool = False
    ) -> Scalars:
        """Height of the roads around places: their mean, the nearer the heavier; at places in a junction, by its number
        (else -1), of its roads alone; or of roads where they lie on the ground."""
        places = self.network.index.places(xy_world, ROAD_SEARCH_M)
        if junction is not None:
            own, of_road = junction[places.point], self.junction_numbers([road.junction for road in self.network.roads])
            places = places.of((own < 0) | (own == of_road[places.road]))
        places, away_m = self._nearest(places, on_ground)
        weight, n = 1 / (0.05 + away_m) ** 2, len(xy_world)
        total = np.bincount(places.point, weight * self._raised(xy_world, places, away_m), n)
        return np.asarray(total / np.maximum(np.bincount(places.point, weight, n), 1e-12))

    def _nearest(self, places: OnRoads, on_ground: bool) -> tuple[OnRoads, Float[np.ndarray, " m"]]:
        """The places on the pavement of roads that are nearest to places of points, and how far away they are; of roads
        that are nowhere on the ground none, if they are to be `on_ground`."""
        table = self.network.index.table
        on = np.clip(places.s, table.start_m[places.road], table.end_m[places.road])
        if on_ground and self.spans:
            near = set(places.road.tolist())
            for name, spans in self.spans_of.items():
                if (number := self._numbers[name]) in near:
                    at = np.flatnonzero(places.road == number)
                    on[at] = _on_ground(spans, places.s[at], on[at])
            known = np.isfinite(on)
            places, on = places.of(known), on[known]
        across = np.clip(places.t, *table.edges(places.road, on))
        return places._replace(s=on, t=across), np.hypot(places.s - on, places.t - across)

    def _raised(self, xy_world: Points2, places: OnRoads, away_m: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """How high the pavement is over the terrain at places on it that are this far from their points."""
        table, terrain = self.network.index.table, self.network.terrain
        # Most points are on the pavement themselves.
        is_near, terrain_m = _mask(len(xy_world), places.point), np.zeros(len(xy_world))
        terrain_m[is_near] = height_at(terrain, xy_world[is_near])
        terrain_m = terrain_m[places.point]
        off = places.of(away_m > 0)
        terrain_m[away_m > 0] = height_at(terrain, table.xy(off.road, off.s, off.t))
        return table.over_terrain(places.road, places.s, places.t, terrain_m)

    @cached_property
    def _has_heights(self) -> Bool[np.ndarray, " r"]:
        return np.array([road.has_heights for road in self.network.roads], dtype=bool)

    @cached_property
    def _numbers(self) -> dict[str, int]:
        """The number of each road by its id."""
        return {road.id: i for i, road in enumerate(self.network.roads)}

    def junction_numbers(self, names: Sequence[str | None]) -> Int[np.ndarray, " k"]:
        """The numbers of junctions by their ids, -1 of none."""
        known = {at.id: i for i, at in enumerate(self.network.junctions)}
        return np.array([-1 if name is None else known.get(name, -2) for name in names], dtype=int)

    @cached_property
    def spans_of(self) -> dict[str, list[Span]]:
        """The decks and tunnels of roads by their ids."""
        found: dict[str, list[Span]] = {}
        for span in self.spans:
            found.setdefault(span.road.id, []).append(span)
        return found

    @cached_property
    def _rows(self) -> "_Rows":
        table, own = self.network.index.table, np.flatnonzero(self._has_heights)
        stations = [self.network.roads[i].stations for i in own]
        road, s = np.repeat(own, [len(at) for at in stations]), np.concatenate(stations)
        left, right = table.edges(road, s)
        points = np.stack([table.base_points(road, s, left + share * (right - left)) for share in SHARES], axis=1)
        low_m = points[..., 2] - height_at(self.network.terrain, points[..., :2])
        high_m, is_deck = low_m.copy(), np.zeros(len(s), dtype=bool)
        for span in self.spans:
            on = (
                (road == self._numbers[span.road.id])
                & (s > span.from_m - GUESS_STEP_M)
                & (s < span.to_m + GUESS_STEP_M)
            )
            if span.is_tunnel:
                high_m[on] += CEILING_M + COVER_M
            else:
                low_m[on] -= DECK_M + BELOW_DECK_M + VALLEY_M
                is_deck |= on & (s > span.from_m + GUESS_STEP_M) & (s < span.to_m - GUESS_STEP_M)
        apart_m = float((right - left).max()) / (len(SHARES) - 1)
        return _Rows(road, points[..., :2], low_m, high_m, is_deck, apart_m)

    @cached_property
    def _slopes_reach_m(self) -> Float[np.ndarray, " r"]:
        """How far beside each road its slopes may decide the ground: to the terrain, or to the slopes of the road that
        is highest over it or deepest below, of those near it; nowhere beside roads without heights."""
        rows, own, (low, high) = self._rows, self._has_heights, self.network.index.boxes
        low_m, high_m = np.zeros((2, len(own)))
        np.minimum.at(low_m, rows.road, rows.low_m.min(axis=1))
        np.maximum.at(high_m, rows.road, rows.high_m.max(axis=1))
        is_near = (low[:, None] - 2 * EMBANKMENT_M < high).all(axis=2)
        is_near = is_near & is_near.T & own
        lowest_m, highest_m = np.where(is_near, low_m, 0.0).min(axis=1), np.where(is_near, high_m, 0.0).max(axis=1)
        apart_m = np.maximum(high_m - lowest_m, highest_m - low_m) + BETWEEN_M
        return np.where(own, np.minimum(EMBANKMENT_M, BERM_M + EMBANKMENT_SLOPE * apart_m), -np.inf)

    def floor(self, xy_world: Points2) -> Scalars:
        """Heights below all pavement on the ground, at places on pavement or near it: the height of the lowest road in
        the grid cells around a place, but not over the terrain."""
        found = np.zeros(len(xy_world))
        if self._has_heights.any() and len(xy_world):
            corner = np.floor(xy_world.min(axis=0) / CELL_M).astype(int)
            at = np.floor(xy_world / CELL_M).astype(int) - corner
            cells = np.floor(self._rows.xy_world / CELL_M).astype(int) - corner
            lowest = np.zeros(at.max(axis=0) + 1)
            inside = ((cells >= 0) & (cells < lowest.shape)).all(axis=-1)
            np.minimum.at(lowest, tuple(cells[inside].T), self._rows.low_m[inside])
            found = scipy.ndimage.minimum_filter(lowest, size=FLOOR_CELLS, mode="nearest")[tuple(at.T)]
        return np.asarray(found)

    def limits(self, xy_world: Points2) -> tuple[Scalars, Scalars]:
        """Heights that `above` is nowhere lower and nowhere higher than, by the deepest and the highest roads around
        cells of a grid and what their slopes reach."""
        if not (self._has_heights.any() and len(xy_world)):
            return np.zeros(len(xy_world)), np.zeros(len(xy_world))
        rows, (column, row) = self._rows, np.floor(xy_world.T / CELL_M).astype(int)
        first, last = np.array([[column.min(), row.min()], [column.max(), row.max()]])
        at, ground = (column - first[0]) * (last[1] - first[1] + 1) + row - first[1], ~rows.is_deck
        least = -self._highest(rows.xy_world, -rows.low_m, first, last)
        most = self._highest(rows.xy_world[ground], rows.high_m[ground], first, last)
        return least.take(at), most.take(at)

    def _highest(
        self,
        xy_world: Float[np.ndarray, "*k 2"],
        raised_m: Float[np.ndarray, "*k"],
        first: Int[np.ndarray, "2"],
        last: Int[np.ndarray, "2"],
    ) -> Float[np.ndarray, "columns rows"]:
        """The greatest height of slopes down from places with others between them, or 0, in the cells of a grid from
        one to another."""
        # From anywhere in a cell to a place between the rows of another.
        near_m = BERM_M + CELL_M * np.sqrt(2) + np.hypot(GUESS_STEP_M, self._rows.apart_m) / 2
        slope_m = near_m + EMBANKMENT_SLOPE * max(float(raised_m.max(initial=0.0)) + ROUGH_M, 0.0)
        reach = int(np.ceil(min(EMBANKMENT_M, slope_m) / CELL_M)) + 1
        corner, end = first - reach, last + reach + 1
        cells = np.floor(xy_world / CELL_M).astype(int)
        inside = ((cells >= corner) & (cells < end)).all(axis=-1)
        highest = np.full(end - corner, -NOWHERE_M)
        np.maximum.at(highest, tuple((cells[inside] - corner).T), raised_m[inside])
        away_m = CELL_M * np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1])
        falls_m = np.maximum(away_m - near_m, 0.0) / EMBANKMENT_SLOPE
        highest = scipy.ndimage.grey_dilation(highest, structure=-falls_m, mode="constant", cval=-NOWHERE_M)
        return np.asarray(np.maximum(highest[reach:-reach, reach:-reach] + ROUGH_M, 0.0))

    def _over_tunnel(self, span: Span, s: Scalars, t: Scalars) -> tuple[Scalars, Scalars]:
        """How far places are from a tunnel, and how high the ground over it is there."""
        road, on = span.road, np.clip(s, span.from_m, span.to_m)
        left, right = road.left(on), road.right(on)
        across = np.clip(t, left - WALL_M, right + WALL_M)
        base = road.base_points(on, np.clip(across, left, right))
        top = base[:, 2] + CEILING_M + COVER_M
        return np.hypot(s - on, t - across), top - height_at(self.network.terrain, base[:, :2])


def _mask(n: int, numbers: Int[np.ndarray, " m"]) -> Bool[np.ndarray, " n"]:
    """Which of n places have one of these numbers."""
    found = np.zeros(n, dtype=bool)
    found[numbers] = True
    return found


def _on_ground(spans: Sequence[Span], s: Scalars, on: Scalars) -> Scalars:
    """The nearest stations at which a road with these decks and tunnels lies on the ground; infinite where it never
    does. `on` are stations within its ends."""
    on = on.copy()
    for span in spans:
        road = span.road
        inside = span.holds(on) | (on == span.from_m) * (span.from_m == road.start_m)
        inside |= (on == span.to_m) & (span.to_m == road.end_m)
        low = span.from_m if span.from_m > road.start_m else -np.inf
        high = span.to_m if span.to_m < road.end_m else np.inf
        on[inside] = np.where(s[inside] - low < high - s[inside], low, high)
    return on


def _below_deck(span: Span, s: Scalars, t: Scalars) -> Scalars:
    """The greatest height (world z) of the ground below and beside a deck."""
    road = span.road
    across = np.clip(t, road.left(s), road.right(s))
    z = road.base_points(s, across)[:, 2] - DECK_M - BELOW_DECK_M
    if span.is_given:
        z -= np.clip(np.minimum(s - span.from_m, span.to_m - s) / EMBANKMENT_SLOPE, 0, VALLEY_M)
    return np.asarray(z + np.abs(t - across) / EMBANKMENT_SLOPE)
