"""Periodic 2D noise for tileable images: spectral clouds, cells and cracks.

Every function is a pure function of its `rng`; opposite edges of every result continue each other.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree


def clouds(
    rng: np.random.Generator, shape: tuple[int, int], low: float, high: float, slope: float = 1.0
) -> Float[np.ndarray, "h w"]:
    """Band-limited noise of unit deviation: `low`..`high` are periods per image side, amplitude falls as f^-slope."""
    h, w = shape
    fy = np.fft.fftfreq(h)[:, None] * h
    fx = np.fft.rfftfreq(w)[None, :] * w
    f = np.hypot(fy, fx)
    amplitude = np.where((f >= low) & (f <= high), np.maximum(f, 1e-9) ** -slope, 0.0)
    spectrum = np.fft.rfft2(rng.standard_normal(shape)) * amplitude
    noise = np.fft.irfft2(spectrum, s=shape)
    return noise / noise.std()


def cells(
    rng: np.random.Generator, shape: tuple[int, int], n: int, warp_px: float = 0.0
) -> tuple[Int[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Periodic Voronoi cells of `n` points: the cell number and the distance to the cell border (pixels)."""
    h, w = shape
    points = rng.uniform(0, 1, (n, 2)) * (w, h)
    x, y = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    if warp_px:
        x = x + warp_px * clouds(rng, shape, 4, 60, 1.2)
        y = y + warp_px * clouds(rng, shape, 4, 60, 1.2)
    where = np.stack([x.ravel() % w, y.ravel() % h], axis=1)
    distance, index = cKDTree(points, boxsize=(w, h)).query(where, k=2)
    return index[:, 0].reshape(shape), ((distance[:, 1] - distance[:, 0]) / 2).reshape(shape)


def smoothstep(low: float, high: float, x: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
