"""Draw lanes, boxes of objects and faces of traffic elements on an image, where the labels' camera projects them."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from synth3dlanes.figures.boxes import color_of, objects_in_image
from synth3dlanes.figures.colors import KINDS
from synth3dlanes.figures.strokes import Style, draw_lines, line_width_px, runs
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane
from synth3dlanes.system.arguments import checked

LEAST_DEPTH_M = 0.5
"""Points closer than this are not drawn: points in the camera's plane cannot be projected."""

# Pieces of the straight line between two points that a lens bends.
CURVE_STEPS = 8


@checked
def draw_overlay(image: UInt8[np.ndarray, "h w 3"], labels: Labels) -> UInt8[np.ndarray, "h w 3"]:
    """The image with its lanes, solid where they are visible, dotted where the ground or an object hides them, and the
    boxes of the objects and the faces of the traffic elements that are seen.

    The image may be resized; the lines are scaled with it. Delimiters are drawn over centre lines.
    """
    height_px, width_px = image.shape[:2]
    scale = np.array([width_px / labels.camera.width_px, height_px / labels.camera.height_px])
    thickness_px = line_width_px((width_px, height_px))
    drawn = Image.fromarray(image)
    for item, lines in objects_in_image(labels):
        draw_lines(drawn, [line * scale for line in lines], color_of(item), thickness_px / 2)
    for kind, color in KINDS.items():
        lanes = [lane for lane in labels.lanes if lane.kind == kind]
        stretches = [found for lane in lanes for found in stretches_img(labels.camera, lane)]
        styles: tuple[Style, ...] = ("dotted", "full")
        for style in styles:
            lines_px = (points_img * scale for is_seen, points_img in stretches if is_seen == (style == "full"))
            draw_lines(drawn, lines_px, color, thickness_px, style)
    return np.asarray(drawn)


def stretches_img(camera: CameraLabel, lane: Lane) -> Iterator[tuple[bool, Float[np.ndarray, "n 2"]]]:
    """The lane in the image as polylines (is_seen, points), split where its visibility changes.

    A line that crosses the border of the image is drawn across it: points beyond it are outside, not hidden.
    """
    points_img = camera.project(lane.xyz_cam)
    in_front = lane.xyz_cam[:, 1] > LEAST_DEPTH_M if camera.lens.is_pinhole else np.isfinite(points_img).all(axis=1)
    in_image = lane.in_image & in_front
    hidden = in_image & ~lane.visible
    drawn = (in_image[:-1] | in_image[1:]) & in_front[:-1] & in_front[1:]
    solid = drawn & ~(hidden[:-1] | hidden[1:])
    for start, stop in runs(drawn.astype(int) + solid):
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
