"""Histograms of parameters and label quantities: counts in bins, and the counts that are expected as declared."""

import math
import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.draw.rules import CONDITIONED
from synth3dlanes.figures.stats import Cases, LabelStatistics, ParameterStatistics, SceneStatistics, is_fine, numbers
from synth3dlanes.params.distributions import Choice, Distribution, Integers, Uniform
from synth3dlanes.system.arrays import Scalars

_UNITS = {"m": "m", "deg": "°", "px": "px"}
# Greatest number of values of a discrete parameter that get a bin each.
_MAX_SINGLE_BINS = 30


@dataclass(frozen=True, eq=False)
class Histogram:
    """Counts of one quantity between `edges`.

    `quantity` names the horizontal axis with its unit. `expected` is the count in each bin by the declared
    distribution, None for label quantities; `is_fine` is false for a parameter that is not as declared.
    """

    title: str
    quantity: str
    edges: Float[np.ndarray, " e"]
    counts: Float[np.ndarray, " n"]
    expected: Float[np.ndarray, " n"] | None
    is_fine: bool

    @property
    def is_of_integers(self) -> bool:
        """Whether each bin is that of an integer."""
        return bool((self.edges % 1 == 0.5).all())


def histograms(scenes: SceneStatistics, labels: LabelStatistics | None) -> list[Histogram]:
    """One histogram for each label quantity and for each parameter that varies."""
    measured = {} if labels is None else labels.measured
    varying = [row for row in scenes.parameters if row.count and row.minimum < row.maximum]
    return [
        *(_of_labels(name, values) for name, values in measured.items() if values.size),
        *(_of_parameter(row, scenes.declared[row.key], scenes.drawn[row.key]) for row in varying),
    ]


def _of_labels(name: str, values: Scalars) -> Histogram:
    # Of few values, these are the first and the last.
    low, high = np.percentile(values, [0.5, 99.5], method="closest_observation")
    is_whole = bool((values % 1 == 0).all()) and high - low < _MAX_SINGLE_BINS
    edges = _single_bins(low, high) if is_whole else np.linspace(low, max(high, low + 1e-6), 41)
    return Histogram(name.partition(" [")[0], name, edges, np.histogram(values, edges)[0].astype(float), None, True)


def _of_parameter(row: ParameterStatistics, declared: Cases, values: Scalars) -> Histogram:
    edges = _edges(row, declared)
    _, _, key = row.key.partition(".")
    name, unit = re.fullmatch(r"(.*?)(?:_(m|deg|px))?", key).groups()  # type: ignore[union-attr]
    quantity = name.replace("_", " ") + (f" [{_UNITS[unit]}]" if unit else "")
    title = f"{row.key} ({CONDITIONED[row.key]})" if row.key in CONDITIONED else row.key
    return Histogram(
        title,
        quantity,
        edges,
        np.histogram(values, edges)[0].astype(float),
        np.sum([count * declared_shares(case, edges) for case, count in declared], axis=0),
        is_fine(row),
    )


def _edges(row: ParameterStatistics, declared: Cases) -> Float[np.ndarray, " e"]:
    """Bins over the declared range and all values; one for each value of a discrete parameter with few values."""
    low, high = min(row.low, row.minimum), max(row.high, row.maximum)
    if all(_is_whole(case) for case, _ in declared) and high - low < _MAX_SINGLE_BINS:
        return _single_bins(low, high)
    return np.linspace(low, high, 21)


def _is_whole(declared: Distribution) -> bool:
    if isinstance(declared, Choice):
        return all(isinstance(value, str) or float(value).is_integer() for value in declared.values)
    return isinstance(declared, Integers)


def _single_bins(low: float, high: float) -> Float[np.ndarray, " e"]:
    """Edges of a bin for each integer."""
    return np.arange(math.floor(low) - 0.5, math.ceil(high) + 1)


def declared_shares(declared: Distribution, edges: Float[np.ndarray, " e"]) -> Scalars:
    """The probability of each bin."""
    if isinstance(declared, Uniform) and declared.high > declared.low:
        return np.diff(np.clip((edges - declared.low) / (declared.high - declared.low), 0.0, 1.0))
    if isinstance(declared, Choice):
        values, weights = numbers(declared), np.array(declared.weights)
    else:
        values = np.arange(declared.low, declared.high + 1, dtype=float)
        weights = np.ones(len(values))
    return np.asarray(np.histogram(values, edges, weights=weights / weights.sum())[0])
