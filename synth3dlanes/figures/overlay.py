"""Lanes drawn on an image, exactly where the camera of the labels sees them."""

import itertools
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image, ImageDraw

from synth3dlanes.figures.colors import KINDS
from synth3dlanes.frames import project
from synth3dlanes.labels import CameraLabel, Labels, Lane

NEAR_M = 0.5
"""Nothing closer than this is drawn: a point in the camera's own plane has no image."""

_SUPERSAMPLING = 4
_HIDDEN_OPACITY = 0.6


def draw_overlay(image: UInt8[np.ndarray, "h w 3"], labels: Labels) -> UInt8[np.ndarray, "h w 3"]:
    """The image with its lanes: solid where they are seen, dotted where the ground or an object hides them.

    The image may be a resized copy; the lines follow its size. Centre lines lie under delimiters.
    """
    height_px, width_px = image.shape[:2]
    scale = np.array([width_px / labels.camera.width_px, height_px / labels.camera.height_px])
    thickness_px = max(1.2, width_px / 320)
    drawn = Image.fromarray(image)
    for kind, color in KINDS.items():
        mask = Image.new("L", (width_px * _SUPERSAMPLING, height_px * _SUPERSAMPLING))
        draw = ImageDraw.Draw(mask)
        for lane in labels.lanes:
            if lane.kind == kind:
                _draw_lane(draw, labels.camera, lane, scale, thickness_px)
        drawn.paste(color, mask=mask.reduce(_SUPERSAMPLING))
    return np.asarray(drawn)


def stretches_img(camera: CameraLabel, lane: Lane) -> Iterator[tuple[bool, Float[np.ndarray, "n 2"]]]:
    """The lane in the image as polylines (is_seen, points), cut where it goes out of sight or comes into it.

    A line that crosses the border of the image is drawn across it: its mask there says "outside", not "hidden".
    """
    in_front = lane.xyz_cam[:, 1] > NEAR_M
    in_image = lane.in_image & in_front
    hidden = in_image & ~lane.visible
    drawn = (in_image[:-1] | in_image[1:]) & in_front[:-1] & in_front[1:]
    solid = drawn & ~(hidden[:-1] | hidden[1:])
    points_img = project(camera.img_from_cam, lane.xyz_cam)
    for start, stop in _runs(drawn.astype(int) + solid):
        if drawn[start]:
            yield bool(solid[start]), points_img[start : stop + 1]


def _runs(values: Int[np.ndarray, " n"]) -> Iterator[tuple[int, int]]:
    """Half-open index ranges over which `values` stay equal."""
    borders = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return ((start, stop) for start, stop in itertools.pairwise(borders) if start < stop)


def _draw_lane(
    draw: ImageDraw.ImageDraw, camera: CameraLabel, lane: Lane, scale: Float[np.ndarray, "2"], thickness_px: float
) -> None:
    for is_seen, points_img in stretches_img(camera, lane):
        # Pillow draws through whole pixels; an odd width lies evenly about them.
        points = np.floor(points_img * scale * _SUPERSAMPLING)
        width = 2 * round(thickness_px * _SUPERSAMPLING / 2) + 1
        if is_seen:
            draw.line([tuple(point) for point in points.tolist()], fill=255, width=width, joint="curve")
            continue
        for u, v in _dots(points, 4 * width):
            radius = width / 2
            draw.ellipse((u - radius, v - radius, u + radius, v + radius), fill=round(255 * _HIDDEN_OPACITY))


def _dots(points: Float[np.ndarray, "n 2"], spacing: int) -> list[tuple[float, float]]:
    """Points evenly spaced along a polyline, its start among them."""
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.arange(0.0, travelled[-1], spacing)
    return [(float(u), float(v)) for u, v in zip(*(np.interp(at, travelled, axis) for axis in points.T), strict=True)]
