"""Read CULane: the lines of a frame, and the lines of its lists. Pixels."""

from dataclasses import dataclass

from synth3dlanes.formats.reading import file_below, numbers
from synth3dlanes.system.arrays import Polyline2
from synth3dlanes.system.errors import FormatError


@dataclass(frozen=True)
class CulaneEntry:
    """One line of a list. Lists of the name `*_gt.txt` have a mask, and whether the lines left-left, left, right and
    right-right of the camera are in it, as 1 to 4."""

    image: str
    mask: str | None
    exists: tuple[bool, ...]


def parse_lines(text: str, where: str) -> tuple[Polyline2, ...]:
    """A file `.lines.txt`: x and y in turn, one line of text per line; FormatErrors begin with `where`."""
    lines = enumerate(text.splitlines(), start=1)
    return tuple(numbers(line, f"{where}:{number}") for number, line in lines if line.strip())


def parse_entry(line: str, where: str) -> CulaneEntry:
    """One line of a list, its paths without the slash that they begin with; FormatErrors begin with `where`."""
    match line.split():
        case [image]:
            return CulaneEntry(file_below(image.lstrip("/"), where), None, ())
        case [image, mask, *flags] if len(flags) == 4 and set(flags) <= {"0", "1"}:
            image, mask = (file_below(path.lstrip("/"), where) for path in (image, mask))
            return CulaneEntry(image, mask, tuple(flag == "1" for flag in flags))
    raise FormatError(f"{where}: expected an image, or an image, a mask and four flags 0 or 1, got {line!r:.80}")


def lines_path(image: str) -> str:
    """Where the lines of an image are."""
    return image.removesuffix(".jpg") + ".lines.txt"
