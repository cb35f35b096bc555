"""Contact sheets of several images."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from synth3dlanes.figures.overlay import draw_overlay
from synth3dlanes.labels import Labels

_GAP_PX = 4


def draw_gallery(
    images: Sequence[UInt8[np.ndarray, "h w 3"]], labels: Sequence[Labels] | None, columns: int
) -> Image.Image:
    """A contact sheet, row by row from the top left, with cells of the first image's size; draws lanes if given."""
    assert images
    assert columns > 0
    height_px, width_px = images[0].shape[:2]
    columns = min(columns, len(images))
    rows = -(-len(images) // columns)
    sheet_size = (columns * (width_px + _GAP_PX) + _GAP_PX, rows * (height_px + _GAP_PX) + _GAP_PX)
    sheet = Image.new("RGB", sheet_size, "white")
    for number, image in enumerate(images):
        drawn = Image.fromarray(image if labels is None else draw_overlay(image, labels[number]))
        row, column = divmod(number, columns)
        corner = (_GAP_PX + column * (width_px + _GAP_PX), _GAP_PX + row * (height_px + _GAP_PX))
        sheet.paste(drawn.resize((width_px, height_px)), corner)
    return sheet
