"""Histograms as paths of an SVG."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.ticker import MaxNLocator

from synth3dlanes.figures.histograms import Histogram

_WIDTH, _HEIGHT = 260, 160
# Half of the longest number fits beside the last tick.
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 20, 8, 32

Ticks = list[tuple[float, str]]


class Plot(NamedTuple):
    """A histogram in pixels: paths of its bars, its declared distribution ("" without one) and its axes, and its ticks
    as (place, text). `kind` is measured, good or bad."""

    title: str
    quantity: str
    label: str
    kind: str
    bars: str
    declared: str
    axes: str
    ticks_x: Ticks
    ticks_y: Ticks
    width: int = _WIDTH
    height: int = _HEIGHT
    left: int = _LEFT


def plot(histogram: Histogram) -> Plot:
    edges, counts, expected = histogram.edges, histogram.counts, histogram.expected
    highest = max(counts.max(), 0.0 if expected is None else expected.max(), 1.0) * 1.05
    bottom, right = _HEIGHT - _BOTTOM, _WIDTH - _RIGHT

    def x(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.asarray(_LEFT + (values - edges[0]) / (edges[-1] - edges[0]) * (right - _LEFT))

    def y(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.asarray(bottom - values / highest * (bottom - _TOP))

    def stairs(heights: Float[np.ndarray, " n"]) -> str:
        corners = zip(np.repeat(x(edges), 2)[1:-1].tolist(), np.repeat(y(heights), 2).tolist(), strict=True)
        return f"M{_LEFT},{bottom}" + "".join(f"L{u:.1f},{v:.1f}" for u, v in corners) + f"L{right},{bottom}"

    at_x, at_y = _ticks(edges[0], edges[-1], 5, histogram.is_of_integers), _ticks(0.0, highest, 3, True)
    places_x, places_y = x(at_x).tolist(), y(at_y).tolist()
    marks = [f"M{u:.1f},{bottom}v4" for u in places_x] + [f"M{_LEFT},{v:.1f}h-4" for v in places_y]
    words = f"{histogram.title}: {counts.sum():.0f} values from {edges[0]:.4g} to {edges[-1]:.4g}"
    return Plot(
        histogram.title,
        histogram.quantity,
        words if histogram.is_fine else f"{words}, not as declared",
        "measured" if expected is None else "good" if histogram.is_fine else "bad",
        stairs(counts),
        "" if expected is None else stairs(expected),
        f"M{_LEFT},{_TOP}V{bottom}H{right}" + "".join(marks),
        list(zip(places_x, (f"{value:g}" for value in at_x), strict=True)),
        list(zip(places_y, (f"{value:g}" for value in at_y), strict=True)),
    )


def _ticks(low: float, high: float, n: int, is_whole: bool) -> Float[np.ndarray, " n"]:
    """At most n + 1 round values in the range."""
    values = np.asarray(MaxNLocator(n, steps=[1, 2, 5, 10], integer=is_whole).tick_values(low, high))
    return np.round(values[(values >= low) & (values <= high)], 12) + 0.0
