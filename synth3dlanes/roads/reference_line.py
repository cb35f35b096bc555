"""Reference lines: curves on the ground from above, along which roads are laid. World frame, metres.

A place on a line is (s, t): its station s, and t metres beside the line along its normal. t grows to the right of
growing s; on a mirrored line to the left.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.system.arrays import AnyPoints2, AnyScalars

# Enough for a projection to converge below 1e-6 m within 30 m of a road with the sharpest bend drawn.
NEWTON_STEPS = 4
# After steps below this, a projection has converged.
SETTLED_M = 1e-9
# Distance between the places of first guesses.
GUESS_STEP_M = 4.0
# Longest Newton step, and the least speed along the line that it assumes, as a share of the true one.
MAX_STEP_M, MIN_SHARE = 20.0, 0.3


class LineFrames(NamedTuple):
    """A line at stations: its points, unit normals to where t grows, metres per station, and the turn of its heading to
    that side in radians per station."""

    points_world: AnyPoints2
    normals: AnyPoints2
    speed: AnyScalars
    turn: AnyScalars


def paired(x: AnyScalars, y: AnyScalars) -> AnyPoints2:
    """Vectors by their components. Of few, as of most queries, np.stack takes ten times as long."""
    both = np.zeros((*x.shape, 2))
    both[..., 0], both[..., 1] = x, y
    return both


def dot(a: AnyPoints2, b: AnyPoints2) -> AnyScalars:
    """The scalar products of vectors; as a sum along an axis they take longer, too."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1])


@dataclass(frozen=True)
class Offset:
    """t(s) of a line beside a reference line: a constant, and what moves it along the road."""

    base_m: float
    moves: Callable[[AnyScalars], AnyScalars] | None = None

    def __call__(self, s: AnyScalars) -> AnyScalars:
        """The offsets at stations."""
        return np.full(s.shape, self.base_m) if self.moves is None else np.asarray(self.base_m + self.moves(s))

    def shifted(self, t_m: float) -> "Offset":
        """The line `t_m` beside it."""
        return replace(self, base_m=self.base_m + t_m)

    @property
    def order(self) -> tuple[float, bool]:
        """Sorts lanes as t grows: one that opens lies beyond its neighbour, where it begins."""
        return self.base_m, self.moves is not None


class ReferenceLine(ABC):
    """A line by its frames, and by a first guess of the station next to a point."""

    @abstractmethod
    def frames(self, s: AnyScalars) -> LineFrames:
        """The line at stations."""

    @abstractmethod
    def guess(self, xy_world: AnyPoints2) -> AnyScalars:
        """Stations near those of points, for the first step of `project`."""

    @property
    def is_mirrored(self) -> bool:
        """Whether t grows to the left of growing s."""
        return False

    @property
    def parts(self) -> Sequence["ReferenceLine"]:
        """The lines that it consists of, one after the other."""
        return (self,)

    @property
    def starts(self) -> Float[np.ndarray, " k"]:
        """Where each of these begins; from there on its own stations count."""
        return np.zeros(1)

    def within(self, start_m: float, end_m: float) -> "ReferenceLine":
        """The line of its parts that are between two stations, each with all its length."""
        return self

    def xy(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints2:
        """World (x, y) of places."""
        points, normals, _, _ = self.frames(s)
        return np.asarray(points + np.asarray(t)[..., None] * normals)

    def speed(self, s: AnyScalars) -> AnyScalars:
        """Metres per station."""
        return self.frames(s).speed

    def project(self, xy_world: AnyPoints2, guess: AnyScalars | None = None) -> tuple[AnyScalars, AnyScalars]:
        """(s, t) of points near the line: Newton's method on the perpendicular foot."""
        s = self.guess(xy_world) if guess is None else guess
        sign = -1.0 if self.is_mirrored else 1.0
        for _ in range(NEWTON_STEPS):
            points, normals, speed, turn = self.frames(s)
            to = xy_world - points
            along = sign * (to[..., 1] * normals[..., 0] - to[..., 0] * normals[..., 1])
            t = dot(to, normals)
            step = np.clip(along / np.maximum(speed - turn * t, MIN_SHARE * speed), -MAX_STEP_M, MAX_STEP_M)
            s = s + step
            if not (np.abs(step) > SETTLED_M).any():
                break
        points, normals, _, _ = self.frames(s)
        return s, dot(xy_world - points, normals)

    def near(self, xy_world: AnyPoints2, low_m: AnyScalars, high_m: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """Which points may lie between these offsets."""
        _, t = self.project(xy_world)
        return np.asarray((t > low_m) & (t < high_m))
