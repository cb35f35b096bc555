"""Antialiased lines over an image, in the styles that all pictures share."""

import itertools
from collections.abc import Iterable, Iterator
from typing import Literal

import numpy as np
from jaxtyping import Int
from PIL import Image, ImageDraw

from synth3dlanes.arrays import Polyline2
from synth3dlanes.figures.colors import Rgb

Style = Literal["full", "dotted", "hollow"]
"""Seen; hidden; and the outline of a line in which another is drawn: a label under a detection."""

_SUPERSAMPLING = 4
# A mask has no longer edge, so that one of the largest image takes 64 MB.
_MASK_PX = 8192
_DOTTED_OPACITY = 0.6
# Widths of a hollow line and of its inside, in those of a full one.
_HOLLOW, _INSIDE = 3.6, 2.2
# Of coordinates: those of a wild detection have no bound, and Pillow counts in 32 bits.
_FARTHEST_PX = 1e6


def line_width_px(size_px: tuple[int, int]) -> float:
    """The width of lanes in an image of this size, with which it grows."""
    return max(1.2, max(size_px) / 320)


def draw_lines(
    image: Image.Image, lines_px: Iterable[Polyline2], color: Rgb, width_px: float, style: Style = "full"
) -> None:
    """Draw lines onto an image. Points are in pixels, those far outside the image too; (0, 0) is the corner of the
    first pixel."""
    lines = list(lines_px)
    if not lines:
        return
    finer = max(1, min(_SUPERSAMPLING, _MASK_PX // max(image.size)))
    mask = Image.new("L", (image.width * finer, image.height * finer))
    draw = ImageDraw.Draw(mask)
    points = [np.floor(np.clip(line, -_FARTHEST_PX, _FARTHEST_PX) * finer) for line in lines]
    if style == "dotted":
        for line in points:
            _draw_dots(draw, line, _odd(width_px * finer))
    else:
        fills = {255: 1.0} if style == "full" else {255: _HOLLOW, 0: _INSIDE}
        for fill, widths in fills.items():
            width = _odd(widths * width_px * finer)
            for line in points:
                draw.line([tuple(point) for point in line.tolist()], fill=fill, width=width, joint="curve")
    image.paste(color, mask=mask.reduce(finer))


def runs(values: Int[np.ndarray, " n"]) -> Iterator[tuple[int, int]]:
    """Half-open index ranges over which `values` stay equal."""
    borders = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return ((start, stop) for start, stop in itertools.pairwise(borders) if start < stop)


def _odd(width: float) -> int:
    """Pillow draws along whole pixels; an odd width is centred on them."""
    return 2 * round(width / 2) + 1


def _draw_dots(draw: ImageDraw.ImageDraw, line: Polyline2, width: int) -> None:
    """Dots evenly spaced along a line, beginning with its start."""
    radius = width / 2
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.arange(0.0, travelled[-1], 4 * width)
    for u, v in zip(*(np.interp(at, travelled, axis).tolist() for axis in line.T), strict=True):
        draw.ellipse((u - radius, v - radius, u + radius, v + radius), fill=round(255 * _DOTTED_OPACITY))
