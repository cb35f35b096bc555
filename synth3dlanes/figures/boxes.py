"""The boxes of objects as lines in the image: twelve edges, and a line on the floor from the middle to the front; and
the edges of the faces of traffic elements."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from synth3dlanes.figures.colors import ELEMENT, OBJECT, Rgb
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import CameraLabel, Labels
from synth3dlanes.labels.object_labels import CORNERS, ObjectLabel
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
    """The objects, then the traffic elements in the image with their lines, but for those that are hidden."""
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
