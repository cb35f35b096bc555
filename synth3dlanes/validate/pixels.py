"""What lies at pixels: which are around a place, which are used, and brightness. No scene, no labels.

A pass has one sample at each pixel's centre: (column, row) + 0.5.
"""

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from synth3dlanes.system.arrays import Points2

# At most this many pixels of a kind are used, evenly spread over the image.
MAX_PIXELS = 10_000

Squares = Int[np.ndarray, "k n"]

# The weights of red, green and blue in the brightness of gamma-coded pixels (ITU-R BT.601).
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)


def luma(rgb: Shaped[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
    """Brightness of gamma-coded pixels, in their own unit."""
    return np.asarray(rgb.astype(np.float32) @ _LUMA)


def around(uv: Points2, shape: tuple[int, ...], reach: int) -> tuple[Squares, Squares]:
    """Rows and columns of the square with sides of 2 x reach pixels around each pixel position, row by row (arbitrary
    for positions outside the image)."""
    sizes = np.array([shape[1], shape[0]])
    j, i = np.floor(np.clip(np.nan_to_num(uv - 0.5), 0, sizes - 2)).astype(int).T
    dy, dx = (steps.ravel()[:, None] for steps in np.mgrid[1 - reach : reach + 1, 1 - reach : reach + 1])
    return np.clip(i + dy, 0, shape[0] - 1), np.clip(j + dx, 0, shape[1] - 1)


def some_pixels(
    of: Bool[np.ndarray, "h w"], most: int = MAX_PIXELS
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Rows and columns of at most about `most` of the selected pixels."""
    rows, columns = np.nonzero(of)
    step = 1 + len(rows) // most
    return rows[::step], columns[::step]
