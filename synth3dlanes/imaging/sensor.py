"""Metering, motion blur and sensor noise, on linear light before the tone curve."""

import numpy as np
import scipy
from jaxtyping import Bool, Float

from synth3dlanes.arrays import LinearImage
from synth3dlanes.geometry.camera import project
from synth3dlanes.imaging.film import MIDDLE_GRAY, levels_per_radiance
from synth3dlanes.imaging.lens import points
from synth3dlanes.scene import Camera

# Largest distance between samples along a pixel's motion, the shortest motion that is blurred, and most samples.
TAP_PX, SHORTEST_PX, MAX_TAPS = 2.5, 0.3, 32
# Share of the variance at middle gray that is read-out noise; the rest is photon noise, which grows with the light.
READ_SHARE = 0.1

# The mean that a metering camera amplifies a darker picture to, counting what is brighter than white as white: that of
# a road in headlights. And how much it amplifies at most, three stops.
METERED_MEAN, MOST_GAIN = 0.02, 8.0


def gain(linear: LinearImage, is_seen: Bool[np.ndarray, "h w"], metering: float) -> float:
    """The amplification of a dark picture, from 1 to MOST_GAIN, by a camera that meters (see `Light`)."""
    mean = float(np.clip(linear[is_seen], 0, 1).mean()) if is_seen.any() else 1.0
    return float(np.clip(METERED_MEAN / max(mean, 1e-9), 1, MOST_GAIN) ** metering)


def motion_blur(
    linear: LinearImage, depth_m: Float[np.ndarray, "h w"], camera: Camera, driven_cam: Float[np.ndarray, "3"]
) -> LinearImage:
    """The mean picture over an exposure during which the camera moves by `driven_cam`, half before the labels' instant
    and half after it. Each pixel averages along its own motion; pixels with infinite depth are unchanged."""
    v, u = np.nonzero(np.isfinite(depth_m))
    uv = np.column_stack([u, v]) + 0.5
    points_cam = points(camera, uv, depth_m[v, u].astype(float))
    way_px = np.hypot(*(project(camera, points_cam + driven_cam / 2) - project(camera, points_cam - driven_cam / 2)).T)
    moving = way_px > SHORTEST_PX
    if not moving.any():
        return linear
    points_cam, (v, u) = points_cam[moving], (v[moving], u[moving])
    n_taps = min(int(np.ceil(way_px[moving].max() / TAP_PX)) + 1, MAX_TAPS)
    total = np.zeros((len(u), 3), np.float32)
    for share in (np.arange(n_taps) + 0.5) / n_taps - 0.5:
        columns, rows = project(camera, points_cam + share * driven_cam).T - 0.5
        for channel in range(3):
            total[:, channel] += scipy.ndimage.map_coordinates(
                linear[..., channel], [rows, columns], order=1, mode="nearest"
            )
    blurred = linear.copy()
    blurred[v, u] = total / n_taps
    return blurred


def add_noise(linear: LinearImage, levels: float, rng: np.random.Generator, amplified: float = 1.0) -> LinearImage:
    """The picture with noise whose standard deviation is `levels` (of 255) at middle gray: photon noise, whose variance
    grows with the light, plus constant read-out noise; both were `amplified` with the light."""
    at_gray = levels / levels_per_radiance(MIDDLE_GRAY)
    light = np.maximum(linear, 0) / np.float32(MIDDLE_GRAY)
    spread = np.float32(at_gray) * np.sqrt(
        READ_SHARE * amplified**2 + (1 - READ_SHARE) * amplified * light, dtype=np.float32
    )
    return np.asarray(linear + spread * rng.standard_normal(linear.shape, dtype=np.float32))
