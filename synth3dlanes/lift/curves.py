"""A smooth curve through uncertain places beside a path: a robust smoothing spline with its standard deviation.

The curve is offsets at stations one metre apart. Lines of one picture are off as a whole, by errors of the picture's
pose and of the line in it, so each has unknown shifts of its own, which are estimated with the curve.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import cho_factor, cho_solve

from synth3dlanes.arrays import Scalars

STEP_M = 1.0
# How a lane's curvature beside the path changes: the standard deviation in 1/m of its changes over a metre. Lanes are
# nearly parallel to the path, but hosts change lanes.
BEND = 5e-4
# Offsets are within this of the path, as a standard deviation.
ASIDE_M = 30.0
# Stations farther from any place than this have no curve.
GAP_M = 6.0
ROUNDS, TUKEY = 6, 4.0
# Errors may be so many times what they are said to be. Those of the places of a line are no less than this share of
# its shifts, which are not quite linear.
SCALES, OWN_SHARE = (0.4, 3.0), 0.5
# So many neighbouring places of a line count as one: they are off together.
TOGETHER = 4.0
# Stations whose offset is less certain than this have no curve.
MAX_STD_M = 1.0
# No curve is more certain than this.
LEAST_STD_M = 0.003


class SeenLine(NamedTuple):
    """A line as one picture shows it, beside the path: stations and offsets of its places; the standard deviations of
    their offsets by errors of their own; what the line's shifts, each of standard deviation one, move each by; its
    error that all pictures share; and the number of the picture."""

    s: Scalars
    d: Scalars
    std: Scalars
    shifts: Float[np.ndarray, "n 2"]
    shared: Scalars
    picture: int = 0

    def at(self, kept: Bool[np.ndarray, " n"]) -> "SeenLine":
        """Some of the places."""
        s, d, std, shifts, shared = (values[kept] for values in self[:5])
        return SeenLine(s, d, std, shifts, shared, self.picture)

    @property
    def total_std(self) -> Scalars:
        """The standard deviations of the offsets by all errors."""
        return np.asarray(np.sqrt(self.std**2 + (self.shifts**2).sum(axis=1) + self.shared**2))


class Smooth(NamedTuple):
    """Offsets at stations, their standard deviations, and which stations have places near them."""

    s: Scalars
    d: Scalars
    std: Scalars
    supported: Bool[np.ndarray, " n"]


def smooth(lines: list[SeenLine]) -> Smooth | None:
    """The curve through what pictures show of one line; None for places of less than four stations."""
    places = _places(lines)
    n, k = int(places.at.max()) + 1, len(lines)
    if n < 4:
        return None
    stations = np.floor(min(line.s.min() for line in lines)) + np.arange(n) * STEP_M
    solved, weight, scale, spread = (
        _Solved(np.zeros(n), np.zeros((k, 2)), np.zeros(n), np.zeros(2)),
        1.0,
        1.0,
        np.ones(2),
    )
    for _ in range(ROUNDS):
        # To the station of each place along the curve found so far.
        target = places.d - np.gradient(solved.curve)[places.at] * places.beyond_m
        solved = _solved(places, target, weight * places.precision / TOGETHER / scale**2, spread)
        left = target - solved.curve[places.at] - (places.shifts * solved.shifts[places.of]).sum(axis=1)
        gap = np.abs(left) * np.sqrt(places.precision)
        # How large shifts are is found from those of this very line, as they are and as they may be.
        spread = np.clip(np.sqrt((solved.shifts**2).mean(axis=0) + solved.shift_variance), *SCALES)
        scale = min(max(1.4826 * float(np.median(gap)), OWN_SHARE * float(spread.max())), SCALES[1])
        weight = np.clip(1 - (gap / (TUKEY * scale)) ** 2, 1e-6, None) ** 2
    total = np.bincount(places.at, weight, minlength=n)
    seen = np.flatnonzero(total > 0.1)
    if not len(seen):
        return None
    shared = np.sqrt(np.bincount(places.at, weight * places.shared**2, minlength=n)[seen] / total[seen])
    nearest_m = np.abs(np.arange(n)[:, None] - seen[None]).min(axis=1) * STEP_M
    std = np.sqrt(solved.variance + np.interp(np.arange(n), seen, shared) ** 2 + LEAST_STD_M**2)
    return Smooth(stations, solved.curve, std, (nearest_m <= GAP_M) & (std < MAX_STD_M))


class _Places(NamedTuple):
    """One place of each picture at each station: the station's index, the line's; its offset; how far beyond the
    station it is; the inverse of the variance of its own error; its shifts and shared error."""

    at: Int[np.ndarray, " n"]
    of: Int[np.ndarray, " n"]
    d: Scalars
    beyond_m: Scalars
    precision: Scalars
    shifts: Float[np.ndarray, "n 2"]
    shared: Scalars


class _Solved(NamedTuple):
    """A curve at its stations, the shifts of all lines, and the variances of both."""

    curve: Scalars
    shifts: Float[np.ndarray, "k 2"]
    variance: Scalars
    shift_variance: Float[np.ndarray, "2"]


def _places(lines: list[SeenLine]) -> _Places:
    """The means of each line's places at each station: pixels of one line there are not independent."""
    s, d, std, shifts, shared = (np.concatenate(values) for values in zip(*(line[:5] for line in lines), strict=True))
    of = np.repeat(np.arange(len(lines)), [len(line.s) for line in lines])
    low = np.floor(s.min())
    at = np.round((s - low) / STEP_M).astype(int)
    pairs, which = np.unique(np.stack([at, of], axis=1), axis=0, return_inverse=True)
    which = which.ravel()
    count = np.bincount(which)
    columns = np.column_stack([d, s - low - at * STEP_M, std, shifts, shared])
    d, beyond_m, std, first, second, shared = (np.bincount(which, column) / count for column in columns.T)
    precision = 1 / (std**2 + LEAST_STD_M**2)
    return _Places(pairs[:, 0], pairs[:, 1], d, beyond_m, precision, np.column_stack([first, second]), shared)


def _solved(places: _Places, target: Scalars, weight: Scalars, spread: Float[np.ndarray, "2"]) -> _Solved:
    """The likeliest curve and shifts. The shifts of each line are two unknowns, which are eliminated."""
    n, k = int(places.at.max()) + 1, int(places.of.max()) + 1
    shifts = places.shifts
    blocks, sides, across = np.repeat(np.diag(1 / spread**2)[None], k, axis=0), np.zeros((k, 2)), np.zeros((n, k, 2))
    np.add.at(blocks, places.of, weight[:, None, None] * shifts[:, :, None] * shifts[:, None, :])
    np.add.at(sides, places.of, (weight * target)[:, None] * shifts)
    np.add.at(across, (places.at, places.of), weight[:, None] * shifts)
    inner = np.linalg.inv(blocks)
    carried = np.einsum("nki,kij->nkj", across, inner)
    system = _third_differences(n) + np.eye(n) / ASIDE_M**2 + np.diag(np.bincount(places.at, weight, minlength=n))
    system -= carried.reshape(n, -1) @ across.reshape(n, -1).T
    side = np.bincount(places.at, weight * target, minlength=n) - np.einsum("nki,ki->n", carried, sides)
    factor = cho_factor(system, lower=True)
    curve = cho_solve(factor, side)
    moved = np.einsum("kij,kj->ki", inner, sides - np.einsum("nki,n->ki", across, curve))
    variance = cho_solve(factor, np.eye(n)).diagonal()
    return _Solved(curve, moved, variance, inner.diagonal(axis1=1, axis2=2).mean(axis=0))


def _third_differences(n: int) -> Float[np.ndarray, "n n"]:
    """The penalty of changes of curvature."""
    rows = np.diff(np.eye(n), 3, axis=0) / (BEND * STEP_M**2.5)
    return np.asarray(rows.T @ rows)
