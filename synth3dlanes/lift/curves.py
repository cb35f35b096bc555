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
BEND = 2e-4
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


class Sight(NamedTuple):
    """A line as one picture shows it, beside the path: stations and offsets of its places; the standard deviations of
    their offsets by errors of their own; what the line's shifts, each of standard deviation one, move each by; its
    error that all pictures share; and the number of the picture."""

    s: Scalars
    d: Scalars
    std: Scalars
    shifts: Float[np.ndarray, "n 2"]
    shared: Scalars
    picture: int = 0

    def at(self, kept: Bool[np.ndarray, " n"]) -> "Sight":
        """Some of the places."""
        s, d, std, shifts, shared = (values[kept] for values in self[:5])
        return Sight(s, d, std, shifts, shared, self.picture)

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


def smooth(sights: list[Sight]) -> Smooth | None:
    """The curve through the sights of one line; None for places of less than four stations."""
    s, d, std, shifts, shared = (
        np.concatenate(values) for values in zip(*(sight[:5] for sight in sights), strict=True)
    )
    of = np.repeat(np.arange(len(sights)), [len(sight.s) for sight in sights])
    low = np.floor(s.min())
    n = int(np.ceil(s.max()) - low) + 1
    if n < 4:
        return None
    stations = low + np.arange(n) * STEP_M
    at, of, mean = _by_station(np.round(s - low).astype(int), of, np.column_stack([s, d, std, shifts, shared]))
    s, d, std, first, second, shared = mean.T
    shifts = np.column_stack([first, second])
    precision = 1 / (std**2 + LEAST_STD_M**2) / TOGETHER
    base = _third_differences(n) + np.eye(n) / ASIDE_M**2
    curve, moves, weight, scale = np.zeros(n), np.zeros((len(sights), 2)), np.ones(len(d)), 1.0
    spread = np.ones(2)
    for _ in range(ROUNDS):
        w = weight * precision / scale**2
        # To the station of each place along the curve found so far.
        target = d - np.gradient(curve)[at] * (s - stations[at])
        system, side, blocks, sides = _normal(n, len(sights), at, of, w, shifts, spread, target)
        inner = np.linalg.inv(blocks)
        joint = base + np.diag(system)
        # The shifts of each sight are eliminated: two unknowns each.
        across = np.zeros((n, len(sights), 2))
        np.add.at(across, (at, of), w[:, None] * shifts)
        carried = np.einsum("nki,kij->nkj", across, inner)
        joint -= np.einsum("nki,mki->nm", carried, across, optimize=True)
        factor = cho_factor(joint, lower=True)
        curve = cho_solve(factor, side - np.einsum("nki,ki->n", carried, sides))
        moves = np.einsum("kij,kj->ki", inner, sides - np.einsum("nki,n->ki", across, curve))
        gap = np.abs(target - curve[at] - (shifts * moves[of]).sum(axis=1)) * np.sqrt(precision * TOGETHER)
        # How large shifts are is found from those of this very line, as they are and as they may be.
        spread = np.sqrt((moves**2).mean(axis=0) + inner.diagonal(axis1=1, axis2=2).mean(axis=0))
        spread = np.clip(spread, *SCALES)
        scale = max(1.4826 * float(np.median(gap)), OWN_SHARE * float(spread.max()))
        scale = min(scale, SCALES[1])
        weight = np.clip(1 - (gap / (TUKEY * scale)) ** 2, 1e-6, None) ** 2
    variance = cho_solve(factor, np.eye(n)).diagonal()
    total = np.bincount(at, weight, minlength=n)
    common = np.sqrt(np.bincount(at, weight * shared**2, minlength=n) / np.maximum(total, 1e-9))
    seen = np.flatnonzero(total > 0.1)
    if not len(seen):
        return None
    common = np.interp(np.arange(n), seen, common[seen])
    nearest = np.abs(np.arange(n)[:, None] - seen[None]).min(axis=1) * STEP_M
    std = np.sqrt(variance + common**2 + LEAST_STD_M**2)
    return Smooth(stations, curve, std, (nearest <= GAP_M) & (std < MAX_STD_M))


def _by_station(
    station: Int[np.ndarray, " n"], of: Int[np.ndarray, " n"], values: Float[np.ndarray, "n k"]
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"], Float[np.ndarray, "m k"]]:
    """The means of each sight's values at each station: pixels of one sight there are not independent."""
    pairs, which = np.unique(np.stack([station, of], axis=1), axis=0, return_inverse=True)
    which = which.ravel()
    count = np.bincount(which)
    mean = np.stack([np.bincount(which, column) / count for column in values.T], axis=1)
    return pairs[:, 0], pairs[:, 1], mean


def _normal(
    n: int, k: int, at: np.ndarray, of: np.ndarray, w: Scalars, shifts: np.ndarray, spread: np.ndarray, target: Scalars
) -> tuple[Scalars, Scalars, Float[np.ndarray, "k 2 2"], Float[np.ndarray, "k 2"]]:
    """The parts of the normal equations: stations, their right sides, and the same of the shifts."""
    blocks = np.repeat(np.diag(1 / spread**2)[None], k, axis=0)
    np.add.at(blocks, of, w[:, None, None] * shifts[:, :, None] * shifts[:, None, :])
    sides = np.zeros((k, 2))
    np.add.at(sides, of, (w * target)[:, None] * shifts)
    return np.bincount(at, w, minlength=n), np.bincount(at, w * target, minlength=n), blocks, sides


def _third_differences(n: int) -> Float[np.ndarray, "n n"]:
    """The penalty of changes of curvature."""
    rows = np.diff(np.eye(n), 3, axis=0) / (BEND * STEP_M**2.5)
    return np.asarray(rows.T @ rows)
