"""Read tuSimple: one line of a label file, or a whole file with its images. Lines are columns (x) by image row."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from synth3dlanes.errors import FormatError, InputError
from synth3dlanes.formats.reading import MALFORMED, json_lines, json_object, read_image


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
    def lines(self) -> Sequence[str]:
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
    with path.open(encoding="utf-8") as file:
        return '"h_samples"' in file.readline()


def find_labels(source: Path) -> Path | None:
    """The tuSimple label file that a path names, or the only one in a folder; None if there is none."""
    if source.suffix == ".json":
        return source if is_tusimple(source) else None
    found = [path for path in sorted(source.glob("*.json")) if is_tusimple(path)]
    if len(found) > 1:
        raise InputError(f"{source}: expected one of its label files, {', '.join(path.name for path in found)}")
    return found[0] if found else None


def parse(line: str, where: str) -> TusimpleFrame:
    """One line of a label file; FormatErrors begin with `where`."""
    document = json_object(line, where)
    try:
        rows_px = np.array(document["h_samples"], dtype=int)
        lanes_u_px = np.array(document["lanes"], dtype=float).reshape(-1, len(rows_px))
        return TusimpleFrame(str(document["raw_file"]), rows_px, lanes_u_px)
    except MALFORMED as error:
        raise FormatError(f"{where}: not a tuSimple frame: {type(error).__name__}: {error}") from None
