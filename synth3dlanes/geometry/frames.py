"""Rigid transforms between frames, named `b_from_a`, and the projection into the image. numpy alone.

Every 3D frame is x right, y forward, z up; angles are radians. Pixels (u, v) count from the image's top-left corner.
"""

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.system.arrays import AnyPoints3, Matrix4


def transform(b_from_a: Matrix4, points_a: AnyPoints3) -> AnyPoints3:
    """Express points of frame a in frame b."""
    return points_a @ b_from_a[:3, :3].T + b_from_a[:3, 3]


def invert(b_from_a: Matrix4) -> Matrix4:
    """The rigid transform `a_from_b`."""
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = b_from_a[:3, :3].T
    a_from_b[:3, 3] = -b_from_a[:3, :3].T @ b_from_a[:3, 3]
    return a_from_b


def from_axes(x: AnyPoints3, y: AnyPoints3, z: AnyPoints3, origin: AnyPoints3) -> Matrix4:
    """The transform from an inner to the outer frame, given the inner frame's unit axes and origin in the outer one."""
    outer_from_inner = np.eye(4)
    outer_from_inner[:3] = np.column_stack([x, y, z, origin])
    return outer_from_inner


def cross(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The vector product of two vectors, for which np.cross takes many times as long."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def quaternion(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4"]:
    """The unit quaternion (w, x, y, z), w >= 0, of a rotation."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    # Four forms of the same, each times another of its components: the largest is the most exact.
    forms = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    form = forms[forms.diagonal().argmax()]
    return np.asarray(form / np.linalg.norm(form) * (1 if form[0] >= 0 else -1))


def rotation(wxyz: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """The rotation of a quaternion (w, x, y, z) of any length but 0."""
    w, x, y, z = wxyz / np.linalg.norm(wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def road_from_cam(height_m: float, pitch_rad: float, roll_rad: float = 0.0, yaw_rad: float = 0.0) -> Matrix4:
    """The camera's pose over the road plane: `height_m` above its foot, turned by `yaw_rad` (positive =
    counter-clockwise seen from above: to the left), then pitched by `pitch_rad` (positive = down) and rolled about its
    viewing axis by `roll_rad` (positive = clockwise as the driver sees it: right side down)."""
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    pitched = np.array([[1.0, 0, 0, 0], [0, c, s, 0], [0, -s, c, height_m], [0, 0, 0, 1]])
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    pose = pitched @ np.array([[c, 0, s, 0], [0, 1.0, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])
    return turned(yaw_rad) @ pose if yaw_rad else pose


def turned(yaw_rad: float, right_m: float = 0.0, forward_m: float = 0.0) -> Matrix4:
    """The pose of a frame turned about z (positive = counter-clockwise seen from above) and moved in the plane."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0, right_m], [s, c, 0, forward_m], [0, 0, 1.0, 0], [0, 0, 0, 1]])


def project(img_from_cam: Float[np.ndarray, "3 3"], points_cam: AnyPoints3) -> Float[np.ndarray, "*n 2"]:
    """Pixels (u, v) of points; NaN for points that are not in front of the camera."""
    homogeneous = points_cam @ img_from_cam.T
    depth = np.where(homogeneous[..., 2:] > 0, homogeneous[..., 2:], np.nan)
    return np.asarray(homogeneous[..., :2] / depth)


def inside_image(uv: Float[np.ndarray, "*n 2"], width_px: int, height_px: int) -> Bool[np.ndarray, "*n"]:
    """Which pixels (u, v) lie in an image of this size; False for NaN."""
    with np.errstate(invalid="ignore"):
        return np.asarray(((uv >= 0) & (uv <= [width_px, height_px])).all(axis=-1))
