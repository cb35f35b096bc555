"""Antialiased lines over an image, in the styles that all pictures share."""

import itertools
from collections.abc import Iterable, Iterator
from typing import Literal

import numpy as np
from jaxtyping import Int
from PIL import Image, ImageDraw

from synth3dlanes.figures.colors import Rgb
from synth3dlanes.system.arrays import Polyline2

Style = Literal["full", "dotted", "hollow"]
"""Seen; hidden; and the outline of a line in which another is drawn: a label under a detection."""

_SUPERSAMPLING = 4
# The longest edge of a mask. The largest mask takes 64 MB.
_MASK_PX = 8192
# Greatest length and turn of pieces of a line that are joined into one.
_STRAIGHT_PX, _STRAIGHT_RAD = 40.0, 0.035
_DOTTED_OPACITY = 0.6
# Widths of a hollow line and of its inside, in widths of a full line.
_HOLLOW, _INSIDE = 3.6, 2.2
# The largest coordinate drawn: a wild detection has no bound, and Pillow counts in 32 bits.
_FARTHEST_PX = 1e6


def line_width_px(size_px: tuple[int, int]) -> float:
    """The width of lanes in an image of this size, with which it grows."""
    return max(1.2, max(size_px) / 320)


def draw_lines(
    image: Image.Image, lines_px: Iterable[Polyline2], color: Rgb, width_px: float, style: Style = "full"
) -> None:
    """Draw lines onto an image. Points are in pixels, those far outside the image too; (0, 0) is the corner of the
    first pixel."""
    lines = [_thinned(np.clip(line, -_FARTHEST_PX, _FARTHEST_PX)) for line in lines_px]
    box = _box(lines, (_HOLLOW + 1) * width_px, image.size)
    if box is None:
        return
    finer = max(1, min(_SUPERSAMPLING, _MASK_PX // max(image.size)))
    mask = Image.new("L", ((box[2] - box[0]) * finer, (box[3] - box[1]) * finer))
    draw = ImageDraw.Draw(mask)
    points = [np.floor((line - box[:2]) * finer) for line in lines]
    if style == "dotted":
        for line in points:
            _draw_dots(draw, line, _odd(width_px * finer))
    else:
        fills = {255: 1.0} if style == "full" else {255: _HOLLOW, 0: _INSIDE}
        for fill, widths in fills.items():
            width = _odd(widths * width_px * finer)
            for line in points:
                draw.line([tuple(point) for point in line.tolist()], fill=fill, width=width, joint="curve")
    image.paste(color, box[:2], mask.reduce(finer))


def runs(values: Int[np.ndarray, " n"]) -> Iterator[tuple[int, int]]:
    """Half-open index ranges over which `values` stay equal."""
    borders = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return ((start, stop) for start, stop in itertools.pairwise(borders) if start < stop)


def _thinned(line: Polyline2) -> Polyline2:
    """A line without points where it is straight: Pillow joins the two pieces at every point with a circle, which takes
    most of the time. It moves by less than a fifth of a pixel."""
    if len(line) < 3:
        return line
    pieces = np.diff(line, axis=0)
    travelled = np.cumsum(np.hypot(*pieces.T))
    turns = np.diff(np.arctan2(pieces[:, 1], pieces[:, 0]))
    turned = np.cumsum(np.abs((turns + np.pi) % (2 * np.pi) - np.pi))
    # Both only grow, so their sum changes where either does.
    part = np.floor(travelled[:-1] / _STRAIGHT_PX) + np.floor(turned / _STRAIGHT_RAD)
    kept = np.flatnonzero(np.diff(part, prepend=0.0)) + 1
    return line[[0, *kept.tolist(), len(line) - 1]]


def _box(lines: list[Polyline2], margin_px: float, size_px: tuple[int, int]) -> tuple[int, int, int, int] | None:
    """The part of the image, left, top, right and bottom, that lines can reach; None if there is none."""
    ends = [end for line in lines if len(line) for end in (line.min(axis=0), line.max(axis=0))]
    if not ends:
        return None
    low = np.clip(np.floor(np.min(ends, axis=0) - margin_px), 0, size_px).astype(int).tolist()
    high = np.clip(np.ceil(np.max(ends, axis=0) + margin_px), 0, size_px).astype(int).tolist()
    return (*low, *high) if low[0] < high[0] and low[1] < high[1] else None


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
