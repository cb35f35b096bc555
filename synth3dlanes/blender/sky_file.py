"""A user's picture of the sky, read by Blender: HDR or EXR."""

from pathlib import Path

import bpy
import numpy as np
from jaxtyping import Float

from synth3dlanes.errors import FormatError
from synth3dlanes.imaging.user_sky import resized


def read_sky(path: Path) -> Float[np.ndarray, "3 h w"]:
    """The picture's upper half at the size of our dome; raise FormatError where it is none."""
    image = bpy.data.images.load(str(path))
    try:
        width, height = image.size
        if width == 0:
            raise FormatError(f"{path.name}: expected a picture, cannot read it")
        if width != 2 * height:
            raise FormatError(f"{path.name}: expected twice as wide as high (equirectangular), got {width}x{height}")
        pixels = np.zeros(width * height * image.channels, dtype=np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    upper = pixels.reshape(height, width, -1)[height // 2 :, :, :3]
    if not np.isfinite(upper).all() or upper.min() < 0 or upper.max() <= 0:
        raise FormatError(f"{path.name}: expected light above the horizon, got black, negative or infinite values")
    return resized(np.moveaxis(upper, -1, 0))
