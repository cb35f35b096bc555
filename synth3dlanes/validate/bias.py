"""Tests over a whole data set: means of the samples' signed values, 0 if images and labels show the same world.

An error too small to be found in one sample, such as a slightly different focal length, biases all samples in the same
direction. A test fails if the mean is both statistically significant and large enough to matter: with many samples even
micrometres become significant. No pixels, no files; the memory does not grow with the data set.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from synth3dlanes.validate.findings import Problem

DATA_SET = "data set"
# Significance level of Student's t-test, and the least number of samples to test.
CHANCE, MIN_SAMPLES = 1e-4, 4


class MeanTest(NamedTuple):
    """The least mean that matters (metres, or a share), and the words of its finding: unit, expectation, direction of
    positive and negative means, possible causes."""

    least: float
    unit: str
    expected: str
    positive: str
    negative: str
    differs: str

    def shown(self, value: float) -> str:
        """A value in the test's unit."""
        return f"{100 * value:.2g} {self.unit}"


_WIDTH = "lane width, lane offsets or focal length of images and labels differ"
_SIDE = "principal point, columns of pixels or the host's place in its lane differ between images and labels"
TESTS = {
    "paint_outward_m": MeanTest(0.002, "cm", "paint under its labels", "outward", "inward", _WIDTH),
    "paint_right_m": MeanTest(0.002, "cm", "paint under its labels", "to the right", "to the left", _SIDE),
    "exit_opening": MeanTest(
        0.002,
        "cm",
        "the exit's paint under its labels",
        "a metre farther out",
        "a metre farther in",
        "the exit's angle or course in images and labels differs",
    ),
    "surface_above_m": MeanTest(
        0.002,
        "cm",
        "the rendered road at its labels' height",
        "above",
        "below",
        "depth, camera height, pitch or focal length of passes and labels differ",
    ),
    "focal_length": MeanTest(
        0.002, "%", "the labels' focal length", "more", "less", "focal lengths of passes and labels differ"
    ),
    "depth_scale": MeanTest(
        0.002, "%", "depth in the labels' metres", "more", "less", "scales of depth and labels differ"
    ),
    "relief": MeanTest(
        0.003,
        "%",
        "the labels' hills",
        "higher ones",
        "lower ones",
        "heights of the terrain in passes and labels differ",
    ),
    "ramp": MeanTest(
        0.02, "%", "the labels' ramp", "a higher one", "a lower one", "heights of the ramp in passes and labels differ"
    ),
    "image_outward_m": MeanTest(0.006, "cm", "paint in the image under its labels", "outward", "inward", _WIDTH),
    "image_right_m": MeanTest(0.006, "cm", "paint in the image under its labels", "to the right", "to the left", _SIDE),
}


@dataclass
class RunningMean:
    """A running mean and the sum of squared deviations from it (Welford's algorithm)."""

    n: int = 0
    mean: float = 0.0
    squares: float = 0.0

    def add(self, value: float) -> None:
        """Add one value."""
        self.n += 1
        step = value - self.mean
        self.mean += step / self.n
        self.squares += step * (value - self.mean)

    @property
    def standard_error(self) -> float:
        """The standard error of the mean; 0 for fewer than two values."""
        return float(np.sqrt(self.squares / (self.n - 1) / self.n)) if self.n > 1 else 0.0

    @property
    def t(self) -> float:
        """The mean in standard errors."""
        return self.mean / self.standard_error if self.standard_error > 0 else float(np.sign(self.mean)) * np.inf

    def fails(self, least: float) -> bool:
        """Whether the mean exceeds `least` and differs significantly from 0."""
        if self.n < MIN_SAMPLES or abs(self.mean) <= least:
            return False
        return abs(self.t) > float(stdtrit(self.n - 1, 1 - CHANCE / 2))

    def summary(self, least: float) -> dict[str, float | bool | None]:
        """The test's numbers, for JSON."""
        t = self.t if np.isfinite(self.t) else None
        numbers = {"mean": self.mean, "standard_error": self.standard_error, "t": t}
        return {"n": self.n, **numbers, "least": least, "fails": self.fails(least)}


def judge(means: Mapping[str, RunningMean]) -> Iterator[Problem]:
    """A problem of the data set for each test that fails."""
    for name, test in TESTS.items():
        if name in means and means[name].fails(test.least):
            found = means[name]
            side = test.positive if found.mean > 0 else test.negative
            yield Problem(
                DATA_SET,
                "",
                f"{name}: expected {test.expected}, got {test.shown(abs(found.mean))} {side} on average "
                f"(t = {found.t:.1f}, {found.n} samples): {test.differs}",
            )
