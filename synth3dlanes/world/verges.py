"""Roads between two edges as paved areas, and their verges and embankments, as heights over the terrain. World frame.

Pavement ends in shoulders. From a shoulder's edge the ground falls gently (the verge), or down an embankment where the
road is raised, until it meets the terrain.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.roads.cross_section import CrossSection
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.maps.cubics import Profile
from synth3dlanes.roads.road_table import RoadTable
from synth3dlanes.roads.roads import Road
from synth3dlanes.scene.road_map import MapLane, MapLaneKind, Polynomial
from synth3dlanes.system.arrays import AnyPoints2, AnyScalars, Points2, Scalars, Spread
from synth3dlanes.world.camera import Sector
from synth3dlanes.world.horizon import HORIZON_M, MAX_CELL_SCALE, TerrainGrid, scale_outside
from synth3dlanes.world.paved_areas import COARSE_M, FACE_ROWS, PRESS_M, PavedAreas, row_count
from synth3dlanes.world.spans import EMBANKMENT_SLOPE

# Beyond NARROW_M ahead of the host, verges and embankments are wider by the share WIDENING per metre, because the cells
# of the terrain are.
NARROW_M, WIDENING = 165.0, 0.06
PRESSED_TO_M = 2.0
VERGE_M = 4.0
VERGE_FALL = 0.05
# Width of the lanes' pavement beyond the paint of an edge line.
PAINT_ROOM_M = 0.05
# How far beyond the host fine cells reach: where it looks, and where it does not.
FINE_M, FINE_BEHIND_M = 60.0, 10.0
# Least station at which the crests of a ramp end, and their reach from the host.
CREST_TO_M, CREST_FROM_HOST_M = 130.0, 115.0
# A branch counts from BEFORE_M before its beginning on, and up to a lane and OVERLAP_M inside its road.
BEFORE_M, OVERLAP_M = 20.0, 1.0
# Least distance beyond the verges within which roads are searched.
ROAD_SEARCH_M = 3.0
# Behind a host without cameras that look back, paint ends after PAINT_BEHIND_M. Exported maps have the rows of roads
# beyond that: the paper's roads are straight from some 160 m on.
PAINT_BEHIND_M, ROAD_BEHIND_M = 30.0, np.append(np.arange(30.0, 165.0, 5.0), 260.0)
# Ramps whose rows must be closer than this have rows of their own: the road's are not farther apart within the range of
# labels.
STEEP_M = 1.5
# Least width of a median, and of one that is grass between inner shoulders; a narrower one is all shoulder.
LEAST_MEDIAN_M, GRASS_FROM_M, INNER_SHOULDER_M = 0.01, 3.0, 0.5


class Beside(NamedTuple):
    """Points beside a road: their distance from its pavement (negative on it, infinite far away), its height over the
    terrain at the nearest station, and the width that its embankment has on their side, None if it has any."""

    outside: AnyScalars
    raised: AnyScalars
    room: AnyScalars | None


@dataclass(frozen=True, eq=False)
class Verges(PavedAreas):
    """Roads without sections of their own around the way of the host, which share its stations. The pavement extends
    under all `markings`."""

    # To the horizon, on terrain that is bent more than that of maps.
    reach_m, column_m = HORIZON_M, 0.8

    def is_built(self, xy_world: Points2) -> Bool[np.ndarray, " n"]:
        """At which places pavement is built at all: where the terrain is."""
        return np.asarray((np.abs(xy_world) < HORIZON_M).all(axis=-1))

    # -- rows and lines

    @cached_property
    def rows_m(self) -> Scalars:
        """The stations of the rows of paint, to beyond the horizon, and more of them on a ramp that needs these."""
        away_m = np.arange(0.0, 2 * HORIZON_M, COARSE_M)
        count = row_count(away_m, away_m, FACE_ROWS)
        ahead_m = np.interp(np.arange(count[-1]), count, away_m)
        behind_m = ahead_m if self.way.both_ways else ahead_m[ahead_m < PAINT_BEHIND_M]
        driven_m = np.arange(0.0, self.way.driven_m, FACE_ROWS.step_m[0])
        rows_m = self.way.near_m + np.concatenate([-behind_m, driven_m, self.way.driven_m + ahead_m])
        ramps = [road.ramp.stations for road in self.network.roads if road.ramp]
        steep = [ramp for ramp in ramps if np.ptp(ramp) < STEEP_M * len(ramp)]
        return np.unique(np.concatenate([self.network.stations(rows_m), *steep]))

    @cached_property
    def _area_rows(self) -> dict[str, Float[np.ndarray, " _"]]:
        rows_m = self.rows_m
        if not self.way.both_ways:
            rows_m = np.union1d(rows_m, self.network.stations(self.way.near_m - ROAD_BEHIND_M))
        return {road.id: rows_m for road in self.network.roads}

    @property
    def _face_rows(self) -> dict[str, Float[np.ndarray, " _"]]:
        return self._area_rows

    def curve_rows(self, curves: Sequence[LaneCurve]) -> list[Float[np.ndarray, " _"]]:
        """The stations of the rows of the paint of each curve."""
        return [self.rows_m] * len(curves)

    def drawn(self, lines: Sequence[LaneCurve], seen: Sector | None) -> dict[LaneCurve, bool]:
        """All of the lines."""
        return dict.fromkeys(lines, True)

    # -- the pavement from above

    @cached_property
    def roads(self) -> Sequence[Road]:
        """The roads within their rows, each with a section."""
        ends = [(road, *self._area_rows[road.id][[0, -1]].tolist()) for road in self.network.roads]
        spans = [(road, max(road.start_m, first_m), min(road.end_m, last_m)) for road, first_m, last_m in ends]
        return [
            replace(road, start_m=start_m, end_m=end_m, sections=(self._section(road, start_m, end_m),))
            for road, start_m, end_m in spans
        ]

    @cached_property
    def table(self) -> RoadTable:
        """The built roads as arrays."""
        return RoadTable(self.roads, self.network.terrain)

    def _section(self, road: Road, start_m: float, end_m: float) -> CrossSection:
        """What lies across a road from its left edge: a shoulder, pavement under the paint of the outer line, lanes and
        medians, and the same on the right, where lanes that end take their width from the road."""
        under_m, lane_m = self.under_paint_m(road), road.lane_width_m
        outer: list[tuple[MapLaneKind, float]] = [("shoulder", road.shoulder_m - under_m), ("driving", under_m)]
        medians: list[Iterable[tuple[MapLaneKind, float]]] = [()]
        medians += (self._median(under_m, high_m - low_m) for low_m, high_m in road.medians)
        across = [*outer]
        for part, median in zip(road.carriageways, medians, strict=True):
            across += median
            across.extend([("driving", lane_m)] * part.n_lanes)
        across += outer[::-1]
        moves = road.right.moves.pieces if isinstance(road.right.moves, Profile) else ()
        n_ending = round(-moves[-1].a / lane_m) if moves else 0
        ending = range(len(across) - 2 - n_ending, len(across) - 2)
        lanes = []
        for i, (kind, width_m) in enumerate(across):
            widths = [Polynomial(s_m=0.0, a=width_m)]
            if i in ending:
                widths = [
                    Polynomial(s_m=at.s_m - start_m, a=width_m + at.a / n_ending, b=at.b / n_ending) for at in moves
                ]
            lanes.append(MapLane(number=-1 - i, kind=kind, widths=tuple(widths)))
        return CrossSection(start_m, end_m, tuple(lanes), Profile((Polynomial(s_m=start_m, a=-road.left.base_m),)))

    def _median(self, under_m: float, width_m: float) -> Iterator[tuple[MapLaneKind, float]]:
        """What lies across a median between the inner lines."""
        if width_m < LEAST_MEDIAN_M:
            return
        paved_m = min(under_m, width_m / 4)
        inner_m = min(paved_m + INNER_SHOULDER_M, 0.45 * width_m)
        yield "driving", paved_m
        if width_m < GRASS_FROM_M:
            yield "shoulder", width_m - 2 * paved_m
        else:
            yield "shoulder", inner_m - paved_m
            yield "median", width_m - 2 * inner_m
            yield "shoulder", inner_m - paved_m
        yield "driving", paved_m

    def under_paint_m(self, road: Road) -> float:
        """Width of a road's pavement outside its outermost lanes: it covers the paint of their edge lines."""
        outer_m = self.markings.width_m * (1.5 if self.markings.left_double else 0.5)
        return min(outer_m + PAINT_ROOM_M, road.shoulder_m)

    # -- heights and distances

    @cached_property
    def grid(self) -> TerrainGrid:
        """The terrain's grid, fine around the roads near the camera."""
        return TerrainGrid(self._area_of_roads(FINE_M), self.way.both_ways)

    @cached_property
    def _narrow(self) -> tuple[float, float, float, float]:
        return self._area_of_roads(NARROW_M)

    def _scale(self, xy_world: AnyPoints2) -> AnyScalars:
        """How many times wider than near the host what is beside a road is at places."""
        return scale_outside(self._narrow, xy_world, WIDENING)

    def _area_of_roads(self, ahead_m: float) -> tuple[float, float, float, float]:
        """The area (x0, y0, x1, y1) of the roads from a little behind the host to `ahead_m` ahead of it."""
        low_m, high_m = self.way.range_m(ahead_m - 5, FINE_BEHIND_M - 2)
        s = self.network.stations(np.linspace(low_m, high_m, 1 + round((high_m - low_m) / 2)))
        points = np.concatenate(
            [
                road.xy(np.clip(s, road.start_m, road.end_m), edge.base_m)
                for road in self.network.roads
                for edge in (road.left, road.right)
            ]
        )
        y0, y1 = self.way.range_m(ahead_m, FINE_BEHIND_M)
        points = points[(points[:, 1] > y0) & (points[:, 1] < y1)]
        x0, x1 = points[:, 0].min() - 10, points[:, 0].max() + 10
        return float(x0), float(y0), float(x1), float(y1)

    def crests(self) -> list[Float[np.ndarray, "m 3"]]:
        """The edges of raised roads' shoulders as world points a metre apart, less on a steep ramp: they hide what lies
        beyond them."""
        found, reach_m = [], self.network.stations(np.array(self.way.range_m(CREST_FROM_HOST_M, 0.0))).max()
        for road in self.network.roads:
            if road.ramp is not None:
                s = np.union1d(road.ramp.stations, np.arange(road.ramp.start_m, max(CREST_TO_M, reach_m)))
                found += [road.points(s, edge(s)) for edge in (road.left, road.right)]
        return found

    def rise(self, xy_world: Points2, on_ground: bool = False) -> Scalars:
        """Height of the pavement at places on it over the terrain."""
        return self.above(xy_world)

    def beside(
        self, xy_world: Float[np.ndarray, "n 2"], reach_m: AnyScalars
    ) -> tuple[Bool[np.ndarray, " n"], list[Beside]]:
        """Which points may be within `reach_m` of a pavement, and these beside every road that any of them may be near:
        beside a branch those that are near its road."""
        masks = {road.id: road.may_reach(xy_world, reach_m) for road in self.network.roads}
        near = np.logical_or.reduce(list(masks.values()))
        xy, found, places = xy_world[near], dict[str, Beside](), dict[str, tuple[Scalars, Scalars]]()
        for road in self.network.roads:
            which = np.logical_or.reduce([masks[at.id][near] for at in (road, *self.network.branches(road))])
            guess, room = None, None
            if road.parting is not None:
                begun, (s, t) = road.parting.road, places[road.parting.road.id]
                # Before it begins, and farther in than the outermost lane of the road there, nothing is its own.
                which &= (s > road.start_m - BEFORE_M) & (t > begun.right(s) - road.lane_width_m - OVERLAP_M)
                guess = s[which]
            s, t, outside, raised = np.array([[0.0], [0.0], [np.inf], [0.0]]).repeat(len(xy), axis=1)
            s[which], t[which] = road.line.project(xy[which], guess)
            outside[which] = road.outside(s[which], t[which])
            if road.ramp is not None:
                raised[which] = road.raised(s[which])
            if road.parting is not None:
                # On its left the embankment ends at the pavement of the road where it begins.
                inner = which & (t < 0)
                room = np.full(len(xy), np.inf)
                room[inner] = np.clip(found[begun.id].outside[inner] + outside[inner], 0, None)
            found[road.id], places[road.id] = Beside(outside, raised, room), (s, t)
        return near, [*found.values()]

    def above(self, xy_world: Points2, are_paved: bool = True) -> Scalars:
        """Height of pavement, verges and embankments over the terrain (0 away from roads)."""
        above = np.zeros(len(xy_world))
        near, roads = self.beside(xy_world, self._reach_m(xy_world))
        scale = self._scale(xy_world[near])
        paved, verge = np.full((2, len(scale)), -np.inf)
        for outside, raised, room in roads:
            squeeze = 1.0 if room is None else np.clip(room / embankment_width(raised, scale), 1e-6, 1)
            verge = np.where(np.isfinite(outside), np.maximum(verge, profile(outside / squeeze, raised, scale)), verge)
            paved = np.where(outside <= 0, np.maximum(paved, raised), paved)
        distance = _nearest(roads, len(scale))
        above[near] = np.where(distance <= 0, paved, np.maximum(verge, -press(distance, scale)))
        return above

    def limits(self, xy_world: Points2) -> tuple[Scalars, Scalars]:
        """Heights that `above` is nowhere lower and nowhere higher than."""
        deepest_m = MAX_CELL_SCALE * max(PRESS_M, 3 * VERGE_M * VERGE_FALL)
        highest_m, reach_m = np.zeros(len(xy_world)), self._reach_m(xy_world)
        for road in self.network.roads:
            if road.ramp is not None:
                near = road.may_reach(xy_world, reach_m)
                highest_m[near] = np.maximum(highest_m[near], road.ramp.height_m)
        return np.full(len(xy_world), -deepest_m), highest_m

    def distance(self, xy_world: Points2) -> Scalars:
        """Distance from the nearest pavement (shoulders included), negative on it, infinite far away."""
        near, roads = self.beside(xy_world, self._reach_m(xy_world))
        clear = np.full(len(xy_world), np.inf)
        clear[near] = _nearest(roads, int(near.sum()))
        return clear

    def _reach_m(self, xy_world: AnyPoints2) -> AnyScalars:
        """Distance from a pavement within which the ground may differ from the terrain."""
        highest_m = max([road.parting.rise_m for road in self.network.roads if road.parting], default=0.0)
        return max(EMBANKMENT_SLOPE * highest_m, ROAD_SEARCH_M) + VERGE_M * self._scale(xy_world)


def _nearest(roads: list[Beside], n: int) -> AnyScalars:
    return np.minimum.reduce([np.full(n, np.inf), *(road.outside for road in roads)])


def press(distance_m: AnyScalars, scale: AnyScalars) -> AnyScalars:
    """How far the terrain mesh is lowered at a distance from the pavement."""
    fade = (VERGE_M * scale - distance_m) / ((VERGE_M - PRESSED_TO_M) * scale)
    return PRESS_M * scale * np.clip(fade, 0, 1)


def embankment_width(raised_m: AnyScalars, scale: AnyScalars) -> AnyScalars:
    """Full width of the strip from a shoulder's edge down to below the terrain; with less room it is compressed."""
    return np.asarray(EMBANKMENT_SLOPE * raised_m + VERGE_M * scale)


def profile(distance_m: Spread, raised_m: Spread | float, scale: Spread) -> Spread:
    """Height of verge and embankment over the terrain at a distance from the shoulder's edge. It is below the lowered
    terrain mesh from about 3 m (times the cell scale) beyond the embankment's foot."""
    d = np.clip(distance_m, 0, None)
    slope = np.where(np.asarray(raised_m) > 0, np.asarray(raised_m) - d / EMBANKMENT_SLOPE, 0.0)
    return np.clip(slope, 0, None) - VERGE_FALL * np.minimum(d, 3 * VERGE_M * np.asarray(scale))
