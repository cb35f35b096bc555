"""Other people's axes and rigid transforms, as ours: x right, y forward, z up."""

from typing import Literal

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import invert
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.errors import FormatError

AxesName = Literal["rfu", "flu", "rdf"]
# Ours; those of vehicles and lidars (x forward, y left, z up); those of cameras (x right, y down, z forward).
OURS_FROM: dict[AxesName, Matrix4] = {
    "rfu": np.eye(4),
    "flu": np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
    "rdf": np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),
}
# Files write matrices with 6 to 12 decimals.
ORTHONORMAL = 2e-3


def rigid(rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"], where: str) -> Matrix4:
    """The transform of a rotation and a translation. Raises FormatError, whose message begins with `where`, for a
    matrix that is no rotation: one that mirrors an axis, or has a scale."""
    product = rotation @ rotation.T
    if not np.abs(product - np.eye(3)).max() <= ORTHONORMAL:
        scale = float(np.cbrt(np.abs(np.linalg.det(rotation))))
        raise FormatError(f"{where}: expected a rotation, got a matrix that is none (its scale is {scale:.4g})")
    if np.linalg.det(rotation) < 0:
        raise FormatError(f"{where}: expected a rotation, got a mirror: one axis points the other way")
    found = np.eye(4)
    # The nearest rotation: rounded numbers of a file would make lengths grow along a drive.
    u, _, vt = np.linalg.svd(rotation)
    found[:3, :3], found[:3, 3] = u @ vt, translation
    return found


def matrix34(values: Float[np.ndarray, "12"], where: str) -> Matrix4:
    """The transform of three rows of a rotation and a translation."""
    rows = values.reshape(3, 4)
    return rigid(rows[:, :3], rows[:, 3], where)


def in_ours(b_from_a: Matrix4, b_axes: AxesName, a_axes: AxesName) -> Matrix4:
    """A transform between two frames in their own axes as one between the same frames in ours."""
    return np.asarray(OURS_FROM[b_axes] @ b_from_a @ invert(OURS_FROM[a_axes]))


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Float[np.ndarray, "3 3"]:
    """`img_from_cam` of a pinhole: pixels from camera coordinates in our axes."""
    return np.array([[fx, cx, 0.0], [0.0, cy, -fy], [0.0, 1.0, 0.0]])
