"""What is paved: roads with sections, junctions and islands from above, on the terrain or at their own heights, with
embankments and cuts beside these. World frame.

Roads are strips of lanes; the pavement of those that connect others in a junction is one area. Terrain meets the
pavement at its edges.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import ClassVar, NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float
from shapely.geometry.base import BaseGeometry

from synth3dlanes.geometry.polylines import parted, spaced
from synth3dlanes.roads.cross_section import KERB_M, CrossSection
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.line_table import Stations
from synth3dlanes.roads.network import SEARCH_RATIO, Junction, Network
from synth3dlanes.roads.road_table import RoadTable
from synth3dlanes.roads.roads import Road
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.scene import Markings
from synth3dlanes.system.arrays import AnyScalars, Points2, Points3, Scalars
from synth3dlanes.world.areas import (
    NOTHING,
    Outlined,
    clipped,
    contains,
    difference,
    filled,
    outlined,
    outset,
    polygon_between,
    polygons_between,
    polygons_of,
    ring_area,
    signed_distance,
    solid,
    union,
)
from synth3dlanes.world.camera import Sector
from synth3dlanes.world.graded import GradedGround
from synth3dlanes.world.horizon import FarHills, TerrainGrid
from synth3dlanes.world.host_way import HostWay
from synth3dlanes.world.spans import Span, spans


class RowSteps(NamedTuple):
    """The steps between rows along roads, at distances from the host's way."""

    away_m: tuple[float, ...]
    step_m: tuple[float, ...]


# Rows of the corners of areas, which decide what has room beside a road and what kerbs hide, and rows of faces, which
# may be longer where nobody sees it.
AREA_ROWS = RowSteps((0.0, 60.0, 120.0, 200.0, 450.0, 4000.0), (0.5, 0.5, 1.0, 2.0, 6.0, 80.0))
FACE_ROWS = RowSteps((0.0, 35.0, 60.0, 110.0, 200.0, 450.0, 4000.0), (0.5, 0.5, 1.0, 1.5, 4.0, 6.0, 80.0))
# The distance of rows from the host is computed at places this far apart.
COARSE_M = 4.0
# Distance ahead of the host to which the terrain has its finest cells: elsewhere it meets the edges of pavement, too.
FINE_M = 40.0
# Depth of the terrain below the edges of the pavement, and how much deeper it is inside, times the size of its cells.
UNDER_FALL_M, PRESS_M = 0.03, 0.3
# Beyond FAR_FROM_M from the host the terrain is lower by FAR_FALL for each metre, less than a pixel: its cells are
# large there, and faces of the pavement dip between their rows.
FAR_FROM_M, FAR_FALL = 400.0, 0.0006
# Distance from the host's way within which kerbs hide what is labelled; the tolerance of their simplified lines, and
# the distance of points along these.
CREST_REACH_M, CREST_SLACK_M, CREST_STEP_M = 110.0, 0.005, 4.0
# Paint farther than this from the host's way is not drawn; the distance is computed at places PAINT_STEP_M apart.
PAINT_M, PAINT_STEP_M = 250.0, 20.0
# The runs of lanes of a section that are raised, level, or medians.
LaneRuns = Callable[[CrossSection], list[tuple[int, int]]]
RAISED_RUNS, LEVEL_RUNS, MEDIAN_RUNS = attrgetter("raised"), attrgetter("level"), attrgetter("medians")
# Distance beside a junction's decks at which the ground ends.
OFF_M = 0.3


class GroundArea(NamedTuple):
    """A part of the ground from above, raised over its pavement; `kind` is what it shows. That of a junction names
    it."""

    polygon: BaseGeometry
    raised_m: float
    kind: str
    junction: str | None = None


@dataclass(frozen=True, eq=False)
class PavedAreas:
    """The pavement of roads with sections around the way of the host, of their junctions and of islands."""

    way: HostWay
    markings: Markings
    hills: FarHills
    # How far from the host's way pavement is built, and the greatest width of faces of lanes.
    reach_m: ClassVar[float] = 480.0
    column_m: ClassVar[float] = 0.9

    @property
    def network(self) -> Network:
        """The roads."""
        return self.way.network

    def is_built(self, xy_world: Points2) -> Bool[np.ndarray, " n"]:
        """At which places pavement is built at all."""
        return np.asarray(self.way.away_at(xy_world) < self.reach_m)

    @property
    def roads(self) -> Sequence[Road]:
        """The roads, with the sections that say what lies across their pavement."""
        return self.network.roads

    @property
    def table(self) -> RoadTable:
        """The stretches of these roads as arrays."""
        return self.network.line_table.table

    # -- rows and lines

    def curve_rows(self, curves: Sequence[LaneCurve]) -> list[Float[np.ndarray, " _"]]:
        """The stations of the rows of the paint of each curve."""
        coarse = _even([curve.end_m for curve in curves], COARSE_M)
        return [_rows(*at, FACE_ROWS) for at in zip(coarse, self.way.away_on(curves, coarse), strict=True)]

    @cached_property
    def _stations(self) -> tuple[list[Scalars], list[Scalars]]:
        """Even stations of each road, and their distances from the host's way."""
        roads = self.network.roads
        coarse = _even([road.end_m for road in roads], COARSE_M)
        counts = [len(s) for s in coarse]
        s = np.concatenate(coarse)
        xy = self.network.index.table.xy(np.repeat(np.arange(len(roads)), counts), s, np.zeros(len(s)))
        return coarse, parted(self.way.away_at(xy), counts)

    def _rows_by_road(self, steps: RowSteps) -> dict[str, Float[np.ndarray, " _"]]:
        found = zip(self.network.roads, *self._stations, strict=True)
        return {road.id: _rows(s, away_m, steps) for road, s, away_m in found}

    @cached_property
    def _area_rows(self) -> dict[str, Float[np.ndarray, " _"]]:
        return self._rows_by_road(AREA_ROWS)

    @cached_property
    def _face_rows(self) -> dict[str, Float[np.ndarray, " _"]]:
        return self._rows_by_road(FACE_ROWS)

    def area_rows(self, stretch: Road) -> Scalars:
        """The stations of the corners of the areas of a stretch of a road."""
        return _within(self._area_rows[stretch.id], stretch)

    def face_rows(self, stretch: Road) -> Scalars:
        """The stations of the rows of faces of a stretch of a road."""
        return _within(self._face_rows[stretch.id], stretch)

    @cached_property
    def grid(self) -> TerrainGrid:
        """The terrain's grid, fine around the host's way, and FINE_M ahead of it."""
        way = self.way
        ahead = self.network.way.xy_world(np.array([way.near_m, way.near_m + 1.0]))
        angle = np.arctan2(*(ahead[1] - ahead[0])[::-1]) + np.linspace(-0.9, 0.9, 9)
        reach = FINE_M * np.stack([np.cos(angle), np.sin(angle)], -1)
        is_still = way.driven_m == 0 and not way.both_ways
        far = [way.places[0] + reach] if is_still else [way.places - FINE_M, way.places + FINE_M]
        points = np.concatenate([way.places - 15.0, way.places + 15.0, *far])
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        return TerrainGrid((float(x0), float(y0), float(x1), float(y1)), way.both_ways)

    def points_beside(
        self, curves: Sequence[LaneCurve], stations: Stations, offsets: Stations
    ) -> list[Float[np.ndarray, "_ _ 3"]]:
        """Points on the pavement, of each of some curves: at each of its stations those at all of its offsets."""
        found = self.network.lines.points_beside(curves, stations, offsets)
        for points in found:
            points[..., 2] += self.hills.height(points[..., :2])
        return found

    # -- areas

    @cached_property
    def _edge_lines(self) -> dict[tuple[int, int], Float[np.ndarray, "_ 2"]]:
        """Lines that bound areas: edges of lanes by the identity of their stretch, which the network keeps, and their
        numbers there."""
        known, wanted = {at.id for at in self.network.junctions}, list[tuple[int, Road, int]]()
        stretches = [stretch for road in self.roads for stretch in road.stretches]
        for i, stretch in enumerate(stretches):
            (section,) = stretch.sections
            bounds = [section.paved, *section.raised, *section.medians]
            bounds += [(k, k + 1) for k in range(len(section.lanes)) if stretch.junction in known]
            wanted += [(i, stretch, edge) for edge in sorted({edge for pair in bounds for edge in pair})]
        rows = [self.area_rows(stretch) for stretch in stretches]
        counts = [len(rows[i]) for i, _, _ in wanted]
        number, edge = (np.repeat([at[k] for at in wanted], counts) for k in (0, 2))
        s, table = np.concatenate([rows[i] for i, _, _ in wanted]), self.table
        xy = table.xy(number, s, table.edge(number, edge, s))
        return {(id(at), k): line for (_, at, k), line in zip(wanted, parted(xy, counts), strict=True)}

    @cached_property
    def strip_of(self) -> dict[str, BaseGeometry]:
        """The pavements of roads from above by their ids."""
        lines, sides = self._edge_lines, list[tuple[Points2, Points2]]()
        for road in self.roads:
            paved = [(at, at.sections[0].paved) for at in road.stretches]
            left, right = (np.concatenate([lines[id(at), edges[side]] for at, edges in paved]) for side in (0, 1))
            sides.append((left, right))
        return dict(zip((road.id for road in self.roads), polygons_between(sides), strict=True))

    @cached_property
    def arms(self) -> BaseGeometry:
        """The pavement of all roads outside junctions."""
        return union(self.strip_of[road.id] for road in self.outside)

    @property
    def outside(self) -> list[Road]:
        """The roads that are in no junction."""
        known = {at.id for at in self.network.junctions}
        return [road for road in self.roads if road.junction not in known]

    @cached_property
    def areas(self) -> list[GroundArea]:
        """The surfaces of junctions and islands."""
        found = []
        for at in self.network.junctions:
            paved, raised = map(solid, self._junction(at))
            if not paved.is_empty:
                found.append(GroundArea(paved, 0.0, "road", at.id))
            found += [GroundArea(part, KERB_M, "walkway", at.id) for part in polygons_of(raised)]
        for island in self.network.islands:
            polygon = solid(ring_area(np.array(island.outline)))
            found += [GroundArea(part, island.height_m, island.surface) for part in polygons_of(polygon)]
        return found

    def _junction(self, at: Junction) -> tuple[BaseGeometry, BaseGeometry]:
        """The pavement of a junction, and its raised walkways."""
        raised = self._runs(at.roads, RAISED_RUNS)
        whole = filled(union([*self._runs(at.roads, LEVEL_RUNS), ring_area(at.outline)]))
        paved, walkways = difference(whole, self._arms_at(whole)), union(raised)
        return paved, difference(walkways, union([paved, self._arms_at(walkways)])) if raised else NOTHING

    def _runs(self, roads: Iterable[Road], runs_of: LaneRuns) -> list[BaseGeometry]:
        """The runs of lanes of some kinds of roads from above."""
        runs = [(id(at), run) for road in roads for at in road.stretches for run in runs_of(at.sections[0])]
        return polygons_between([(self._edge_lines[at, low], self._edge_lines[at, high]) for at, (low, high) in runs])

    def _arms_at(self, area: BaseGeometry) -> BaseGeometry:
        """The parts of `arms` that an area may touch."""
        parts, tree = self._arm_parts
        return shapely.MultiPolygon([parts[i] for i in sorted(tree.query(area).tolist())])

    @cached_property
    def _arm_parts(self) -> tuple[np.ndarray, shapely.STRtree]:
        parts = shapely.get_parts(self.arms)
        return parts, shapely.STRtree(parts)

    @cached_property
    def pavement(self) -> BaseGeometry:
        """All of the pavement from above, walkways included."""
        whole = union([self.arms, *(area.polygon for area in self.areas)])
        shapely.prepare(whole)
        return whole

    def edges(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> Iterator[Points3]:
        """The edges of the pavement of traffic, walkways and grass left out, within about `reach_m` of a place: lines
        with points a metre apart."""
        lines = clipped(shapely.boundary(self._drivable), _around(xy_world, reach_m))
        for line in shapely.get_parts(shapely.line_merge(lines)):
            if not line.is_empty:
                ring = shapely.get_coordinates(shapely.segmentize(line, 1.0))
                yield np.column_stack([ring, self.under(ring)])

    @cached_property
    def _raised_strips(self) -> list[BaseGeometry]:
        """The raised lanes of roads outside junctions."""
        return self._runs(self.outside, RAISED_RUNS)

    def strips(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> Iterator[tuple[Points3, Points3]]:
        """Both edges of each strip of pavement within about `reach_m` of a place: of every section of a road, those in
        junctions included, and on both sides of a median."""
        for stretch in (stretch for road in self.roads for stretch in road.stretches):
            s, (section,) = self.area_rows(stretch), stretch.sections
            near = np.flatnonzero(np.hypot(*(stretch.xy(s, 0.0) - xy_world).T) < SEARCH_RATIO * reach_m)
            if len(near) > 1:
                s, (first, last) = s[near[0] : near[-1] + 1], section.paved
                ends = [first, *(edge for run in section.medians for edge in run), last]
                for low, high in zip(ends[::2], ends[1::2], strict=True):
                    yield stretch.points(s, section.edge(low, s)), stretch.points(s, section.edge(high, s))

    def carriageway(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> BaseGeometry:
        """The pavement of traffic from above, without grass, within about `reach_m` of a place."""
        return clipped(self._drivable, _around(xy_world, reach_m))

    def walkways(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> BaseGeometry:
        """The walkways of roads and junctions from above, within about `reach_m` of a place."""
        of_junctions = (area.polygon for area in self.areas if area.kind == "walkway")
        return clipped(union([*self._raised_strips, *of_junctions]), _around(xy_world, reach_m))

    @cached_property
    def carriageways(self) -> BaseGeometry:
        """The pavement without raised lanes and islands."""
        raised = [area.polygon for area in self.areas if area.raised_m] + self._raised_strips
        # Rows of strips beside each other differ by less than this.
        slack = outset(union(raised), 0.01)
        whole = difference(self.pavement, slack)
        shapely.prepare(whole)
        return whole

    @cached_property
    def _drivable(self) -> BaseGeometry:
        """The pavement of traffic without grass."""
        return difference(self.carriageways, self._grass)

    @cached_property
    def _grass(self) -> BaseGeometry:
        found = [area.polygon for area in self.areas if area.kind == "grass"]
        grass = union(found + self._runs(self.outside, MEDIAN_RUNS))
        shapely.prepare(grass)
        return grass

    def is_grass(self, xy_world: Points2, room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are on the grass of medians and islands, or at most `room_m` beside it."""
        return np.asarray(shapely.dwithin(self._grass, shapely.points(xy_world), room_m))

    # -- heights and distances

    @cached_property
    def raised(self) -> list[tuple[BaseGeometry, float]]:
        """What is raised over the pavement, by how much: walkways, those of junctions, and islands."""
        walkways = [area.polygon for area in self.areas if area.kind == "walkway"]
        found = [(union([*self._raised_strips, *walkways]), KERB_M)]
        found += [(area.polygon, area.raised_m) for area in self.areas if area.raised_m and area.kind != "walkway"]
        for polygon, _ in found:
            shapely.prepare(polygon)
        return found

    def above(self, flat: Points2, are_paved: bool = True) -> Scalars:
        """Height over the terrain of the ground below all decks, without kerbs; `are_paved` as `GradedGround.above` has
        it."""
        covered = np.zeros(len(flat), dtype=bool)
        for span in self.tunnels:
            covered |= contains(span.area, flat)
        return self.graded_ground.above(flat, covered, are_paved)

    def graded(self, xy_world: Points2, are_paved: bool = True) -> Scalars:
        """Height of the ground below all decks, without kerbs; `are_paved` as `GradedGround.above` has it."""
        return np.asarray(height_at(self.network.terrain, xy_world) + self.above(xy_world, are_paved))

    @cached_property
    def spans(self) -> list[Span]:
        """The decks and tunnels."""
        return [] if not self._has_heights else spans(self.network.index.table, self.strip_of)

    @cached_property
    def tunnels(self) -> list[Span]:
        """The tunnels."""
        return [span for span in self.spans if span.is_tunnel]

    @cached_property
    def graded_ground(self) -> GradedGround:
        """The ground below decks, by the heights of its roads."""
        return GradedGround(self.network, self.spans)

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

    def _ground_strips(self, road: Road) -> Iterator[BaseGeometry]:
        """The pavement of a road where it lies on the ground."""
        spans_of = self.graded_ground.spans_of
        if road.id not in spans_of:
            yield self.strip_of[road.id]
            return
        from_m = road.start_m
        for to_m, next_m in [*sorted((at.from_m, at.to_m) for at in spans_of[road.id]), (road.end_m, road.end_m)]:
            for stretch in road.stretches:
                low, high = max(stretch.start_m, from_m), min(stretch.end_m, to_m)
                rows = self.area_rows(stretch)
                s = np.union1d(rows[(rows > low) & (rows < high)], [low, high])
                if high > low:
                    yield polygon_between(stretch.xy(s, stretch.left(s)), stretch.xy(s, stretch.right(s)))
            from_m = max(next_m, from_m)

    @cached_property
    def _has_heights(self) -> bool:
        return any(road.has_heights for road in self.network.roads)

    def area_heights(
        self, places: Sequence[tuple[GroundArea, Float[np.ndarray, "_ 2"]]]
    ) -> list[Float[np.ndarray, " _"]]:
        """Heights of the surfaces of areas at places of each: on the terrain, or between the heights of its roads
        there."""
        if not places:
            return []
        counts = [len(xy) for _, xy in places]
        xy_world = np.concatenate([xy for _, xy in places])
        z = height_at(self.network.terrain, xy_world) + np.repeat([area.raised_m for area, _ in places], counts)
        if self._has_heights:
            # Below a deck, a junction is as high as its own roads.
            inside = [area.junction if self.spans else None for area, _ in places]
            z += self.graded_ground.mean(xy_world, np.repeat(self.graded_ground.junction_numbers(inside), counts))
        return parted(z, counts)

    def under(self, xy_world: Points2) -> Scalars:
        """Height of the lower side of the pavement."""
        return np.asarray(height_at(self.network.terrain, xy_world) + self.rise(xy_world))

    def rise(self, xy_world: Points2, on_ground: bool = False) -> Scalars:
        """Height of the pavement around places over the terrain, or of what of it lies `on_ground`."""
        return self.graded_ground.mean(xy_world, on_ground=on_ground) if self._has_heights else np.zeros(len(xy_world))

    def limits(self, xy_world: Points2) -> tuple[Scalars, Scalars]:
        """Heights that `above` is nowhere lower and nowhere higher than."""
        return self.graded_ground.limits(xy_world)

    def bed_height(self, xy_world: Points2) -> Scalars:
        """Height of the terrain mesh, which goes on below decks, and a little under the edges of other pavement."""
        z, beside = self._bed(xy_world)
        z[beside] = self.graded(xy_world[beside], are_paved=False)
        return z

    def inner_bed_height(self, xy_world: Points2) -> Scalars:
        """Height of the terrain mesh below pavement, inside its edges: nobody sees it there, and it is quickly
        found."""
        pressed_m = (UNDER_FALL_M + PRESS_M) * self.grid.cell_scale(xy_world)
        below_m = self.graded_ground.floor(xy_world) - pressed_m - self._far_fall_m(xy_world)
        return np.asarray(height_at(self.network.terrain, xy_world) + below_m)

    def beside_tunnels(self, xy_world: Points2, is_over: bool) -> Scalars:
        """Height of the terrain mesh at places that are not inside tunnels, or over these, edges included."""
        if not self.tunnels:
            return self.bed_height(xy_world)
        z, beside = (np.zeros(len(xy_world)), np.ones(len(xy_world), dtype=bool)) if is_over else self._bed(xy_world)
        xy, covered = xy_world[beside], np.full(int(beside.sum()), is_over)
        z[beside] = height_at(self.network.terrain, xy) + self.graded_ground.above(xy, covered, are_paved=False)
        return np.asarray(z - UNDER_FALL_M) if is_over else z

    def _bed(self, flat: Points2) -> tuple[Scalars, Bool[np.ndarray, " n"]]:
        """Heights of the terrain mesh under pavement, 0 elsewhere, and which places are not under it."""
        inside, z = contains(self.graded_pavement, flat), np.zeros(len(flat))
        under = flat[inside]
        z[inside] = height_at(self.network.terrain, under) - self.bed_depth(under)
        z[inside] += self.rise(under, on_ground=True) - self._far_fall_m(under)
        return z, ~inside

    def bed_depth(self, xy_world: Points2) -> AnyScalars:
        """How far the terrain mesh is below the edges of the pavement."""
        return UNDER_FALL_M * self.grid.cell_scale(xy_world)

    def _far_fall_m(self, xy_world: Points2) -> Scalars:
        return FAR_FALL * np.maximum(self.way.away_at(xy_world) - FAR_FROM_M, 0.0)

    @cached_property
    def _outlined(self) -> Outlined:
        return outlined(self.pavement)

    @cached_property
    def _carriageways_outlined(self) -> Outlined:
        return outlined(self.carriageways)

    def distance(self, xy_world: Points2) -> Scalars:
        """Distance from the nearest pavement, negative on it."""
        return signed_distance(self._outlined, xy_world)

    def is_clear(self, xy_world: Points2, room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are farther than `room_m` from any pavement; asked so, it takes less time than by distances."""
        return ~np.asarray(shapely.dwithin(self.pavement, shapely.points(xy_world), room_m))

    def is_off_ground_pavement(self, xy_world: Points2, room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are farther than `room_m` from pavement that lies on the ground, below decks too."""
        return ~np.asarray(shapely.dwithin(self.graded_pavement, shapely.points(xy_world), room_m))

    def off_carriageways(self, xy_world: Points2) -> Scalars:
        """Distance from the nearest pavement of traffic, negative on it."""
        return signed_distance(self._carriageways_outlined, xy_world)

    def drawn(self, lines: Sequence[LaneCurve], seen: Sector | None) -> dict[LaneCurve, bool]:
        """The lines whose paint is near enough to be drawn, and whether what a camera sees may hold any of it."""
        if not lines:
            return {}
        numbers = [self.network.line_table.numbers[line.id] for line in lines]
        stations = _even([line.end_m for line in lines], PAINT_STEP_M)
        is_near = np.array([away_m.min() < PAINT_M for away_m in self.way.away_on(lines, stations)])
        in_sight = self.network.line_table.which_come(seen.holds)[numbers] if seen else np.ones(len(lines), dtype=bool)
        return {line: bool(own) for line, near, own in zip(lines, is_near, in_sight, strict=True) if near}

    def crests(self) -> list[Float[np.ndarray, "m 3"]]:
        """The upper edges of kerbs and islands within reach of the labels: they hide what lies close behind them."""
        near, found, tops = shapely.box(*self.way.box(CREST_REACH_M)), list[Points2](), list[float]()
        for area, raised_m in self.raised:
            lines = shapely.intersection(shapely.boundary(area), near)
            for line in shapely.get_parts(shapely.line_merge(shapely.simplify(lines, CREST_SLACK_M))):
                xy = shapely.get_coordinates(shapely.segmentize(line, CREST_STEP_M))
                if len(xy) > 1:
                    found.append(xy)
                    tops.append(raised_m)
        if not found:
            return []
        counts, xy = [len(at) for at in found], np.concatenate(found)
        crests = np.column_stack([xy, self.under(xy) + np.repeat(tops, counts)])
        return parted(crests, counts)


def _around(xy_world: Float[np.ndarray, "2"], reach_m: float) -> tuple[float, float, float, float]:
    """The box about a place in which roads are near it."""
    (x0, y0), (x1, y1) = xy_world - SEARCH_RATIO * reach_m, xy_world + SEARCH_RATIO * reach_m
    return float(x0), float(y0), float(x1), float(y1)


def _even(ends_m: Sequence[float], step_m: float) -> list[Float[np.ndarray, " _"]]:
    """Stations from 0 to each of some ends, at most a step apart."""
    last_m = np.array(ends_m, float)
    counts = 2 + (last_m / step_m).astype(int)
    return parted(spaced(0.0 * last_m, last_m, counts), counts)


def _within(s: Scalars, stretch: Road) -> Float[np.ndarray, " m"]:
    """The ends of a stretch of a road, and the stations between these."""
    start_m, end_m = stretch.start_m, stretch.end_m
    inside = s[np.searchsorted(s, start_m, "right") : np.searchsorted(s, end_m)]
    return np.array([start_m, *inside.tolist(), end_m] if end_m > start_m else [start_m])


def _rows(s: Scalars, away_m: Scalars, steps: RowSteps) -> Float[np.ndarray, " m"]:
    """Stations from the first to the last of `s`, whose distances from the host are `away_m`: closer near the host."""
    count = row_count(s, away_m, steps)
    n = max(int(np.ceil(count[-1])), 1)
    return np.interp(np.linspace(0.0, count[-1], n + 1), count, s)


def row_count(s: Scalars, away_m: Scalars, steps: RowSteps) -> Scalars:
    """The number of rows up to each station, which is `away_m` from the host."""
    step = np.interp(away_m, steps.away_m, steps.step_m)
    return np.concatenate([[0.0], np.cumsum(np.diff(s) * 2 / (step[1:] + step[:-1]))])
