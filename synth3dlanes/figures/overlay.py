"""Draw lanes and the boxes of objects on an image, where the labels' camera projects them."""

import itertools
from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image, ImageDraw

from synth3dlanes.figures.boxes import objects_in_image
from synth3dlanes.figures.colors import KINDS, OBJECT
from synth3dlanes.labels import CameraLabel, Labels, Lane

NEAR_M = 0.5
"""Points closer than this are not drawn: points in the camera's plane cannot be projected."""

# Pieces of the straight line between two points that a lens bends.
CURVE_STEPS = 8

_SUPERSAMPLING = 4
_HIDDEN_OPACITY = 0.6


def draw_overlay(image: UInt8[np.ndarray, "h w 3"], labels: Labels) -> UInt8[np.ndarray, "h w 3"]:
    """The image with its lanes, solid where they are visible, dotted where the ground or an object hides them, and the
    boxes of the objects that are seen.

    The image may be resized; the lines are scaled with it. Delimiters are drawn over centre lines.
    """
    height_px, width_px = image.shape[:2]
    scale = np.array([width_px / labels.camera.width_px, height_px / labels.camera.height_px])
    thickness_px = max(1.2, width_px / 320)
    drawn = Image.fromarray(image)
    boxes = [line * scale for _, lines in objects_in_image(labels) for line in lines]
    drawn.paste(OBJECT, mask=_mask(drawn, boxes, thickness_px / 2))
    for kind, color in KINDS.items():
        mask = Image.new("L", (width_px * _SUPERSAMPLING, height_px * _SUPERSAMPLING))
        draw = ImageDraw.Draw(mask)
        for lane in labels.lanes:
            if lane.kind == kind:
                _draw_lane(draw, labels.camera, lane, scale, thickness_px)
        drawn.paste(color, mask=mask.reduce(_SUPERSAMPLING))
    return np.asarray(drawn)


def _mask(image: Image.Image, lines: Iterable[Float[np.ndarray, "n 2"]], thickness_px: float) -> Image.Image:
    """Where thin lines cover an image."""
    mask = Image.new("L", (image.width * _SUPERSAMPLING, image.height * _SUPERSAMPLING))
    draw = ImageDraw.Draw(mask)
    for line in lines:
        points = np.floor(line * _SUPERSAMPLING).tolist()
        draw.line([tuple(point) for point in points], fill=255, width=round(thickness_px * _SUPERSAMPLING))
    return mask.reduce(_SUPERSAMPLING)


def stretches_img(camera: CameraLabel, lane: Lane) -> Iterator[tuple[bool, Float[np.ndarray, "n 2"]]]:
    """The lane in the image as polylines (is_seen, points), split where its visibility changes.

    A line that crosses the border of the image is drawn across it: points beyond it are outside, not hidden.
    """
    points_img = camera.project(lane.xyz_cam)
    in_front = lane.xyz_cam[:, 1] > NEAR_M if camera.lens.is_pinhole else np.isfinite(points_img).all(axis=1)
    in_image = lane.in_image & in_front
    hidden = in_image & ~lane.visible
    drawn = (in_image[:-1] | in_image[1:]) & in_front[:-1] & in_front[1:]
    solid = drawn & ~(hidden[:-1] | hidden[1:])
    for start, stop in _runs(drawn.astype(int) + solid):
        if drawn[start]:
            yield bool(solid[start]), _curve(camera, lane.xyz_cam[start : stop + 1], points_img[start : stop + 1])


def _curve(
    camera: CameraLabel, points_cam: Float[np.ndarray, "n 3"], points_img: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "m 2"]:
    """Points in the image as a polyline, with additional points where the lens bends the line between them."""
    if camera.lens.is_pinhole:
        return points_img
    finer = np.arange(CURVE_STEPS * (len(points_cam) - 1) + 1) / CURVE_STEPS
    between = [np.interp(finer, np.arange(len(points_cam)), values) for values in points_cam.T]
    bent = camera.project(np.stack(between, axis=1))
    return np.asarray(bent[np.isfinite(bent).all(axis=1)])


def _runs(values: Int[np.ndarray, " n"]) -> Iterator[tuple[int, int]]:
    """Half-open index ranges over which `values` stay equal."""
    borders = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return ((start, stop) for start, stop in itertools.pairwise(borders) if start < stop)


def _draw_lane(
    draw: ImageDraw.ImageDraw, camera: CameraLabel, lane: Lane, scale: Float[np.ndarray, "2"], thickness_px: float
) -> None:
    for is_seen, points_img in stretches_img(camera, lane):
        # Pillow draws along whole pixels; an odd width is centred on them.
        points = np.floor(points_img * scale * _SUPERSAMPLING)
        width = 2 * round(thickness_px * _SUPERSAMPLING / 2) + 1
        if is_seen:
            draw.line([tuple(point) for point in points.tolist()], fill=255, width=width, joint="curve")
            continue
        for u, v in _dots(points, 4 * width):
            radius = width / 2
            draw.ellipse((u - radius, v - radius, u + radius, v + radius), fill=round(255 * _HIDDEN_OPACITY))


def _dots(points: Float[np.ndarray, "n 2"], spacing: int) -> list[tuple[float, float]]:
    """Points evenly spaced along a polyline, beginning with its start."""
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.arange(0.0, travelled[-1], spacing)
    return [(float(u), float(v)) for u, v in zip(*(np.interp(at, travelled, axis) for axis in points.T), strict=True)]
