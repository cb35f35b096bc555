"""What the readers of foreign formats share: labelled images, their lanes in our camera frame."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BufferedReader
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Bool, Float, Shaped, UInt8
from PIL import Image
from pydantic import AfterValidator, TypeAdapter, ValidationError

from synth3dlanes.dataset.format import decode_image, shown_size
from synth3dlanes.geometry.frames import from_axes, inside_image, project, road_from_cam, rotation
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, LaneGraph, LaneKind, Marking, PaintColor, Pair
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.files import open_regular, read_bounded
from synth3dlanes.system.json_arrays import JsonPoints
from synth3dlanes.system.schema import PathBelow, shown

MAX_FILE_BYTES = 512 << 20
"""An image of 8192 x 8192 takes 200 MB without compression, the labels of 100,000 images 400 MB."""
MOST_TEXT = 64 << 20
"""Bytes of one frame's label file, and of a line of a list."""
PICTURES = ("JPEG", "PNG", "BMP", "WEBP")
MOST_BYTES = 1 << 34
"""Most bytes of a file with many frames, such as COCO's annotations."""
LEAST_SPACING_M = 0.5
MAX_NUMBER = 1e6
"""Beyond any coordinate or column."""
_BELOW = TypeAdapter(PathBelow)


def _two_or_more(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    if len(points) < 2:
        raise ValueError(f"expected a line of two points or more, got {len(points)}")
    return points


JsonLine = Annotated[JsonPoints, AfterValidator(_two_or_more)]
"""Points of a line that can be measured."""
UNKNOWN: tuple[Marking, None, None, None] = ("none", None, None, None)
"""The paint of lines of formats that do not have it."""


@dataclass(frozen=True, eq=False)
class ForeignSample:
    """One labelled image; `key` is the path by which its format names it."""

    key: str
    image: UInt8[np.ndarray, "h w 3"]
    labels: Labels


@dataclass(frozen=True, eq=False)
class ForeignLane:
    """A lane of a foreign file, in our camera frame; `paint` is its marking, colour, whether it is double, and
    its stripes if they differ."""

    kind: LaneKind
    xyz_cam: Float[np.ndarray, "n 3"]
    visible: Bool[np.ndarray, " n"]
    paint: tuple[Marking, PaintColor | None, bool | None, Pair | None] = UNKNOWN


@dataclass(frozen=True, eq=False)
class LabelLines:
    """A label file with a JSON document a line for each image."""

    path: Path

    @cached_property
    def lines(self) -> Sequence[bytes]:
        return json_lines(self.path)

    def __len__(self) -> int:
        return len(self.lines)


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
            marking, color, double, pair = lane.paint
            points = xyz_cam, in_image, visible, None
            made.append(
                Lane(name, lane.kind, "main", marking, None, None, *points, color=color, double=double, pair=pair)
            )
    to_road = road_from_cam(height_m, pitch_rad)
    camera = CameraLabel(*size_px, img_from_cam, height_m, pitch_rad, to_road, to_road)
    return Labels(camera, tuple(made), LaneGraph((), {}, None))


def read_image(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """The pixels of a JPEG, PNG, BMP or WebP file of at most 8192 x 8192, turned as the file says (EXIF), as OpenCV and
    the benchmarks' own tools do; raise FormatError where it is none."""
    return decode_image(read_file(path), str(path), kinds=PICTURES, is_turned=True)


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image file as it is to be shown (EXIF), without decoding it."""
    return image_header(path)[:2]


def image_header(path: Path) -> tuple[int, int, str]:
    """Width, height and kind (JPEG, PNG) of an image file, without decoding it."""
    try:
        with _opened(path) as stream, Image.open(stream) as image:
            return (*shown_size(image), image.format or "")
    except FormatError:
        raise
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise FormatError(f"{path}: expected an image, got {error}") from None


def read_mask(path: Path, size_px: tuple[int, int], *modes: str) -> Shaped[np.ndarray, "h w ..."]:
    """The pixels of a PNG file of this width, height and one of these modes of Pillow's."""
    if (found := image_size(path)) != size_px:
        raise FormatError(f"{path}: expected the size of its image, {size_px}, got {found}")
    try:
        with Image.open(path) as image:
            pixels, found_mode = np.asarray(image), image.mode
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise FormatError(f"{path}: expected a mask, got {error}") from None
    if found_mode not in modes:
        raise FormatError(f"{path}: expected a mask of mode {' or '.join(modes)}, got {found_mode}")
    return pixels


def read_text(path: Path) -> str:
    """The text of a label file."""
    try:
        return read_bounded(path, MOST_TEXT).decode()
    except FormatError:
        raise
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError(f"{path}: expected a label file, got {error}") from None


def first_lines(path: Path, most: int) -> list[str]:
    """The first lines of a list, at most `most`, without their ends."""
    lines: list[str] = []
    with _opened(path) as file:
        while len(lines) < most and (line := file.readline(MOST_TEXT)):
            try:
                lines.append(line.decode().rstrip("\n"))
            except UnicodeDecodeError as error:
                raise FormatError(f"{path}:{len(lines) + 1}: expected text, got {error}") from None
    return lines


def listed_files(path: Path, most: int) -> list[str]:
    """The first files of a list, at most `most`; raise FormatError for one that is not below the export's folder."""
    return [file_below(line, f"{path}:{number}") for number, line in enumerate(first_lines(path, most), start=1)]


def file_below(text: str, where: str) -> str:
    """A path that a file of an export names; raise FormatError where it is not below a folder."""
    try:
        return _BELOW.validate_python(text)
    except ValidationError:
        raise FormatError(f"{where}: expected a path below the folder, got {shown(text)}") from None


def numbers(text: str, where: str, columns: int = 2) -> Float[np.ndarray, "n c"]:
    """A line of numbers as rows of `columns`; raise FormatError where they do not fill rows or are no numbers."""
    try:
        found = np.array(text.split(), dtype=float)
    except ValueError:
        raise FormatError(f"{where}: expected numbers, got {shown(text)}") from None
    if len(found) % columns or not (np.abs(found) <= MAX_NUMBER).all():
        raise FormatError(f"{where}: expected numbers up to {MAX_NUMBER:g} in groups of {columns}, got {shown(text)}")
    return found.reshape(-1, columns)


def drawable(lines: Sequence[Float[np.ndarray, "_ 2"]], where: str) -> tuple[Float[np.ndarray, "_ 2"], ...]:
    """Lines that can be drawn; raise FormatError where one has fewer than two points, or the same twice."""
    for line in lines:
        if len(line) < 2 or not np.abs(np.diff(line, axis=0)).max(axis=1).all():
            raise FormatError(f"{where}: expected lines of two different points or more, got {shown(line.tolist())}")
    return tuple(lines)


def _opened(path: Path) -> BufferedReader:
    try:
        return open_regular(path)
    except FormatError:
        raise
    except (OSError, ValueError):
        raise FormatError(f"{path}: expected a file, got none") from None


def read_file(path: Path, most: int = MAX_FILE_BYTES) -> bytes:
    """The bytes of a file that a user or another file names; raise FormatError where there is none or it has more than
    `most`."""
    try:
        return read_bounded(path, most)
    except FormatError:
        raise
    except (OSError, ValueError) as error:
        raise FormatError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


def pose_of(place: Sequence[float] | Float[np.ndarray, "3"], wxyz: Sequence[float] | Float[np.ndarray, "4"]) -> Matrix4:
    """The pose of a place and a quaternion; NaN where that is none."""
    is_turn = bool(np.isfinite(wxyz).all() and np.any(wxyz))
    x, y, z = rotation(np.array(wxyz, float)).T if is_turn else np.full((3, 3), np.nan)
    return from_axes(x, y, z, np.array(place, float))


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
        if not kept or xyz_cam[index, 1] >= xyz_cam[kept[-1], 1] + LEAST_SPACING_M - 1e-6:
            kept.append(index)
    return kept
