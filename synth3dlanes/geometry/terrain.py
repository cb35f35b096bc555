"""The terrain: a sum of Gaussians with analytic height and gradient (paper, section 'Terrain 3D'). World frame."""

import numpy as np

from synth3dlanes.arrays import AnyPoints2, AnyScalars
from synth3dlanes.scene import Gaussian, Terrain


def height_at(terrain: Terrain, xy_world: AnyPoints2) -> AnyScalars:
    """Terrain height in metres: sum of magnitude * exp(-1/2 r' S^-1 r) with rotated axes."""
    z = np.zeros(xy_world.shape[:-1])
    for gaussian in terrain.gaussians:
        precision, magnitude_m, dx, dy = _local(gaussian, xy_world)
        (a, b), (_, c) = precision
        z += magnitude_m * np.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
    return z


def gradient_at(terrain: Terrain, xy_world: AnyPoints2) -> AnyPoints2:
    """(dz/dx, dz/dy) of the terrain."""
    gradient = np.zeros(xy_world.shape)
    for gaussian in terrain.gaussians:
        precision, magnitude_m, dx, dy = _local(gaussian, xy_world)
        (a, b), (_, c) = precision
        z = magnitude_m * np.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
        gradient[..., 0] -= z * (a * dx + b * dy)
        gradient[..., 1] -= z * (b * dx + c * dy)
    return gradient


def _local(gaussian: Gaussian, xy_world: AnyPoints2) -> tuple[list[list[float]], float, AnyScalars, AnyScalars]:
    cos, sin = np.cos(gaussian.orientation_rad), np.sin(gaussian.orientation_rad)
    p, q = 1 / gaussian.sd_m[0] ** 2, 1 / gaussian.sd_m[1] ** 2
    a, b, c = cos * cos * p + sin * sin * q, cos * sin * (p - q), sin * sin * p + cos * cos * q
    dx = xy_world[..., 0] - gaussian.center_m[0]
    dy = xy_world[..., 1] - gaussian.center_m[1]
    return [[a, b], [b, c]], gaussian.magnitude_m, dx, dy
