"""What the segmentation formats share: names, places of files, masks as PNG, and the lines of the labels in pixels."""

import io

import numpy as np
from jaxtyping import Float, Shaped
from PIL import Image

from synth3dlanes.formats.format import SampleFrame
from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.labels.labels import CameraLabel, Lane
from synth3dlanes.scene.instance_ids import numbers_of

PASSES = ("semantic", "instance")
STUFF = ("sky", "terrain", "road", "shoulder")
"""Classes without instances."""

STEP_M = 0.1
NEAREST_M = 0.5
POINT_EVERY_PX = 8.0


def file_name(frame: SampleFrame) -> str:
    """The name of a frame's files, unique in the export."""
    return f"{frame.split}-{frame.key}"


def image_path(frame: SampleFrame) -> str:
    """Where the frame's image goes."""
    return f"images/{file_name(frame)}.{frame.image_format}"


def png(pixels: Shaped[np.ndarray, "h w ..."]) -> bytes:
    """A PNG of 8 or 16 bits a pixel without palette, or of RGB."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def delimiter_numbers(instance: Shaped[np.ndarray, "h w"]) -> Shaped[np.ndarray, "h w"]:
    """1 + i at the paint of delimiter i of the labels, 0 elsewhere; 8 bits where they are enough."""
    numbers = numbers_of("delimiter", instance) + 1
    return numbers.astype(np.uint8 if numbers.max() <= np.iinfo(np.uint8).max else np.uint16)


def line_pixels(lane: Lane, camera: CameraLabel) -> Float[np.ndarray, "_ 2"]:
    """Pixels along the part of a lane in the image that the ground does not hide, from near to far."""
    at = np.arange(len(lane.xyz_cam) - 1.0)
    lengths_m = np.linalg.norm(np.diff(lane.xyz_cam, axis=0), axis=1)
    pieces = np.maximum(1, np.ceil(lengths_m / STEP_M)).astype(int)
    fine = np.concatenate([i + np.arange(n) / n for i, n in zip(at, pieces, strict=True)] + [np.array([len(at)])])
    knots = np.arange(len(lane.xyz_cam))
    points_cam = np.column_stack([np.interp(fine, knots, column) for column in lane.xyz_cam.T])
    # Between two samples the ground is seen if it is at both.
    seen = np.interp(fine, knots, lane.terrain_visible.astype(float)) == 1
    uv = camera.project(points_cam[seen & (points_cam[:, 1] > NEAREST_M)])
    uv = uv[((uv >= 0) & (uv < [camera.width_px, camera.height_px])).all(axis=1)]
    if not len(uv):
        return uv
    along_px = lengths_along(uv)[: len(uv)]
    _, first = np.unique(along_px // POINT_EVERY_PX, return_index=True)
    return uv[np.unique([*first, len(uv) - 1])]
