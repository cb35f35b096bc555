"""The road plan: main road, exit and ramp as smooth functions of a station, and projections of points to stations.

Two coordinate systems. The *plan* is the road before its flips: the exit leaves to the right for stations s >= 0.
The *world* is the plan with x and y mirrored as the scene's flips say. A station `s` is the y of a point on the main
reference line; `t` is the distance to the right of a reference line along its normal. Metres throughout.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from synth3dlanes.arrays import AnyPoints2, AnyPoints3, AnyScalars
from synth3dlanes.geometry import terrain as ground
from synth3dlanes.labels import RoadName
from synth3dlanes.scene import Road, Terrain

# Knots of the quartic (paper, Table 'Lane top view geometry'); beyond them roads continue along their tangents.
S_END_M = 100.0
# An exit continues straight from where the inside of a bend would compress its length per station below this share of
# the main road's: beyond that the displaced curve would fold back on itself.
MIN_STRETCH = 0.3
# Lower limit of the ramp's length; avoids a division by zero.
MIN_RAMP_LENGTH_M = 0.1
# Straight pieces between `RoadPlan.ramp_stations` are nowhere farther than this from the ramp: less than paint floats.
RAMP_SAG_M = 0.001
# Enough for a projection to converge below 1e-6 m within 30 m of a road with the sharpest bend drawn.
NEWTON_STEPS = 4


@dataclass(frozen=True, eq=False)
class RoadPlan:
    """The geometry of a road over its terrain."""

    road: Road
    terrain: Terrain

    # -- sizes

    @property
    def n_lanes(self) -> int:
        return self.road.n_lanes

    @property
    def has_exit(self) -> bool:
        return self.road.topology > 1

    @property
    def n_exit_lanes(self) -> int:
        return self.road.n_exit_lanes

    @property
    def n_main_after(self) -> int:
        """Main lanes behind the split (before the merge)."""
        return self.road.n_main_after

    @property
    def width_m(self) -> float:
        """Width of one lane."""
        return self.road.lane_width_m

    @property
    def shoulder_m(self) -> float:
        return self.road.shoulder_factor * self.width_m

    @property
    def n_oncoming(self) -> int:
        """Lanes of oncoming traffic, on the plan's left."""
        return self.road.n_oncoming

    @property
    def oncoming_inner_m(self) -> float:
        """Offset of the inner edge of the oncoming lanes: the host's left boundary where there is no median."""
        return self.boundary_m(0) - self.road.median_m

    @property
    def left_m(self) -> float:
        """Offset of the plan's leftmost lane boundary."""
        return self.oncoming_inner_m - self.n_oncoming * self.width_m if self.n_oncoming else self.boundary_m(0)

    def boundary_m(self, j: int) -> float:
        """Offset of lane boundary j = 0..n of the main road before the split; j counts from the plan's left."""
        return (j - self.n_lanes / 2) * self.width_m

    @property
    def exit_half_m(self) -> float:
        """Half the width of the exit's lanes."""
        return self.n_exit_lanes * self.width_m / 2

    @property
    def exit_base_m(self) -> float:
        """Main-road offset of the exit's reference line at the split: the middle of the exit's lanes there."""
        return self.boundary_m(self.n_lanes) - self.exit_half_m

    # -- flips

    @cached_property
    def flips(self) -> Float[np.ndarray, "2"]:
        """(+-1, +-1): world = plan * flips."""
        road = self.road
        return np.array([-1.0 if road.flip_longitudinal else 1.0, -1.0 if road.flip_lateral else 1.0])

    def plan_station(self, s_world: AnyScalars) -> AnyScalars:
        """Plan station of a world station, and vice versa."""
        return s_world * self.flips[1]

    # -- the main road in the plan

    @cached_property
    def _quartic(self) -> tuple[list[float], list[float], list[float]]:
        """Coefficients of the reference line and its first two derivatives, the constant first."""
        road = self.road
        ys = np.array([-100.0, -50.0, 50.0, 100.0])
        xs = [road.offset_m50_m + road.offset_m100_m, road.offset_m50_m]
        xs += [road.offset_p50_m, road.offset_p50_m + road.offset_p100_m]
        f = np.concatenate([[0.0], np.linalg.solve(ys[:, None] ** np.arange(1, 5), np.array(xs))])
        df = f[1:] * np.arange(1, 5)
        return f.tolist(), df.tolist(), (df[1:] * np.arange(1, 4)).tolist()

    def main_line(self, s: AnyScalars) -> tuple[AnyScalars, AnyScalars, AnyScalars]:
        """x of the reference line and its first two derivatives; straight beyond the outer knots."""
        # The function that is called most often: on few stations numpy's own overhead counts.
        (a0, a1, a2, a3, a4), (b0, b1, b2, b3), (c0, c1, c2) = self._quartic
        inside = np.minimum(np.maximum(s, -S_END_M), S_END_M)
        x = (((a4 * inside + a3) * inside + a2) * inside + a1) * inside + a0
        slope = ((b3 * inside + b2) * inside + b1) * inside + b0
        bend = (c2 * inside + c1) * inside + c0
        beyond = s - inside
        return x + beyond * slope, slope, np.where(beyond == 0, bend, 0.0)

    def _main_frame(self, s: AnyScalars) -> tuple[AnyPoints2, AnyPoints2, AnyScalars, AnyScalars]:
        """Point, right normal, speed |dM/ds| and turn rate d(heading)/ds (to the right) of the reference line."""
        x, slope, bend = self.main_line(s)
        speed = np.sqrt(1 + slope * slope)
        return (
            np.stack([x, s], -1),
            np.stack([1 / speed, -slope / speed], -1),
            speed,
            bend / (speed * speed),
        )

    def _main_plan(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints2:
        point, normal, _, _ = self._main_frame(s)
        return point + np.asarray(t)[..., None] * normal

    def stations_along(self, road: RoadName, s_world: float, lengths_m: AnyScalars) -> AnyScalars:
        """World stations at the given lengths of a road ahead of `s_world`, measured along its reference line; sorted
        lengths, negative behind it."""
        if lengths_m[0] < 0:
            behind, ahead = lengths_m[lengths_m < 0], lengths_m[lengths_m >= 0]
            return np.concatenate(
                [self._along(road, s_world, -behind[::-1], -1)[::-1], self._along(road, s_world, ahead)]
            )
        return self._along(road, s_world, lengths_m)

    def _along(
        self, road: RoadName, s_world: float, lengths_m: AnyScalars, sign: int = 1, reach: float = 1.05
    ) -> AnyScalars:
        """World stations at lengths ahead of `s_world`, or behind it with the sign -1."""
        grid = s_world + sign * np.linspace(0, reach * lengths_m[-1], 8 * int(lengths_m[-1]) + 9)
        middle = self.plan_station((grid[1:] + grid[:-1]) / 2)
        speed = self._main_frame(middle)[2]
        if road == "exit":
            speed = np.where(middle < 0, speed, np.linalg.norm(self._exit_frame(middle)[1], axis=-1))
        arc = np.concatenate([[0.0], np.cumsum(speed * np.abs(np.diff(grid)))])
        # An exit on the inside of a bend is shorter than its stations.
        if arc[-1] < lengths_m[-1]:
            return self._along(road, s_world, lengths_m, sign, 1.5 * reach)
        return np.interp(lengths_m, arc, grid)

    # -- the exit in the plan

    def _q_polynomial(self, s: AnyScalars) -> tuple[AnyScalars, AnyScalars]:
        road = self.road
        slope = np.tan(road.exit_angle_rad)
        return s * slope + road.exit_offset_m * (s / 60) ** 2, slope + road.exit_offset_m * s / 1800

    @cached_property
    def exit_end_m(self) -> float:
        """Station beyond which the exit runs straight: 100 m, or less where a bend would fold it."""
        s = np.linspace(0, S_END_M, 401)
        _, _, speed, turn = self._main_frame(s)
        displaced = self.exit_base_m + self._q_polynomial(s)[0]
        folded = np.flatnonzero(speed - turn * displaced < MIN_STRETCH * speed)
        return float(s[folded[0]]) if folded.size else S_END_M

    def opening(self, s: AnyScalars) -> AnyScalars:
        """q(s): how far the exit lanes have moved away from the main road, along the main road's normal."""
        inside = np.clip(s, 0, self.exit_end_m)
        q, dq = self._q_polynomial(inside)
        return np.asarray(q + np.clip(s - inside, 0, None) * dq)

    def station_where_open(self, q_m: float) -> float:
        """Smallest station with opening(s) >= q_m; infinity for a road without exit."""
        if not self.has_exit:
            return float("inf")
        slope, bend = np.tan(self.road.exit_angle_rad), self.road.exit_offset_m / 60**2
        bent = 2 * q_m / (slope + np.sqrt(slope**2 + 4 * bend * q_m))
        if bent <= self.exit_end_m:
            return float(bent)
        q, dq = self._q_polynomial(np.array([self.exit_end_m]))
        return float(self.exit_end_m + (q_m - q[0]) / dq[0])

    @cached_property
    def nose_m(self) -> float:
        """Station of the nose, where the opening is one lane wide."""
        return self.station_where_open(self.width_m)

    @cached_property
    def ramp_start_m(self) -> float | None:
        """Station where the shoulders have separated and the ramp begins; None if that is outside the scene."""
        start = self.station_where_open(self.width_m + 2 * self.shoulder_m)
        return start if start <= S_END_M else None

    def ramp(self, s: AnyScalars) -> AnyScalars:
        """Height of the exit above the terrain."""
        if self.ramp_start_m is None:
            return np.zeros(np.shape(s))
        u = np.clip((s - self.ramp_start_m) / self._ramp_length_m, 0, 1)
        return np.asarray(self.road.ramp_height_m * u * u * (3 - 2 * u))

    @property
    def _ramp_length_m(self) -> float:
        return max(self.road.ramp_height_m * self.road.ramp_slope, MIN_RAMP_LENGTH_M)

    @property
    def ramp_stations(self) -> Float[np.ndarray, " _"]:
        """Plan stations from the ramp's start to its end, as far apart as its curvature allows; empty without ramp."""
        if self.ramp_start_m is None:
            return np.zeros(0)
        # A piece of length d is off by d^2 / 8 times the curvature, which is 6 height / length^2 at both ends.
        pieces = int(np.ceil(np.sqrt(6 * self.road.ramp_height_m / (8 * RAMP_SAG_M))))
        return self.ramp_start_m + self._ramp_length_m * np.linspace(0, 1, max(pieces, 1) + 1)

    def _exit_frame(self, s: AnyScalars) -> tuple[AnyPoints2, AnyPoints2, AnyPoints2]:
        """Point, derivative by station and right normal of the exit's reference line, for s >= 0."""
        inside = np.clip(s, 0, self.exit_end_m)
        point, normal, speed, turn = self._main_frame(inside)
        q, dq = self._q_polynomial(inside)
        displaced = self.exit_base_m + q
        tangent = np.stack([-normal[..., 1], normal[..., 0]], -1)
        step = (speed - turn * displaced)[..., None] * tangent + dq[..., None] * normal
        right = np.stack([step[..., 1], -step[..., 0]], -1) / np.linalg.norm(step, axis=-1, keepdims=True)
        return point + displaced[..., None] * normal + (s - inside)[..., None] * step, step, right

    def _exit_plan(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints2:
        point, _, right = self._exit_frame(s)
        return point + np.asarray(t)[..., None] * right

    # -- points in the world

    def main_xy(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints2:
        """World (x, y) at plan station s and plan offset t of the main road."""
        return self._main_plan(s, t) * self.flips

    def exit_xy(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints2:
        """World (x, y) at plan station s >= 0 and plan offset t of the exit."""
        return self._exit_plan(s, t) * self.flips

    def lift(self, xy_world: AnyPoints2, above_m: AnyScalars | float = 0.0) -> AnyPoints3:
        """3D points on the terrain, or `above_m` over it."""
        z = ground.height_at(self.terrain, xy_world) + above_m
        return np.concatenate([xy_world, np.asarray(z)[..., None]], -1)

    # -- from the world back to stations

    def project_main(self, xy_world: AnyPoints2) -> tuple[AnyScalars, AnyScalars]:
        """Plan (s, t) of world points near the main road (Newton's method on the perpendicular foot)."""
        xy = xy_world * self.flips
        s = xy[..., 1].copy()
        for _ in range(NEWTON_STEPS):
            point, normal, speed, turn = self._main_frame(s)
            to = xy - point
            along = to[..., 1] * normal[..., 0] - to[..., 0] * normal[..., 1]
            t = (to * normal).sum(-1)
            s = s + np.clip(along / np.maximum(speed - turn * t, 0.3 * speed), -20, 20)
        point, normal, _, _ = self._main_frame(s)
        return s, ((xy - point) * normal).sum(-1)

    def project_exit(self, xy_world: AnyPoints2, s: AnyScalars) -> tuple[AnyScalars, AnyScalars]:
        """Plan (s, t) of world points near the exit, from an initial guess of s; the resulting s may be negative."""
        xy = xy_world * self.flips
        for _ in range(NEWTON_STEPS):
            point, step, _ = self._exit_frame(s)
            s = s + np.clip(((xy - point) * step).sum(-1) / (step * step).sum(-1), -20, 20)
        point, _, right = self._exit_frame(s)
        return s, ((xy - point) * right).sum(-1)


def is_wide_enough(road: Road) -> bool:
    """Whether the bends of a road leave room for its oncoming lanes: on the inside of a sharp one they would fold."""
    plan = RoadPlan(road, Terrain(gaussians=()))
    _, _, speed, turn = plan._main_frame(np.linspace(-S_END_M, S_END_M, 401))
    return bool((speed - turn * (plan.left_m - plan.shoulder_m) >= MIN_STRETCH * speed).all())
