"""Clips as animated pictures."""

import io
from collections.abc import Sequence

import numpy as np
from PIL import Image

from synth3dlanes.system.arrays import RgbImage

# How each kind is written.
OPTIONS: dict[str, dict[str, int | bool]] = {"webp": {"quality": 80, "method": 6}, "gif": {}, "png": {}}


def draw_clip(frames: Sequence[RgbImage], fps: float, width_px: int | None = None, kind: str = "webp") -> bytes:
    """An animated picture that repeats the frames, as `webp`, `gif` (256 colours, hundredths of a second) or `png`;
    wider ones are shrunk to `width_px`."""
    height, width = frames[0].shape[:2]
    if width_px is not None and width > width_px:
        width, height = width_px, round(height * width_px / width)
    first, *others = (Image.fromarray(frame).resize((width, height), Image.Resampling.LANCZOS) for frame in frames)
    # Whole milliseconds, of a GIF hundredths of seconds, that add up to the clip's duration.
    unit_ms = 10 if kind == "gif" else 1
    ends_ms = unit_ms * np.round(1000 / unit_ms / fps * np.arange(len(frames) + 1)).astype(int)
    stream = io.BytesIO()
    animation = {"save_all": True, "append_images": others, "duration": np.diff(ends_ms).tolist(), "loop": 0}
    first.save(stream, kind.upper(), **animation, **OPTIONS[kind])
    return stream.getvalue()
