"""A smooth curve through uncertain places beside a path: a robust smoothing spline with its standard deviation.

The curve is offsets at stations one metre apart. Lines of one picture are off as a whole, by errors of the picture's
pose and of the line in it, so each has unknown shifts of its own, which are estimated with the curve.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from synth3dlanes.system.arrays import Points2, Scalars

STATION_STEP_M = 1.0
# How a lane's curvature beside the path changes: the standard deviation in 1/m of its changes over a metre. Lanes are
# nearly parallel to the path, but hosts change lanes.
BEND_STD = 5e-4
# Offsets are within this of the path, as a standard deviation.
OFFSET_STD_M = 30.0
# Stations farther from any place than this have no curve.
GAP_M = 6.0
ROUNDS, TUKEY = 6, 4.0
# Range of the ratio between errors as found and as stated. The errors of a line's places are at least OWN_SHARE of its
# shifts, which are not quite linear.
SCALES, OWN_SHARE = (0.4, 3.0), 0.5
# Weight of the stated shifts, in lines.
STATED_LINES = 20
# Error of a place of a line, as a share of the error of the whole line.
PLACE_SHARE = 0.3
# Number of neighbouring places of a line that count as one: their errors are correlated.
TOGETHER = 4.0
# Stations whose offset is less certain than this have no curve.
MAX_STD_M = 1.0
# No curve is more certain than this.
LEAST_STD_M = 0.003


class SeenLine(NamedTuple):
    """A line as one picture shows it, beside the path: stations and offsets of its places; how far ahead and to the
    right of the camera each is; the standard deviations of their offsets by errors of their own; what the line's two
    shifts and an error that all pictures share, each of standard deviation one, move each by for each metre from the
    camera (the first to the right of the line of sight, the others along it); and the number of the picture."""

    s: Scalars
    d: Scalars
    sight_m: Points2
    std: Scalars
    shifts: Float[np.ndarray, "n 3"]
    picture: int = 0

    def at(self, kept: Bool[np.ndarray, " n"]) -> "SeenLine":
        s, d, sight_m, std, shifts = (values[kept] for values in self[:5])
        return SeenLine(s, d, sight_m, std, shifts, self.picture)

    @property
    def total_std(self) -> Scalars:
        """The standard deviations of the offsets by all errors, where the line leads along the path."""
        moved, own = moved_by(self.shifts, self.sight_m, self.std, np.zeros(len(self.s)))
        return np.asarray(np.sqrt(own**2 + (moved**2).sum(axis=1)))


class Smooth(NamedTuple):
    """Offsets at stations, their standard deviations, and which stations have places near them."""

    s: Scalars
    d: Scalars
    std: Scalars
    supported: Bool[np.ndarray, " n"]


def moved_by(
    shifts: Float[np.ndarray, "n 3"], sight_m: Points2, std: Scalars, slope: Scalars
) -> tuple[Float[np.ndarray, "n 3"], Scalars]:
    """What shifts move the offsets of a line by, and the standard deviations of the places' own errors. What moves a
    place along the path moves the line aside by the slope of its offsets."""
    ahead_m, aside_m = sight_m.T
    across, along = ahead_m + slope * aside_m, aside_m - slope * ahead_m
    moved = shifts * np.column_stack([across, along, along])
    return moved, np.hypot(std, PLACE_SHARE * np.hypot(*moved[:, :2].T))


def smooth(lines: list[SeenLine]) -> Smooth | None:
    """The curve through what pictures show of one line; None for places of less than four stations."""
    places = _places(lines)
    n, k = int(places.at.max()) + 1, len(lines)
    if n < 4:
        return None
    stations = np.floor(min(line.s.min() for line in lines)) + np.arange(n) * STATION_STEP_M
    solved, weight, scale, spread = None, 1.0, 1.0, np.ones(2)
    for _ in range(ROUNDS):
        # Shifts are taken at the curve of the previous round. At its own places, a line that is off to the near side
        # would count more than a line that is off to the far side.
        curve = places.d if solved is None else solved.curve[places.at]
        slope = np.zeros(len(curve)) if solved is None else np.gradient(solved.curve)[places.at]
        moved, own = moved_by(
            places.shifts, places.sight_m + [0.0, 1.0] * (curve - places.d)[:, None], places.std, slope
        )
        precision = 1 / (own**2 + LEAST_STD_M**2)
        # To the station of each place along the curve.
        target = places.d - slope * places.beyond_m
        solved = _solved(places, moved[:, :2], target, weight * precision / TOGETHER / scale**2, spread)
        left = target - solved.curve[places.at] - (moved[:, :2] * solved.shifts[places.of]).sum(axis=1)
        gap = np.abs(left) * np.sqrt(precision)
        # The variance of shifts is estimated from this line's shifts and their own variances.
        found = (solved.shifts**2).sum(axis=0) + k * solved.shift_variance
        spread = np.clip(np.sqrt((found + STATED_LINES) / (k + STATED_LINES)), *SCALES)
        scale = min(max(1.4826 * float(np.median(gap)), OWN_SHARE * float(spread.max())), SCALES[1])
        weight = np.clip(1 - (gap / (TUKEY * scale)) ** 2, 1e-6, None) ** 2
    total = np.bincount(places.at, weight, minlength=n)
    seen = np.flatnonzero(total > 0.1)
    if solved is None or not len(seen):
        return None
    shared = np.sqrt(np.bincount(places.at, weight * moved[:, 2] ** 2, minlength=n)[seen] / total[seen])
    nearest_m = np.abs(np.arange(n)[:, None] - seen[None]).min(axis=1) * STATION_STEP_M
    std = np.sqrt(solved.variance + np.interp(np.arange(n), seen, shared) ** 2 + LEAST_STD_M**2)
    return Smooth(stations, solved.curve, std, (nearest_m <= GAP_M) & (std < MAX_STD_M))


class _Places(NamedTuple):
    """One place of each picture at each station: the station's index, the line's; its offset; how far beyond the
    station it is; and the rest as a `SeenLine` has it."""

    at: Int[np.ndarray, " n"]
    of: Int[np.ndarray, " n"]
    d: Scalars
    beyond_m: Scalars
    sight_m: Points2
    std: Scalars
    shifts: Float[np.ndarray, "n 3"]


class _Solved(NamedTuple):
    """A curve at its stations, the shifts of all lines, and the variances of both."""

    curve: Scalars
    shifts: Float[np.ndarray, "k 2"]
    variance: Scalars
    shift_variance: Float[np.ndarray, "2"]


def _places(lines: list[SeenLine]) -> _Places:
    """The means of each line's places at each station: pixels of one line there are not independent."""
    s, d, sight_m, std, shifts = (np.concatenate(values) for values in zip(*(line[:5] for line in lines), strict=True))
    of = np.repeat(np.arange(len(lines)), [len(line.s) for line in lines])
    low = np.floor(s.min())
    at = np.round((s - low) / STATION_STEP_M).astype(int)
    pairs, which = np.unique(np.stack([at, of], axis=1), axis=0, return_inverse=True)
    which = which.ravel()
    count = np.bincount(which)
    columns = np.column_stack([d, s - low - at * STATION_STEP_M, std, sight_m, shifts])
    d, beyond_m, std, *rest = (np.bincount(which, column) / count for column in columns.T)
    return _Places(pairs[:, 0], pairs[:, 1], d, beyond_m, np.column_stack(rest[:2]), std, np.column_stack(rest[2:]))


def _solved(
    places: _Places, shifts: Float[np.ndarray, "n 2"], target: Scalars, weight: Scalars, spread: Float[np.ndarray, "2"]
) -> _Solved:
    """The likeliest curve and shifts, which move places by `shifts`. Those of each line are two unknowns, which are
    eliminated."""
    n, k = int(places.at.max()) + 1, int(places.of.max()) + 1
    blocks, sides, across = np.repeat(np.diag(1 / spread**2)[None], k, axis=0), np.zeros((k, 2)), np.zeros((n, k, 2))
    np.add.at(blocks, places.of, weight[:, None, None] * shifts[:, :, None] * shifts[:, None, :])
    np.add.at(sides, places.of, (weight * target)[:, None] * shifts)
    np.add.at(across, (places.at, places.of), weight[:, None] * shifts)
    inner = np.linalg.inv(blocks)
    carried = np.einsum("nki,kij->nkj", across, inner)
    system = _third_differences(n) + np.eye(n) / OFFSET_STD_M**2 + np.diag(np.bincount(places.at, weight, minlength=n))
    system -= carried.reshape(n, -1) @ across.reshape(n, -1).T
    side = np.bincount(places.at, weight * target, minlength=n) - np.einsum("nki,ki->n", carried, sides)
    factor = scipy.linalg.cho_factor(system, lower=True)
    curve = scipy.linalg.cho_solve(factor, side)
    moved = np.einsum("kij,kj->ki", inner, sides - np.einsum("nki,n->ki", across, curve))
    variance = scipy.linalg.cho_solve(factor, np.eye(n)).diagonal()
    return _Solved(curve, moved, variance, inner.diagonal(axis1=1, axis2=2).mean(axis=0))


def _third_differences(n: int) -> Float[np.ndarray, "n n"]:
    """The penalty of changes of curvature."""
    rows = np.diff(np.eye(n), 3, axis=0) / (BEND_STD * STATION_STEP_M**2.5)
    return np.asarray(rows.T @ rows)
