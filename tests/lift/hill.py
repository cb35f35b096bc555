"""A drive over a hill in closed form: its scans and 2D lanes are found by bisection, without the code under test."""

from collections.abc import Callable
from functools import cache

import numpy as np

from synth3dlanes.recorded.drives.drive import Drive, DriveCamera, DriveFrame, Scan

STEP_M, LANES_M = 4.0, (-5.25, -1.75, 1.75)
CAMERA_M, LIDAR_M, FOCAL_PX, SIZE_PX = 1.5, 1.9, 1000.0, (1280, 720)
ELEVATIONS = np.radians(np.linspace(3, -28, 24))


def height(xy: np.ndarray) -> np.ndarray:
    """A road that falls to its right, over a crest 50 m ahead."""
    return -0.02 * xy[..., 0] + 2.0 * np.exp(-(((xy[..., 1] - 50) / 25) ** 2))


def aside(y: np.ndarray) -> np.ndarray:
    """How far the road bends to the right at y."""
    return 0.0008 * y**2


def met(eye: np.ndarray, rays: np.ndarray, far_m: float = 70.0) -> np.ndarray:
    """Where rays first meet the hill: (n, 3), NaN where they do not."""
    at = np.arange(0.5, far_m, 0.25)
    places = eye + rays[:, None] * at[None, :, None]
    below = places[..., 2] < height(places[..., :2])
    first = below.argmax(axis=1)
    low, high = at[np.maximum(first - 1, 0)], at[first]
    for _ in range(40):
        middle = (low + high) / 2
        place = eye + rays * middle[:, None]
        is_below = place[:, 2] < height(place[:, :2])
        low, high = np.where(is_below, low, middle), np.where(is_below, middle, high)
    return np.where(below.any(axis=1)[:, None], eye + rays * high[:, None], np.nan)


def pose(number: int) -> np.ndarray:
    """The host at a frame: on the road, along it, upright on it."""
    y = number * STEP_M
    ahead, here = np.array([aside(np.array(y + 0.1)), y + 0.1]), np.array([aside(np.array(y)), y])
    forward = np.array([*(ahead - here), height(ahead) - height(here)])
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0, 1])
    right /= np.linalg.norm(right)
    found = np.eye(4)
    found[:3, :3] = np.column_stack([right, forward, np.cross(right, forward)])
    found[:3, 3] = *here, height(here)
    return found


@cache
def scanned(number: int) -> np.ndarray:
    """The points in the world that a lidar of 24 beams sees of the hill."""
    azimuth = np.linspace(-np.pi, np.pi, 240, endpoint=False)
    up, around = np.meshgrid(ELEVATIONS, azimuth, indexing="ij")
    rays = np.stack([np.cos(up) * np.sin(around), np.cos(up) * np.cos(around), np.sin(up)], -1).reshape(-1, 3)
    at = pose(number)
    eye = at[:3, 3] + LIDAR_M * at[:3, 2]
    points = met(eye, rays @ at[:3, :3].T)
    return points[np.isfinite(points[:, 0])]


def scan(number: int, world_from_host: np.ndarray, things: np.ndarray) -> Scan:
    """A scan, and points of things on the hill."""
    at = pose(number)
    eye = at[:3, 3] + LIDAR_M * at[:3, 2]
    points = np.concatenate([scanned(number), things])
    local = (points - eye) @ at[:3, :3]
    return Scan(local, np.full(len(local), 0.3), number * 0.2, world_from_host)


def lanes_world(start: float = -10.0, end: float = 120.0) -> list[np.ndarray]:
    """The delimiters: (n, 3)."""
    y = np.arange(start, end, 0.5)
    lines = [np.column_stack([aside(y) + off, y]) for off in LANES_M]
    return [np.column_stack([xy, height(xy)]) for xy in lines]


def seen(eye: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which points the hill does not hide."""
    share = np.linspace(0.01, 0.98, 200)
    sight = eye + (points - eye)[:, None] * share[None, :, None]
    return (sight[..., 2] > height(sight[..., :2]) - 1e-3).all(axis=1)


@cache
def lanes_px(number: int) -> tuple[np.ndarray, ...]:
    """The delimiters as the camera sees them."""
    at = pose(number)
    eye = at[:3, 3] + CAMERA_M * at[:3, 2]
    lines = []
    for line in lanes_world():
        cam = (line - eye) @ at[:3, :3]
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = np.array(SIZE_PX) / 2 + FOCAL_PX * np.stack([cam[:, 0], -cam[:, 2]], -1) / cam[:, 1:2]
        inside = (cam[:, 1] > 2) & (cam[:, 1] < 80) & (uv >= 0).all(axis=1) & (uv <= SIZE_PX).all(axis=1)
        kept = np.flatnonzero(inside & seen(eye, line))
        lines += [uv[part] for part in np.split(kept, np.flatnonzero(np.diff(kept) > 1) + 1) if len(part) > 2]
    return tuple(lines)


def drive(
    n: int = 12,
    things: Callable[[int], np.ndarray] = lambda number: np.zeros((0, 3)),
    wrong: Callable[[np.ndarray], np.ndarray] = lambda pose: pose,
) -> Drive:
    """The drive; `things` are points beside the ground's at a frame, `wrong` spoils poses."""
    frames = [
        DriveFrame(
            f"{number:03d}",
            number * 0.2,
            wrong(pose(number)),
            load_scan=lambda number=number: scan(number, wrong(pose(number)), things(number)),
            lanes_px=lanes_px(number),
        )
        for number in range(n)
    ]
    img_from_cam = np.array([[FOCAL_PX, SIZE_PX[0] / 2, 0], [0, SIZE_PX[1] / 2, -FOCAL_PX], [0, 1, 0]])
    host_from_cam, host_from_lidar = np.eye(4), np.eye(4)
    host_from_cam[2, 3], host_from_lidar[2, 3] = CAMERA_M, LIDAR_M
    return Drive("hill", frames, DriveCamera(*SIZE_PX, img_from_cam, host_from_cam), host_from_lidar)


def box(x: float, y: float) -> np.ndarray:
    """Points on the sides and the roof of a car that stands here."""
    rng = np.random.default_rng(3)
    points = rng.uniform([-0.9, -2.2, 0.25], [0.9, 2.2, 1.5], (600, 3))
    points[:200, 0], points[200:400, 1], points[400:, 2] = -0.9, -2.2, 1.5
    points[:, :2] += [x, y]
    points[:, 2] += height(points[:, :2])
    return points
