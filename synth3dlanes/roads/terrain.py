"""The terrain: a sum of Gaussians with analytic height and gradient (paper, section 'Terrain 3D'), of some maps over a
smooth grid of heights. World frame."""

import numpy as np
import scipy
from jaxtyping import Bool, Float

from synth3dlanes.scene.scene import Gaussian, HeightGrid, Terrain
from synth3dlanes.system.arrays import AnyPoints2, AnyScalars


def height_at(terrain: Terrain, xy_world: AnyPoints2) -> AnyScalars:
    """Terrain height in metres: sum of magnitude * exp(-1/2 r' S^-1 r) with rotated axes."""
    z = np.zeros(xy_world.shape[:-1])
    for gaussian in terrain.gaussians:
        (a, b, c), magnitude_m, dx, dy = _local(gaussian, xy_world)
        z += magnitude_m * np.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
    if terrain.base is not None:
        places = [_place(terrain.base, xy_world, axis)[0] + 1 for axis in (1, 0)]
        z += scipy.ndimage.map_coordinates(terrain.base.coefficients, places, prefilter=False)
    return z


def gradient_at(terrain: Terrain, xy_world: AnyPoints2) -> AnyPoints2:
    """(dz/dx, dz/dy) of the terrain."""
    gradient = np.zeros(xy_world.shape)
    for gaussian in terrain.gaussians:
        (a, b, c), magnitude_m, dx, dy = _local(gaussian, xy_world)
        z = magnitude_m * np.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
        gradient[..., 0] -= z * (a * dx + b * dy)
        gradient[..., 1] -= z * (b * dx + c * dy)
    if terrain.base is not None:
        for axis in (0, 1):
            gradient[..., axis] += _slope(terrain.base, xy_world, axis)
    return gradient


def grid_weights(grid: HeightGrid, xy_world: AnyPoints2) -> tuple[Float[np.ndarray, "*n 2 4"], np.ndarray]:
    """The weights of a grid's coefficients along x and y at points, and the numbers of the first of these: a point's
    height is the sum over four columns and four rows. Beyond the grid, those of its edge."""
    at = np.stack([_place(grid, xy_world, axis)[0] for axis in (0, 1)], axis=-1)
    first = at.astype(int)
    return _b_spline(at - first, slope=False), first


def _place(grid: HeightGrid, xy_world: AnyPoints2, axis: int) -> tuple[AnyScalars, Bool[np.ndarray, "*n"]]:
    """Places along x (0) or y (1) in steps from the second coefficient on, kept within the grid, and whether they were
    within it."""
    most = (len(grid.rows[0]), len(grid.rows))[axis] - 3 - 1e-9
    at = (xy_world[..., axis] - grid.corner_m[axis]) / grid.step_m - 1
    return np.clip(at, 0, most), (at >= 0) & (at <= most)


def _b_spline(u: AnyScalars, slope: bool) -> Float[np.ndarray, "*n 4"]:
    """Weights of the four coefficients around places u in [0, 1) between the middle two, or their slopes."""
    v = 1 - u
    if slope:
        parts = [-v * v / 2, 1.5 * u * u - 2 * u, -1.5 * v * v + 2 * v, u * u / 2]
    else:
        parts = [v**3 / 6, 2 / 3 - u * u + u**3 / 2, 2 / 3 - v * v + v**3 / 2, u**3 / 6]
    return np.stack(parts, axis=-1)


def _slope(grid: HeightGrid, xy_world: AnyPoints2, axis: int) -> AnyScalars:
    """The grid's rise along x (0) or y (1) at points; none beyond it."""
    (x_at, _), (y_at, _) = places = [_place(grid, xy_world, k) for k in (0, 1)]
    column, row, table = x_at.astype(int), y_at.astype(int), grid.coefficients
    x, y = _b_spline(x_at - column, axis == 0), _b_spline(y_at - row, axis == 1)
    z = np.zeros(x_at.shape)
    for i in range(4):
        z += y[..., i] * sum((x[..., k] * table[row + i, column + k] for k in range(4)), np.zeros(z.shape))
    return np.where(places[axis][1], z / grid.step_m, 0.0)


def _local(
    gaussian: Gaussian, xy_world: AnyPoints2
) -> tuple[tuple[float, float, float], float, AnyScalars, AnyScalars]:
    cos, sin = np.cos(gaussian.orientation_rad), np.sin(gaussian.orientation_rad)
    p, q = 1 / gaussian.sd_m[0] ** 2, 1 / gaussian.sd_m[1] ** 2
    a, b, c = cos * cos * p + sin * sin * q, cos * sin * (p - q), sin * sin * p + cos * cos * q
    dx = xy_world[..., 0] - gaussian.center_m[0]
    dy = xy_world[..., 1] - gaussian.center_m[1]
    return (a, b, c), gaussian.magnitude_m, dx, dy
