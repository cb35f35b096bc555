"""Tests over a whole data set: signed values of its samples, whose mean is 0 where images and labels are of one world.

What is too little to be seen in one sample, such as a lens of another focal length, pushes all samples the same way. A
test fails where the mean is more than chance leaves and large enough to matter: among many samples chance leaves
nothing, and micrometres are nobody's fault. No pixels, no files; the memory does not grow with the data set.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from synth3dlanes.validate.findings import Problem

DATA_SET = "data set"
# How often chance alone may push a mean this far, by Student's t; fewer samples than these have no say.
CHANCE, MIN_SAMPLES = 1e-4, 4


class Test(NamedTuple):
    """The least mean that matters (metres, or a share), how it is told, and what a mean beyond it comes from."""

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
    "paint_outward_m": Test(0.002, "cm", "paint under its labels", "outward", "inward", _WIDTH),
    "paint_right_m": Test(0.002, "cm", "paint under its labels", "to the right", "to the left", _SIDE),
    "exit_opening": Test(
        0.002,
        "cm",
        "the exit's paint under its labels",
        "a metre farther out",
        "a metre farther in",
        "the exit's angle or course in images and labels differs",
    ),
    "surface_above_m": Test(
        0.002,
        "cm",
        "the rendered road at its labels' height",
        "above",
        "below",
        "depth, camera height, pitch or focal length of passes and labels differ",
    ),
    "focal_length": Test(
        0.002, "%", "the labels' focal length", "more", "less", "focal lengths of passes and labels differ"
    ),
    "depth_scale": Test(0.002, "%", "depth in the labels' metres", "more", "less", "scales of depth and labels differ"),
    "relief": Test(
        0.003,
        "%",
        "the labels' hills",
        "higher ones",
        "lower ones",
        "heights of the terrain in passes and labels differ",
    ),
    "ramp": Test(
        0.02, "%", "the labels' ramp", "a higher one", "a lower one", "heights of the ramp in passes and labels differ"
    ),
    "image_outward_m": Test(0.006, "cm", "paint in the image under its labels", "outward", "inward", _WIDTH),
    "image_right_m": Test(0.006, "cm", "paint in the image under its labels", "to the right", "to the left", _SIDE),
}


@dataclass
class Mean:
    """A running mean, with the sum of squares about it (Welford)."""

    n: int = 0
    mean: float = 0.0
    squares: float = 0.0

    def add(self, value: float) -> None:
        """Take in one more value."""
        self.n += 1
        step = value - self.mean
        self.mean += step / self.n
        self.squares += step * (value - self.mean)

    @property
    def standard_error(self) -> float:
        """Of the mean; 0 of fewer than two values."""
        return float(np.sqrt(self.squares / (self.n - 1) / self.n)) if self.n > 1 else 0.0

    @property
    def t(self) -> float:
        """The mean in standard errors."""
        return self.mean / self.standard_error if self.standard_error > 0 else float(np.sign(self.mean)) * np.inf

    def fails(self, least: float) -> bool:
        """Whether the mean is beyond `least`, and farther from 0 than chance would have it."""
        if self.n < MIN_SAMPLES or abs(self.mean) <= least:
            return False
        return abs(self.t) > float(stdtrit(self.n - 1, 1 - CHANCE / 2))

    def summary(self, least: float) -> dict[str, float | bool | None]:
        """Everything, for JSON."""
        t = self.t if np.isfinite(self.t) else None
        numbers = {"mean": self.mean, "standard_error": self.standard_error, "t": t}
        return {"n": self.n, **numbers, "least": least, "fails": self.fails(least)}


def judge(means: Mapping[str, Mean]) -> Iterator[Problem]:
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
