"""Tests over a whole data set: means of the samples' signed values, 0 if images and labels show the same world.

An error too small to be found in one sample, such as a slightly different focal length, biases all samples in the same
direction. A test fails if the mean is both statistically significant and large enough to matter: with many samples even
micrometres become significant. The memory does not grow with the data set.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from synth3dlanes.validate.centroids import PaintOffset, image_offsets, line_views, paint_offsets
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Problem, Signed

DATA_SET = "data set"
# Significance level of Student's t-test, and the least number of samples to test.
CHANCE, MIN_SAMPLES = 1e-4, 4


class MeanTest(NamedTuple):
    """The least mean that matters, in metres, and the words of its finding: expectation, direction of positive and
    negative means, what differs then."""

    least: float
    expected: str
    positive: str
    negative: str
    differs: str

    def shown(self, value: float) -> str:
        """A value in words."""
        return f"{100 * value:.2g} cm"


_WIDTH = "lane width, lane offsets or focal length of images and labels differ"
_SIDE = "principal point, columns of pixels or the host's place in its lane differ between images and labels"
_EXIT = "the exit's angle or course in images and labels differs"
_HEIGHT = "depth, camera height, pitch or focal length of passes and labels differ"
TESTS = {
    "paint_outward_m": MeanTest(0.002, "paint under its labels", "outward", "inward", _WIDTH),
    "paint_right_m": MeanTest(0.002, "paint under its labels", "to the right", "to the left", _SIDE),
    "exit_outward_m": MeanTest(0.004, "the exit's paint under its labels", "farther out", "farther in", _EXIT),
    "surface_above_m": MeanTest(0.002, "the rendered road at its labels' height", "above", "below", _HEIGHT),
    "image_outward_m": MeanTest(0.006, "paint in the image under its labels", "outward", "inward", _WIDTH),
    "image_right_m": MeanTest(0.006, "paint in the image under its labels", "to the right", "to the left", _SIDE),
}
# Least amount of paint for a value: pixels, or slices of an image.
MIN_WEIGHT = {"paint": 30.0, "image": 15.0, "exit": 30.0}
# Lines this close to the camera's vertical plane count as on neither side.
ASIDE_M = 0.5


def signed_values(evidence: Evidence) -> Iterator[Signed]:
    """The signed values of paint of this sample, of a clip those of its first frame: its frames are alike, and the
    tests over the data set take samples as independent. `surface_above_m` is measured where points are (`points`)."""
    if evidence.scene.shot.frame or evidence.scene.shot.view:
        return
    network, labels = evidence.world.network, evidence.labels
    views = line_views(evidence.paint, labels)
    if "instance" in evidence.passes:
        lines = list(paint_offsets(views, evidence.passes["instance"]))
        yield from _sides("paint", lines)
        exit_lines = [line for line in lines if line.lane.road != network.main.id]
        if any(road.parting for road in network.roads) and exit_lines:
            ways = [line.lane.xyz_cam[-1] - line.lane.xyz_cam[0] for line in exit_lines]
            out = network.rightward * np.sign(np.array(ways) @ labels.camera.road_from_cam[1, :3])
            n_px = sum(float(line.n_px.sum()) for line in exit_lines)
            moment = sum(float(line.moment_m.sum()) * sign for line, sign in zip(exit_lines, out, strict=True))
            if n_px >= MIN_WEIGHT["exit"]:
                yield Signed("exit_outward_m", moment / n_px)
    if evidence.paint.shows:
        yield from _sides("image", list(image_offsets(views, evidence.luma)))


def _sides(name: str, lines: Sequence[PaintOffset]) -> Iterator[Signed]:
    """Offsets of paint to the right, and outward, away from the camera's vertical plane."""
    points_cam = np.concatenate([np.zeros((0, 3)), *(line.points_cam for line in lines)])
    n_px, moment_m = (np.concatenate([np.zeros(0), *(line[i] for line in lines)]) for i in (2, 3))
    side = np.sign(points_cam[:, 0]) * (np.abs(points_cam[:, 0]) > ASIDE_M)
    for which, sign in (("right", np.ones(len(side))), ("outward", side)):
        weight = float(n_px @ np.abs(sign))
        if weight >= MIN_WEIGHT[name]:
            yield Signed(f"{name}_{which}_m", float(moment_m @ sign) / weight)


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
        return bool(abs(self.t) > stdtrit(self.n - 1, 1 - CHANCE / 2))

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
