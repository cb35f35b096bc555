"""Reference lines of maps: spirals, with straight lines and arcs among them, cubics, polylines, and chains of these.
World frame, metres; stations are lengths, of a cubic its parameter."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.roads.maps.cubics import SAME_M
from synth3dlanes.roads.reference_line import GUESS_STEP_M, LineFrames, ReferenceLine, paired
from synth3dlanes.scene.road_map import PlanPiece
from synth3dlanes.system.arrays import AnyPoints2, AnyScalars, Polyline2

# Numbers of nodes on [0, 1] for integrals along a spiral, exact to a nanometre up to a few turns. A spiral that turns
# by at most FEW_RAD, as most do between their beginning and a place, needs few.
MANY_NODES, FEW_NODES, FEW_RAD = 40, 10, 1.5
# An arc of less curvature (1/m) is a parabola here, to a tenth of a millimetre in a kilometre.
STRAIGHT = 1e-9
# Steps in which lengths along a cubic are measured.
CUBIC_STEPS = 2000
# Metres per parameter; what is slower stands still.
LEAST_SPEED = 1e-9


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
        """Those of all lines, if each is a spiral."""
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
