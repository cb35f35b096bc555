"""Results of checks: findings and their words, and measured values as distributions of constant size."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

# Bands of distance ahead of the camera; the guarantees of docs/validate.md hold up to PROOF_M.
PROOF_M = 40.0
BANDS_M = (0.0, 10.0, 20.0, PROOF_M, 80.0, np.inf)
BAND_NAMES = ("0-10 m", "10-20 m", "20-40 m", "40-80 m", "80+ m")
# Values are counted in bins 10 % wide, so that the memory does not grow with the dataset; values below the first edge
# count as 0.
EDGES = 1e-4 * 1.1 ** np.arange(180)
WORST = 5


class Finding(NamedTuple):
    """A fault of a sample, and its lane ("" for none in particular)."""

    lane: str
    reason: str


class Problem(NamedTuple):
    """A fault of a dataset: the sample (`train:00000017`) or file, the lane ("" for none in particular), the reason."""

    where: str
    lane: str
    reason: str

    def line(self) -> str:
        """The problem in one line."""
        reason = " ".join(self.reason.split())
        return ": ".join(part for part in (self.where, self.lane, reason) if part)


class Measure(NamedTuple):
    """Values of one kind and the distance ahead of each; those named `*_visible` are 1 where pixels disagree."""

    name: str
    y_m: Float[np.ndarray, " n"]
    values: Float[np.ndarray, " n"]

    def worst(self) -> float:
        """The value that ranks a sample: the largest within PROOF_M, or the sum for `*_visible`."""
        near = self.values[self.y_m < PROOF_M]
        return float(near.sum() if self.name.endswith("visible") else near.max(initial=0.0))


class Signed(NamedTuple):
    """One sample's signed value for a test over the whole data set; its mean is 0 if images and labels show the same
    world. `name` is a key of `bias.TESTS`."""

    name: str
    value: float


class Bounded(NamedTuple):
    """A number of a sample and the limits between which it is in a correct one. A finding tells of one beyond them; the
    number itself tells how well the limits still fit (`tests.validate.limits`)."""

    name: str
    value: float
    least: float = -np.inf
    most: float = np.inf

    @property
    def is_beyond(self) -> bool:
        """Whether it is beyond its limits, or not a number."""
        return not self.least <= self.value <= self.most


class MovingObject(NamedTuple):
    """Where an object stands on the road, metres, and its velocity there, metres per second; None without a time. World
    frame."""

    foot_world: Float[np.ndarray, "3"]
    velocity_world: Float[np.ndarray, "3"] | None


class Instant(NamedTuple):
    """The objects of a picture by their numbers, its scene, and its time in the clip. Pictures of one scene are
    compared with each other (`moving.between`)."""

    scene: str
    time_s: float
    objects: Mapping[int, MovingObject]


# What a check of a sample yields.
Result = Finding | Measure | Signed | Bounded | Instant


def findings_of(results: Iterable[Result]) -> list[Finding]:
    """The findings among results."""
    return [result for result in results if isinstance(result, Finding)]


@dataclass
class RangeHistogram:
    """A histogram of values for each band of distance."""

    counts: Int[np.ndarray, "bands bins"] = field(
        default_factory=lambda: np.zeros((len(BAND_NAMES), len(EDGES) + 1), dtype=int)
    )
    totals: Float[np.ndarray, " bands"] = field(default_factory=lambda: np.zeros(len(BAND_NAMES)))

    def add(self, measure: Measure) -> None:
        """Count the values of one more sample."""
        bands = np.searchsorted(BANDS_M, measure.y_m, side="right") - 1
        np.add.at(self.counts, (bands, np.searchsorted(EDGES, measure.values, side="right")), 1)
        np.add.at(self.totals, bands, measure.values)

    def summary(self, bands: slice) -> dict[str, float]:
        """Count, mean and percentiles of a range of bands; a percentile is its bin's upper edge."""
        counts = self.counts[bands].sum(axis=0)
        n = int(counts.sum())
        if n == 0:
            return {"n": 0}
        cumulative = np.cumsum(counts)
        at = [int(np.searchsorted(cumulative, q / 100 * n)) for q in (50, 95, 99)]
        upper = [0.0 if i == 0 else float(EDGES[min(i, len(EDGES) - 1)]) for i in at]
        mean = float(self.totals[bands].sum()) / n
        return {"n": n, "mean": mean, "median": upper[0], "p95": upper[1], "p99": upper[2]}


def judged(
    name: str, value: float, reason: str, least: float = -np.inf, most: float = np.inf, lane: str = ""
) -> Iterator[Result]:
    """A number of a sample between its limits, or a finding."""
    number = Bounded(name, value, least, most)
    yield number
    if number.is_beyond:
        yield Finding(lane, reason)


def counted(
    name: str, wrong: Bool[np.ndarray, " n"], reason: str, single: int, share: float = 0.0, lane: str = ""
) -> Iterator[Result]:
    """The number of what is wrong: at most `single`, or a share of all, or a finding. In the reason, {wrong} and {n}
    are the numbers of what is wrong and of all."""
    n, n_wrong = len(wrong), int(np.count_nonzero(wrong))
    yield from judged(name, n_wrong, reason.format(wrong=n_wrong, n=n), most=max(single, share * n), lane=lane)
