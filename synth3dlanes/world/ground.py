"""The ground as built: terrain, pavement, verges and embankments, as one height over (x, y). World frame.

A paved area ends in shoulders. From a shoulder's edge the ground falls gently (the verge), or down an embankment
where the road is raised, until it passes below the terrain mesh, which is lowered under pavement and verge.
`meshes.py` builds exactly this surface; `visibility.py` tests lines of sight against it.
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
from synth3dlanes.roads.road_table import Nearby
from synth3dlanes.roads.roads import Road
from synth3dlanes.scene.scene import Markings
from synth3dlanes.system.arrays import AnyPoints2, AnyPoints3, AnyScalars, Points2, Points3, Scalars
from synth3dlanes.world.areas import NOTHING, polygon_between, union
from synth3dlanes.world.camera import Sector
from synth3dlanes.world.horizon import FarHills, far_dam, on_faces

Spread = Float[np.ndarray, "*#n"]

# Size of the terrain cells near the road. The depths and widths below are for cells of this size; farther away they
# grow in proportion to the cell.
CELL_M = 1.25
MAX_CELL_SCALE = 8.0
PRESS_M = 0.3
PRESSED_TO_M = 2.0
VERGE_M = 4.0
VERGE_FALL = 0.05
# Horizontal over vertical extent of the embankment beside a raised road.
EMBANKMENT_SLOPE = 1.5
# Growth of the terrain's cells per metre outside the fine area.
GROWTH = 0.06
# Width of the lanes' pavement beyond the paint of an edge line.
PAINT_ROOM_M = 0.05
# How far beyond the host fine cells reach: where it looks, and where it does not.
FINE_M, FINE_BEHIND_M = 165.0, 10.0
# Least station at which the crests of a ramp end, and their reach from the host.
CREST_TO_M, CREST_FROM_HOST_M = 130.0, 115.0
# Least distance beyond the verges within which roads are searched.
ROAD_SEARCH_M = 3.0
# How far the terrain mesh goes: ahead and aside, and behind a host that does not look there.
HORIZON_M, BEHIND_M = 4000.0, 300.0
ROAD_BEHIND_M = 30.0
# From here to the horizon each row of the road is longer than the previous one by this fraction.
FAR_ROWS_M, FAR_ROWS_GROWTH = 420.0, 0.03
# A ramp whose own rows would be closer than this gets them: within the range of labels the road's are no farther apart.
STEEP_M = 1.0
# Least width of a median that is grass between inner shoulders; a narrower one is all shoulder.
GRASS_FROM_M, INNER_SHOULDER_M = 3.0, 0.5


class Beside(NamedTuple):
    """Points and a road: their distance from its pavement (negative on it, infinite far away), its height over the
    terrain at the nearest station, and the width that its embankment has on their side, None if it has any."""

    road: Road
    outside: AnyScalars
    raised: AnyScalars
    room: AnyScalars | None


@dataclass(frozen=True, eq=False)
class Ground:
    """Ground heights around roads. Mesh resolution is highest ahead of the host, which starts at the station `near_m`
    as it drives, and drives on to the station `driven_m` after it; with `both_ways` behind it too. `fine` is (x0, y0,
    x1, y1) of the area with fine terrain cells. The pavement extends under all `markings`."""

    network: Network
    near_m: float
    markings: Markings
    hills: FarHills
    driven_m: float = 0.0
    both_ways: bool = False

    def ahead_m(self, driven_m: Spread) -> Spread:
        """How far stations as the host drives are ahead of its last place, 0 to its first; behind that they are
        negative."""
        last_m = self.near_m + self.driven_m
        return np.where(driven_m > last_m, driven_m - last_m, np.minimum(driven_m - self.near_m, 0))

    def away_m(self, s: Spread) -> Spread:
        """How far stations are from the host's way."""
        return np.abs(self.ahead_m(self.network.stations(s)))

    def away_at(self, xy_world: AnyPoints2) -> AnyScalars:
        """How far points are from the host's way, along the road."""
        return np.abs(self.ahead_m(xy_world[..., 1]))

    def away_along(self, road: Road, s: Spread) -> Spread:
        """How far stations of a road are from the host's way."""
        return self.away_m(s)

    def drawn(self, lines: Sequence[LaneCurve], seen: Sector | None) -> dict[LaneCurve, bool]:
        """The lines whose paint is drawn at all, and whether what a camera sees may hold any of it."""
        return dict.fromkeys(lines, True)

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
            *((-part for part in ahead) if self.both_ways else [np.arange(-ROAD_BEHIND_M, 0, 1.0)]),
            np.arange(0, self.driven_m, 0.5),
            *(self.driven_m + part for part in ahead),
        ]
        ramps = [road.ramp.stations for road in self.network.roads if road.ramp]
        steep = [self.network.stations(ramp) for ramp in ramps if np.ptp(ramp) < STEEP_M * len(ramp)]
        return np.unique(np.concatenate([self.near_m + np.concatenate(rows), *steep, [0.0]]))

    def curve_rows(self, curves: Sequence[LaneCurve]) -> list[Float[np.ndarray, " _"]]:
        """Stations of the rows of the paint of each curve, as s grows."""
        return [np.sort(self.network.stations(self.rows_driven_m))] * len(curves)

    def away_on(
        self, curves: Sequence[LaneCurve], stations: Sequence[Float[np.ndarray, " _"]]
    ) -> list[Float[np.ndarray, " _"]]:
        """How far stations of each of some curves are from the host's way."""
        return [self.away_m(s) for s in stations]

    def range_m(self, ahead_m: float, behind_m: float) -> tuple[float, float]:
        """Stations as the host drives from `behind_m` behind its first place to `ahead_m` ahead of its last; with
        `both_ways` from `ahead_m` behind."""
        return self.near_m - (ahead_m if self.both_ways else behind_m), self.near_m + self.driven_m + ahead_m

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

    def pavement_edges(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> Iterator[Points3]:
        """The edges of the pavement, shoulders included, and of a median's grass, within about `reach_m` of a place of
        the host."""
        for road, s, (left, *grass, right) in self._pavement_lines(xy_world, reach_m):
            for t in (left, right, *grass):
                points = road.points(s, t)
                alone = stretches(~self.is_on_other(road, points[:, :2]))
                yield from (points[first:end] for first, end in alone if end - first > 1)

    def pavement_strips(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> Iterator[tuple[Points3, Points3]]:
        """Both edges of each strip of pavement within about `reach_m` of a place of the host: of every road, and on
        both sides of a median's grass."""
        for road, s, offsets in self._pavement_lines(xy_world, reach_m):
            for low, high in zip(offsets[::2], offsets[1::2], strict=True):
                if len(s) > 1:
                    yield road.points(s, low), road.points(s, high)

    def carriageway(self, xy_world: Float[np.ndarray, "2"], reach_m: float) -> BaseGeometry:
        """The pavement of traffic from above, shoulders included, within about `reach_m` of a place of the host."""
        strips = self.pavement_strips(xy_world, reach_m)
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

    def beside_pavement(self, driven_m: Float[np.ndarray, " k"], aside_m: Float[np.ndarray, " m"]) -> Points2:
        """Places at stations as the host drives, `aside_m` beside the pavement on both sides."""
        road, s = self.network.main, self.network.stations(driven_m)
        aside = np.concatenate([road.left.base_m - aside_m, road.right.base_m + aside_m])
        return road.xy(np.tile(s, len(aside)), np.repeat(aside, len(s)))

    @cached_property
    def fine(self) -> tuple[float, float, float, float]:
        """(x0, y0, x1, y1) of the area near the camera in which the roads get fine terrain cells."""
        low_m, high_m = self.range_m(FINE_M - 5, FINE_BEHIND_M - 2)
        s = self.network.stations(np.linspace(low_m, high_m, 1 + round((high_m - low_m) / 2)))
        points = np.concatenate(
            [
                road.xy(np.clip(s, road.start_m, road.end_m), edge.base_m)
                for road in self.network.roads
                for edge in (road.left, road.right)
            ]
        )
        y0, y1 = self.range_m(FINE_M, FINE_BEHIND_M)
        points = points[(points[:, 1] > y0) & (points[:, 1] < y1)]
        x0, x1 = points[:, 0].min() - 10, points[:, 0].max() + 10
        return float(x0), float(y0), float(x1), float(y1)

    def crests(self) -> list[Float[np.ndarray, "m 3"]]:
        """The edges of raised roads' shoulders as world points a metre apart, less on a steep ramp: they hide what lies
        beyond them."""
        found, reach_m = [], self.network.stations(np.array(self.range_m(CREST_FROM_HOST_M, 0.0))).max()
        for road in self.network.roads:
            if road.ramp is not None:
                s = np.union1d(road.ramp.stations, np.arange(road.ramp.start_m, max(CREST_TO_M, reach_m)))
                found += [road.points(s, edge(s)) for edge in (road.left, road.right)]
        return found

    def cell_scale(self, xy_world: AnyPoints2) -> AnyScalars:
        """Terrain cell size as a multiple of CELL_M, as `mesh_axes` lays it out."""
        x0, y0, x1, y1 = self.fine
        out = np.maximum(
            np.maximum(x0 - xy_world[..., 0], xy_world[..., 0] - x1),
            np.maximum(y0 - xy_world[..., 1], xy_world[..., 1] - y1),
        )
        return np.clip(1 + np.clip(out, 0, None) * GROWTH / CELL_M, 1, MAX_CELL_SCALE)

    def beside(
        self, xy_world: Float[np.ndarray, "n 2"], reach_m: AnyScalars
    ) -> tuple[Bool[np.ndarray, " n"], list[Beside]]:
        """Which points may be within `reach_m` of a road's pavement, and these beside every road."""
        near, found = self._nearby(xy_world, reach_m)
        beside: dict[str, Beside] = {}
        for road, which, s, t in found:
            outside, raised, room = np.full(len(which), np.inf), np.zeros(len(which)), None
            outside[which] = road.outside(s, t)
            if road.ramp is not None:
                raised[which] = road.raised(s)
            if road.parting is not None:
                # On its left the embankment ends at the pavement of the road where it begins.
                inner, room = which.copy(), np.full(len(which), np.inf)
                inner[which] = t < 0
                room[inner] = np.clip(beside[road.parting.road.id].outside[inner] + outside[inner], 0, None)
            beside[road.id] = Beside(road, outside, raised, room)
        return near, list(beside.values())

    def _nearby(
        self, xy_world: Float[np.ndarray, "n 2"], reach_m: AnyScalars
    ) -> tuple[Bool[np.ndarray, " n"], list[Nearby]]:
        """Which points may be within `reach_m` of a pavement, and where these are along every road that any may be
        near: on one that begins beside another, of those that are near that one."""
        network = self.network
        masks = {road.id: road.may_reach(xy_world, reach_m) for road in network.roads}
        near = np.logical_or.reduce(list(masks.values()))
        xy = xy_world[near]
        found: dict[str, Nearby] = {}
        for road in network.roads:
            guess = None
            if road.parting is None:
                which = np.logical_or.reduce([masks[at.id][near] for at in (road, *network.branches(road))])
            elif beside := found.get(road.parting.road.id):
                close = road.parting.may_hold(road, beside.s, beside.t, reach_m[near][beside.which])
                which, guess = beside.which.copy(), beside.s[close]
                which[which] = close
            else:
                continue
            if which.any():
                found[road.id] = Nearby(road, which, *road.line.project(xy[which], guess))
        return near, list(found.values())

    def above_terrain(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the built ground over the analytic terrain at any points (0 away from roads)."""
        flat = xy_world.reshape(-1, 2)
        above = np.zeros(len(flat))
        near, roads = self.beside(flat, self._reach_m(flat))
        scale = self.cell_scale(flat[near])
        paved, verge = np.full((2, len(scale)), -np.inf)
        for _, outside, raised, room in roads:
            squeeze = 1.0 if room is None else np.clip(room / embankment_width(raised, scale), 1e-6, 1)
            verge = np.where(np.isfinite(outside), np.maximum(verge, profile(outside / squeeze, raised, scale)), verge)
            paved = np.where(outside <= 0, np.maximum(paved, raised), paved)
        distance = _nearest(roads, len(scale))
        above[near] = np.where(distance <= 0, paved, np.maximum(verge, -press(distance, scale)))
        return above.reshape(xy_world.shape[:-1])

    def terrain_mesh_height(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the terrain mesh: the terrain, lowered under pavement and verges."""
        flat = xy_world.reshape(-1, 2)
        pressed = np.zeros(len(flat))
        near, roads = self.beside(flat, self._reach_m(flat))
        scale = self.cell_scale(flat[near])
        pressed[near] = press(_nearest(roads, len(scale)), scale)
        z = terrain.height_at(self.network.terrain, flat) - pressed
        return np.asarray(z.reshape(xy_world.shape[:-1]))

    @cached_property
    def mesh_axes(self) -> tuple[Scalars, Float[np.ndarray, " m"]]:
        """World x of the columns of the terrain mesh's vertices, and world y of their rows."""
        x0, y0, x1, y1 = self.fine
        return _axis(x0, x1, HORIZON_M), _axis(y0, y1, HORIZON_M if self.both_ways else BEHIND_M)

    def mesh_heights(self, xy_world: AnyPoints2) -> AnyScalars:
        """Heights of the terrain mesh's vertices, far hills included."""
        return self.terrain_mesh_height(xy_world) + self.hills.height(xy_world)

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
            lines = [curve.shifted(at) for at in t.tolist()]
            points = [self.lift_far(line.xy_world(s), line.raised(s) + far_dam(s), s) for line in lines]
            found.append(np.stack(points, axis=1))
        return found

    def lift_far(self, xy_world: AnyPoints2, above_m: Spread, s: Spread) -> AnyPoints3:
        """3D points at stations, `above_m` over the terrain with its far hills; far away over the faces of its mesh."""
        points = self.network.lift(xy_world, above_m + self.hills.height(xy_world))
        share = np.broadcast_to(on_faces(s), points.shape[:-1])
        far = share > 0
        over_m = np.broadcast_to(above_m, share.shape)[far] + self._face_height(xy_world[far]) - points[far, 2]
        points[far, 2] += share[far] * over_m
        return points

    def _face_height(self, xy_world: Points2) -> Scalars:
        """Height of the terrain mesh's faces, not pressed under pavements: of either way to split a quad into triangles
        the higher one."""
        axes = self.mesh_axes
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

    def height(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the ground as built."""
        return terrain.height_at(self.network.terrain, xy_world) + self.above_terrain(xy_world)

    def foot_height(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of somebody who walks over the ground: as its own, but steps, such as kerbs, are climbed smoothly."""
        return self.height(xy_world)

    def is_in(self, points_world: Points3) -> Bool[np.ndarray, " n"]:
        """Which points lie in the ground as built."""
        return np.asarray(self.height(points_world[:, :2]) > points_world[:, 2])

    def is_stacked(self, xy_world: Points2) -> Bool[np.ndarray, " n"]:
        """At which places one road passes over another."""
        return np.zeros(len(xy_world), dtype=bool)

    def height_near(self, points_world: Points3) -> Scalars:
        """Height of the ground as built at points, of several surfaces that nearest to each."""
        return self.height(points_world[:, :2])

    def height_along(self, road: str, xy_world: Points2) -> Scalars:
        """Height of the ground as built at places beside a road, of several surfaces that of the road."""
        return self.height(xy_world)

    def clearance(self, xy_world: AnyPoints2) -> AnyScalars:
        """Distance from the nearest pavement (shoulders included), negative on it, infinite far away."""
        flat = xy_world.reshape(-1, 2)
        near, roads = self.beside(flat, self._reach_m(flat))
        clear = np.full(len(flat), np.inf)
        clear[near] = _nearest(roads, int(near.sum()))
        return clear.reshape(xy_world.shape[:-1])

    def is_clear(self, xy_world: Float[np.ndarray, "n 2"], room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are farther than `room_m` from any pavement."""
        return np.asarray(self.clearance(xy_world) > room_m)

    def is_off_carriageways(self, xy_world: Points2, room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are farther than `room_m` from any pavement of traffic."""
        return self.is_clear(xy_world, room_m)

    def off_carriageways(self, xy_world: AnyPoints2) -> AnyScalars:
        """Distance from the nearest pavement of traffic, negative on it."""
        return self.clearance(xy_world)

    def is_within(self, xy_world: Float[np.ndarray, "n 2"], reach_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are at most `reach_m` from a pavement."""
        return np.asarray(self.clearance(xy_world) <= reach_m)

    def is_on_other(self, road: Road, xy_world: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Which points lie on the pavement of another road."""
        near, roads = self.beside(xy_world, self._reach_m(xy_world))
        found = np.zeros(len(xy_world), dtype=bool)
        found[near] = _nearest([at for at in roads if at.road is not road], int(near.sum())) <= 0
        return found

    def _reach_m(self, xy_world: AnyPoints2) -> AnyScalars:
        """Distance from a pavement within which the ground may differ from the terrain."""
        highest_m = max([road.parting.rise_m for road in self.network.roads if road.parting], default=0.0)
        return max(EMBANKMENT_SLOPE * highest_m, ROAD_SEARCH_M) + VERGE_M * self.cell_scale(xy_world)


def _axis(low: float, high: float, before_m: float) -> Scalars:
    """Coordinates CELL_M apart in [low, high]; outside, to `before_m` before it and HORIZON_M beyond it, cells grow by
    GROWTH per metre of distance."""

    def outside(reach_m: float) -> Scalars:
        n = int(np.ceil(np.log1p(reach_m * GROWTH / CELL_M) / np.log1p(GROWTH)))
        return np.asarray(CELL_M / GROWTH * ((1 + GROWTH) ** np.arange(1, n + 1) - 1))

    inner = np.linspace(low, high, int(np.ceil((high - low) / CELL_M)) + 1)
    return np.concatenate([low - outside(before_m)[::-1], inner, high + outside(HORIZON_M)])


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
