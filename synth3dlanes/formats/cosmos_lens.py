"""F-theta cameras, as Cosmos has them: a polynomial from the angle of a ray to its distance from the principal point,
fitted to a camera of ours. Pixel corners at whole numbers."""

from dataclasses import dataclass

import numpy as np

from synth3dlanes.formats.writing import CV_FROM_CAM
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.system.errors import InputError

DEGREE = 5
LIMIT_PX = 1.0
"""How far the polynomial may be from the camera: 0.4 px for a pinhole of 110 degrees and 1600 columns."""
GRID, ROUNDS = (41, 31), 30


@dataclass(frozen=True)
class FTheta:
    """A pixel is its principal point and `stretch` times right, and down, the distance `polynomial(angle)` from it:
    coefficients of rising powers, in pixels."""

    cx_px: float
    cy_px: float
    stretch: float
    polynomial: tuple[float, ...]
    worst_px: float


def fitted(camera: CameraLabel, where: str) -> FTheta:
    """Least squares over the image, weighted towards the worst places. Raises InputError for a camera that is farther
    than LIMIT_PX from all of these."""
    (fx, _, cx), (_, fy, cy), _ = camera.img_from_cam @ CV_FROM_CAM.T
    steps = (np.linspace(0.0, size, n) for size, n in zip((camera.width_px, camera.height_px), GRID, strict=True))
    uv = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    rays = camera.rays(uv)
    known = np.isfinite(rays).all(axis=1)
    uv, rays = uv[known], rays[known]
    angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 2]), rays[:, 1])
    radius = np.hypot((uv[:, 0] - cx) * fy / fx, uv[:, 1] - cy)
    powers, weights = angle[:, None] ** np.arange(1, DEGREE + 1), np.ones(len(angle))
    for _ in range(ROUNDS):
        factors = np.linalg.lstsq(powers * weights[:, None], radius * weights, rcond=None)[0]
        apart = np.abs(powers @ factors - radius)
        weights *= np.sqrt(1 + apart / max(apart.max(), 1e-12))
    factors = np.array([float(f"{factor:.8g}") for factor in factors])  # the rest depends on threads and processors
    aside = rays[:, [0, 2]] * [1, -1] / np.maximum(np.hypot(rays[:, 0], rays[:, 2]), 1e-12)[:, None]
    found = aside * (powers @ factors)[:, None] * [fx / fy, 1] + [cx, cy]
    worst_px = float(np.linalg.norm(found - uv, axis=1).max())
    if not worst_px <= LIMIT_PX:
        raise InputError(
            f"{where}: expected a camera that an f-theta polynomial follows within {LIMIT_PX:g} px, got"
            f" {camera.name or 'one'} that it misses by {worst_px:.1f} px"
        )
    return FTheta(float(cx), float(cy), float(fx / fy), (0.0, *factors.tolist()), worst_px)
