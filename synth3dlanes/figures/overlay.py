"""Draw lanes, boxes of objects and faces of traffic elements on an image, where the labels' camera projects them.

A box is twelve edges, and a line on the floor from its middle to its front; a face is its four edges.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from synth3dlanes.figures.colors import ELEMENT, KINDS, OBJECT, Rgb
from synth3dlanes.figures.strokes import Style, draw_lines, line_width_px, runs
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane
from synth3dlanes.labels.object_labels import CORNERS, ObjectLabel
from synth3dlanes.system.arguments import checked
from synth3dlanes.system.arrays import Polyline2

# Nearer parts of lines cannot be projected. Pieces of a line, which a lens bends.
CUT_DEPTH_M, PIECES = 0.3, 12
# Objects of which less is seen have no box: it would stand before what hides them.
LEAST_SEEN = 0.05
# Ends of all lines in the frame of a box of size 2.
LINES = np.array(
    [
        *((CORNERS[i], CORNERS[j]) for i in range(8) for j in range(i) if (CORNERS[i] != CORNERS[j]).sum() == 1),
        ((0, 0, -1), (0, 1, -1)),
    ]
)


# The edges of the face of a traffic element.
FACE = np.array(
    [((x, -1, z), (x2, -1, z2)) for x, z, x2, z2 in ((-1, 1, 1, 1), (1, 1, 1, -1), (1, -1, -1, -1), (-1, -1, -1, 1))]
)


def objects_in_image(labels: Labels) -> Iterator[tuple[ObjectLabel, list[Polyline2]]]:
    """The objects, then the traffic elements in the image that are not hidden, with their lines."""
    for item in (*(labels.objects or ()), *(labels.traffic_elements or ())):
        if item.box_px is not None and (item.visible_fraction is None or item.visible_fraction >= LEAST_SEEN):
            yield item, list(lines_img(labels.camera, item))


def color_of(item: ObjectLabel) -> Rgb:
    """The colour of an object's lines."""
    return ELEMENT if item.is_element else OBJECT


def lines_img(camera: CameraLabel, item: ObjectLabel) -> Iterator[Polyline2]:
    """The parts of the lines of a box, or of the edges of an element's face, that are ahead of the camera and in its
    lens's field."""
    for first, second in transform(item.cam_from_object, (FACE if item.is_element else LINES) * item.size_m / 2):
        share = np.linspace(0, 1, (1 if camera.lens.is_pinhole else PIECES) + 1)[:, None]
        points_cam = first + share * (second - first)
        if camera.lens.is_pinhole:
            points_cam = _ahead(*points_cam)
        uv = camera.project(points_cam)
        uv = uv[np.isfinite(uv).all(axis=1)]
        if len(uv) > 1:
            yield uv


def _ahead(first: Float[np.ndarray, "3"], second: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n 3"]:
    """The part of a straight line that is ahead of the camera."""
    near, far = sorted((first, second), key=lambda point: float(point[1]))
    if far[1] <= CUT_DEPTH_M:
        return np.zeros((0, 3))
    share = max(0.0, (CUT_DEPTH_M - near[1]) / (far[1] - near[1])) if far[1] > near[1] else 0.0
    return np.stack([near + share * (far - near), far])


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
