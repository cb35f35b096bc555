"""Signed offset, across the line, between the paint of each delimiter in the pixels and in the labels.

    views = line_views(paint, labels)                            # once per sample
    for line in paint_offsets(views, passes["instance"]):        # or image_offsets(views, luma)
        line.mean_m           # offset of the paint's centroid to the right of its label; negative: to the left
        line.n_px.sum()       # number of pixels of paint; with 100 or more the mean is accurate to about 3 mm
        line.points_cam, line.n_px, line.moment_m                # the same for each slice

Rows of the image cut a line into slices. A pass has one sample at each pixel's centre. So in each slice the pixels of
paint are compared with the pixels whose centres the labels' paint covers. If both show the same world these are the
same pixels, without rounding errors. The offset of the centroid is the difference of their first moments divided by the
number of pixels. Slices are skipped near cars, trees or other lines, at ends of paint, and at the image's border.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Integer
from scipy.interpolate import CubicSpline

from synth3dlanes.geometry.polylines import stretches
from synth3dlanes.labels.labels import MASKS, CameraLabel, Labels, Lane
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.system.arrays import Points3, Scalars
from synth3dlanes.validate.paint import WorldPaint

# Interpolated points per label point: labels are 1 m apart, and a line may bend by millimetres in between.
STEPS = 4
RANGE_M = 80.0
# Paint is searched up to this far beyond its edges, and at least this many pixels.
REACH_M, REACH_PX = 0.5, 3.0
# Largest number of rows used for one line.
MAX_ROWS = 200
# For `image_offsets`: the largest distance, the least number of slices, the least contrast in gray levels, and the
# width of the road beside a line with which its paint is compared.
IMAGE_RANGE_M, MIN_SLICES, MIN_CONTRAST, BESIDE_M = 30.0, 15, 10.0, 0.12


class PaintOffset(NamedTuple):
    """The paint of one line by slice, from near to far: its position, its number of paint pixels, and the sum of their
    offsets to the right of the label, as the camera looks, in metres. `image_offsets` gives one slice for the whole
    line, with one pixel per row."""

    lane: Lane
    points_cam: Points3
    n_px: Scalars
    moment_m: Scalars

    @property
    def mean_m(self) -> float:
        """Offset of the centroid of all slices to the right."""
        return float(self.moment_m.sum() / self.n_px.sum())


class Slices(NamedTuple):
    """Intersections of image rows with the paint of one line: from column `left_px` to `right_px` at the row's
    centre."""

    row: Int[np.ndarray, " n"]
    left_px: Scalars
    right_px: Scalars
    points_cam: Points3

    def take(self, kept: np.ndarray) -> "Slices":
        """The selected slices."""
        return Slices(self.row[kept], self.left_px[kept], self.right_px[kept], self.points_cam[kept])


class LineView(NamedTuple):
    """A line's slices and the pixels around them: columns, offsets to the right of the line on the road, and whether
    each pixel is within reach, at the edge of the reach, and paint according to the labels."""

    lane: Lane
    slices: Slices
    column: Int[np.ndarray, "n k"]
    right_m: Float[np.ndarray, "n k"]
    near: Bool[np.ndarray, "n k"]
    edge: Bool[np.ndarray, "n k"]
    painted: Bool[np.ndarray, "n k"]
    half_m: float

    @property
    def row(self) -> Int[np.ndarray, "n 1"]:
        """The pixels' rows."""
        return self.slices.row[:, None]


def line_views(paint: WorldPaint, labels: Labels) -> list[LineView]:
    """One view of every delimiter, in the labels' order; of those that come towards the camera, from their ends."""
    return [_view(paint, labels.camera, _going_away(lane)) for lane in labels.lanes if lane.kind == "delimiter"]


def _going_away(lane: Lane) -> Lane:
    """The lane with its points from near to far where the camera sees it."""
    seen = np.flatnonzero(lane.visible)
    if not seen.size or lane.xyz_cam[seen[-1], 1] >= lane.xyz_cam[seen[0], 1]:
        return lane
    return replace(lane, **{name: getattr(lane, name)[::-1] for name in ("xyz_cam", *MASKS)})


def paint_offsets(views: Sequence[LineView], instance: Integer[np.ndarray, "h w"]) -> Iterator[PaintOffset]:
    """The offset of every delimiter with visible paint, from instance ids."""
    for number, view in enumerate(views):
        ids = instance[view.row, view.column]
        own = ids == instance_id("delimiter", number)
        is_paint, is_other = view.near & own, view.near & ~own & (ids != 0)
        # Slices without paint pixels count too: of two thin overlapping lines, pixels may hit only one.
        used = ~(is_other | (is_paint & view.edge)).any(axis=1)
        n_px = is_paint.sum(axis=1)[used].astype(float)
        surplus = is_paint.astype(float) - (view.painted & view.near)
        if n_px.any():
            yield PaintOffset(view.lane, view.slices.points_cam[used], n_px, (surplus * view.right_m)[used].sum(axis=1))


def image_offsets(views: Sequence[LineView], luma: Float[np.ndarray, "h w"]) -> Iterator[PaintOffset]:
    """The offset of every line between two lanes whose paint is brighter or darker than the road beside it. Lines at
    the road's edges are skipped, because the surfaces on their two sides differ in brightness."""
    for view in views:
        if view.lane.left is None or view.lane.right is None:
            continue
        slices = view.slices
        px_m = (2 * view.half_m / (slices.right_px - slices.left_px))[:, None]
        near, end_m = luma[view.row, view.column], view.half_m + px_m
        left, right = (
            _mean(near, view.near & (side * view.right_m > end_m) & (side * view.right_m < end_m + px_m + BESIDE_M))
            for side in (-1, 1)
        )
        brighter = np.where(np.abs(view.right_m) < end_m, near - np.where(view.right_m < 0, left, right), 0.0)
        used = (slices.points_cam[:, 1] < IMAGE_RANGE_M) & np.isfinite(brighter).all(axis=1)
        if used.sum() < MIN_SLICES:
            continue
        area, moment = (
            float(np.median((values * px_m)[used].sum(axis=1))) for values in (brighter, brighter * view.right_m)
        )
        if abs(area) > MIN_CONTRAST * 2 * view.half_m:
            middle = np.median(slices.points_cam[used], axis=0)[None]
            n = np.array([float(used.sum())])
            yield PaintOffset(view.lane, middle, n, n * moment / area)


def _mean(values: Float[np.ndarray, "n k"], of: Bool[np.ndarray, "n k"]) -> Float[np.ndarray, "n 1"]:
    """The mean of the selected values of each row, NaN if there are none."""
    with np.errstate(invalid="ignore"):
        return np.where(of, values, 0.0).sum(axis=1, keepdims=True) / of.sum(axis=1, keepdims=True)


def _view(paint: WorldPaint, camera: CameraLabel, lane: Lane) -> LineView:
    """The slices of a line whose surroundings are fully in the image, with the surrounding pixels."""
    stripes_m = np.array(paint.stripes_m(lane.id))
    half_m = float(np.abs(stripes_m).max()) + paint.width_m(lane.id) / 2
    slices = _slices(paint, camera, lane, half_m)
    width_px, row = camera.width_px, slices.row
    pad = np.maximum(REACH_M / (2 * half_m) * (slices.right_px - slices.left_px), REACH_PX)
    inside = (slices.left_px >= pad) & (slices.right_px + pad <= width_px) & (row >= 0) & (row < camera.height_px)
    slices, pad = slices.take(inside), pad[inside, None]
    left, right = slices.left_px[:, None], slices.right_px[:, None]
    first = np.floor(left - pad).astype(int)
    column = first + np.arange(int((right + pad - first).max(initial=0)) + 1)
    center = column + 0.5
    beyond = np.maximum(left - center, center - right)
    right_m = half_m * (2 * center - left - right) / (right - left)
    painted = (np.abs(right_m[..., None] - stripes_m) < paint.width_m(lane.id) / 2).any(axis=-1)
    column = np.clip(column, 0, width_px - 1)
    return LineView(lane, slices, column, right_m, beyond < pad, beyond > pad - 1, painted, half_m)


def _slices(paint: WorldPaint, camera: CameraLabel, lane: Lane, half_m: float) -> Slices:
    """All slices of a line's visible painted stretches; the paint extends `half_m` to either side."""
    none = Slices(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0), np.zeros((0, 3)))
    seen = lane.visible & (lane.xyz_cam[:, 1] < RANGE_M)
    steps = np.flatnonzero(seen[:-1] & seen[1:])
    if not steps.size:
        return none
    at = np.arange(steps[0] * STEPS, (steps[-1] + 1) * STEPS + 1) / STEPS
    length = np.cumsum(np.maximum(np.linalg.norm(np.diff(lane.xyz_cam, axis=0), axis=1), 1e-6))
    length = np.concatenate([[0.0], length])
    points_cam = CubicSpline(length, lane.xyz_cam)(np.interp(at, np.arange(len(length)), length))
    strip = paint.strip(camera, lane, points_cam)
    left, right = (camera.project(points_cam + side_m * strip.across_cam) for side_m in (-half_m, half_m))
    shows = np.isin(at[:-1].astype(int), steps) & strip.painted[:-1] & strip.painted[1:]
    # Only stretches that go up in the image, so that a row cuts the line once.
    shows &= (np.diff(left[:, 1]) < 0) & (np.diff(right[:, 1]) < 0)
    runs = [slice(first, last + 1) for first, last in stretches(shows)]
    parts = [none, *(_run(left[run], right[run], points_cam[run]) for run in runs)]
    slices = Slices(*(np.concatenate(values) for values in zip(*parts, strict=True)))
    kept = np.flatnonzero(slices.right_px > slices.left_px)
    return slices.take(kept[:: 1 + len(kept) // MAX_ROWS])


def _run(
    left: Float[np.ndarray, "p 2"], right: Float[np.ndarray, "p 2"], points_cam: Float[np.ndarray, "p 3"]
) -> Slices:
    """The slices of one stretch of paint, given its edges in the image, from near (low) to far (high)."""
    lowest, highest = min(left[0, 1], right[0, 1]), max(left[-1, 1], right[-1, 1])
    row = np.arange(int(np.ceil(highest - 0.5)), int(np.floor(lowest - 0.5)) + 1)
    # Reversed, because np.interp needs increasing rows.
    left, right, points_cam = left[::-1], right[::-1], points_cam[::-1]
    middle_v = (left[:, 1] + right[:, 1]) / 2
    left_px, right_px = (np.interp(row + 0.5, side[:, 1], side[:, 0]) for side in (left, right))
    at = np.stack([np.interp(row + 0.5, middle_v, axis) for axis in points_cam.T], axis=1)
    return Slices(row, left_px, right_px, at)
