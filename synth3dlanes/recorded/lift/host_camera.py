"""The camera of a frame over the ground: height, pitch, roll and yaw relative to the road below it."""

import numpy as np

from synth3dlanes.geometry.frames import road_from_cam
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.recorded.drives.drive import DriveCamera
from synth3dlanes.recorded.lift.ground import GroundMap
from synth3dlanes.recorded.lift.path import Path
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.errors import InputError

# Size of the ground along and across the path that gives the road plane. Where that ground is not known, WIDER times
# the size is used.
ALONG_M, ASIDE_M, WIDER = 4.0, 1.5, 4.0
MIN_PLACES = 12


def camera_label(camera: DriveCamera, world_from_cam: Matrix4, ground: GroundMap, path: Path) -> CameraLabel:
    """The camera's label: its place over the plane that touches the ground below it. Raises InputError where no ground
    is near it."""
    eye = world_from_cam[:3, 3]
    normal, height_m = _plane_below(eye, ground, path)
    forward = path.curve(path.to_plan(eye[None, :2])[:, 0], 1)[0]
    forward = forward - (forward @ normal) * normal
    forward /= np.linalg.norm(forward)
    road_from_world = np.stack([np.cross(forward, normal), forward, normal])
    x, y, _ = (road_from_world @ world_from_cam[:3, :3]).T
    pitch, yaw = float(np.arcsin(-y[2])), float(np.arctan2(-y[0], y[1]))
    level = road_from_cam(0.0, pitch, 0.0, yaw)[:3, :3].T @ x
    roll = float(np.arctan2(-level[2], level[0]))
    return CameraLabel(
        width_px=camera.width_px,
        height_px=camera.height_px,
        img_from_cam=camera.img_from_cam,
        height_m=height_m,
        pitch_rad=pitch,
        road_from_cam=road_from_cam(height_m, pitch, roll, yaw),
        world_from_cam=world_from_cam,
        roll_rad=roll,
        yaw_rad=yaw,
        name=camera.name,
        lens=camera.lens,
    )


def _plane_below(eye: np.ndarray, ground: GroundMap, path: Path) -> tuple[np.ndarray, float]:
    """The unit normal of the plane below a place, and the place's height over it."""
    s = float(path.to_plan(eye[None, :2])[0, 0])
    for wide in (1.0, WIDER, WIDER**2):
        along, aside = np.meshgrid(np.linspace(-wide, wide, 9) * ALONG_M, np.linspace(-1, 1, 7) * ASIDE_M * wide**0.5)
        xy = path.to_world(s + along.ravel(), aside.ravel())
        z = ground.at(xy)[0]
        has = np.isfinite(z)
        if has.sum() < MIN_PLACES:
            continue
        columns = np.column_stack([xy[has] - eye[:2], np.ones(has.sum())])
        (a, b, c), *_ = np.linalg.lstsq(columns, z[has], rcond=None)
        normal = np.array([-a, -b, 1.0]) / np.sqrt(a * a + b * b + 1)
        height_m = float((eye[2] - c) * normal[2])
        if height_m <= 0:
            raise InputError(
                f"camera: expected it above the ground, got it {-height_m:.2f} m below: is the drive's z up, and the "
                "camera's place on the host right?"
            )
        return normal, height_m
    raise InputError(f"scans: expected points on the ground near the host at {np.round(eye, 1).tolist()}, got none")
