"""2D lanes of a drive's images: tuSimple's and CULane's files, and our own JSON."""

import io
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from synth3dlanes.formats.culane import lines_path, parse_lines
from synth3dlanes.formats.reading import read_file, read_text
from synth3dlanes.formats.tusimple import is_tusimple
from synth3dlanes.formats.tusimple import parse as parse_tusimple
from synth3dlanes.recorded.drives.tables import MAX_TEXT_BYTES
from synth3dlanes.system.arrays import Polyline2
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import DocumentPart, PathBelow, parse

LINES_FORMAT, LINES_VERSION = "synth3dlanes.lines", 1
# The most lines and points of an image. Benchmarks have up to 20 lines of a few hundred points.
MOST_LINES, MOST_POINTS = 500, 50_000

_Pixel = Annotated[float, Field(ge=-1e5, le=1e5)]
_Line = Annotated[list[tuple[_Pixel, _Pixel]], Field(min_length=2)]


class _Lines(DocumentPart):
    format: Literal["synth3dlanes.lines"]
    version: Literal[1]
    images: dict[PathBelow, list[_Line]]


@dataclass(frozen=True, eq=False)
class ImageLines:
    """The lines of a drive's images. `names` are the images that a file of lines lists, in its order; empty where each
    image has a file of its own. `read` gives the lines of an image by its path; `path` is where they come from."""

    names: tuple[str, ...]
    read: Callable[[Path], tuple[Polyline2, ...]]
    path: Path

    def of(self, image: Path) -> tuple[Polyline2, ...]:
        """The lines of an image. Raises FormatError for too many."""
        lines = self.read(image)
        n_points = sum(map(len, lines))
        if len(lines) > MOST_LINES or n_points > MOST_POINTS:
            most, got = f"{MOST_LINES} lines of {MOST_POINTS:,} points", f"{len(lines):,} of {n_points:,}"
            raise FormatError(f"{self.path}: expected at most {most} in an image, got {got} in {image.name[:60]}")
        return lines

    def expect_some(self, images: Iterable[Path]) -> None:
        """Raise FormatError where none of these images has a line."""
        if not any(self.of(image) for image in images):
            raise FormatError(f"{self.path}: expected lanes in the images of this drive, got none in any of them")


def read_lines_of(path: Path) -> ImageLines:
    """The lines in a file of tuSimple (JSON lines), in our own file, or, of CULane, in a folder or beside each image.
    Raises FormatError, here or when an image's lines are asked for."""
    if path.is_dir():
        return ImageLines((), partial(_of_culane, path), path)
    if path.suffix in (".json", ".jsonl") and is_tusimple(path):
        return _listed(_tusimple(path), path)
    what = f"lanes of tuSimple or {LINES_FORMAT} version {LINES_VERSION}"
    found = parse(_Lines, read_file(path, MAX_TEXT_BYTES), str(path), what, MAX_TEXT_BYTES)
    return _listed({name: tuple(np.array(line) for line in lines) for name, lines in found.images.items()}, path)


def _tusimple(path: Path) -> dict[str, tuple[Polyline2, ...]]:
    found: dict[str, tuple[Polyline2, ...]] = {}
    for number, line in enumerate(io.BytesIO(read_file(path, MAX_TEXT_BYTES)), start=1):
        if line.strip():
            frame = parse_tusimple(line, f"{path}:{number}")
            columns = (np.stack([lane, frame.rows_px.astype(float)], axis=-1)[lane >= 0] for lane in frame.lanes_u_px)
            # tuSimple's rows go down; ours go away from the car.
            found[frame.raw_file] = tuple(lane[::-1] for lane in columns if len(lane) > 1)
    return found


def _listed(lines: dict[str, tuple[Polyline2, ...]], path: Path) -> ImageLines:
    """Lines by image, found by the longest common end of the paths."""
    by_name: dict[str, list[str]] = {}
    for name in lines:
        by_name.setdefault(Path(name).name, []).append(name)

    def read(image: Path) -> tuple[Polyline2, ...]:
        names = by_name.get(image.name, [])
        fitting = names if len(names) == 1 else [name for name in names if image.as_posix().endswith(f"/{name}")]
        if len(fitting) > 1:
            raise FormatError(f"{path}: expected one entry for {image}, got {len(fitting)}")
        return lines[fitting[0]] if fitting else ()

    return ImageLines(tuple(lines), read, path)


def _of_culane(folder: Path, image: Path) -> tuple[Polyline2, ...]:
    name = lines_path(image.with_suffix(".jpg").name)
    path = next(filter(os.path.lexists, (folder / name, image.parent / name)), None)
    if path is None:
        return ()
    return tuple(line for line in parse_lines(read_text(path), str(path)) if len(line) > 1)
