"""Contact sheets of several images."""

from collections.abc import Sequence

from PIL import Image, ImageDraw, ImageFont

from synth3dlanes.figures.overlay import draw_overlay
from synth3dlanes.figures.shown import ShownSample

_GAP_PX = 4
_TEXT_PX = 12


def draw_gallery(samples: Sequence[ShownSample], columns: int, width_px: int | None = None) -> Image.Image:
    """A contact sheet, row by row from the top left, each picture with its name and the lanes of its labels.

    Cells have the first picture's size, or fill a sheet of at most `width_px`; pictures of another shape fit into them.
    """
    assert samples
    assert columns > 0
    height, width = samples[0].image.shape[:2]
    columns = min(columns, len(samples))
    rows = -(-len(samples) // columns)
    if width_px is not None and columns * (width + _GAP_PX) + _GAP_PX > width_px:
        shrunk = max(1, (width_px - _GAP_PX) // columns - _GAP_PX)
        width, height = shrunk, max(1, round(height * shrunk / width))
    sheet_size = (columns * (width + _GAP_PX) + _GAP_PX, rows * (height + _GAP_PX) + _GAP_PX)
    sheet = Image.new("RGB", sheet_size, "white")
    for number, sample in enumerate(samples):
        drawn = Image.fromarray(sample.image if sample.labels is None else draw_overlay(sample.image, sample.labels))
        row, column = divmod(number, columns)
        corner = (_GAP_PX + column * (width + _GAP_PX), _GAP_PX + row * (height + _GAP_PX))
        scale = min(width / drawn.width, height / drawn.height)
        size = min(width, round(scale * drawn.width)), min(height, round(scale * drawn.height))
        sheet.paste(drawn.resize(size, Image.Resampling.LANCZOS), corner)
        _write(sheet, sample.name, corner)
    return sheet


def _write(sheet: Image.Image, name: str, corner: tuple[int, int]) -> None:
    """A name in white on black, into the top left of a cell."""
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(_TEXT_PX)
    place = (corner[0] + 3, corner[1] + 1)
    _, _, right, bottom = draw.textbbox(place, name, font=font)
    draw.rectangle((*corner, right + 2, bottom + 2), fill="black")
    draw.text(place, name, fill="white", font=font)
