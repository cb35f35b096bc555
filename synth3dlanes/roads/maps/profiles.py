"""Cubic pieces of functions along a road, as OpenDRIVE has them."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.scene.road_map import Polynomial
from synth3dlanes.system.arrays import Scalars


class CubicPiece(NamedTuple):
    """A cubic in the distance from `s`: rows are constant, linear, quadratic and cubic coefficients, one column per
    function; it ends at `end`."""

    s: float
    end: float
    abcd: Float[np.ndarray, "4 k"]


def pieces(
    s: Scalars, values: Float[np.ndarray, "m k"], tolerance: float, unit_speed: bool = False
) -> list[CubicPiece]:
    """Cubics with equal slopes where they meet, none farther than `tolerance` from the values at the stations `s`: the
    fewest that halving gives. With `unit_speed` the values are points of a curve by its length."""
    slopes = np.gradient(values, s, axis=0, edge_order=2)
    if unit_speed:
        slopes /= np.linalg.norm(slopes, axis=1, keepdims=True)

    def cover(first: int, last: int) -> list[CubicPiece]:
        length, change = s[last] - s[first], values[last] - values[first]
        constant, linear, mean, end = values[first], slopes[first], change / length, slopes[last]
        abcd = np.stack(
            [constant, linear, (3 * mean - 2 * linear - end) / length, (linear + end - 2 * mean) / length**2]
        )
        u = s[first : last + 1] - s[first]
        error = np.linalg.norm(u[:, None] ** np.arange(4) @ abcd - values[first : last + 1], axis=1)
        if last == first + 1 or error.max() <= tolerance:
            return [CubicPiece(float(s[first]), float(s[last]), abcd)]
        middle = (first + last) // 2
        return cover(first, middle) + cover(middle, last)

    return cover(0, len(s) - 1)


def knots(s: Scalars, values: Float[np.ndarray, "m k"], tolerance: float) -> list[int]:
    """Indices of stations `s`, the first and last among them, between which straight lines are never farther than
    `tolerance` from the values: the fewest that halving gives."""

    def cover(first: int, last: int) -> list[int]:
        share = ((s[first : last + 1] - s[first]) / (s[last] - s[first]))[:, None]
        straight = values[first] + share * (values[last] - values[first])
        if last == first + 1 or np.abs(straight - values[first : last + 1]).max() <= tolerance:
            return [last]
        middle = (first + last) // 2
        return cover(first, middle) + cover(middle, last)

    return [0, *cover(0, len(s) - 1)]


def cubics(s: Scalars, values: Scalars, tolerance: float) -> Iterator[Polynomial]:
    """A value along a road as cubics, none farther than `tolerance` from it at its stations."""
    for piece in pieces(s, values[:, None], tolerance):
        a, b, c, d = piece.abcd[:, 0].tolist()
        yield Polynomial(s_m=piece.s, a=a, b=b, c=c, d=d)
