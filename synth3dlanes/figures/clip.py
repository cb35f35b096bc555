"""Clips as animated pictures."""

import io
from collections.abc import Sequence

import numpy as np
from PIL import Image

from synth3dlanes.arrays import RgbImage

WEBP_QUALITY = 80


def draw_clip(frames: Sequence[RgbImage], fps: float, width_px: int | None = None) -> bytes:
    """An animated WebP that repeats the frames; wider ones are shrunk to `width_px`."""
    height, width = frames[0].shape[:2]
    if width_px is not None and width > width_px:
        width, height = width_px, round(height * width_px / width)
    first, *others = (Image.fromarray(frame).resize((width, height), Image.Resampling.LANCZOS) for frame in frames)
    # Whole milliseconds that add up to the clip's duration.
    ends_ms = np.round(1000 / fps * np.arange(len(frames) + 1)).astype(int)
    stream = io.BytesIO()
    durations_ms = np.diff(ends_ms).tolist()
    first.save(
        stream,
        "WEBP",
        save_all=True,
        append_images=others,
        duration=durations_ms,
        loop=0,
        quality=WEBP_QUALITY,
        method=6,
    )
    return stream.getvalue()
