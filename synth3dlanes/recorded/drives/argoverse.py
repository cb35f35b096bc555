"""Argoverse 2: a log of its sensor data set. The host's frame is the vehicle's, at the middle of the rear axle.

Sources: Wilson et al., "Argoverse 2: Next generation datasets for self-driving perception and forecasting", 2021, and
the package av2. In the frames of points and vehicle x is ahead and y left. A file of a scan has the points of both
lidars in the vehicle's frame, with the car's motion within a turn undone; here they are in the upper lidar's frame.
Images are undistorted.
"""

from pathlib import Path

import numpy as np
import scipy
from jaxtyping import Shaped

from synth3dlanes.formats.reading import image_size
from synth3dlanes.geometry.frames import invert
from synth3dlanes.recorded.drives.drive import Drive, DriveCamera
from synth3dlanes.recorded.drives.gather import Recording, TimedFiles, gather, timed
from synth3dlanes.recorded.drives.poses import NANO, OURS_FROM, UNIT, camera_matrix, in_ours, read_pose_feather
from synth3dlanes.recorded.drives.tables import numeric, read_feather
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.errors import FormatError

POSES = "city_SE3_egovehicle.feather"
DEFAULT_CAMERA, LIDAR = "ring_front_center", "up_lidar"
PLACE = ("qx", "qy", "qz", "qw", "tx_m", "ty_m", "tz_m")
LENS = ("fx_px", "fy_px", "cx_px", "cy_px", "width_px", "height_px")
HALF_PX = 0.5


def is_argoverse(folder: Path) -> bool:
    """Whether a folder is a log of Argoverse 2."""
    return (folder / POSES).is_file()


def read_argoverse(folder: Path, camera: str = "") -> Drive:
    """A log: its lidar, one of its cameras (by default the front camera), and its poses in the city's frame. Raises
    FormatError."""
    camera = camera or DEFAULT_CAMERA
    scans = _by_time(folder / "sensors" / "lidar", ".feather")
    images = _by_time(folder / "sensors" / "cameras" / camera, ".jpg")
    found = _camera(folder / "calibration", camera, images)
    track = read_pose_feather(folder / POSES)
    host_from_lidar = in_ours(_place(folder / "calibration", LIDAR), "flu", "flu")
    lidar_from_file = invert(host_from_lidar) @ OURS_FROM["flu"]
    return gather(folder.resolve().name, Recording(scans, images, track, host_from_lidar, lidar_from_file), found)


def _by_time(folder: Path, ending: str) -> TimedFiles:
    """Files whose names are their times in nanoseconds."""
    paths = list(folder.glob(f"*{ending}")) if folder.is_dir() else []
    unnamed = [path for path in paths if not (path.stem.isdecimal() and len(path.stem) <= 19)]
    if unnamed:
        raise FormatError(f"{unnamed[0]}: expected a time in nanoseconds as its name, got {unnamed[0].stem[:40]}")
    paths.sort(key=lambda path: int(path.stem))
    return timed(paths, np.array([int(path.stem) * NANO for path in paths]), str(folder), "files")


def _camera(folder: Path, name: str, images: TimedFiles) -> DriveCamera:
    path = folder / "intrinsics.feather"
    row = _row(read_feather(path, ("sensor_name", *LENS)), name, path)
    fx, fy, cx, cy, width, height = (float(row[key]) for key in LENS)
    if not (fx > 0 and fy > 0 and 1 <= width <= 1e5 and 1 <= height <= 1e5):
        raise FormatError(f"{path}: {name}: expected a focal length and a size in pixels above 0, got others")
    if len(images) and (found := image_size(images.paths[0])) != (int(width), int(height)):
        told = f"{width:.0f}x{height:.0f}, got {found[0]}x{found[1]}"
        raise FormatError(f"{images.paths[0]}: expected the size of its calibration, {told}")
    matrix = camera_matrix(fx, fy, cx + HALF_PX, cy + HALF_PX)
    return DriveCamera(int(width), int(height), matrix, in_ours(_place(folder, name), "flu", "rdf"), name=name)


def _place(folder: Path, sensor: str) -> Matrix4:
    """The pose of a sensor in the vehicle's frame, each in its own axes."""
    path = folder / "egovehicle_SE3_sensor.feather"
    row = _row(read_feather(path, ("sensor_name", *PLACE)), sensor, path)
    values = np.array([row[key] for key in PLACE])
    if not abs(np.linalg.norm(values[:4]) - 1) <= UNIT or not np.isfinite(values).all():
        raise FormatError(f"{path}: {sensor}: expected a unit quaternion and a place, got others")
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = scipy.spatial.transform.Rotation.from_quat(values[:4]).as_matrix(), values[4:]
    return found


def _row(columns: dict[str, Shaped[np.ndarray, " _"]], sensor: str, path: Path) -> dict[str, float]:
    names = [str(name) for name in columns.pop("sensor_name")]
    if sensor not in names:
        raise FormatError(f"{path}: expected the sensor {sensor[:40]}, got {', '.join(names)[:200] or 'none'}")
    at = names.index(sensor)
    return {key: float(numeric(values, f"{path}: {key}")[at]) for key, values in columns.items()}
