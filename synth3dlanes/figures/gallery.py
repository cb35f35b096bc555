"""Several images in one file: contact sheets, and clips as animated pictures."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from synth3dlanes.figures import colors
from synth3dlanes.figures.overlay import draw_overlay
from synth3dlanes.figures.samples import ShownSample
from synth3dlanes.system.arrays import RgbImage
from synth3dlanes.system.files import encoded

_GAP_PX = 4
_TEXT_PX, _CAPTION_PX = 12, 18


def draw_gallery(samples: Sequence[ShownSample], columns: int, width_px: int | None = None) -> Image.Image:
    """A contact sheet, row by row from the top left, each picture with the lanes of its labels below its name.

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
    pitch = (width + _GAP_PX, _CAPTION_PX + height + _GAP_PX)
    sheet_size = (columns * pitch[0] + _GAP_PX, rows * pitch[1] + _GAP_PX)
    sheet = Image.new("RGB", sheet_size, "white")
    for number, sample in enumerate(samples):
        drawn = Image.fromarray(sample.image if sample.labels is None else draw_overlay(sample.image, sample.labels))
        row, column = divmod(number, columns)
        corner = (_GAP_PX + column * pitch[0], _GAP_PX + row * pitch[1])
        sheet.paste(_caption(sample.name, width), corner)
        scale = min(width / drawn.width, height / drawn.height)
        size = min(width, round(scale * drawn.width)), min(height, round(scale * drawn.height))
        sheet.paste(drawn.resize(size, Image.Resampling.LANCZOS), (corner[0], corner[1] + _CAPTION_PX))
    return sheet


def _caption(name: str, width_px: int) -> Image.Image:
    """A name, cut where its cell ends."""
    caption = Image.new("RGB", (width_px, _CAPTION_PX), "white")
    ImageDraw.Draw(caption).text((1, 1), name, fill=colors.INK, font=ImageFont.load_default(_TEXT_PX))
    return caption


# How each kind is written.
OPTIONS: dict[str, dict[str, int | bool]] = {"webp": {"quality": 80, "method": 6}, "gif": {}, "png": {}}


def draw_clip(frames: Sequence[RgbImage], fps: float, width_px: int | None = None, kind: str = "webp") -> bytes:
    """An animated picture that repeats the frames, as `webp`, `gif` (256 colours, hundredths of a second) or `png`;
    wider ones are shrunk to `width_px`."""
    height, width = frames[0].shape[:2]
    if width_px is not None and width > width_px:
        width, height = width_px, round(height * width_px / width)
    first, *others = (Image.fromarray(frame).resize((width, height), Image.Resampling.LANCZOS) for frame in frames)
    # Whole milliseconds (for a GIF, hundredths of a second) that add up to the clip's duration.
    unit_ms = 10 if kind == "gif" else 1
    ends_ms = unit_ms * np.round(1000 / unit_ms / fps * np.arange(len(frames) + 1)).astype(int)
    animation = {"save_all": True, "append_images": others, "duration": np.diff(ends_ms).tolist(), "loop": 0}
    return encoded(lambda stream: first.save(stream, kind.upper(), **animation, **OPTIONS[kind]))
