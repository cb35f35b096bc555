"""The reference lines of the paper's roads: the quartic of the main road, and the exit's, which is displaced from it.

The *plan* is the road before its flips: the exit leaves to the right for stations s >= 0, and a station is the y of a
point on the main road's line. The world is the plan with x and y mirrored as the scene's flips say; t is the plan's.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from synth3dlanes.roads.reference_line import MAX_STEP_M, NEWTON_STEPS, LineFrames, ReferenceLine, dot, paired
from synth3dlanes.roads.roads import BEFORE_M, WIDER
from synth3dlanes.scene.scene import PaperRoad
from synth3dlanes.system.arrays import AnyPoints2, AnyScalars

# Knots of the quartic (paper, Table 'Lane top view geometry'); beyond them roads continue along their tangents.
S_END_M = 100.0
# Stations from the split to far beyond the scene.
EXIT_STATIONS_M = np.concatenate([np.arange(0.0, 400.0, 2.0), np.geomspace(400.0, 20_000.0, 40)])


class Flips(NamedTuple):
    """(+-1, +-1): world = plan * flips."""

    x: float
    y: float


class Quartic(ReferenceLine):
    """The main road's line: x = f(y), straight beyond the outer knots. A station is y in the plan."""

    def __init__(self, road: PaperRoad, flips: Flips) -> None:
        self.flips = flips
        ys = np.array([-100.0, -50.0, 50.0, 100.0])
        xs = [road.offset_m50_m + road.offset_m100_m, road.offset_m50_m]
        xs += [road.offset_p50_m, road.offset_p50_m + road.offset_p100_m]
        f = np.concatenate([[0.0], np.linalg.solve(ys[:, None] ** np.arange(1, 5), np.array(xs))])
        df = f[1:] * np.arange(1, 5)
        # The polynomial and its first two derivatives, the constant first.
        self._f, self._df, self._d2f = f.tolist(), df.tolist(), (df[1:] * np.arange(1, 4)).tolist()

    @property
    def is_mirrored(self) -> bool:
        """As one of its two flips makes it."""
        return self.flips.x * self.flips.y < 0

    def _plan(self, s: AnyScalars) -> tuple[AnyScalars, AnyScalars, AnyScalars]:
        """x in the plan and its first two derivatives."""
        # The function that is called most often: on few stations numpy's own overhead counts.
        (a0, a1, a2, a3, a4), (b0, b1, b2, b3), (c0, c1, c2) = self._f, self._df, self._d2f
        inside = np.minimum(np.maximum(s, -S_END_M), S_END_M)
        x = (((a4 * inside + a3) * inside + a2) * inside + a1) * inside + a0
        slope = ((b3 * inside + b2) * inside + b1) * inside + b0
        bend = (c2 * inside + c1) * inside + c0
        beyond = s - inside
        return x + beyond * slope, slope, np.where(beyond == 0, bend, 0.0)

    def frames(self, s: AnyScalars) -> LineFrames:
        """The line at stations."""
        x, slope, bend = self._plan(s)
        speed = np.sqrt(1 + slope * slope)
        points = paired(self.flips.x * x, self.flips.y * s)
        normals = paired(self.flips.x / speed, -self.flips.y * slope / speed)
        return LineFrames(points, normals, speed, bend / (speed * speed))

    def guess(self, xy_world: AnyPoints2) -> AnyScalars:
        """The points' y in the plan."""
        return np.asarray(xy_world[..., 1] * self.flips.y)

    def across(self, xy_world: AnyPoints2) -> AnyScalars:
        """About how far points are beside the line: their distance from its tangent at their y."""
        x, slope, _ = self._plan(self.guess(xy_world))
        return np.asarray((xy_world[..., 0] * self.flips.x - x) / np.sqrt(1 + slope * slope))

    def near(self, xy_world: AnyPoints2, low_m: AnyScalars, high_m: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """Which points may lie between these offsets."""
        across = self.across(xy_world)
        return np.asarray((across > low_m) & (across < high_m))


@dataclass(frozen=True, eq=False)
class Opening:
    """q(s): how far the exit lanes have moved away from the main road, along its normal; straight from `end_m` on."""

    slope: float
    offset_m: float
    end_m: float = S_END_M

    def polynomial(self, s: AnyScalars) -> tuple[AnyScalars, AnyScalars]:
        """q and its derivative before the end."""
        return s * self.slope + self.offset_m * (s / 60) ** 2, self.slope + self.offset_m * s / 1800

    def __call__(self, s: AnyScalars) -> AnyScalars:
        """q at stations; 0 before the split."""
        inside = np.clip(s, 0, self.end_m)
        q, dq = self.polynomial(inside)
        return np.asarray(q + np.clip(s - inside, 0, None) * dq)

    def station(self, q_m: float) -> float:
        """Smallest station at which it is `q_m`."""
        bend = self.offset_m / 60**2
        bent = 2 * q_m / (self.slope + np.sqrt(self.slope**2 + 4 * bend * q_m))
        if bent <= self.end_m:
            return float(bent)
        q, dq = self.polynomial(np.array([self.end_m]))
        return float(self.end_m + (q_m - q[0]) / dq[0])


@dataclass(frozen=True, eq=False)
class Displaced(ReferenceLine):
    """The exit's line: displaced from the main road's by `base_m` and its opening, for stations >= 0 of that line."""

    base: Quartic
    base_m: float
    opening: Opening

    @property
    def is_mirrored(self) -> bool:
        """As the main road's line."""
        return self.base.is_mirrored

    def _steps(self, s: AnyScalars) -> tuple[AnyPoints2, AnyPoints2, AnyPoints2]:
        """Points, their derivatives by station, and unit normals."""
        inside = np.clip(s, 0, self.opening.end_m)
        points, normals, speed, turn = self.base.frames(inside)
        q, dq = self.opening.polynomial(inside)
        displaced = self.base_m + q
        sign = self.base.flips.x * self.base.flips.y
        tangents = paired(-sign * normals[..., 1], sign * normals[..., 0])
        steps = (speed - turn * displaced)[..., None] * tangents + dq[..., None] * normals
        aside = paired(sign * steps[..., 1], -sign * steps[..., 0]) / np.sqrt(dot(steps, steps))[..., None]
        return points + displaced[..., None] * normals + (s - inside)[..., None] * steps, steps, aside

    def frames(self, s: AnyScalars) -> LineFrames:
        """The line at stations; its turn is not needed by its own projection."""
        points, steps, aside = self._steps(s)
        return LineFrames(points, aside, np.sqrt(dot(steps, steps)), np.zeros(np.shape(s)))

    def xy(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints2:
        """World (x, y) of places."""
        points, _, aside = self._steps(s)
        return np.asarray(points + np.asarray(t)[..., None] * aside)

    def guess(self, xy_world: AnyPoints2) -> AnyScalars:
        """Stations of the main road's line."""
        return self.base.project(xy_world)[0]

    def project(self, xy_world: AnyPoints2, guess: AnyScalars | None = None) -> tuple[AnyScalars, AnyScalars]:
        """(s, t) of points near the line; s may be negative."""
        s = self.guess(xy_world) if guess is None else guess
        for _ in range(NEWTON_STEPS):
            points, steps, _ = self._steps(s)
            ahead = dot(xy_world - points, steps) / dot(steps, steps)
            s = s + np.clip(ahead, -MAX_STEP_M, MAX_STEP_M)
        points, _, aside = self._steps(s)
        return s, dot(xy_world - points, aside)

    @cached_property
    def _plan_y(self) -> AnyScalars:
        y = self._steps(EXIT_STATIONS_M)[0][:, 1] * self.base.flips.y
        return np.asarray(np.maximum.accumulate(y))

    def near(self, xy_world: AnyPoints2, low_m: AnyScalars, high_m: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """Which points may lie between these offsets."""
        across = self.base.across(xy_world) - self.base_m
        # An exit that leaves at an angle reaches a given y only at a much larger station.
        station = np.interp(self.base.guess(xy_world), self._plan_y, EXIT_STATIONS_M)
        return np.asarray((across > low_m) & (across < high_m + WIDER * self.opening(station + BEFORE_M)))
