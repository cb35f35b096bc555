"""Read tuSimple: one line of a label file, or a whole file with its images. Lines are columns (x) by image row."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int, UInt8
from pydantic import Field, model_validator

from synth3dlanes.formats.reading import json_lines, read_image
from synth3dlanes.system import schema
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import open_regular
from synth3dlanes.system.schema import MAX_BYTES, Excerpt, Number, PathBelow


@dataclass(frozen=True, eq=False)
class TusimpleFrame:
    """One line of a label file as plain arrays; a column below 0 is absent."""

    raw_file: str
    rows_px: Int[np.ndarray, " r"]
    lanes_u_px: Float[np.ndarray, "l r"]


@dataclass(frozen=True, eq=False)
class TusimpleSplit:
    """A `label_data_*.json`; the clips lie beside it."""

    path: Path

    @cached_property
    def lines(self) -> Sequence[bytes]:
        """One document per line."""
        return json_lines(self.path)

    def __len__(self) -> int:
        return len(self.lines)

    def frame(self, index: int) -> TusimpleFrame:
        """One line of the file."""
        return parse(self.lines[index], f"{self.path}:{index + 1}")

    def image(self, index: int) -> UInt8[np.ndarray, "h w 3"]:
        """The frame's picture."""
        return read_image(self.path.parent / self.frame(index).raw_file)


def is_tusimple(path: Path) -> bool:
    """Whether the first line of the file is a tuSimple frame."""
    try:
        with open_regular(path) as file:
            return b'"h_samples"' in file.readline(MAX_BYTES)
    except OSError as error:
        raise FormatError(f"{path}: cannot be read: {error.strerror}") from None


def find_labels(source: Path) -> Path | None:
    """The tuSimple label file that a path names, or the only one in a folder; None if there is none."""
    if source.suffix == ".json":
        return source if is_tusimple(source) else None
    found = [path for path in sorted(source.glob("*.json")) if is_tusimple(path)]
    if len(found) > 1:
        raise InputError(f"{source}: expected one of its label files, {', '.join(path.name for path in found)}")
    return found[0] if found else None


def parse(line: str | bytes, where: str) -> TusimpleFrame:
    """One line of a label file; FormatErrors begin with `where`."""
    found = schema.parse(_Line, line, where, "a frame of tuSimple")
    lanes_u_px = np.array(found.lanes, dtype=float).reshape(-1, len(found.h_samples))
    return TusimpleFrame(found.raw_file, np.array(found.h_samples, dtype=int), lanes_u_px)


class _Line(Excerpt):
    raw_file: PathBelow
    h_samples: Annotated[list[Number], Field(min_length=1)]
    lanes: list[list[Number]]

    @model_validator(mode="after")
    def _has_a_column_for_every_row(self) -> "_Line":
        if any(len(lane) != len(self.h_samples) for lane in self.lanes):
            raise ValueError(f"lanes: expected {len(self.h_samples)} columns each, as many as h_samples")
        return self
