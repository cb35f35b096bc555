"""Tolerances of samples made again on another kind of machine: how wrong each pixel of a layer is, 0 where it is right.

A picture is compared by means: over blocks of several sizes, and over each object and surface. Noise of rendering is
the smaller, the more pixels a mean has. Other layers are compared pixel by pixel; single pixels, as in the seams
between two objects, may differ.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.ndimage import uniform_filter

from synth3dlanes.system.arrays import IdImage
from synth3dlanes.validate.pixels import luma

Raster = Shaped[np.ndarray, "h w *c"]
ErrorMap = Float[np.ndarray, "h w"]

# Levels of 255 by which means of n pixels may differ: NOISE[0] + NOISE[1] / sqrt(n). Renders by another random seed, or
# of twice the samples a pixel, stay below 0.8 of it; machines differ far less.
NOISE = (3.0, 110.0)
BLOCKS, LEAST_PIXELS = (4, 8, 16, 32, 64), 8
# Wrong pixels are no clump if fewer than CLUMP of 9 neighbours are wrong, or at most FEW of all and SHARE of all.
CLUMP, FEW, SHARE = 3, 3, 0.005
# Errors of depths, heights and ranges: in metres, and as a share.
VALUE_M, VALUE_SHARE = 5e-4, 5e-5
NORMAL = 0.02
# Contrast of single pixels in relation to that of the picture made again: blurred below, noisy above.
CONTRAST = (0.9, 1.1)
DETAIL_PX, FAINT = 16, 0.25


class LayerPair(NamedTuple):
    """One array of a sample: its name, what `dataset.json` makes, what lies there, how wrong a guess is of the latter,
    and the numbers of the objects and surfaces that its pixels show, made and lying there, with their names."""

    name: str
    made: Raster
    lies: Raster
    wrong: Callable[[Raster, Raster], ErrorMap]
    shown: IdImage
    also: IdImage
    names: dict[int, str]


def clumps(off: Bool[np.ndarray, "h w"]) -> ErrorMap:
    """Where pixels are off that are more than a few at a seam: none, or all of them."""
    together = off & (uniform_filter(off.astype(np.float32), 3, mode="constant") * 9 > CLUMP - 0.5)
    is_wrong = together.sum() > FEW or off.mean() > SHARE
    return (off if off.mean() > SHARE else together).astype(np.float32) * is_wrong


def wrong_ids(guess: Raster, lies: Raster) -> ErrorMap:
    """Of semantic and instance ids."""
    return clumps(guess != lies)


def wrong_values(guess: Raster, lies: Raster) -> ErrorMap:
    """Of metres, which may be infinite."""
    with np.errstate(invalid="ignore"):
        off = np.abs(guess - lies) > VALUE_M + VALUE_SHARE * np.abs(lies)
    return clumps(np.where(np.isfinite(guess) & np.isfinite(lies), off, guess != lies))


def wrong_normals(guess: Raster, lies: Raster) -> ErrorMap:
    """Of unit vectors."""
    return clumps(np.abs(guess - lies).max(axis=-1) > NORMAL)


def wrong_colours(shown: IdImage) -> Callable[[Raster, Raster], ErrorMap]:
    """Of a picture, in levels of 255 beyond what noise explains; `shown` numbers its objects and surfaces from 0."""
    areas = np.bincount(shown.ravel())

    def wrong(guess: Raster, lies: Raster) -> ErrorMap:
        error = guess.astype(np.float32) - lies
        excess = np.zeros(shown.shape, np.float32)
        for size in BLOCKS:
            rows, columns = (n // size for n in shown.shape)
            whole = excess[: rows * size, : columns * size]
            blocks = error[: rows * size, : columns * size].reshape(rows, size, columns, size, 3)
            means = np.abs(blocks.mean(axis=(1, 3))).max(axis=-1) - _noise(size * size)
            # Where smaller blocks show it, they show better where.
            is_told = whole.reshape(rows, size, columns, size).max(axis=(1, 3)) > 0
            whole += np.kron(np.where(is_told, 0, np.maximum(means, 0)), np.ones((size, size), np.float32))
        sums = np.stack([np.bincount(shown.ravel(), error[..., i].ravel()) for i in range(3)], axis=-1)
        means = np.abs(sums).max(axis=-1) / np.maximum(areas, 1) - _noise(np.maximum(areas, 1))
        is_told = np.bincount(shown.ravel(), excess.ravel()) > 0
        means = np.where(is_told | (areas < LEAST_PIXELS) | (areas > BLOCKS[-1] ** 2), 0, np.maximum(means, 0))
        return np.asarray(excess + means[shown], np.float32)

    return wrong


def _noise(n: int | Int[np.ndarray, " n"]) -> Float[np.ndarray, "*n"]:
    return np.asarray(NOISE[0] + NOISE[1] / np.sqrt(n))


def contrast(made: Raster, lies: Raster) -> float:
    """Of single pixels beside their neighbours: how many times that of the picture made again, in the median of
    blocks."""
    squares = []
    for picture in (made, lies):
        gray = luma(picture)
        squares.append(uniform_filter((gray - uniform_filter(gray, 3)) ** 2, DETAIL_PX)[::DETAIL_PX, ::DETAIL_PX])
    return float(np.sqrt(np.median((squares[1] + FAINT) / (squares[0] + FAINT))))
