"""What lies at pixels and between them: passes, brightness, and depth interpolated as on a plane. No scene, no labels.

A pass has one sample at each pixel's centre: (column, row) + 0.5.
"""

from typing import NamedTuple

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


class InterpolatedDepth(NamedTuple):
    """Depth at points between pixels: interpolated, and the share by which it may err because the surface bends."""

    depth_m: Float[np.ndarray, " n"]
    bend: Float[np.ndarray, " n"]


def around(uv: Points2, shape: tuple[int, ...], reach: int) -> tuple[Squares, Squares]:
    """Rows and columns of the square with sides of 2 x reach pixels around each pixel position, row by row (arbitrary
    for positions outside the image)."""
    sizes = np.array([shape[1], shape[0]])
    j, i = np.floor(np.clip(np.nan_to_num(uv - 0.5), 0, sizes - 2)).astype(int).T
    dy, dx = (steps.ravel()[:, None] for steps in np.mgrid[1 - reach : reach + 1, 1 - reach : reach + 1])
    return np.clip(i + dy, 0, shape[0] - 1), np.clip(j + dx, 0, shape[1] - 1)


def depth_between(depth_m: Float[np.ndarray, "h w"], uv: Points2) -> InterpolatedDepth:
    """Depth at positions in the image. The inverse of a plane's depth is linear in the image."""
    rows, columns = around(uv, depth_m.shape, 1)
    right, down = uv[:, 0] - 0.5 - columns[0], uv[:, 1] - 0.5 - rows[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        square = 1 / depth_m[around(uv, depth_m.shape, 2)].astype(float).reshape(4, 4, -1)
        (a, b), (c, d) = square[1, 1:3], square[2, 1:3]
        between = 1 / ((a * (1 - right) + b * right) * (1 - down) + (c * (1 - right) + d * right) * down)
        # A sixteenth of the sum of second differences at both ends is the error of a parabola's chord in its middle.
        bends = sum(
            np.abs(a - b - c + d).max(axis=0) / 16 for a, b, c, d in (square[:, 1:3], square.swapaxes(0, 1)[:, 1:3])
        )
        return InterpolatedDepth(between, bends * between)


def some_pixels(
    of: Bool[np.ndarray, "h w"], most: int = MAX_PIXELS
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Rows and columns of at most about `most` of the selected pixels."""
    rows, columns = np.nonzero(of)
    step = 1 + len(rows) // most
    return rows[::step], columns[::step]
