"""Light that strays in the lens: the veil and the ghosts of a sun ahead, and the glow around lamps at night."""

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.imaging.daylight import Daylight
from synth3dlanes.imaging.lens import cosines
from synth3dlanes.imaging.sky import sun_direction
from synth3dlanes.scene.scene import Light
from synth3dlanes.system.arrays import LinearImage
from synth3dlanes.world.world import View

# The veil of a source that gives the irradiance E at an angle of a degrees is VEIL E / (a ** 2 + CORE ** 2): in the eye
# it is 10 E / a ** 2 (CIE 1999), in a coated lens behind clean glass about a tenth of that.
VEIL, CORE_DEG, FARTHEST_DEG = 1.0, 1.0, 50.0
# Ghosts: places on the line from the sun through the image's middle (1: at the sun), radii as shares of the image's
# width, and colours.
GHOSTS = ((-0.35, 0.05, (0.6, 1.0, 0.7)), (-0.7, 0.09, (0.5, 0.6, 1.0)), (0.4, 0.03, (1.0, 0.8, 0.5)))
GHOST_SHARE = 0.0012
# What is brighter than this glows: shares of its light, and the glow's spread as shares of the image's width.
GLOWS_FROM, BRIGHTEST, GLOWS = 1.5, 150.0, ((0.35, 0.004), (0.2, 0.014), (0.12, 0.05))
SHRUNK = 4
# A lamp's head: radius, and radiance.
HEAD_M, HEAD_LIGHT = 0.15, 0.01

Depth = Float[np.ndarray, "h w"]


def add_sun_glare(linear: LinearImage, depth_m: Depth, light: Light, daylight: Daylight, view: View) -> LinearImage:
    """The picture with the stray light of the sun, if it is ahead and not hidden, at full strength."""
    direction_cam = view.world_from_cam[:3, :3].T @ sun_direction(light)
    if direction_cam[1] < np.cos(np.radians(FARTHEST_DEG)) or not daylight.sun.any():
        return linear
    u, v = view.project(direction_cam[None])[0]
    seen = _seen_share(depth_m, u, v)
    if seen == 0:
        return linear
    angle_deg = np.degrees(np.arccos(np.clip(cosines(view.camera, direction_cam), -1, 1)))
    glare = (seen * daylight.film * daylight.sun).astype(np.float32)
    veil = VEIL / (angle_deg**2 + CORE_DEG**2)
    ghosts = _ghosts(view, u, v) if np.isfinite(u) else np.float32(0)
    return np.asarray(linear + (veil[..., None] + ghosts) * glare, np.float32)


def _seen_share(depth_m: Depth, u: float, v: float) -> float:
    """The share of the pixels around the sun that show sky; 1 outside the image."""
    height_px, width_px = depth_m.shape
    if not (0 <= u < width_px and 0 <= v < height_px):
        return 1.0
    row, column = int(v), int(u)
    around = depth_m[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4]
    return float(np.isinf(around).mean())


def _ghosts(view: View, u: float, v: float) -> LinearImage:
    """Discs of the sun's light, mirrored between the lens's glasses."""
    camera = view.camera
    total = np.zeros((camera.height_px, camera.width_px, 3), np.float32)
    columns, rows = np.arange(camera.width_px) + 0.5, np.arange(camera.height_px)[:, None] + 0.5
    for place, radius, color in GHOSTS:
        center = camera.cx_px + place * (u - camera.cx_px), camera.cy_px + place * (v - camera.cy_px)
        away = np.hypot(columns - center[0], rows - center[1]) / (radius * camera.width_px)
        disc = np.clip((1 - away) * 6, 0, 1) * (0.6 + 0.4 * np.minimum(away, 1) ** 4)
        total += GHOST_SHARE * disc[..., None].astype(np.float32) * np.array(color, np.float32)
    return total


def add_lamp_heads(
    linear: LinearImage, depth_m: Depth, heads_world: Float[np.ndarray, "n 3"], view: View, film: float
) -> LinearImage:
    """The picture with the bright heads of lit street lamps, where nothing nearer hides them."""
    heads_cam = transform(invert(view.world_from_cam), heads_world)
    heads_cam = heads_cam[heads_cam[:, 1] > 2]
    height_px, width_px = depth_m.shape
    for (u, v), y_m in zip(view.project(heads_cam).tolist(), heads_cam[:, 1].tolist(), strict=True):
        if not (0 <= u < width_px and 0 <= v < height_px) or depth_m[int(v), int(u)] < y_m - 1:
            continue
        radius_px = HEAD_M * view.camera.fx_px / y_m
        reach = int(3 * radius_px) + 2
        top, left = max(int(v) - reach, 0), max(int(u) - reach, 0)
        at = np.s_[top : int(v) + reach + 1, left : int(u) + reach + 1]
        rows, columns = (
            np.arange(part.start, min(part.stop, size)) for part, size in zip(at, depth_m.shape, strict=True)
        )
        squared = (columns + 0.5 - u) ** 2 + ((rows + 0.5 - v) ** 2)[:, None]
        spread = max(radius_px, 0.6)
        spot = HEAD_LIGHT * film * min(radius_px / 0.6, 1) ** 2 * np.exp(-squared / (2 * spread**2))
        linear[at] += spot[..., None].astype(np.float32) * np.array([1.0, 0.85, 0.6], np.float32)
    return linear


def add_glow(linear: LinearImage) -> LinearImage:
    """The picture with the glow around its bright spots, at full strength."""
    height_px, width_px = linear.shape[:2]
    excess = np.clip(linear - GLOWS_FROM, 0, BRIGHTEST)
    if not excess.any():
        return linear
    rows, columns = np.arange(0, height_px, SHRUNK), np.arange(0, width_px, SHRUNK)
    small = np.add.reduceat(np.add.reduceat(excess, rows, axis=0), columns, axis=1) / SHRUNK**2
    glow = np.zeros_like(small)
    for share, spread in GLOWS:
        sigma_px = spread * width_px / SHRUNK
        glow += share * scipy.ndimage.gaussian_filter(small, (sigma_px, sigma_px, 0), truncate=3)
    smooth = glow.repeat(SHRUNK, axis=0).repeat(SHRUNK, axis=1)[:height_px, :width_px]
    return np.asarray(
        linear + scipy.ndimage.gaussian_filter(smooth, (SHRUNK / 2, SHRUNK / 2, 0), truncate=2), np.float32
    )
