"""Polylines of points in any frame: lengths along them, points at equal distances, and stretches of them."""

from collections.abc import Sequence
from itertools import accumulate, pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.system.arrays import Scalars


def spaced(first: Scalars, last: Scalars, counts: Int[np.ndarray, " n"]) -> Float[np.ndarray, " _"]:
    """Evenly spaced numbers from each first to each last one, two or more, as `np.linspace` has them."""
    ends = np.cumsum(counts)
    number = np.arange(counts.sum()) - np.repeat(ends - counts, counts)
    found = np.repeat(first, counts) + number * np.repeat((last - first) / (counts - 1), counts)
    found[ends - 1] = last
    return found


def parted(values: np.ndarray, counts: Sequence[int] | Int[np.ndarray, " n"]) -> list[np.ndarray]:
    """Parts of values with these lengths, one after the other."""
    return [values[first:end] for first, end in pairwise(accumulate(map(int, counts), initial=0))]


def lengths_along(points: Float[np.ndarray, "n d"]) -> Scalars:
    """The length of a polyline from its beginning to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def resampled(points: Float[np.ndarray, "n d"], n: int) -> Float[np.ndarray, "m d"]:
    """`n` points at equal distances along a polyline."""
    lengths = lengths_along(points)
    at = np.linspace(0.0, lengths[-1], n)
    return np.column_stack([np.interp(at, lengths, column) for column in points.T])


def stretches(kept: Bool[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """The first and the last (exclusive) index of each unbroken run of true values."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
    return [(first, end) for first, end in ends.reshape(-1, 2).tolist()]


def thinned(lines: Float[np.ndarray, "n k d"], most_m: float) -> Float[np.ndarray, "m k d"]:
    """Places of lines beside each other without those between which all lines stay within `most_m`."""
    kept, stack = {0, len(lines) - 1}, [(0, len(lines) - 1)]
    while stack:
        first, last = stack.pop()
        inner, a, step = lines[first + 1 : last], lines[first], lines[last] - lines[first]
        if not len(inner):
            continue
        share = ((inner - a) * step).sum(-1) / np.maximum((step**2).sum(-1), 1e-12)
        apart = np.linalg.norm(inner - a - np.clip(share, 0, 1)[..., None] * step, axis=-1).max(axis=1)
        at = first + 1 + int(apart.argmax())
        if apart.max() > most_m:
            kept.add(at)
            stack += [(first, at), (at, last)]
    return lines[sorted(kept)]


def all_feet(
    points: Float[np.ndarray, "n d"], line: Float[np.ndarray, "k d"]
) -> tuple[Float[np.ndarray, "n m"], Float[np.ndarray, "n m"]]:
    """Distances of points from each step of a polyline, and where on it they are nearest, from 0 to 1. A line of one
    point is one step of no length."""
    return (
        feet_on_steps(points, line[:-1], np.diff(line, axis=0))
        if len(line) > 1
        else feet_on_steps(points, line, np.zeros_like(line))
    )


def feet_on_steps(
    points: Float[np.ndarray, "n d"], starts: Float[np.ndarray, "m d"], steps: Float[np.ndarray, "m d"]
) -> tuple[Float[np.ndarray, "n m"], Float[np.ndarray, "n m"]]:
    """Distances of points from each of some steps, and where on it they are nearest, from 0 to 1."""
    to, along = _offsets(points, starts), steps.T.copy()[:, None]
    share = np.clip((to * along).sum(axis=0) / np.maximum((steps**2).sum(axis=1), 1e-12), 0, 1)
    to -= share * along
    return np.sqrt((to * to).sum(axis=0)), share


def distances_between(points: Float[np.ndarray, "n d"], others: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "n k"]:
    """The distance of each point from each of the others."""
    to = _offsets(points, others)
    return np.sqrt((to * to).sum(axis=0))


def _offsets(points: Float[np.ndarray, "n d"], others: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "d n k"]:
    """A coordinate at a time in memory: sums over rows of two or three numbers take numpy four times as long."""
    return points.T.copy()[:, :, None] - others.T.copy()[:, None]


def feet_of(
    points: Float[np.ndarray, "n d"], line: Float[np.ndarray, "k d"]
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Distances of points from a polyline, the steps of it that are nearest, and where on these, from 0 to 1."""
    away, share = all_feet(points, line)
    every, at = np.arange(len(points)), away.argmin(axis=1)
    return away[every, at], at, share[every, at]
