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

from synth3dlanes.arrays import AnyPoints2, AnyScalars, Points2, Points3, Scalars
from synth3dlanes.geometry.areas import (
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
from synth3dlanes.geometry.ground import EMBANKMENT_SLOPE, FINE_M, Ground
from synth3dlanes.geometry.lane_curves import LaneCurve
from synth3dlanes.geometry.map_network import AS_FAR, Junction, MapNetwork
from synth3dlanes.geometry.passages import DECK_M, Passage, passages
from synth3dlanes.geometry.roads import Road
from synth3dlanes.geometry.section_road import KERB_M, RAISED, SectionRoad
from synth3dlanes.geometry.terrain import height_at
from synth3dlanes.road_map import MapIsland

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
# The edges of a road's pavement.
EDGES = attrgetter("left"), attrgetter("right")
# Level ground beside it: wider than a cell of the terrain, so that no cut covers the edge of the pavement.
BERM_M = 1.5


class GroundArea(NamedTuple):
    """A part of the ground from above, raised over its pavement; `kind` is what it shows."""

    polygon: BaseGeometry
    raised_m: float
    kind: str


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
                found.append(GroundArea(paved, 0.0, "road"))
            found += [GroundArea(part, KERB_M, "walkway") for part in polygons_of(raised)]
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
        (x0, y0), (x1, y1) = xy_world - AS_FAR * reach_m, xy_world + AS_FAR * reach_m
        lines = clipped(shapely.boundary(self.carriageways), (x0, y0, x1, y1))
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
        """Height of the built ground over the analytic terrain at any points (0 away from roads)."""
        flat = xy_world.reshape(-1, 2)
        above = self._built(flat) if self._has_heights else np.zeros(len(flat))
        for polygon, raised_m in self._raised:
            above[contains(polygon, flat)] += raised_m
        return above.reshape(xy_world.shape[:-1])

    def _built(self, flat: Points2) -> Scalars:
        """Height over the terrain of roads with heights of their own, without kerbs, and of what they are laid on:
        the ground falls or rises from the edges of their pavement until it meets the terrain."""
        above = np.zeros(len(flat))
        near, roads = self.network.nearby(flat, np.full(len(flat), EMBANKMENT_M))
        n = int(near.sum())
        low, high, paved = np.full(n, -np.inf), np.full(n, np.inf), np.full(n, -np.inf)
        for road, which, s, t in roads:
            own, at = self.network.road(road.id), np.flatnonzero(which)
            if not own.has_heights:
                continue
            on, across = np.clip(s, own.start_m, own.end_m), np.clip(t, own.left(s), own.right(s))
            base = own.base_points(on, across)
            raised = base[:, 2] - height_at(self.network.terrain, base[:, :2])
            away = np.hypot(s - on, t - across)
            inside, slope = away == 0, np.maximum(away - BERM_M, 0.0) / EMBANKMENT_SLOPE
            low[at] = np.maximum(low[at], np.where(inside, -np.inf, raised - slope))
            high[at] = np.minimum(high[at], np.where(inside, np.inf, raised + slope))
            paved[at[inside]] = np.maximum(paved[at[inside]], raised[inside])
        above[near] = np.where(np.isfinite(paved), paved, np.minimum(np.maximum(0.0, low), np.maximum(high, low)))
        return above

    def is_in(self, points_world: Points3) -> Bool[np.ndarray, " n"]:
        """Which points lie in the ground as built; below the deck of a bridge there is none."""
        found = super().is_in(points_world)
        for under_m, at in self._under_decks(points_world[:, :2]):
            z, deck_m = points_world[at, 2], self.height(points_world[at, :2]) - DECK_M
            found[at] &= (z < under_m) | (z > deck_m)
        return found

    def height_near(self, points_world: Points3) -> Scalars:
        """Height of the ground as built at points, on a bridge or below it."""
        found = super().height_near(points_world)
        for under_m, at in self._under_decks(points_world[:, :2]):
            is_below = points_world[at, 2] < (under_m + found[at]) / 2
            found[at] = np.where(is_below, under_m, found[at])
        return found

    def _under_decks(self, xy_world: Points2) -> Iterator[tuple[Scalars, Int[np.ndarray, " m"]]]:
        """Heights of each road that passes below another, and at which of some points."""
        for area, road in self._passages:
            at = np.flatnonzero(contains(area, xy_world))
            if at.size:
                yield road.base_points(*road.line.project(xy_world[at]))[:, 2], at

    def is_stacked(self, xy_world: Points2) -> Bool[np.ndarray, " n"]:
        """At which places one road passes over another."""
        inside = [contains(area, xy_world) for area, _ in self._passages]
        return np.logical_or.reduce([np.zeros(len(xy_world), dtype=bool), *inside])

    @cached_property
    def _passages(self) -> list[Passage]:
        return passages(self.network.roads if self._has_heights else (), self.strip)

    @cached_property
    def _has_heights(self) -> bool:
        return any(road.has_heights for road in self.network.roads)

    def area_height(self, area: GroundArea, xy_world: Points2) -> Scalars:
        """Height of an area's surface: on the terrain, or between the heights of its roads there."""
        z = height_at(self.network.terrain, xy_world)
        if self._has_heights:
            z = z + self._own_raised(xy_world)
        return np.asarray(z + area.raised_m)

    def under(self, xy_world: Points2) -> Scalars:
        """Height of the lower side of the pavement."""
        z = height_at(self.network.terrain, xy_world)
        return np.asarray(z + self._own_raised(xy_world) if self._has_heights else z)

    def _own_raised(self, xy_world: Points2) -> Scalars:
        """Height over the terrain of roads with heights of their own, without kerbs: the mean of those around points,
        the nearer the heavier."""
        near, roads = self.network.nearby(xy_world, np.full(len(xy_world), NEAR_M))
        total, weights = np.zeros((2, len(xy_world)))
        rows = np.flatnonzero(near)
        for road, which, s, t in roads:
            own = self.network.road(road.id)
            on, across = np.clip(s, own.start_m, own.end_m), np.clip(t, own.left(s), own.right(s))
            base = own.base_points(on, across)
            raised = base[:, 2] - height_at(self.network.terrain, base[:, :2])
            off = np.hypot(np.maximum(np.maximum(own.left(s) - t, t - own.right(s)), 0), s - on)
            weight = 1 / (0.05 + off) ** 2
            at = rows[which]
            total[at] += weight * raised
            weights[at] += weight
        return total / np.maximum(weights, 1e-12)

    def way_box(self, reach_m: float) -> tuple[float, float, float, float]:
        """(x0, y0, x1, y1) around all that is this near to the host's way."""
        (x0, y0), (x1, y1) = self._way.min(axis=0) - reach_m, self._way.max(axis=0) + reach_m
        return float(x0), float(y0), float(x1), float(y1)

    def terrain_mesh_height(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the terrain mesh, which goes on a little under the edges of the pavement."""
        flat = xy_world.reshape(-1, 2)
        z, inside = self.height(flat), contains(self.pavement, flat)
        z[inside] = self.under(flat[inside]) - UNDER_FALL_M * self.cell_scale(flat[inside])
        return z.reshape(xy_world.shape[:-1])

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
