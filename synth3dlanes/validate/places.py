"""Positions of points, seen from above, on the roads of a scene, and the surface expected there. Plan frame, metres.

Follows the meshes that Blender renders: surfaces are straight between their rows of vertices.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.arrays import Points3, Scalars
from synth3dlanes.frames import transform
from synth3dlanes.geometry import meshes
from synth3dlanes.geometry.ground import Ground
from synth3dlanes.geometry.lanes import LaneCurve
from synth3dlanes.geometry.terrain import gradient_at, height_at
from synth3dlanes.labels import CameraLabel
from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.world import World

# Points are projected onto the exit up to this far before the split and this far left of the exit's lanes.
BEHIND_M, ASIDE_M = 20.0, 1.0
# The exit's faces are cut where they meet the main pavement; this far outside it no face is cut.
CUT_M = 0.3
# Points on the main right shoulder this close to the exit's lanes may be covered by the faces of these.
COVER_M = 2.0
# Points are moved onto the road along the line of sight by at most this.
MAX_FLOAT_M = 0.05


@dataclass(frozen=True, eq=False)
class RoadPlaces:
    """Points by station and offset on the main road and on the exit; NaN where the exit is not near."""

    ground: Ground
    s: Scalars
    t: Scalars
    exit_s: Scalars
    exit_t: Scalars

    def at(self, which: Bool[np.ndarray, " n"]) -> "RoadPlaces":
        """The selected points."""
        return RoadPlaces(self.ground, self.s[which], self.t[which], self.exit_s[which], self.exit_t[which])

    def outside(self) -> Scalars:
        """Distance from the nearest pavement, negative on it."""
        return np.fmin(self._outside_main(), self._outside_exit())

    def raised(self) -> Scalars:
        """Height of the pavement over the terrain."""
        plan = self.ground.plan
        raised = np.zeros(self.s.shape)
        on_exit = self._outside_exit() < np.minimum(self._outside_main(), CUT_M)
        if plan.ramp_start_m is not None and on_exit.any():
            rows = np.sort(plan.plan_station(meshes.road_stations(self.ground)))
            raised[on_exit] = np.interp(self.exit_s[on_exit], rows, plan.ramp(rows))
        return raised

    def on_slope(self) -> Bool[np.ndarray, " n"]:
        """Which points are on the ramp where it rises."""
        raised = self.raised()
        return (raised > 0) & (raised < self.ground.plan.road.ramp_height_m)

    def right_of(self, curve: LaneCurve) -> Scalars:
        """Distance to the right of a curve in the plan."""
        on_main = self.t - curve.main_offset(self.ground.plan, self.s)
        return np.where(self._follows_exit(curve), self.exit_t - curve.fork_m, on_main)

    def station(self, curve: LaneCurve) -> Scalars:
        """Stations along a curve."""
        return np.where(self._follows_exit(curve), self.exit_s, self.s)

    def surface(self, margin_m: float) -> Int[np.ndarray, " n"]:
        """Semantic id of road or shoulder where only one is possible, given a margin; 0 elsewhere."""
        plan, ground = self.ground.plan, self.ground
        main, exits = self._outside_main(), self._outside_exit()
        right = ground.main_right_edge(self.s) - plan.shoulder_m
        beyond = np.maximum(plan.left_m - self.t, self.t - right)
        beyond = np.where(
            self._in_median(), np.fmin(self.t - plan.oncoming_inner_m, plan.boundary_m(0) - self.t), beyond
        )
        is_covered = (self.s > -BEHIND_M) & (np.abs(self.exit_t) < plan.exit_half_m + COVER_M)
        beyond = np.where((self.t > right - margin_m) & is_covered, 0.0, beyond)
        on_exit = (main > CUT_M) & (exits < 0)
        beyond = np.where(on_exit, np.abs(self.exit_t) - plan.exit_half_m, beyond)
        known = on_exit | ((main < 0) & ~self._on_grass(margin_m))
        road, shoulder = SEMANTIC_IDS["road"], SEMANTIC_IDS["shoulder"]
        paved_m = ground.under_paint_m + margin_m
        return np.where(known & (beyond < -margin_m), road, np.where(known & (beyond > paved_m), shoulder, 0))

    def _follows_exit(self, curve: LaneCurve) -> Bool[np.ndarray, " n"]:
        return (curve.fork_road == "exit") & (self.s >= 0) & (self.exit_s >= 0)

    def _in_median(self) -> Bool[np.ndarray, " n"]:
        plan = self.ground.plan
        return (plan.n_oncoming > 0) & (self.t > plan.oncoming_inner_m) & (self.t < plan.boundary_m(0))

    def _on_grass(self, margin_m: float) -> Bool[np.ndarray, " n"]:
        """Which points may be on the grass of the median."""
        grass = meshes.median_grass_m(self.ground)
        if grass is None:
            return np.zeros(self.t.shape, dtype=bool)
        return (self.t > grass[0] - margin_m) & (self.t < grass[1] + margin_m)

    def _outside_main(self) -> Scalars:
        return np.maximum(self.ground.left_edge_m - self.t, self.t - self.ground.main_right_edge(self.s))

    def _outside_exit(self) -> Scalars:
        aside = np.maximum(-meshes.SEAM_M - self.exit_t, self.exit_t) - self.ground.exit_edge_m
        return np.where(self.exit_s >= 0, aside, np.nan)


def places(ground: Ground, xy_world: Float[np.ndarray, "n 2"]) -> RoadPlaces:
    """Project points near a road onto it."""
    plan = ground.plan
    s, t = plan.project_main(xy_world)
    exit_s, exit_t = np.full(s.shape, np.nan), np.full(s.shape, np.nan)
    if plan.has_exit:
        near = (s > -BEHIND_M) & (t > plan.boundary_m(plan.n_lanes - plan.n_exit_lanes) - ASIDE_M)
        exit_s[near], exit_t[near] = plan.project_exit(xy_world[near], np.maximum(s[near], 0))
    return RoadPlaces(ground, s, t, exit_s, exit_t)


def on_road(world: World, camera: CameraLabel, points_cam: Points3) -> tuple[Points3, Bool[np.ndarray, " n"]]:
    """Move points that float over the road along the line of sight onto it; also return where this is reliable."""
    terrain, points = world.scene.terrain, transform(camera.world_from_cam, points_cam)
    place = places(world.ground, points[:, :2])
    sight = points - camera.world_from_cam[:3, 3]
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    falls = (sight[:, :2] * gradient_at(terrain, points[:, :2])).sum(axis=1) - sight[:, 2]
    over_m = points[:, 2] - height_at(terrain, points[:, :2]) - place.raised()
    with np.errstate(divide="ignore", invalid="ignore"):
        way_m = np.clip(np.where(falls > 0, over_m / falls, np.inf), -1, 1)
    return points + way_m[:, None] * sight, (np.abs(way_m) < MAX_FLOAT_M) & ~place.on_slope()
