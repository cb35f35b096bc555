"""The score of CULane and CurveLanes, from the description of their evaluator alone: lines as wide bands of pixels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from PIL import Image, ImageDraw

from synth3dlanes.system.arrays import MaskImage, Polyline2

STEPS = 50


@dataclass(frozen=True)
class Canvas:
    """What the bands are drawn on, their width, and the overlap (IoU) from which on two of them match."""

    width_px: int
    height_px: int
    band_px: int
    iou: float


@dataclass(frozen=True)
class BandScore:
    """F1, recall and precision; 0 where nothing matches."""

    f_score: float
    recall: float
    precision: float


def score(frames: Sequence[tuple[Sequence[Polyline2], Sequence[Polyline2]]], canvas: Canvas) -> BandScore:
    """Frames of (ground truth, prediction); pairs are those of the greatest overlap in all."""
    n_true = sum(len(true) for true, _ in frames)
    n_predicted = sum(len(predicted) for _, predicted in frames)
    n_matched = sum(_matched(true, predicted, canvas) for true, predicted in frames)
    recall, precision = n_matched / max(1, n_true), n_matched / max(1, n_predicted)
    return BandScore(2 * recall * precision / (recall + precision) if n_matched else 0.0, recall, precision)


def _matched(true: Sequence[Polyline2], predicted: Sequence[Polyline2], canvas: Canvas) -> int:
    bands_true, bands_predicted = ([_band(line, canvas) for line in lines] for lines in (true, predicted))
    overlaps = np.array([[_overlap(a, b) for b in bands_predicted] for a in bands_true])
    overlaps = overlaps.reshape(len(true), len(predicted))
    pairs = scipy.optimize.linear_sum_assignment(overlaps, maximize=True)
    return int(np.count_nonzero(overlaps[pairs] > canvas.iou))


def _band(line: Polyline2, canvas: Canvas) -> MaskImage:
    """The pixels of a line: a natural cubic spline through its points, drawn as OpenCV does: between whole pixels, half
    the width to either side of the middle one, with round ends."""
    points = np.rint(_spline(line) if len(line) > 2 else line)
    image = Image.new("1", (canvas.width_px, canvas.height_px))
    draw, half_px = ImageDraw.Draw(image), canvas.band_px // 2
    corners = [(float(x), float(y)) for x, y in points]
    draw.line(corners, fill=1, width=2 * half_px + 1, joint="curve")
    for x, y in (corners[0], corners[-1]):
        draw.ellipse((x - half_px, y - half_px, x + half_px, y + half_px), fill=1)
    return np.asarray(image)


def _spline(line: Polyline2) -> Polyline2:
    lengths_px = np.linalg.norm(np.diff(line, axis=0), axis=1)
    knots_px = np.concatenate([[0.0], np.cumsum(lengths_px)])
    at_px = np.interp(np.arange(STEPS * len(lengths_px) + 1) / STEPS, np.arange(len(knots_px)), knots_px)
    return np.asarray(scipy.interpolate.CubicSpline(knots_px, line, bc_type="natural")(at_px))


def _overlap(a: MaskImage, b: MaskImage) -> float:
    return float(np.count_nonzero(a & b) / max(1, np.count_nonzero(a | b)))
