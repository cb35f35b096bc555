"""Roads between two edges: their pavement, verges and embankments, as heights over the terrain. World frame.

A paved area ends in shoulders. From a shoulder's edge the ground falls gently (the verge), or down an embankment
where the road is raised, until it passes below the terrain mesh, which is lowered under pavement and verge.
`meshes.py` builds exactly this surface.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from shapely.geometry.base import BaseGeometry

from synth3dlanes.geometry.polylines import stretches
from synth3dlanes.roads import terrain
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import Road
from synth3dlanes.scene.scene import Markings
from synth3dlanes.system.arrays import AnyPoints2, AnyPoints3, AnyScalars, Points2, Points3, Scalars, Spread
from synth3dlanes.world.areas import NOTHING, polygon_between, union
from synth3dlanes.world.camera import Sector
from synth3dlanes.world.horizon import HORIZON_M, MAX_CELL_SCALE, FarHills, TerrainGrid, far_dam, on_faces
from synth3dlanes.world.host_way import HostWay
from synth3dlanes.world.spans import EMBANKMENT_SLOPE, Span

# Depths and widths for fine cells of the terrain; farther away they grow in proportion to the cell.
PRESS_M = 0.3
PRESSED_TO_M = 2.0
VERGE_M = 4.0
VERGE_FALL = 0.05
# Width of the lanes' pavement beyond the paint of an edge line.
PAINT_ROOM_M = 0.05
# How far beyond the host fine cells reach: where it looks, and where it does not.
FINE_M, FINE_BEHIND_M = 165.0, 10.0
# Least station at which the crests of a ramp end, and their reach from the host.
CREST_TO_M, CREST_FROM_HOST_M = 130.0, 115.0
# A road that begins beside another is asked from BEFORE_M before that on, and a lane and OVERLAP_M deep in the other.
BEFORE_M, OVERLAP_M = 20.0, 1.0
# Least distance beyond the verges within which roads are searched.
ROAD_SEARCH_M = 3.0
# How far a road goes on behind a host that does not look there.
ROAD_BEHIND_M = 30.0
# From here to the horizon each row of the road is longer than the previous one by this fraction.
FAR_ROWS_M, FAR_ROWS_GROWTH = 420.0, 0.03
# A ramp whose own rows would be closer than this gets them: within the range of labels the road's are no farther apart.
STEEP_M = 1.0
# Least width of a median that is grass between inner shoulders; a narrower one is all shoulder.
GRASS_FROM_M, INNER_SHOULDER_M = 3.0, 0.5


class Beside(NamedTuple):
    """Points beside a road: their distance from its pavement (negative on it, infinite far away), its height over the
    terrain at the nearest station, and the width that its embankment has on their side, None if it has any."""

    outside: AnyScalars
    raised: AnyScalars
    room: AnyScalars | None


@dataclass(frozen=True, eq=False)
class Verges:
    """Roads without sections around the way of the host. The pavement extends under all `markings`."""

    way: HostWay
    markings: Markings
    hills: FarHills
    # No road passes over another, and nothing is raised over the pavement.
    spans: tuple[Span, ...] = ()
    raised: tuple[tuple[BaseGeometry, float], ...] = ()

    @property
    def network(self) -> Network:
        """The roads."""
        return self.way.network

    # -- rows and lines

    @cached_property
    def rows_driven_m(self) -> Scalars:
        """Stations of the rows of road and paint as the host drives, to beyond the horizon: half a metre apart near the
        host, more far away, less on a ramp that needs it. 0, where roads may begin, is always among them."""
        n_far = int(np.log(2 * HORIZON_M / FAR_ROWS_M) / np.log1p(FAR_ROWS_GROWTH))
        ahead = [
            np.arange(0, 80, 0.5),
            np.arange(80, 160, 1.0),
            np.arange(160, FAR_ROWS_M, 2.0),
            FAR_ROWS_M * (1 + FAR_ROWS_GROWTH) ** np.arange(n_far),
        ]
        rows = [
            *((-part for part in ahead) if self.way.both_ways else [np.arange(-ROAD_BEHIND_M, 0, 1.0)]),
            np.arange(0, self.way.driven_m, 0.5),
            *(self.way.driven_m + part for part in ahead),
        ]
        ramps = [road.ramp.stations for road in self.network.roads if road.ramp]
        steep = [self.network.stations(ramp) for ramp in ramps if np.ptp(ramp) < STEEP_M * len(ramp)]
        return np.unique(np.concatenate([self.way.near_m + np.concatenate(rows), *steep, [0.0]]))

    def curve_rows(self, curves: Sequence[LaneCurve]) -> list[Float[np.ndarray, " _"]]:
        """Stations of the rows of the paint of each curve, as s grows."""
        return [np.sort(self.network.stations(self.rows_driven_m))] * len(curves)

    def drawn(self, lines: Sequence[LaneCurve], seen: Sector | None) -> dict[LaneCurve, bool]:
        """The lines whose paint is drawn at all, and whether what a camera sees may hold any of it."""
        return dict.fromkeys(lines, True)

    def points_beside(
        self,
        curves: Sequence[LaneCurve],
        stations: Sequence[Float[np.ndarray, " _"]],
        offsets: Sequence[Float[np.ndarray, " _"]],
    ) -> list[Float[np.ndarray, "_ _ 3"]]:
        """Points on the pavement as it is built, of each of some curves: at each of its stations those at all of its
        offsets from it."""
        found = []
        for curve, s, t in zip(curves, stations, offsets, strict=True):
            points = curve.points_beside(np.repeat(s, len(t)), np.tile(t, len(s))).reshape(len(s), len(t), 3)
            found.append(self.with_far_hills(points + far_dam(s)[:, None, None] * [0, 0, 1], s[:, None]))
        return found

    def with_far_hills(self, points_world: AnyPoints3, s: Spread) -> AnyPoints3:
        """Points over the terrain at stations, raised by its far hills; far away by how its faces lie over it."""
        xy_world, by_m = points_world[..., :2], self.hills.height(points_world[..., :2])
        share = np.broadcast_to(on_faces(s), by_m.shape)
        far = share > 0
        terrain_m = terrain.height_at(self.network.terrain, xy_world[far])
        by_m[far] += share[far] * (self._face_height(xy_world[far]) - terrain_m - by_m[far])
        return points_world + by_m[..., None] * [0, 0, 1]

    def _face_height(self, xy_world: Points2) -> Scalars:
        """Height of the terrain mesh's faces, not pressed under pavements: of either way to split a quad into triangles
        the higher one."""
        axes = self.grid.axes
        cells = [
            np.clip(np.searchsorted(axis, at) - 1, 0, len(axis) - 2) for axis, at in zip(axes, xy_world.T, strict=True)
        ]
        corners = np.array([[axis[cell], axis[cell + 1]] for axis, cell in zip(axes, cells, strict=True)])
        u, v = (xy_world.T - corners[:, 0]) / (corners[:, 1] - corners[:, 0])

        def height(i: int, j: int) -> Scalars:
            xy = np.stack([corners[0, i], corners[1, j]], -1)
            return np.asarray(self.network.lift(xy, self.hills.height(xy))[:, 2])

        a, b, c, d = height(0, 0), height(1, 0), height(0, 1), height(1, 1)
        one = a + np.where(u > v, (b - a) * u + (d - b) * v, (c - a) * v + (d - c) * u)
        other = np.where(u + v < 1, a + (b - a) * u + (c - a) * v, d + (c - d) * (1 - u) + (b - d) * (1 - v))
        return np.maximum(one, other)

    # -- the pavement from above

    def under_paint_m(self, road: Road) -> float:
        """Width of a road's pavement outside its outermost lanes: it covers the paint of their edge lines."""
        outer_m = self.markings.width_m * (1.5 if self.markings.left_double else 0.5)
        return min(outer_m + PAINT_ROOM_M, road.shoulder_m)

    def beside_median_m(self, road: Road, width_m: float) -> tuple[float, float]:
        """How far into a median of a road its pavement goes on beside the inner lines, and how far its shoulders do."""
        paved_m = min(self.under_paint_m(road), width_m / 4)
        return paved_m, min(paved_m + INNER_SHOULDER_M, 0.45 * width_m)

    def grass_in_medians(self, road: Road) -> list[tuple[float, float]]:
        """Offsets between which a road's medians are grass."""
        found = []
        for left_m, right_m in road.medians:
            width_m = right_m - left_m
            if width_m >= GRASS_FROM_M:
                _, inner_m = self.beside_median_m(road, width_m)
                found.append((left_m + inner_m, left_m + (width_m - inner_m)))
        return found

    def is_grass(self, xy_world: Points2, room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are on grass that the pavement surrounds, or at most `room_m` beside it."""
        _, t = self.network.main.line.project(xy_world)
        found = np.zeros(len(xy_world), dtype=bool)
        for low_m, high_m in self.grass_in_medians(self.network.main):
            found |= (t >= low_m - room_m) & (t <= high_m + room_m)
        return found

    def edges(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> Iterator[Points3]:
        """The edges of the pavement, shoulders included, and of a median's grass, within about `reach_m` of a place of
        the host."""
        for road, s, (left, *grass, right) in self._pavement_lines(xy_world, reach_m):
            for t in (left, right, *grass):
                points = road.points(s, t)
                alone = stretches(~self.network.is_on_other(road, points[:, :2], s))
                yield from (points[first:end] for first, end in alone if end - first > 1)

    def strips(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> Iterator[tuple[Points3, Points3]]:
        """Both edges of each strip of pavement within about `reach_m` of a place of the host: of every road, and on
        both sides of a median's grass."""
        for road, s, offsets in self._pavement_lines(xy_world, reach_m):
            for low, high in zip(offsets[::2], offsets[1::2], strict=True):
                if len(s) > 1:
                    yield road.points(s, low), road.points(s, high)

    def carriageway(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> BaseGeometry:
        """The pavement of traffic from above, shoulders included, within about `reach_m` of a place of the host."""
        strips = self.strips(xy_world, reach_m)
        return union(polygon_between(low[:, :2], high[:, :2]) for low, high in strips)

    def walkways(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> BaseGeometry:
        """The walkways that are part of the roads, from above, within about `reach_m` of a place of the host."""
        return NOTHING

    def _pavement_lines(
        self, xy_world: Float[np.ndarray, "2"], reach_m: float
    ) -> Iterator[tuple[Road, Scalars, list[Scalars]]]:
        """Of every road the stations, and the offsets where pavement begins and ends in turn, as t grows."""
        stations = self.network.stations_near(xy_world, reach_m)
        for road in self.network.roads:
            s = stations[(stations >= road.start_m) & (stations <= road.end_m)]
            grass = [np.full(len(s), t) for median in self.grass_in_medians(road) for t in median]
            yield road, s, [road.left(s), *grass, road.right(s)]

    # -- heights and distances

    @cached_property
    def grid(self) -> TerrainGrid:
        """The terrain's grid, fine around the roads near the camera."""
        low_m, high_m = self.way.range_m(FINE_M - 5, FINE_BEHIND_M - 2)
        s = self.network.stations(np.linspace(low_m, high_m, 1 + round((high_m - low_m) / 2)))
        points = np.concatenate(
            [
                road.xy(np.clip(s, road.start_m, road.end_m), edge.base_m)
                for road in self.network.roads
                for edge in (road.left, road.right)
            ]
        )
        y0, y1 = self.way.range_m(FINE_M, FINE_BEHIND_M)
        points = points[(points[:, 1] > y0) & (points[:, 1] < y1)]
        x0, x1 = points[:, 0].min() - 10, points[:, 0].max() + 10
        return TerrainGrid((float(x0), float(y0), float(x1), float(y1)), self.way.both_ways)

    def crests(self) -> list[Float[np.ndarray, "m 3"]]:
        """The edges of raised roads' shoulders as world points a metre apart, less on a steep ramp: they hide what lies
        beyond them."""
        found, reach_m = [], self.network.stations(np.array(self.way.range_m(CREST_FROM_HOST_M, 0.0))).max()
        for road in self.network.roads:
            if road.ramp is not None:
                s = np.union1d(road.ramp.stations, np.arange(road.ramp.start_m, max(CREST_TO_M, reach_m)))
                found += [road.points(s, edge(s)) for edge in (road.left, road.right)]
        return found

    def beside(
        self, xy_world: Float[np.ndarray, "n 2"], reach_m: AnyScalars
    ) -> tuple[Bool[np.ndarray, " n"], list[Beside]]:
        """Which points may be within `reach_m` of a pavement, and these beside every road that any may be near: beside
        one that begins beside another, those that are near that one."""
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

    def above(self, xy_world: Points2) -> Scalars:
        """Height of pavement, verges and embankments over the terrain (0 away from roads)."""
        above = np.zeros(len(xy_world))
        near, roads = self.beside(xy_world, self._reach_m(xy_world))
        scale = self.grid.cell_scale(xy_world[near])
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

    def bed_height(self, xy_world: Points2) -> Scalars:
        """Height of the terrain mesh: the terrain, lowered under pavement and verges."""
        pressed = np.zeros(len(xy_world))
        near, roads = self.beside(xy_world, self._reach_m(xy_world))
        scale = self.grid.cell_scale(xy_world[near])
        pressed[near] = press(_nearest(roads, len(scale)), scale)
        return np.asarray(terrain.height_at(self.network.terrain, xy_world) - pressed)

    def distance(self, xy_world: Points2) -> Scalars:
        """Distance from the nearest pavement (shoulders included), negative on it, infinite far away."""
        near, roads = self.beside(xy_world, self._reach_m(xy_world))
        clear = np.full(len(xy_world), np.inf)
        clear[near] = _nearest(roads, int(near.sum()))
        return clear

    def is_clear(self, xy_world: Points2, room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are farther than `room_m` from any pavement."""
        return np.asarray(self.distance(xy_world) > room_m)

    def off_carriageways(self, xy_world: Points2) -> Scalars:
        """The same: there are no walkways."""
        return self.distance(xy_world)

    def _reach_m(self, xy_world: AnyPoints2) -> AnyScalars:
        """Distance from a pavement within which the ground may differ from the terrain."""
        highest_m = max([road.parting.rise_m for road in self.network.roads if road.parting], default=0.0)
        return max(EMBANKMENT_SLOPE * highest_m, ROAD_SEARCH_M) + VERGE_M * self.grid.cell_scale(xy_world)


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
