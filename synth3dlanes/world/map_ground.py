"""The ground of a map as built: roads and junctions on the terrain or at their own heights, with embankments and cuts
beside these. World frame.

The pavement of roads that connect others in a junction is one area. Terrain meets the pavement at its edges.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from operator import attrgetter
from typing import NamedTuple

import numpy as np
import scipy
import shapely
from jaxtyping import Bool, Float, Int
from shapely.geometry.base import BaseGeometry

from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.map_network import AS_FAR, Junction, MapNetwork
from synth3dlanes.roads.roads import Road
from synth3dlanes.roads.section_road import KERB_M, RAISED, SectionRoad
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.road_map import MapIsland
from synth3dlanes.system.arrays import AnyPoints2, AnyScalars, Points2, Points3, Scalars
from synth3dlanes.world.areas import (
    Outlined,
    clipped,
    contains,
    difference,
    filled,
    outlined,
    outset,
    polygon_between,
    polygons_of,
    ring_area,
    signed_distance,
    solid,
    union,
)
from synth3dlanes.world.ground import EMBANKMENT_SLOPE, FINE_M, Ground
from synth3dlanes.world.passages import BERM_M, CEILING_M, COVER_M, DECK_M, VALLEY_M, WALL_M, Span, spans

# Places along the host's way from which distances are measured, and rows along roads by their distance from it.
WAY_STEP_M = 5.0
ROW_STEPS_M, ROW_STEPS_AT_M = (0.5, 0.5, 1.0, 2.0, 6.0), (0.0, 60.0, 120.0, 200.0, 450.0)
# Half the width of a street with its walkways, about.
HALF_STREET_M = 6.0
# Roads with heights are looked for this far from points of areas.
NEAR_M = 3.0
# The terrain under the edges of the pavement is so much lower than that, times the size of its cells.
UNDER_FALL_M = 0.03
# Kerbs this near to the host's way hide what is labelled; as lines that are simplified by so much, in such steps.
CREST_REACH_M, CREST_SLACK_M, CREST_STEP_M = 110.0, 0.005, 4.0
# Paint farther than this from the host's way is not drawn; places along a line that are asked.
PAINT_M, PAINT_STEP_M = 250.0, 20.0
# How far beyond a raised road's edge its embankment may reach.
EMBANKMENT_M = 40.0
# Between the stations at which a road's height over the terrain is asked, it changes by less than this.
BETWEEN_M = 0.5
# The edges of a road's pavement.
EDGES = attrgetter("left"), attrgetter("right")
# The ground is so much lower than the lower side of a deck above it. A tunnel covers places so near to it.
BELOW_DECK_M, COVERED_M = 0.3, 0.5
# What is no farther from pavement is on it.
EDGE_M = 1e-4
# Junctions are cut so far beside their decks.
OFF_M = 0.3


class GroundArea(NamedTuple):
    """A part of the ground from above, raised over its pavement; `kind` is what it shows. That of a junction names
    it."""

    polygon: BaseGeometry
    raised_m: float
    kind: str
    junction: str | None = None


@dataclass(frozen=True, eq=False)
class _Bounds:
    """Heights over the terrain between which the ground may be at places: at least `low`, at most `high`, by the roads
    that are so far away, `deck` below decks; of pavement, and of what covers a tunnel."""

    low: Scalars
    high: Scalars
    low_away_m: Scalars
    high_away_m: Scalars
    deck: Scalars
    paved: Scalars
    cover: Scalars

    @classmethod
    def of(cls, n: int) -> "_Bounds":
        """Those of n places that nothing bounds."""
        none, lowest = np.full(n, np.inf), np.full(n, -np.inf)
        return cls(lowest.copy(), none.copy(), none.copy(), none.copy(), none.copy(), lowest.copy(), lowest.copy())

    def beside(self, at: Int[np.ndarray, " m"], away_m: Scalars, raised_m: Scalars) -> None:
        """Places at a distance from pavement of this height."""
        is_on, fall_m = away_m < EDGE_M, np.maximum(away_m - BERM_M, 0.0) / EMBANKMENT_SLOPE
        self.paved[at[is_on]] = np.maximum(self.paved[at[is_on]], raised_m[is_on])
        self._at_least(at[~is_on], (raised_m - fall_m)[~is_on], away_m[~is_on])
        higher = (raised_m + fall_m < self.high[at]) & ~is_on
        self.high[at[higher]], self.high_away_m[at[higher]] = (raised_m + fall_m)[higher], away_m[higher]

    def covers(self, at: Int[np.ndarray, " m"], away_m: Scalars, top_m: Scalars) -> None:
        """Places at a distance from a tunnel with this height of the ground over it."""
        self._at_least(at, top_m - np.maximum(away_m - BERM_M, 0.0) / EMBANKMENT_SLOPE, away_m)
        is_over = away_m < COVERED_M
        self.cover[at[is_over]] = np.maximum(self.cover[at[is_over]], top_m[is_over])

    def _at_least(self, at: Int[np.ndarray, " m"], low_m: Scalars, away_m: Scalars) -> None:
        higher = low_m > self.low[at]
        self.low[at[higher]], self.low_away_m[at[higher]] = low_m[higher], away_m[higher]

    def below(self, at: Int[np.ndarray, " m"], most_m: Scalars) -> None:
        """Places below and beside a deck."""
        self.deck[at] = np.minimum(self.deck[at], most_m)

    def ground(self, covered: Bool[np.ndarray, " n"]) -> Scalars:
        """The heights over the terrain: the terrain where it may be, else the nearest height that may be. Between two
        roads whose slopes would cross, the ground leads evenly from one to the other."""
        found = np.clip(0.0, self.low, np.maximum(self.low, self.high))
        cross = self.low > self.high
        low_m, high_m = self.low_away_m[cross], self.high_away_m[cross]
        share = low_m / np.maximum(low_m + high_m, 1e-9)
        found[cross] = self.low[cross] + share * (self.high[cross] - self.low[cross])
        found = np.minimum(found, self.deck)
        found = np.where(covered, np.maximum(found, self.cover), found)
        is_in_tunnel = covered & (self.paved < self.cover - COVER_M)
        return np.where(np.isfinite(self.paved) & ~is_in_tunnel, self.paved, found)


@dataclass(frozen=True, eq=False, kw_only=True)
class MapGround(Ground):
    """The ground of a map. Distances ahead are those from the host's way, from above."""

    network: MapNetwork
    islands: tuple[MapIsland, ...]

    # -- distances from the host

    @cached_property
    def _way(self) -> Points2:
        s = np.linspace(self.near_m, self.near_m + self.driven_m, 1 + int(np.ceil(self.driven_m / WAY_STEP_M)))
        return self.network.way.xy_world(s)

    @cached_property
    def _way_tree(self) -> "scipy.spatial.cKDTree":
        return scipy.spatial.cKDTree(self._way)

    def away_at(self, xy_world: AnyPoints2) -> AnyScalars:
        """How far points are from the host's way."""
        return np.asarray(self._way_tree.query(xy_world)[0])

    def away_along(self, road: Road, s: AnyScalars) -> AnyScalars:
        """How far places on a road's line are from the host's way."""
        return self.away_at(road.xy(s, 0.0))

    def away_on(self, curve: LaneCurve, s: AnyScalars) -> AnyScalars:
        """How far places on a curve are from the host's way."""
        return self.away_at(curve.xy_world(s))

    def curve_rows(self, curve: LaneCurve) -> Scalars:
        """The stations of the rows of a curve's paint."""
        return self.rows(curve.end_m, lambda s: self.away_on(curve, s))

    def points_beside(self, curve: LaneCurve, s: Scalars, t: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n k 3"]:
        """Points on the pavement: at each station of a curve those at all offsets from it."""
        return curve.points_beside(np.repeat(s, len(t)), np.tile(t, len(s))).reshape(len(s), len(t), 3)

    @cached_property
    def _road_rows(self) -> dict[str, Scalars]:
        found = {}
        for road in self.network.roads:
            found[road.id] = self.rows(road.end_m, partial(self.away_along, road))
        return found

    def stretch_rows(self, stretch: SectionRoad) -> Scalars:
        """The stations of the rows of a stretch of a road."""
        s, ends = self._road_rows[stretch.id], [stretch.start_m, stretch.end_m]
        return np.union1d(s[(s > ends[0]) & (s < ends[1])], ends)

    def rows(self, end_m: float, away_m: Callable[[Scalars], Scalars]) -> Scalars:
        """Stations from 0 to an end, closer to each other near the host."""
        coarse = np.linspace(0.0, end_m, 2 + int(end_m / 4.0))
        step = np.interp(away_m(coarse), ROW_STEPS_AT_M, ROW_STEPS_M)
        count = np.concatenate([[0.0], np.cumsum(np.diff(coarse) * 2 / (step[1:] + step[:-1]))])
        n = max(int(np.ceil(count[-1])), 1)
        return np.interp(np.linspace(0.0, count[-1], n + 1), count, coarse)

    @cached_property
    def fine(self) -> tuple[float, float, float, float]:
        """(x0, y0, x1, y1) of the area with fine terrain cells: around the host's way, and as far as it looks."""
        ahead = self.network.way.xy_world(np.array([self.near_m, self.near_m + 1.0]))
        angle = np.arctan2(*(ahead[1] - ahead[0])[::-1]) + np.linspace(-0.9, 0.9, 9)
        reach = FINE_M * np.stack([np.cos(angle), np.sin(angle)], -1)
        far = (
            [self._way[0] + reach]
            if self.driven_m == 0 and not self.both_ways
            else [self._way - FINE_M, self._way + FINE_M]
        )
        points = np.concatenate([self._way - 15.0, self._way + 15.0, *far])
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        return float(x0), float(y0), float(x1), float(y1)

    # -- areas

    def strip(self, road: SectionRoad) -> BaseGeometry:
        """The pavement of a road from above."""
        rows = [(at, self.stretch_rows(at)) for at in road.stretches]
        left, right = (np.concatenate([at.xy(s, edge(at)(s)) for at, s in rows]) for edge in EDGES)
        return polygon_between(left, right)

    @cached_property
    def arms(self) -> BaseGeometry:
        """The pavement of all roads outside junctions."""
        return union(self.strip(road) for road in self.outside)

    @property
    def outside(self) -> list[SectionRoad]:
        """The roads that are in no junction."""
        known = {at.id for at in self.network.junctions}
        return [road for road in self.network.roads if road.junction not in known]

    @cached_property
    def areas(self) -> list[GroundArea]:
        """The surfaces of junctions and islands."""
        found = []
        for at in self.network.junctions:
            paved, raised = map(solid, self._junction(at))
            if not paved.is_empty:
                found.append(GroundArea(paved, 0.0, "road", at.id))
            found += [GroundArea(part, KERB_M, "walkway", at.id) for part in polygons_of(raised)]
        for island in self.islands:
            polygon = solid(ring_area(np.array(island.outline)))
            found += [GroundArea(part, island.height_m, island.surface) for part in polygons_of(polygon)]
        return found

    def _junction(self, at: Junction) -> tuple[BaseGeometry, BaseGeometry]:
        """The pavement of a junction, and its raised walkways."""
        lanes, raised = list[BaseGeometry](), list[BaseGeometry]()
        for road in at.roads:
            for stretch in road.stretches:
                for i, lane in enumerate(stretch.sections[0].lanes):
                    if lane.kind != "none":
                        (raised if lane.kind in RAISED else lanes).append(self._between(stretch, (i, i + 1)))
        outline = ring_area(at.outline)
        paved = difference(filled(union([*lanes, outline])), self.arms)
        walkways = difference(union(raised), union([paved, self.arms]))
        return paved, walkways

    @cached_property
    def pavement(self) -> BaseGeometry:
        """All of the pavement from above, walkways included."""
        whole = union([self.arms, *(area.polygon for area in self.areas)])
        shapely.prepare(whole)
        return whole

    def pavement_edges(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> Iterator[Points3]:
        """The edges of the pavement of traffic, walkways left out, within about `reach_m` of a place: lines with points
        a metre apart."""
        lines = clipped(shapely.boundary(self.carriageways), _around(xy_world, reach_m))
        for line in shapely.get_parts(shapely.line_merge(lines)):
            if not line.is_empty:
                ring = shapely.get_coordinates(shapely.segmentize(line, 1.0))
                yield np.column_stack([ring, self.under(ring)])

    @cached_property
    def _raised_strips(self) -> list[BaseGeometry]:
        """The raised lanes of roads outside junctions."""
        stretches = [stretch for road in self.outside for stretch in road.stretches]
        return [self._between(stretch, edges) for stretch in stretches for edges in stretch.sections[0].raised]

    def _between(self, stretch: SectionRoad, edges: tuple[int, int]) -> BaseGeometry:
        """The area between two edges of a stretch of a road."""
        s, (section,) = self.stretch_rows(stretch), stretch.sections
        left, right = (stretch.xy(s, section.edge(edge, s)) for edge in edges)
        return polygon_between(left, right)

    def pavement_strips(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> Iterator[tuple[Points3, Points3]]:
        """Both edges of the pavement of every road within about `reach_m` of a place, those in junctions included."""
        for road in self.network.roads:
            rows = [(at, self.stretch_rows(at)) for at in road.stretches]
            left, right = (np.concatenate([at.points(s, edge(at)(s)) for at, s in rows]) for edge in EDGES)
            if (np.hypot(*(left[:, :2] - xy_world).T) < AS_FAR * reach_m).any():
                yield left, right

    def carriageway(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> BaseGeometry:
        """The pavement of traffic from above, within about `reach_m` of a place."""
        return clipped(self.carriageways, _around(xy_world, reach_m))

    def walkways(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> BaseGeometry:
        """The walkways of roads and junctions from above, within about `reach_m` of a place."""
        of_junctions = (area.polygon for area in self.areas if area.kind == "walkway")
        return clipped(union([*self._raised_strips, *of_junctions]), _around(xy_world, reach_m))

    def beside_pavement(self, driven_m: Float[np.ndarray, " k"], aside_m: Float[np.ndarray, " m"]) -> Points2:
        """Places at lengths along the host's way, so far beside what is about its pavement on both sides."""
        way, aside = self.network.way, np.concatenate([-aside_m - HALF_STREET_M, aside_m + HALF_STREET_M])
        s = np.tile(np.clip(driven_m, 0.0, way.end_m), len(aside))
        return way.points_beside(s, np.repeat(aside, len(driven_m)))[:, :2]

    @cached_property
    def carriageways(self) -> BaseGeometry:
        """The pavement without raised lanes and islands."""
        raised = [area.polygon for area in self.areas if area.raised_m] + self._raised_strips
        # Rows of strips beside each other differ by less than this.
        slack = outset(union(raised), 0.01)
        return difference(self.pavement, slack)

    @cached_property
    def _grass(self) -> BaseGeometry:
        found = [area.polygon for area in self.areas if area.kind == "grass"]
        for road in self.outside:
            for stretch in road.stretches:
                medians = [i for i, lane in enumerate(stretch.sections[0].lanes) if lane.kind == "median"]
                found += [self._between(stretch, (i, i + 1)) for i in medians]
        grass = union(found)
        shapely.prepare(grass)
        return grass

    def is_grass(self, xy_world: Points2, room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are on the grass of medians and islands, or at most `room_m` beside it."""
        return np.asarray(shapely.dwithin(self._grass, shapely.points(xy_world), room_m))

    # -- heights and distances

    @cached_property
    def _raised(self) -> list[tuple[BaseGeometry, float]]:
        """What is raised over the pavement, by how much: walkways, those of junctions, and islands."""
        walkways = [area.polygon for area in self.areas if area.kind == "walkway"]
        found = [(union([*self._raised_strips, *walkways]), KERB_M)]
        found += [(area.polygon, area.raised_m) for area in self.areas if area.raised_m and area.kind != "walkway"]
        for polygon, _ in found:
            shapely.prepare(polygon)
        return found

    def above_terrain(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the built ground over the analytic terrain at any points (0 away from roads): on decks, and over
        tunnels."""
        flat = xy_world.reshape(-1, 2)
        above = self._graded_above(flat)
        for span in self.decks:
            at = np.flatnonzero(contains(span.area, flat))
            above[at] = np.maximum(above[at], span.height(flat[at]) - height_at(self.network.terrain, flat[at]))
        for polygon, raised_m in self._raised:
            above[contains(polygon, flat)] += raised_m
        return above.reshape(xy_world.shape[:-1])

    def _graded_above(self, flat: Points2) -> Scalars:
        """Height over the terrain of the ground below all decks, without kerbs."""
        if not self._has_heights:
            return np.zeros(len(flat))
        covered = np.zeros(len(flat), dtype=bool)
        for span in self.tunnels:
            covered |= contains(span.area, flat)
        return self._built(flat, covered)

    def graded(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the ground below all decks, without kerbs."""
        flat = xy_world.reshape(-1, 2)
        z = height_at(self.network.terrain, flat) + self._graded_above(flat)
        return np.asarray(z.reshape(xy_world.shape[:-1]))

    def _built(self, flat: Points2, covered: Bool[np.ndarray, " n"]) -> Scalars:
        """Height over the terrain of roads with heights of their own where they lie on the ground, without kerbs, and
        of what they are laid on: from the edges of their pavement the ground falls or rises until it meets the terrain.
        It stays below decks, and goes over tunnels where places are `covered`."""
        above = np.zeros(len(flat))
        near, roads = self.network.nearby(flat, self._slopes_reach_m)
        z = height_at(self.network.terrain, flat[near])
        bounds = _Bounds.of(len(z))
        for road, which, s, t in roads:
            own, at = self.network.road(road.id), np.flatnonzero(which)
            if not own.has_heights:
                continue
            on = self._on_ground(own, s)
            known = np.isfinite(on)
            if known.any():
                bounds.beside(at[known], *self._beside(own, s[known], t[known], on[known]))
            for span in self._spans_of.get(own.id, ()):
                if span.is_tunnel:
                    bounds.covers(at, *self._over_tunnel(span, s, t))
                else:
                    inside = span.holds(s)
                    bounds.below(at[inside], self._below_deck(span, s[inside], t[inside]) - z[at[inside]])
        above[near] = bounds.ground(covered[near])
        return above

    @cached_property
    def _slopes_reach_m(self) -> dict[str, float]:
        """How far beside each road with heights its slopes may decide the ground: to the terrain, or to the slopes of
        the road that is highest over it or deepest below."""
        ranges = {}
        for name, road in ((road.id, self.network.road(road.id)) for road in self.network.roads):
            if not road.has_heights:
                continue
            s = road.plan.stations
            edges = np.concatenate([road.base_points(s, side(s)) for side in (road.left, road.right)])
            raised_m = edges[:, 2] - height_at(self.network.terrain, edges[:, :2])
            low_m, high_m = float(raised_m.min()), float(raised_m.max())
            spans = self._spans_of.get(name, ())
            low_m -= (DECK_M + BELOW_DECK_M + VALLEY_M) * any(not span.is_tunnel for span in spans)
            high_m += (CEILING_M + COVER_M) * any(span.is_tunnel for span in spans)
            ranges[name] = low_m, high_m
        lowest_m = min((low_m for low_m, _ in ranges.values()), default=0.0)
        highest_m = max((high_m for _, high_m in ranges.values()), default=0.0)
        return {
            name: min(EMBANKMENT_M, BERM_M + EMBANKMENT_SLOPE * (max(high_m - lowest_m, highest_m - low_m) + BETWEEN_M))
            for name, (low_m, high_m) in ranges.items()
        }

    def _on_ground(self, road: SectionRoad, s: Scalars) -> Scalars:
        """The nearest stations of a road at which it lies on the ground; infinite where it never does."""
        on = np.clip(s, road.start_m, road.end_m)
        for span in self._spans_of.get(road.id, ()):
            inside = span.holds(on) | (on == span.from_m) * (span.from_m == road.start_m)
            inside |= (on == span.to_m) & (span.to_m == road.end_m)
            low = span.from_m if span.from_m > road.start_m else -np.inf
            high = span.to_m if span.to_m < road.end_m else np.inf
            on[inside] = np.where(s[inside] - low < high - s[inside], low, high)
        return on

    def _beside(self, road: SectionRoad, s: Scalars, t: Scalars, on: Scalars) -> tuple[Scalars, Scalars]:
        """How far places are from the pavement of a road at its stations `on`, and how high that is over the terrain
        there."""
        across = np.clip(t, road.left(on), road.right(on))
        base = road.base_points(on, across)
        return np.hypot(s - on, t - across), base[:, 2] - height_at(self.network.terrain, base[:, :2])

    def _over_tunnel(self, span: Span, s: Scalars, t: Scalars) -> tuple[Scalars, Scalars]:
        """How far places are from a tunnel, and how high the ground over it is over the terrain there."""
        road, on = span.road, np.clip(s, span.from_m, span.to_m)
        left, right = road.left(on), road.right(on)
        across = np.clip(t, left - WALL_M, right + WALL_M)
        base = road.base_points(on, np.clip(across, left, right))
        top = base[:, 2] + CEILING_M + COVER_M
        return np.hypot(s - on, t - across), top - height_at(self.network.terrain, base[:, :2])

    def _below_deck(self, span: Span, s: Scalars, t: Scalars) -> Scalars:
        """The greatest height of the ground below and beside a deck."""
        road = span.road
        across = np.clip(t, road.left(s), road.right(s))
        z = road.base_points(s, across)[:, 2] - DECK_M - BELOW_DECK_M
        if span.is_given:
            z -= np.clip(np.minimum(s - span.from_m, span.to_m - s) / EMBANKMENT_SLOPE, 0, VALLEY_M)
        return np.asarray(z + np.abs(t - across) / EMBANKMENT_SLOPE)

    def is_in(self, points_world: Points3) -> Bool[np.ndarray, " n"]:
        """Which points lie in the ground as built: below a deck there is none down to the graded ground, and none in a
        tunnel."""
        found = super().is_in(points_world)
        for span, at in self._spans_at(points_world[:, :2]):
            z, floor_m = points_world[at, 2], span.height(points_world[at, :2])
            if span.is_tunnel:
                found[at] &= (z < floor_m) | (z > floor_m + CEILING_M)
            else:
                found[at] &= (z < self.graded(points_world[at, :2])) | (z > floor_m - DECK_M)
        return found

    def height_near(self, points_world: Points3) -> Scalars:
        """Height of the ground as built at points: on a bridge or below it, over a tunnel or in it."""
        found = super().height_near(points_world)
        for span, at in self._spans_at(points_world[:, :2]):
            xy, z = points_world[at, :2], points_world[at, 2]
            other = span.height(xy) if span.is_tunnel else self.graded(xy)
            found[at] = np.where(np.abs(other - z) < np.abs(found[at] - z), other, found[at])
        return found

    def height_along(self, road: str, xy_world: Points2) -> Scalars:
        """Height of the ground as built at places beside a road: on its deck, below that of another, or in its
        tunnel."""
        if not self.spans:
            return self.height(xy_world)
        own = self.network.road(road)
        s, t = own.line.project(xy_world)
        on = np.clip(s, own.start_m, own.end_m)
        z = own.base_points(on, np.clip(t, own.left(on), own.right(on)))[:, 2]
        return self.height_near(np.column_stack([xy_world, z]))

    def _spans_at(self, xy_world: Points2) -> Iterator[tuple[Span, Int[np.ndarray, " m"]]]:
        """The decks and tunnels at places, and at which each is."""
        for span in self.spans:
            at = np.flatnonzero(contains(span.area, xy_world))
            if at.size:
                yield span, at

    def is_stacked(self, xy_world: Points2) -> Bool[np.ndarray, " n"]:
        """At which places there is a road over another, or over or below the ground."""
        found = np.zeros(len(xy_world), dtype=bool)
        for _, at in self._spans_at(xy_world):
            found[at] = True
        return found

    @cached_property
    def spans(self) -> list[Span]:
        """The decks and tunnels."""
        return spans(self.network.roads if self._has_heights else (), self.strip)

    @cached_property
    def decks(self) -> list[Span]:
        """The decks of bridges."""
        return [span for span in self.spans if not span.is_tunnel]

    @cached_property
    def tunnels(self) -> list[Span]:
        """The tunnels."""
        return [span for span in self.spans if span.is_tunnel]

    @cached_property
    def _spans_of(self) -> dict[str, list[Span]]:
        found: dict[str, list[Span]] = {}
        for span in self.spans:
            found.setdefault(span.road.id, []).append(span)
        return found

    @cached_property
    def graded_pavement(self) -> BaseGeometry:
        """The pavement that lies on the ground from above, walkways included: all but that of decks and tunnels."""
        if not self.spans:
            return self.pavement
        parts = [part for road in self.outside for part in self._ground_strips(road)]
        for area in self.areas:
            off = [
                span.area for span in self.spans if area.junction is not None and span.road.junction == area.junction
            ]
            parts.append(difference(area.polygon, outset(union(off), OFF_M)) if off else area.polygon)
        whole = union(parts)
        shapely.prepare(whole)
        return whole

    def _ground_strips(self, road: SectionRoad) -> Iterator[BaseGeometry]:
        """The pavement of a road where it lies on the ground."""
        if road.id not in self._spans_of:
            yield self.strip(road)
            return
        from_m = road.start_m
        for to_m, next_m in [*sorted((at.from_m, at.to_m) for at in self._spans_of[road.id]), (road.end_m, road.end_m)]:
            for stretch in road.stretches:
                low, high = max(stretch.start_m, from_m), min(stretch.end_m, to_m)
                rows = self.stretch_rows(stretch)
                s = np.union1d(rows[(rows > low) & (rows < high)], [low, high])
                if high > low:
                    yield polygon_between(stretch.xy(s, stretch.left(s)), stretch.xy(s, stretch.right(s)))
            from_m = max(next_m, from_m)

    @cached_property
    def _has_heights(self) -> bool:
        return any(road.has_heights for road in self.network.roads)

    def area_height(self, area: GroundArea, xy_world: Points2) -> Scalars:
        """Height of an area's surface: on the terrain, or between the heights of its roads there."""
        z = height_at(self.network.terrain, xy_world)
        if self._has_heights:
            z = z + self._own_raised(xy_world, junction=area.junction if self.spans else None)
        return np.asarray(z + area.raised_m)

    def under(self, xy_world: Points2) -> Scalars:
        """Height of the lower side of the pavement."""
        z = height_at(self.network.terrain, xy_world)
        return np.asarray(z + self._own_raised(xy_world) if self._has_heights else z)

    def _own_raised(self, xy_world: Points2, junction: str | None = None, on_ground: bool = False) -> Scalars:
        """Height over the terrain of roads with heights of their own, without kerbs: the mean of those around points,
        the nearer the heavier; of those of a junction alone, or of roads where they lie on the ground."""
        near, roads = self.network.nearby(xy_world, np.full(len(xy_world), NEAR_M))
        total, weights = np.zeros((2, len(xy_world)))
        rows = np.flatnonzero(near)
        for road, which, s, t in roads:
            own = self.network.road(road.id)
            if junction is not None and own.junction != junction:
                continue
            on = self._on_ground(own, s) if on_ground else np.clip(s, own.start_m, own.end_m)
            known = np.isfinite(on)
            off, raised = self._beside(own, s[known], t[known], on[known])
            weight = 1 / (0.05 + off) ** 2
            at = rows[which][known]
            total[at] += weight * raised
            weights[at] += weight
        return total / np.maximum(weights, 1e-12)

    def way_box(self, reach_m: float) -> tuple[float, float, float, float]:
        """(x0, y0, x1, y1) around all that is this near to the host's way."""
        (x0, y0), (x1, y1) = self._way.min(axis=0) - reach_m, self._way.max(axis=0) + reach_m
        return float(x0), float(y0), float(x1), float(y1)

    def terrain_mesh_height(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the terrain mesh, which goes on below decks, and a little under the edges of other pavement."""
        flat = xy_world.reshape(-1, 2)
        return self._in_bed(flat, self.graded(flat)).reshape(xy_world.shape[:-1])

    def beside_tunnels(self, xy_world: Points2, is_over: bool) -> Scalars:
        """Height of the terrain mesh at places that are not inside tunnels, or over these, edges included."""
        if not self.tunnels:
            return self.terrain_mesh_height(xy_world)
        z = height_at(self.network.terrain, xy_world) + self._built(xy_world, np.full(len(xy_world), is_over))
        return np.asarray(z - UNDER_FALL_M) if is_over else self._in_bed(xy_world, z)

    def _in_bed(self, flat: Points2, z: Scalars) -> Scalars:
        inside = contains(self.graded_pavement, flat)
        z[inside] = height_at(self.network.terrain, flat[inside]) - UNDER_FALL_M * self.cell_scale(flat[inside])
        if self._has_heights:
            z[inside] += self._own_raised(flat[inside], on_ground=True)
        return z

    @cached_property
    def _outlined(self) -> Outlined:
        return outlined(self.pavement)

    @cached_property
    def _carriageways_outlined(self) -> Outlined:
        return outlined(self.carriageways)

    def clearance(self, xy_world: AnyPoints2) -> AnyScalars:
        """Distance from the nearest pavement, negative on it."""
        return signed_distance(self._outlined, xy_world)

    def is_clear(self, xy_world: Points2, room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are farther than so much from any pavement."""
        return ~np.asarray(shapely.dwithin(self.pavement, shapely.points(xy_world), room_m))

    def is_off_ground_pavement(self, xy_world: Points2, room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are farther than so much from pavement that lies on the ground, below decks too."""
        return ~np.asarray(shapely.dwithin(self.graded_pavement, shapely.points(xy_world), room_m))

    def is_within(self, xy_world: Points2, reach_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are at most so far from a pavement, to half a per cent of that."""
        area = shapely.buffer(self.pavement, reach_m)
        shapely.prepare(area)
        return contains(area, xy_world)

    def off_carriageways(self, xy_world: AnyPoints2) -> AnyScalars:
        """Distance from the nearest pavement of traffic, negative on it."""
        return signed_distance(self._carriageways_outlined, xy_world)

    def shows(self, curve: LaneCurve) -> bool:
        """Whether a line's paint is near enough to be drawn."""
        s = np.linspace(0.0, curve.end_m, 2 + int(curve.end_m / PAINT_STEP_M))
        return bool((self.away_on(curve, s) < PAINT_M).any())

    def crests(self) -> list[Float[np.ndarray, "m 3"]]:
        """The upper edges of kerbs and islands within reach of the labels: they hide what lies close behind them."""
        near = shapely.box(*self.way_box(CREST_REACH_M))
        found = []
        for area, raised_m in self._raised:
            lines = shapely.intersection(shapely.boundary(area), near)
            for line in shapely.get_parts(shapely.line_merge(shapely.simplify(lines, CREST_SLACK_M))):
                xy = shapely.get_coordinates(shapely.segmentize(line, CREST_STEP_M))
                if len(xy) > 1:
                    found.append(np.column_stack([xy, self.under(xy) + raised_m]))
        return found


def _around(xy_world: Float[np.ndarray, "2"], reach_m: float) -> tuple[float, float, float, float]:
    """The box about a place in which roads are near it."""
    (x0, y0), (x1, y1) = xy_world - AS_FAR * reach_m, xy_world + AS_FAR * reach_m
    return float(x0), float(y0), float(x1), float(y1)
