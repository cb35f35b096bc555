"""The forms of reference lines: spirals, with straight lines and arcs among them, cubics, polylines and chains of these
for plans; the quartic of the paper's main road, and the line of its exit, which is displaced from that. World frame,
metres; stations of plans are lengths, of a cubic its parameter.

The *plan* of the paper's road is the road before its flips: the exit leaves to the right for stations s >= 0, and a
station is the y of a point on the main road's line. The world is the plan with x and y mirrored as the scene's flips
say; t is the plan's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from synth3dlanes.roads.maps.cubics import SAME_M
from synth3dlanes.roads.reference_line import GUESS_STEP_M, LineFrames, ReferenceLine, dot, paired
from synth3dlanes.scene.road_map import PlanPiece
from synth3dlanes.scene.scene import PaperRoad
from synth3dlanes.system.arrays import AnyPoints2, AnyScalars, Polyline2

# Numbers of nodes on [0, 1] for integrals along a spiral, exact to a nanometre up to a few turns. A spiral that turns
# by at most FEW_RAD, as most do between their beginning and a place, needs few.
MANY_NODES, FEW_NODES, FEW_RAD = 40, 10, 1.5
# An arc of less curvature (1/m) is a parabola here, to a tenth of a millimetre in a kilometre.
STRAIGHT = 1e-9
# Steps in which lengths along a cubic are measured.
CUBIC_STEPS = 2000
# The least metres per unit of a cubic's parameter; below, the curve has no direction.
LEAST_SPEED = 1e-9
# Knots of the quartic (paper, Table 'Lane top view geometry'); beyond them roads continue along their tangents.
S_END_M = 100.0
# The exit may be beside a point up to WIDER times its opening, BEFORE_M ahead of the point's station on the main road.
BEFORE_M, WIDER = 20.0, 1.5
# Stations from the split to far beyond the scene.
EXIT_STATIONS_M = np.concatenate([np.arange(0.0, 400.0, 2.0), np.geomspace(400.0, 20_000.0, 40)])


@dataclass(frozen=True, eq=False)
class FiniteLine(ReferenceLine):
    """A line over `length_m` of stations from `start_m` on; before and behind them it goes on by its own formula."""

    length_m: float
    start_m: float = field(default=0.0, kw_only=True)

    @cached_property
    def stations(self) -> Float[np.ndarray, " k"]:
        """The stations of places along it, GUESS_STEP_M apart or closer."""
        return np.asarray(self.start_m + np.linspace(0, self.length_m, 2 + int(self.length_m / GUESS_STEP_M)))

    @cached_property
    def _tree(self) -> "scipy.spatial.cKDTree":
        return scipy.spatial.cKDTree(self.frames(self.stations).points_world)

    def guess(self, xy_world: AnyPoints2) -> AnyScalars:
        """The station of the nearest of some places."""
        return np.asarray(self.stations[self._tree.query(xy_world)[1]])


@dataclass(frozen=True, eq=False)
class Spiral(FiniteLine):
    """A line whose curvature (to the left, 1/m) changes evenly by `bends` per metre: a straight line if both are 0, an
    arc if `bends` is. `heading_rad` is counter-clockwise from world x."""

    start_world: tuple[float, float]
    heading_rad: float
    curvature: float = 0.0
    bends: float = 0.0

    @property
    def numbers(self) -> tuple[float, ...]:
        """Place, heading, curvature and its change, and the first normal, as `spiral_frames` takes them."""
        normal = float(np.sin(self.heading_rad)), float(-np.cos(self.heading_rad))
        return (*self.start_world, self.heading_rad, self.curvature, self.bends, *normal)

    def frames(self, s: AnyScalars) -> LineFrames:
        """The line at stations, as `spiral_frames` says it: of one line it need not look which are bent."""
        if self.bends:
            return spiral_frames(np.broadcast_to(self.numbers, (*s.shape, 7)), s)
        heading, k = self.heading_rad + s * self.curvature, self.curvature
        normals, first = (
            paired(np.sin(heading), -np.cos(heading)),
            np.array([np.sin(self.heading_rad), -np.cos(self.heading_rad)]),
        )
        if abs(k) > STRAIGHT:
            way = (normals - first) / k
        else:
            way = s[..., None] * [-first[1], first[0]] - (k * s**2 / 2)[..., None] * first
        return LineFrames(self.start_world + way, normals, np.ones(s.shape), np.full(s.shape, -k))


@cache
def _nodes(n: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Nodes and weights of Gauss's rule on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(n)  # type: ignore[no-untyped-call]
    return nodes / 2 + 0.5, weights / 2


def spiral_frames(numbers: Float[np.ndarray, "*n 7"], s: AnyScalars) -> LineFrames:
    """Spirals, each by its `numbers`, at one station each."""
    x, y, first_rad, curvature, bends, first_x, first_y = (numbers[..., i] for i in range(7))
    heading = first_rad + s * (curvature + bends * s / 2)
    normal_x, normal_y = np.sin(heading), -np.cos(heading)
    # A straight line to the second order, below which an arc so wide does not differ.
    bent, straight = bends != 0, np.abs(curvature) <= STRAIGHT
    radius_of, fall = np.where(straight, 1.0, curvature), curvature * s**2 / 2
    way_x = np.where(straight, s * -first_y - fall * first_x, (normal_x - first_x) / radius_of)
    way_y = np.where(straight, s * first_x - fall * first_y, (normal_y - first_y) / radius_of)
    if bent.any():
        turn_rad = np.abs(s) * (np.abs(curvature) + np.abs(bends * s))
        for n, at in ((FEW_NODES, bent & (turn_rad <= FEW_RAD)), (MANY_NODES, bent & (turn_rad > FEW_RAD))):
            nodes, weights = _nodes(n)
            along = s[at][:, None] * nodes
            u = first_rad[at][:, None] + along * (curvature[at][:, None] + bends[at][:, None] * along / 2)
            way_x[at], way_y[at] = s[at] * (np.cos(u) @ weights), s[at] * (np.sin(u) @ weights)
    return LineFrames(
        paired(x + way_x, y + way_y), paired(normal_x, normal_y), np.ones(s.shape), -(curvature + bends * s)
    )


@dataclass(frozen=True, eq=False)
class Cubic(FiniteLine):
    """A line of two cubics of its parameter, each by its coefficients from the constant on."""

    x: tuple[float, float, float, float]
    y: tuple[float, float, float, float]

    def frames(self, s: AnyScalars) -> LineFrames:
        """The line at stations."""
        values = [
            (a + s * (b + s * (c + s * d)), b + s * (2 * c + s * 3 * d), 2 * c + s * 6 * d)
            for a, b, c, d in (self.x, self.y)
        ]
        (px, py), (dx, dy), (ddx, ddy) = zip(*values, strict=True)
        # In a cusp the curve stands still and has no normal.
        speed = np.maximum(np.hypot(dx, dy), LEAST_SPEED)
        normals = paired(dy, -dx) / speed[..., None]
        return LineFrames(paired(px, py), normals, speed, (dy * ddx - dx * ddy) / speed**2)


@dataclass(frozen=True, eq=False)
class MeasuredCubic(FiniteLine):
    """A cubic by the length along it, scaled to `length_m`."""

    cubic: Cubic

    @cached_property
    def _knots(self) -> tuple[AnyScalars, AnyScalars]:
        """Parameters, and the stations there."""
        parameter = np.linspace(0, self.cubic.length_m, CUBIC_STEPS + 1)
        speed = self.cubic.frames((parameter[1:] + parameter[:-1]) / 2).speed
        lengths_m = np.concatenate([[0.0], np.cumsum(speed)])
        return parameter, lengths_m * (self.length_m / lengths_m[-1])

    def frames(self, s: AnyScalars) -> LineFrames:
        """The line at stations."""
        parameter, stations = self._knots
        ends = np.array([0, -1])
        per_m = np.diff(parameter)[ends] / np.diff(stations)[ends]
        at = np.interp(s, stations, parameter)
        at = at + np.minimum(s, 0) * per_m[0] + np.maximum(s - self.length_m, 0) * per_m[1]
        points, normals, speed, turn = self.cubic.frames(at)
        # The cubic's own length per metre of station, which is 1 where the given length is right.
        scale = self._scale
        return LineFrames(points, normals, np.full(s.shape, scale), turn / speed * scale)

    @cached_property
    def _scale(self) -> float:
        parameter = np.linspace(0, self.cubic.length_m, CUBIC_STEPS + 1)
        speed = self.cubic.frames((parameter[1:] + parameter[:-1]) / 2).speed
        return float(speed.mean() * self.cubic.length_m / self.length_m)


@dataclass(frozen=True, eq=False)
class Chain(FiniteLine):
    """Lines one after the other, each from where the previous one ends; the outer ones go on."""

    lines: Sequence[FiniteLine]

    @classmethod
    def of(cls, lines: Sequence[FiniteLine]) -> "Chain":
        """The chain of these lines."""
        return cls(sum(line.length_m for line in lines), lines)

    @classmethod
    def through(cls, points_world: Polyline2) -> "Chain":
        """A polyline."""
        steps = np.diff(points_world, axis=0)
        ways = zip(points_world.tolist(), steps.tolist(), strict=False)
        return cls.of([Spiral(float(np.hypot(dx, dy)), (x, y), float(np.arctan2(dy, dx))) for (x, y), (dx, dy) in ways])

    @property
    def parts(self) -> Sequence[FiniteLine]:
        """Its lines."""
        return self.lines

    @cached_property
    def starts(self) -> Float[np.ndarray, " k"]:
        """Where each line begins."""
        return np.cumsum([self.start_m, *(line.length_m for line in self.lines[:-1])])

    @cached_property
    def _numbers(self) -> Float[np.ndarray, "k 7"] | None:
        """The numbers of all lines, if each is a spiral."""
        lines = [line for line in self.lines if isinstance(line, Spiral)]
        return np.array([line.numbers for line in lines]) if len(lines) == len(self.lines) else None

    def within(self, start_m: float, end_m: float) -> "Chain":
        """The lines between two stations, the outer ones with all their length: at the end, the one before it."""
        first = max(int(np.searchsorted(self.starts, start_m + SAME_M, side="right")) - 1, 0)
        last = max(int(np.searchsorted(self.starts, end_m - SAME_M)), first + 1)
        if (first, last) not in self._parts:
            lines = self.lines[first:last]
            own = Chain(sum(line.length_m for line in lines), lines, start_m=float(self.starts[first]))
            self._parts[first, last] = own
        return self._parts[first, last]

    @cached_property
    def _parts(self) -> dict[tuple[int, int], "Chain"]:
        """Its parts that were asked for, by their first line and the one after their last: roads share them."""
        return {}

    def frames(self, s: AnyScalars) -> LineFrames:
        """The line at stations."""
        if len(self.lines) == 1:
            return self.lines[0].frames(s - self.start_m)
        starts = self.starts
        which = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, None)
        first = int(which.min(initial=len(starts) - 1))
        if first == which.max(initial=first):
            return self.lines[first].frames(s - starts[first])
        if self._numbers is not None:
            return spiral_frames(self._numbers[which], s - starts[which])
        found = LineFrames(np.zeros((*s.shape, 2)), np.zeros((*s.shape, 2)), np.ones(s.shape), np.zeros(s.shape))
        for i in np.unique(which):
            at = which == i
            for whole, part in zip(found, self.lines[i].frames(s[at] - starts[i]), strict=True):
                whole[at] = part
        return found


def plan_line(plan: Sequence[PlanPiece]) -> Chain:
    """The reference line of a road's plan."""
    lines = ((piece.length_m, line_of(piece)) for piece in plan)
    return Chain.of([MeasuredCubic(m, line) if isinstance(line, Cubic) else line for m, line in lines])


def plan_points(plan: Sequence[PlanPiece], s: AnyScalars) -> Float[np.ndarray, "n 3"]:
    """x, y and heading of a plan at stations; before and behind it, of its ends' tangents."""
    line = plan_line(plan)
    inside = np.clip(s, 0, line.length_m)
    points, normals, _, _ = line.frames(inside)
    ahead = paired(-normals[:, 1], normals[:, 0])
    return np.column_stack([points + (s - inside)[:, None] * ahead, np.arctan2(ahead[:, 1], ahead[:, 0])])


def line_of(piece: PlanPiece) -> Spiral | Cubic:
    """The line of a piece of a plan; the stations of a cubic are its parameter."""
    start, length_m = (piece.x_m, piece.y_m), piece.length_m
    if piece.u is None or piece.v is None:
        bends = (piece.curvature_end - piece.curvature) / length_m
        return Spiral(length_m, start, piece.heading_rad, piece.curvature, bends)
    cos, sin = float(np.cos(piece.heading_rad)), float(np.sin(piece.heading_rad))
    (x0, *x), (y0, *y) = (
        [a * u + b * v for u, v in zip(piece.u, piece.v, strict=True)] for a, b in ((cos, -sin), (sin, cos))
    )
    return Cubic(piece.parameter_end, (x0 + start[0], x[0], x[1], x[2]), (y0 + start[1], y[0], y[1], y[2]))


# -- the paper's


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
        """Whether exactly one of its two flips mirrors it."""
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
        """Whether it is mirrored, as the main road's line is."""
        return self.base.is_mirrored

    def frames(self, s: AnyScalars) -> LineFrames:
        """The line at stations; its projection does without its turn."""
        inside = np.clip(s, 0, self.opening.end_m)
        points, normals, speed, turn = self.base.frames(inside)
        q, dq = self.opening.polynomial(inside)
        displaced = self.base_m + q
        sign = self.base.flips.x * self.base.flips.y
        tangents = paired(-sign * normals[..., 1], sign * normals[..., 0])
        steps = (speed - turn * displaced)[..., None] * tangents + dq[..., None] * normals
        speed = np.sqrt(dot(steps, steps))
        aside = paired(sign * steps[..., 1], -sign * steps[..., 0]) / speed[..., None]
        points = points + displaced[..., None] * normals + (s - inside)[..., None] * steps
        return LineFrames(points, aside, speed, np.zeros(np.shape(s)))

    def guess(self, xy_world: AnyPoints2) -> AnyScalars:
        """Stations of the main road's line."""
        return self.base.project(xy_world)[0]

    @cached_property
    def _plan_y(self) -> AnyScalars:
        y = self.frames(EXIT_STATIONS_M).points_world[:, 1] * self.base.flips.y
        return np.asarray(np.maximum.accumulate(y))

    def near(self, xy_world: AnyPoints2, low_m: AnyScalars, high_m: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """Which points may lie between these offsets."""
        across = self.base.across(xy_world) - self.base_m
        # An exit that leaves at an angle reaches a given y only at a much larger station.
        station = np.interp(self.base.guess(xy_world), self._plan_y, EXIT_STATIONS_M)
        return np.asarray((across > low_m) & (across < high_m + WIDER * self.opening(station + BEFORE_M)))
