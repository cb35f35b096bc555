"""Read a user's sky picture (HDR or EXR) with Blender."""

from pathlib import Path

import bpy
import numpy as np
from jaxtyping import Float

from synth3dlanes.imaging.user_sky import resized
from synth3dlanes.system.errors import FormatError


def read_sky(path: Path) -> Float[np.ndarray, "3 h w"]:
    """The picture's upper half at the size of the built-in dome; raise FormatError if it is not a sky picture."""
    image = bpy.data.images.load(str(path))
    try:
        width, height = image.size
        if width == 0:
            raise FormatError(f"{path.name}: cannot read the picture")
        if width != 2 * height:
            raise FormatError(
                f"{path.name}: expected a picture twice as wide as high (equirectangular), got {width}x{height}"
            )
        pixels = np.zeros(width * height * image.channels, dtype=np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    upper = pixels.reshape(height, width, -1)[height // 2 :, :, :3]
    if not np.isfinite(upper).all() or upper.min() < 0 or upper.max() <= 0:
        raise FormatError(f"{path.name}: expected light above the horizon, got black, negative or infinite values")
    return resized(np.moveaxis(upper, -1, 0))
