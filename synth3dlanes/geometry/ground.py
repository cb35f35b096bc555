"""The ground as built: terrain, pavement, verges and embankments, as one height over (x, y). World frame.

A paved area ends in shoulders. From a shoulder's edge the ground falls gently (the verge), or down an embankment
where the exit is raised, until it passes below the terrain mesh, which is lowered under pavement and verge.
`meshes.py` builds exactly this surface; `visibility.py` tests lines of sight against it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from synth3dlanes.arrays import AnyPoints2, AnyScalars
from synth3dlanes.geometry import terrain
from synth3dlanes.geometry.horizon import FarHills
from synth3dlanes.geometry.road import S_END_M, RoadPlan
from synth3dlanes.scene import Markings

Spread = Float[np.ndarray, "*#n"]

# Size of the terrain cells near the road. The depths and widths below are for cells of this size; farther away they
# grow in proportion to the cell.
CELL_M = 1.25
MAX_CELL_SCALE = 8.0
PRESS_M = 0.3
PRESSED_TO_M = 2.0
VERGE_M = 4.0
VERGE_FALL = 0.05
# Horizontal over vertical extent of the embankment beside a raised exit.
EMBANKMENT_SLOPE = 1.5
# Growth of the terrain's cells per metre outside the fine area.
GROWTH = 0.06
# Width of the lanes' pavement beyond the paint of an edge line.
PAINT_ROOM_M = 0.05
# Length behind the split over which the pavement of a lane that leaves narrows to nothing (topology 4).
TAPER_M = 20.0
# How far beyond the host fine cells reach: where it looks, and where it does not.
FINE_M, FINE_BEHIND_M = 165.0, 10.0
# Stations from the split to far beyond the scene.
EXIT_STATIONS_M = np.concatenate([np.arange(0.0, 400.0, 2.0), np.geomspace(400.0, 20_000.0, 40)])
# The crests of a ramp continue this far beyond the scene, and this far from the host.
CREST_BEYOND_M, CREST_FROM_HOST_M = 30.0, 115.0


@dataclass(frozen=True, eq=False)
class Ground:
    """Ground heights around a road. Mesh resolution is highest ahead of the host, which starts at the world station
    `near_m` and drives on to the station `driven_m` after it; with `both_ways` behind it too. `fine` is (x0, y0, x1,
    y1) of the area with fine terrain cells. The pavement extends under all `markings`."""

    plan: RoadPlan
    near_m: float
    markings: Markings
    hills: FarHills
    driven_m: float = 0.0
    both_ways: bool = False

    def ahead_m(self, s_world: Spread) -> Spread:
        """How far world stations are ahead of the host's last place, 0 to its first; behind that they are negative."""
        last_m = self.near_m + self.driven_m
        return np.where(s_world > last_m, s_world - last_m, np.minimum(s_world - self.near_m, 0))

    def range_m(self, ahead_m: float, behind_m: float) -> tuple[float, float]:
        """World stations from `behind_m` behind the host's first place to `ahead_m` ahead of its last; with
        `both_ways` from `ahead_m` behind."""
        return self.near_m - (ahead_m if self.both_ways else behind_m), self.near_m + self.driven_m + ahead_m

    @cached_property
    def edge_m(self) -> float:
        """Plan offset of the main pavement's right edge before the split."""
        return self.plan.n_lanes * self.plan.width_m / 2 + self.plan.shoulder_m

    @cached_property
    def left_edge_m(self) -> float:
        """Plan offset of the main pavement's left edge, negative; the oncoming lanes and the median are on it."""
        return self.plan.left_m - self.plan.shoulder_m

    @cached_property
    def exit_edge_m(self) -> float:
        """Outer edge of the exit's shoulder, left or right of its reference line."""
        return self.plan.exit_half_m + self.plan.shoulder_m

    @cached_property
    def under_paint_m(self) -> float:
        """Width of road pavement outside the outermost lanes: it covers the paint of their edge lines."""
        outer_m = self.markings.width_m * (1.5 if self.markings.left_double else 0.5)
        return min(outer_m + PAINT_ROOM_M, self.plan.shoulder_m)

    def main_right_edge(self, s: AnyScalars) -> AnyScalars:
        """Plan offset of the main pavement's right edge; it moves in where a main lane leaves (topology 4)."""
        lost_m = (self.plan.n_lanes - self.plan.n_main_after) * self.plan.width_m
        return np.asarray(self.edge_m - lost_m * np.clip(s / min(TAPER_M, self.plan.nose_m), 0, 1))

    @cached_property
    def fine(self) -> tuple[float, float, float, float]:
        """(x0, y0, x1, y1) of the area near the camera in which the roads get fine terrain cells."""
        low_m, high_m = self.range_m(FINE_M - 5, FINE_BEHIND_M - 2)
        s = np.linspace(low_m, high_m, 1 + round((high_m - low_m) / 2))
        xy = [self.plan.main_xy(self.plan.plan_station(s), t) for t in (self.left_edge_m, self.edge_m)]
        if self.plan.has_exit:
            stations = np.clip(self.plan.plan_station(s), 0, None)
            xy += [self.plan.exit_xy(stations, t) for t in (-self.exit_edge_m, self.exit_edge_m)]
        points = np.concatenate(xy)
        y0, y1 = self.range_m(FINE_M, FINE_BEHIND_M)
        points = points[(points[:, 1] > y0) & (points[:, 1] < y1)]
        x0, x1 = points[:, 0].min() - 10, points[:, 0].max() + 10
        return float(x0), float(y0), float(x1), float(y1)

    def crests(self) -> list[Float[np.ndarray, "m 3"]]:
        """The edges of the raised exit's shoulders as world points a metre apart, less on a steep ramp: they hide what
        lies beyond them."""
        plan = self.plan
        if plan.ramp_start_m is None:
            return []
        reach_m = plan.plan_station(np.array(self.range_m(CREST_FROM_HOST_M, 0.0))).max()
        s = np.union1d(plan.ramp_stations, np.arange(plan.ramp_start_m, max(S_END_M + CREST_BEYOND_M, reach_m)))
        return [plan.lift(plan.exit_xy(s, edge), plan.ramp(s)) for edge in (-self.exit_edge_m, self.exit_edge_m)]

    def cell_scale(self, xy_world: AnyPoints2) -> AnyScalars:
        """Terrain cell size as a multiple of CELL_M, as `meshes.terrain_axes` lays it out."""
        x0, y0, x1, y1 = self.fine
        out = np.maximum(
            np.maximum(x0 - xy_world[..., 0], xy_world[..., 0] - x1),
            np.maximum(y0 - xy_world[..., 1], xy_world[..., 1] - y1),
        )
        return np.clip(1 + np.clip(out, 0, None) * GROWTH / CELL_M, 1, MAX_CELL_SCALE)

    def edge_distances(self, xy_world: AnyPoints2) -> tuple[AnyScalars, AnyScalars, AnyScalars, AnyScalars]:
        """(main, outside, raised, room): distance from the main pavement and from the exit's (negative inside, infinite
        far away), the exit's height over the terrain at the nearest station, and the width available to its
        embankment on the point's side."""
        s, t = self.plan.project_main(xy_world)
        main = np.maximum(self.left_edge_m - t, t - self.main_right_edge(s))
        outside = np.full(s.shape, np.inf)
        raised = np.zeros(s.shape)
        room = np.full(s.shape, np.inf)
        if self.plan.has_exit:
            reach = self._reach_m(xy_world) + 1.5 * self.plan.opening(np.clip(s + 20, 0, None))
            close = (s > -20) & (t > self.main_right_edge(s) - self.plan.width_m - 1) & (t < self.edge_m + reach)
            if close.any():
                se, te = self.plan.project_exit(xy_world[close], s[close])
                outside[close] = np.where(se >= 0, np.abs(te) - self.exit_edge_m, np.inf)
                raised[close] = self.plan.ramp(se)
                room[close] = np.where(te < 0, np.clip(main[close] + outside[close], 0, None), np.inf)
        return main, outside, raised, room

    def above_terrain(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the built ground over the analytic terrain at any points (0 away from roads)."""
        flat = xy_world.reshape(-1, 2)
        above = np.zeros(len(flat))
        near = self._near(flat)
        xy = flat[near]
        main, exits, raised, room = self.edge_distances(xy)
        scale = self.cell_scale(xy)
        distance = np.minimum(main, exits)
        main_profile = profile(main, 0.0, scale)
        squeeze = np.clip(room / embankment_width(raised, scale), 1e-6, 1)
        exit_profile = np.where(
            np.isfinite(exits), profile(np.where(np.isfinite(exits), exits / squeeze, 0), raised, scale), -np.inf
        )
        built = np.where(
            main <= 0, np.where(exits <= 0, np.maximum(raised, 0), 0.0), np.maximum(main_profile, exit_profile)
        )
        above[near] = np.where(distance <= 0, built, np.maximum(built, -press(distance, scale)))
        return above.reshape(xy_world.shape[:-1])

    def terrain_mesh_height(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the terrain mesh: the terrain, lowered under pavement and verges."""
        flat = xy_world.reshape(-1, 2)
        pressed = np.zeros(len(flat))
        near = self._near(flat)
        main, exits, _, _ = self.edge_distances(flat[near])
        pressed[near] = press(np.minimum(main, exits), self.cell_scale(flat[near]))
        z = terrain.height_at(self.plan.terrain, flat) - pressed
        return np.asarray(z.reshape(xy_world.shape[:-1]))

    def height(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the ground as built."""
        return terrain.height_at(self.plan.terrain, xy_world) + self.above_terrain(xy_world)

    def clearance(self, xy_world: AnyPoints2) -> AnyScalars:
        """Distance from the nearest pavement (shoulders included), negative on it, infinite far away."""
        flat = xy_world.reshape(-1, 2)
        clear = np.full(len(flat), np.inf)
        near = self._near(flat)
        main, exits, _, _ = self.edge_distances(flat[near])
        clear[near] = np.minimum(main, exits)
        return clear.reshape(xy_world.shape[:-1])

    def _near(self, xy_world: AnyPoints2) -> np.ndarray:
        """Which points are close enough to a road that the ground there may differ from the terrain."""
        xy = xy_world * self.plan.flips
        x, slope, _ = self.plan.main_line(xy[:, 1])
        across = (xy[:, 0] - x) / np.sqrt(1 + slope * slope)
        reach = self._reach_m(xy_world)
        right = self.edge_m + reach
        if self.plan.has_exit:
            # An exit that leaves at an angle reaches a given y only at a much larger station.
            station = np.interp(xy[:, 1], self._exit_y, EXIT_STATIONS_M)
            right = right + self.plan.opening(station + 20) * 1.5
        return (across > self.left_edge_m - reach) & (across < right)

    @cached_property
    def _exit_y(self) -> AnyScalars:
        """Plan y of the exit's reference line at EXIT_STATIONS_M."""
        y = self.plan.exit_xy(EXIT_STATIONS_M, 0.0)[:, 1] * self.plan.flips[1]
        return np.asarray(np.maximum.accumulate(y))

    def _reach_m(self, xy_world: AnyPoints2) -> AnyScalars:
        """Largest distance from a shoulder's edge at which the ground may differ from the terrain."""
        return EMBANKMENT_SLOPE * self.plan.road.ramp_height_m + VERGE_M * self.cell_scale(xy_world)


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
