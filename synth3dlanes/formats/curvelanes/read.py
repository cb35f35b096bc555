"""Read CurveLanes: the lines of a frame. Pixels."""

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.reading import numbers
from synth3dlanes.system import schema
from synth3dlanes.system.schema import Excerpt


class _Point(Excerpt):
    x: str
    y: str


class _Lines(Excerpt):
    Lines: list[list[_Point]]


def parse(text: str, where: str) -> tuple[Float[np.ndarray, "_ 2"], ...]:
    """A file `.lines.json`; FormatErrors begin with `where`."""
    found = schema.parse(_Lines, text, where, "lines of CurveLanes")
    return tuple(numbers(" ".join(f"{point.x} {point.y}" for point in line), where) for line in found.Lines)


def labels_path(image: str) -> str:
    """Where the lines of an image are, `images/a.jpg` or `train/images/a.jpg`."""
    folder, _, name = image.rpartition("images/")
    return f"{folder}labels/{name.removesuffix('.jpg')}.lines.json"
