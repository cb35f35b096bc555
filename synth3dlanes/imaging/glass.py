"""The glass before the lens: drops of water, which refract, and dirt, which absorbs and scatters light.

The glass is no object of the scene: masks and passes are as through clear glass.
"""

import numpy as np
import scipy

from synth3dlanes.system.arrays import LinearImage

# Drops at full strength, their radii as shares of the image's height, and how much smaller than the picture the upside
# down view in a drop is.
N_DROPS, RADII, SMALLER = 90, (0.006, 0.03), 9.0
# Dirt: grids of smooth noise, the share of light that the dirtiest glass absorbs, and the share of the mean picture
# that it adds.
DIRT_GRIDS, TAKEN, SCATTERED = ((5, 7), (17, 23), (60, 80)), 0.45, 0.12


def add_drops(linear: LinearImage, strength: float, rng: np.random.Generator) -> LinearImage:
    """The picture through a glass with drops of water."""
    height_px, width_px = linear.shape[:2]
    blurred = scipy.ndimage.gaussian_filter(linear, (height_px / 180, height_px / 180, 0))
    out = linear.copy()
    for u, v, size, *phases in rng.random((rng.poisson(N_DROPS * strength), 6)).tolist():
        center_u, center_v = u * width_px, v * height_px
        radius = height_px * RADII[0] * (RADII[1] / RADII[0]) ** (size**2)
        left, right = (int(np.clip(center_u + side * 1.5 * radius, 0, width_px)) for side in (-1, 1))
        top, bottom = (int(np.clip(center_v + side * 1.5 * radius, 0, height_px)) for side in (-1, 1))
        x, y = np.meshgrid(np.arange(left, right) + 0.5 - center_u, np.arange(top, bottom) + 0.5 - center_v)
        angle = np.arctan2(y, x)
        outline = 1 + 0.25 * np.cos(angle + 7 * phases[0]) + 0.12 * np.cos(2 * angle + 7 * phases[1])
        away = np.hypot(x, 0.9 * y) / (radius * outline)
        share = np.clip((1 - away) * radius / 1.5, 0, 1) * (0.7 + 0.3 * phases[2])
        bend = SMALLER * (1 + away**2)
        where = [center_v - bend * y - 0.5, center_u - bend * x - 0.5]
        view = (
            np.stack(
                [scipy.ndimage.map_coordinates(blurred[..., k], where, order=1, mode="mirror") for k in range(3)],
                axis=-1,
            )
            * (1 - 0.45 * np.clip(away, 0, 1) ** 4)[..., None]
        )
        at = np.s_[top:bottom, left:right]
        out[at] += share[..., None].astype(np.float32) * (view - out[at])
    return out


def add_dirt(linear: LinearImage, strength: float, rng: np.random.Generator) -> LinearImage:
    """The picture through a dusty, smeared glass."""
    shape = linear.shape[:2]
    noise = np.zeros(shape, np.float32)
    for grid in DIRT_GRIDS:
        small = rng.random(grid, dtype=np.float32)
        noise += scipy.ndimage.zoom(
            small, (shape[0] / grid[0], shape[1] / grid[1]), order=1, grid_mode=True, mode="nearest"
        )
    dust = np.float32(strength) * np.clip(noise / len(DIRT_GRIDS) * 2.4 - 0.75, 0, 1)[..., None]
    return np.asarray(linear * (1 - TAKEN * dust) + SCATTERED * dust * linear.mean(axis=(0, 1)))
