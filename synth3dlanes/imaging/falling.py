"""Rain and snow in the air, and spray behind cars, as layers of the picture.

Drops and flakes are points near the camera; each leaves the streak of its own motion and the host's during the
exposure. Nothing here moves or hides a pixel of the other layers.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import Image as Pillow
from PIL import ImageDraw

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.imaging.lens import points_away
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import LinearImage
from synth3dlanes.world.motion import car_speed, host_exposure
from synth3dlanes.world.world import View

# The exposure's duration without motion blur; with it, it follows from the metres driven.
SHORTEST_S = 0.008
# Headlights light what falls before the camera: radiance at 1 m per unit of its reflectance.
LIT_BY_HEADLIGHTS = 4e-3
# Spray: its middle behind the car and above the road; the distances from there, aside, above and below, at which it is
# e times thinner; half of its length; and the most of the light that it takes, at SPRAY_FULL_M_S and faster.
SPRAY_BEHIND_M, SPRAY_UP_M, SPRAY_ASIDE_M, SPRAY_ABOVE_M, SPRAY_BELOW_M = 2.5, 0.5, 1.3, 0.7, 0.3
SPRAY_HALF_LENGTH_M, SPRAY_SHARE, SPRAY_FULL_M_S = 2.0, 0.6, 14.0
FARTHEST_SPRAY_M = 80.0
OVERSAMPLED = 2
NEAREST_M = 1.7  # beyond the host's bonnet


class Precipitation(NamedTuple):
    """What falls: how many at full strength for 480 x 360 pixels, how fast, how large, how opaque, and how far away."""

    n: int
    m_per_s: float
    size_m: tuple[float, float]
    opacity: float
    farthest_m: float


RAIN = Precipitation(2600, 7.5, (0.0015, 0.004), 0.45, 14.0)
SNOW = Precipitation(4000, 1.2, (0.005, 0.014), 0.9, 22.0)


def add_falling(
    linear: LinearImage,
    depth_m: Float[np.ndarray, "h w"],
    scene: Scene,
    view: View,
    airlight: Float[np.ndarray, "3"],
    film: float,
) -> LinearImage:
    """The picture with the scene's rain and snow in front of all that is not nearer; where they are follows from seed,
    split and index."""
    weather, rng = scene.weather, scene.picture_stream("falling")
    for kind, strength in ((RAIN, weather.rain), (SNOW, weather.snowfall)):
        if strength > 0:
            share, nearness = _streaks(kind, strength, scene, view, rng)
            lamps = LIT_BY_HEADLIGHTS * film * (weather.headlights and view.camera.looks_ahead) * nearness
            glow = (airlight * film).astype(np.float32) + lamps[..., None]
            share = share * (depth_m > NEAREST_M)
            linear = linear + share[..., None] * (glow - linear)
    return linear


def _streaks(
    kind: Precipitation, strength: float, scene: Scene, view: View, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """The share of each pixel that streaks cover, and 1 / distance squared of the streaks there."""
    camera = view.camera
    n = int(kind.n * strength * camera.width_px * camera.height_px / (480 * 360))
    u = rng.random((n, 5))
    uv = (u[:, :2] * 1.2 - 0.1) * [camera.width_px, camera.height_px]
    y_m = np.cbrt(NEAREST_M**3 + (kind.farthest_m**3 - NEAREST_M**3) * u[:, 2])
    size_px = (kind.size_m[0] + (kind.size_m[1] - kind.size_m[0]) * u[:, 3] ** 2) * camera.fx_px / y_m
    speed_m_s, duration_s, _ = host_exposure(scene.shot, scene.sensor.motion_blur_m)
    # All pictures of a world have one wind.
    is_one_of_many = scene.shot.n_frames * scene.shot.n_cameras > 1
    wind = (scene.stream("wind") if is_one_of_many else rng).normal(0, 0.15 * kind.m_per_s, 2)
    way_road = (duration_s or SHORTEST_S) * np.array([wind[0], wind[1] - speed_m_s, -kind.m_per_s])
    way_cam = invert(view.road_from_cam)[:3, :3] @ way_road
    points_cam = points_away(camera, uv, y_m)
    ends = [view.project(points_cam + sign * way_cam / 2) for sign in (-1, 1)]
    size = camera.width_px * OVERSAMPLED, camera.height_px * OVERSAMPLED
    covered, near = Pillow.new("L", size), Pillow.new("L", size)
    draw, draw_near = ImageDraw.Draw(covered), ImageDraw.Draw(near)
    # Thin streaks cover a part of their pixels; long ones pass each pixel in a part of the exposure.
    corners_px = np.concatenate(ends, axis=1)
    length_px = np.nan_to_num(np.hypot(*(ends[1] - ends[0]).T))
    thin = np.minimum(OVERSAMPLED * size_px, 1) * np.minimum(1, (4 * size_px + 2) / (length_px + 2))
    opacity = (255 * kind.opacity * thin).astype(int)
    widths = np.maximum(np.rint(OVERSAMPLED * size_px), 1).astype(int)
    nearness = np.clip(255 * (NEAREST_M / y_m) ** 2, 1, 255).astype(int)
    corners = (OVERSAMPLED * corners_px).round(1).tolist()
    in_field = np.isfinite(corners_px).all(axis=1)
    for i in np.argsort(-y_m):
        if not in_field[i]:
            continue
        draw.line(corners[i], int(opacity[i]), int(widths[i]))
        draw_near.line(corners[i], int(nearness[i]), int(widths[i]))
    return _shrunk(covered), _shrunk(near) / np.float32(NEAREST_M**2)


def _shrunk(layer: Pillow.Image) -> Float[np.ndarray, "h w"]:
    return np.asarray(layer.reduce(OVERSAMPLED), np.float32) / 255


def add_spray(
    linear: LinearImage, depth_m: Float[np.ndarray, "h w"], scene: Scene, view: View, airlight: Float[np.ndarray, "3"]
) -> LinearImage:
    """The picture with the spray of the moving cars ahead in the rain; only what is behind the spray is seen through
    it."""
    height_px, width_px = depth_m.shape
    models, cam_from_world = scene.assets.car_models, invert(view.world_from_cam)
    for car, pose in zip(view.cars, view.world_from_cars, strict=True):
        most = SPRAY_SHARE * scene.weather.rain * min(car_speed(scene, car) / SPRAY_FULL_M_S, 1.0)
        behind_m = models[car.model - 1].length_m * car.scale / 2 + SPRAY_BEHIND_M
        place = transform(cam_from_world, transform(pose, np.array([[0.0, -behind_m, SPRAY_UP_M]])))
        if most == 0 or not 3 < place[0, 1] < FARTHEST_SPRAY_M:
            continue
        (u, v), y_m = view.project(place)[0], place[0, 1]
        if np.isnan(u):
            continue
        aside, above, below = (m * view.camera.fx_px / y_m for m in (SPRAY_ASIDE_M, SPRAY_ABOVE_M, SPRAY_BELOW_M))
        left, right = (int(np.clip(u + side * 2.5 * aside, 0, width_px)) for side in (-1, 1))
        top, bottom = (int(np.clip(v + reach, 0, height_px)) for reach in (-2.5 * above, 2.5 * below))
        at = np.s_[top:bottom, left:right]
        across = ((np.arange(left, right) + 0.5 - u) / aside) ** 2
        lower = np.arange(top, bottom) + 0.5 - v
        down = (lower / np.where(lower > 0, below, above)) ** 2
        # The part of the spray that is before what the pixel shows.
        before = np.clip((depth_m[at] - y_m) / (2 * SPRAY_HALF_LENGTH_M) + 0.5, 0, 1)
        share = most * np.exp(-across - down[:, None]) * before
        linear[at] += share[..., None].astype(np.float32) * (airlight.astype(np.float32) - linear[at])
    return linear
