"""Metering, motion blur and sensor noise, on linear light before the tone curve."""

import numpy as np
import scipy
from jaxtyping import Bool, Float

from synth3dlanes.imaging.film import MIDDLE_GRAY, levels_per_radiance
from synth3dlanes.imaging.lens import points
from synth3dlanes.scene.host import HostCamera
from synth3dlanes.system.arrays import LinearImage
from synth3dlanes.world.camera import project

# Largest distance between samples along a pixel's motion, the shortest motion that is blurred, and numbers of samples.
TAP_PX, SHORTEST_PX, TAPS = 2.5, 0.3, (2, 3, 4, 6, 8, 12, 16, 24, 32)
# Share of the variance at middle gray that is read-out noise; the rest is photon noise, which grows with the light.
READ_SHARE = 0.1

# The mean to which a metering camera amplifies a darker picture (of a road in headlights; brighter than white counts as
# white), and its greatest gain, three stops.
METERED_MEAN, MOST_GAIN = 0.02, 8.0


def gain(linear: LinearImage, is_seen: Bool[np.ndarray, "h w"], metering: float) -> float:
    """The amplification of a dark picture, from 1 to MOST_GAIN, by a camera that meters (see `Light`)."""
    seen = linear if is_seen.all() else linear[is_seen]
    mean = float(np.clip(seen, 0, 1).mean()) if seen.size else 1.0
    return float(np.clip(METERED_MEAN / max(mean, 1e-9), 1, MOST_GAIN) ** metering)


def add_vignette(linear: LinearImage, camera: HostCamera, strength: float) -> LinearImage:
    """The picture with darker corners: at half a diagonal from the optical axis, or farther, `strength` of the light is
    missing, nearer to it less with the square of the distance."""
    height_px, width_px = linear.shape[:2]
    right_px, down_px = np.arange(width_px) + 0.5 - camera.cx_px, np.arange(height_px) + 0.5 - camera.cy_px
    share = (right_px**2 + down_px[:, None] ** 2) / ((width_px**2 + height_px**2) / 4)
    return linear * (1 - strength * np.minimum(share, 1))[..., None].astype(np.float32)


def motion_blur(
    linear: LinearImage, depth_m: Float[np.ndarray, "h w"], camera: HostCamera, driven_cam: Float[np.ndarray, "3"]
) -> LinearImage:
    """The mean picture over an exposure during which the camera moves by `driven_cam`, half before the labels' instant
    and half after it. Each pixel averages along its own motion; pixels with infinite depth are unchanged."""
    v, u = np.nonzero(np.isfinite(depth_m))
    uv = np.column_stack([u, v]) + 0.5
    points_cam = points(camera, uv, depth_m[v, u].astype(float))
    way_px = np.hypot(*(project(camera, points_cam + driven_cam / 2) - project(camera, points_cam - driven_cam / 2)).T)
    blurred, channels = linear.copy(), np.ascontiguousarray(np.moveaxis(linear, -1, 0))
    # Most pixels move little, and need few samples.
    least_px = SHORTEST_PX
    for n_taps in TAPS:
        most_px = np.inf if n_taps == TAPS[-1] else (n_taps - 1) * TAP_PX
        at = np.flatnonzero((way_px > least_px) & (way_px <= most_px))
        if at.size:
            blurred[v[at], u[at]] = _mean_along(channels, camera, points_cam[at], driven_cam, n_taps)
        least_px = most_px
    return blurred


def _mean_along(
    channels: Float[np.ndarray, "3 h w"],
    camera: HostCamera,
    points_cam: Float[np.ndarray, "n 3"],
    driven_cam: Float[np.ndarray, "3"],
    n_taps: int,
) -> Float[np.ndarray, "n 3"]:
    """The mean light of a picture at `n_taps` places along each point's motion."""
    total = np.zeros((3, len(points_cam)), np.float32)
    for share in (np.arange(n_taps) + 0.5) / n_taps - 0.5:
        columns, rows = project(camera, points_cam + share * driven_cam).T - 0.5
        places = np.stack([rows, columns])
        for channel, light in zip(total, channels, strict=True):
            channel += scipy.ndimage.map_coordinates(light, places, order=1, mode="nearest")
    return (total / n_taps).T


def add_noise(linear: LinearImage, levels: float, rng: np.random.Generator, amplified: float = 1.0) -> LinearImage:
    """The picture with noise whose standard deviation is `levels` (of 255) at middle gray: photon noise, whose variance
    grows with the light, plus constant read-out noise; both were `amplified` with the light."""
    at_gray = levels / levels_per_radiance(MIDDLE_GRAY)
    light = np.maximum(linear, 0) / np.float32(MIDDLE_GRAY)
    spread = np.float32(at_gray) * np.sqrt(
        READ_SHARE * amplified**2 + (1 - READ_SHARE) * amplified * light, dtype=np.float32
    )
    return np.asarray(linear + spread * rng.standard_normal(linear.shape, dtype=np.float32))
