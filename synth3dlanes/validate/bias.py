"""Tests over a whole data set: means of the samples' signed values, 0 if images and labels show the same world.

An error too small to be found in one sample, such as a slightly different focal length, biases all samples in the same
direction. A test fails if the mean is both statistically significant and large enough to matter: with many samples even
micrometres become significant.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.special import stdtrit

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import Lane
from synth3dlanes.scene.instance_ids import numbers_of
from synth3dlanes.system.arrays import Scalars
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
# Least amount of paint for a value: pixels, or profiles across a line of an image.
MIN_WEIGHT = {"paint": 30.0, "image": 15.0, "exit": 30.0}
# Lines this close to the camera's vertical plane count as on neither side.
ASIDE_M = 0.5
# Range of paint, how far from it pixels are compared, at least, and how many of them at most.
RANGE_M, REACH_M, REACH_PX, MOST = 80.0, 0.25, 3.0, 40_000


class PaintOffset(NamedTuple):
    """How far the paint of a line is from its label, in parts: where each is beside the camera, its weight, and this
    times its offset to the right, as the camera looks."""

    lane: Lane
    x_cam: Scalars
    weight: Scalars
    moment_m: Scalars


def signed_values(evidence: Evidence) -> Iterator[Signed]:
    """The signed values of paint in the passes."""
    lines = list(paint_offsets(evidence))
    yield from sides("paint", evidence, lines)
    network = evidence.world.network
    if any(road.parting for road in network.roads):
        of_exit = [line for line in lines if line.lane.road != network.main.id]
        along = evidence.camera.road_from_cam[1, :3]
        ways = [np.sign((line.lane.xyz_cam[-1] - line.lane.xyz_cam[0]) @ along) for line in of_exit]
        yield from _mean("exit_outward_m", of_exit, [network.rightward * way for way in ways], MIN_WEIGHT["exit"])


def paint_offsets(evidence: Evidence) -> Iterator[PaintOffset]:
    """The offset of every delimiter with visible paint, in parts of a pixel each.

    A pass has one sample at each pixel's centre. So the pixels of paint are compared with those whose points the
    scene's paint covers. If both show one world, these are the same pixels, without rounding errors; if not, the offset
    of the centroid is the difference of their first moments divided by the number of pixels. Each pixel is asked for
    the line that is nearest to it in the image, where it shows this line or bare ground.
    """
    instance, paint = evidence.passes["instance"], evidence.paint
    numbers = numbers_of("delimiter", instance)
    away_px, nearest = distance_transform_edt(numbers < 0, return_indices=True)
    depth_m = evidence.passes["depth"]
    reach_px = np.maximum(REACH_M * evidence.camera.img_from_cam[0, 0] / depth_m, REACH_PX)
    is_near = (away_px < reach_px) & (depth_m < RANGE_M)
    lines = numbers[tuple(nearest)]
    # Where the image cuts a line off at its side, a part of its width is missing.
    rows = np.arange(len(lines))[:, None] + lines * len(lines)
    is_near &= ~np.isin(rows, rows[:, [0, -1]][is_near[:, [0, -1]]])
    on = evidence.seen(is_near & ((numbers >= 0) | (instance == 0)), MOST).on_road
    assert on.pixels is not None, "just taken from pixels"
    own, shown = lines[tuple(on.pixels.T)], on.number("delimiter")
    x_cam = transform(invert(evidence.camera.world_from_cam), on.points_world)[:, 0]
    for number, lane in enumerate(lane for lane in evidence.labels.lanes if lane.kind == "delimiter"):
        at = own == number
        if lane.id not in paint.ids or not at.any():
            continue
        place = on.places.at(at)
        right_m, is_inside = paint.right_m(lane.id, place), paint.beyond_m(lane.id, place) < 0
        is_own = shown[at] == number
        surplus = np.where(np.isfinite(right_m), is_own.astype(float) - is_inside, 0.0)
        if is_own.any():
            seen = np.flatnonzero(lane.visible)
            towards = seen.size and lane.xyz_cam[seen[-1], 1] < lane.xyz_cam[seen[0], 1]
            moment_m = surplus * np.nan_to_num(right_m, posinf=0.0) * (-1 if towards else 1)
            yield PaintOffset(lane, x_cam[at], is_own.astype(float), moment_m)


def sides(name: str, evidence: Evidence, lines: Sequence[PaintOffset]) -> Iterator[Signed]:
    """Mean offsets of paint to the right, and outward, away from the camera's vertical plane. Of a clip those of its
    first frame: its frames are alike, and the tests over the data set take samples as independent."""
    if evidence.scene.shot.frame or evidence.scene.shot.view:
        return
    outward = [np.sign(line.x_cam) * (np.abs(line.x_cam) > ASIDE_M) for line in lines]
    yield from _mean(f"{name}_right_m", lines, [1.0] * len(lines), MIN_WEIGHT[name])
    yield from _mean(f"{name}_outward_m", lines, outward, MIN_WEIGHT[name])


def _mean(name: str, lines: Sequence[PaintOffset], signs: Sequence[float | Scalars], least: float) -> Iterator[Signed]:
    weight = sum(float((line.weight * np.abs(sign)).sum()) for line, sign in zip(lines, signs, strict=True))
    if weight >= least:
        moment_m = sum(float((line.moment_m * sign).sum()) for line, sign in zip(lines, signs, strict=True))
        yield Signed(name, moment_m / weight)


class Mean(NamedTuple):
    """The mean of the signed values of samples, its standard error, and how many standard errors it is from 0."""

    n: int
    mean: float
    standard_error: float
    t: float

    def fails(self, least: float) -> bool:
        """Whether the mean exceeds `least` and differs significantly from 0."""
        if self.n < MIN_SAMPLES or abs(self.mean) <= least:
            return False
        return bool(abs(self.t) > stdtrit(self.n - 1, 1 - CHANCE / 2))

    def summary(self, least: float) -> dict[str, float | bool | None]:
        """The test's numbers, for JSON."""
        numbers = {**self._asdict(), "t": self.t if np.isfinite(self.t) else None}
        return {**numbers, "least": least, "fails": self.fails(least)}


def mean_of(values: Sequence[float]) -> Mean:
    """That of some values; without a standard error of fewer than two."""
    mean = float(np.mean(values))
    error = float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
    return Mean(len(values), mean, error, mean / error if error > 0 else float(np.sign(mean)) * np.inf)


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
