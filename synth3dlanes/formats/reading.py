"""What the readers of foreign formats share: labelled images, their lanes in our camera frame."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image

from synth3dlanes.dataset.format import decode_image
from synth3dlanes.errors import FormatError
from synth3dlanes.files import open_regular, read_bounded
from synth3dlanes.frames import inside_image, project, road_from_cam
from synth3dlanes.labels import CameraLabel, Labels, Lane, LaneGraph, LaneKind, Marking, PaintColor

MALFORMED = (KeyError, TypeError, IndexError, ValueError, AttributeError, OverflowError)
"""What a damaged file of an export of ours raises on the way to arrays. Files of others are parsed by schemas."""
MAX_FILE_BYTES = 512 << 20
"""An image of 8192 x 8192 takes 200 MB without compression, the labels of 100,000 images 400 MB."""
PICTURES = ("JPEG", "PNG", "BMP", "WEBP")
STEP_M = 0.5
UNKNOWN: tuple[Marking, None, None] = ("none", None, None)
"""The paint of lines of formats that do not have it."""


@dataclass(frozen=True, eq=False)
class ForeignSample:
    """One labelled image; `key` is the path by which its format names it."""

    key: str
    image: UInt8[np.ndarray, "h w 3"]
    labels: Labels


@dataclass(frozen=True, eq=False)
class ForeignLane:
    """A lane of a foreign file, in our camera frame; `paint` is its marking, colour and whether it is double."""

    kind: LaneKind
    xyz_cam: Float[np.ndarray, "n 3"]
    visible: Bool[np.ndarray, " n"]
    paint: tuple[Marking, PaintColor | None, bool | None] = UNKNOWN


def labels_of(
    size_px: tuple[int, int],
    img_from_cam: Float[np.ndarray, "3 3"],
    height_m: float,
    pitch_rad: float,
    lanes: Sequence[ForeignLane],
) -> Labels:
    """Foreign lanes as our labels: sampled every half metre or so, near to far; no graph, no roll."""
    made = []
    for index, lane in enumerate(lanes):
        kept = _thinned(lane.xyz_cam)
        if len(kept) >= 2:
            xyz_cam, visible = lane.xyz_cam[kept], lane.visible[kept]
            in_image = inside_image(project(img_from_cam, xyz_cam), *size_px)
            name = f"{lane.kind}{index}"
            marking, color, double = lane.paint
            made.append(
                Lane(name, lane.kind, "main", marking, None, None, xyz_cam, in_image, visible, None, color, double)
            )
    to_road = road_from_cam(height_m, pitch_rad)
    camera = CameraLabel(*size_px, img_from_cam, height_m, pitch_rad, to_road, to_road)
    return Labels(camera, tuple(made), LaneGraph((), {}, None))


def read_image(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """The pixels of a JPEG, PNG, BMP or WebP file of at most 8192 x 8192; raise FormatError where it is none."""
    return decode_image(read_file(path), str(path), kinds=PICTURES)


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image file, without decoding it."""
    try:
        with open_regular(path) as stream, Image.open(stream) as image:
            return (image.width, image.height)
    except FormatError:
        raise
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise FormatError(f"{path}: expected an image, got {error}") from None


def read_text(path: Path) -> str:
    """The text of a label file."""
    try:
        return read_file(path).decode()
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: expected a label file, got {error}") from None


def read_file(path: Path) -> bytes:
    """The bytes of a file that a user or another file names; raise FormatError where there is none."""
    try:
        return read_bounded(path, MAX_FILE_BYTES)
    except FormatError:
        raise
    except (OSError, ValueError) as error:
        raise FormatError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


def json_lines(path: Path) -> list[bytes]:
    """The documents of a JSON-lines file, undecoded."""
    return [line for line in read_file(path).split(b"\n") if line.strip()]


def json_object(text: str, where: str) -> dict[str, Any]:
    """The JSON object that a label file or one line of it is."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{where}: expected a JSON document, got {error}") from None
    if not isinstance(document, dict):
        raise FormatError(f"{where}: expected a JSON object, got {type(document).__name__}")
    return document


def _thinned(xyz_cam: Float[np.ndarray, "n 3"]) -> list[int]:
    """Points half a metre further along y than the last one kept: some files have one every 25 cm, in any order."""
    kept: list[int] = []
    for index in np.argsort(xyz_cam[:, 1], kind="stable").tolist():
        if not kept or xyz_cam[index, 1] >= xyz_cam[kept[-1], 1] + STEP_M - 1e-6:
            kept.append(index)
    return kept
