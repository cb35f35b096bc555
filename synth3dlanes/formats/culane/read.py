"""Read CULane: the lines of a frame, and the lines of its lists. Pixels."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.reading import MALFORMED

Polyline = Float[np.ndarray, "_ 2"]


@dataclass(frozen=True)
class CulaneEntry:
    """One line of a list. Lists of the name `*_gt.txt` have a mask, and whether the lines left-left, left, right and
    right-right of the camera are in it, as 1 to 4."""

    image: str
    mask: str | None
    exists: tuple[bool, ...]


def parse_lines(text: str, where: str) -> tuple[Polyline, ...]:
    """A file `.lines.txt`: x and y in turn, one line of text per line; FormatErrors begin with `where`."""
    try:
        return tuple(np.array(line.split(), dtype=float).reshape(-1, 2) for line in text.splitlines() if line.strip())
    except MALFORMED as error:
        raise FormatError(f"{where}: not lines of CULane: {type(error).__name__}: {error}") from None


def parse_entry(line: str, where: str) -> CulaneEntry:
    """One line of a list, its paths without the slash that they begin with; FormatErrors begin with `where`."""
    match line.split():
        case [image]:
            return CulaneEntry(image.lstrip("/"), None, ())
        case [image, mask, *flags] if len(flags) == 4 and set(flags) <= {"0", "1"}:
            return CulaneEntry(image.lstrip("/"), mask.lstrip("/"), tuple(flag == "1" for flag in flags))
    raise FormatError(f"{where}: expected an image, or an image, a mask and four flags 0 or 1, got {line!r:.80}")


def lines_path(image: str) -> str:
    """Where the lines of an image are."""
    return image.removesuffix(".jpg") + ".lines.txt"
