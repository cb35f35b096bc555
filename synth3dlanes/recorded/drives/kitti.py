"""KITTI's drives: raw data (`*_drive_*_sync`) and sequences of its odometry benchmark. The host's frame is the lidar's.

Sources: Geiger et al., "Vision meets robotics: The KITTI dataset", IJRR 2013, and the readme files of the development
kits. Images are rectified; pixels count from the middle of the first one. Points look along x, y is to their left.
"""

import re
from pathlib import Path

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.formats.reading import image_size
from synth3dlanes.geometry.frames import invert
from synth3dlanes.geometry.lens import PINHOLE
from synth3dlanes.recorded.drives.drive import Drive, DriveCamera
from synth3dlanes.recorded.drives.gather import Recording, TimedFiles, gather, timed
from synth3dlanes.recorded.drives.poses import (
    OURS_FROM,
    PoseTrack,
    camera_matrix,
    in_ours,
    matrix34,
    read_kitti_poses,
    rigid,
    track,
)
from synth3dlanes.recorded.drives.tables import floats, read_lines, read_rows
from synth3dlanes.system.arrays import Matrix4, Scalars
from synth3dlanes.system.errors import FormatError

EARTH_M = 6378137.0
# Where a Mercator projection ends.
MOST_LATITUDE_DEG = 89.0
HALF_PX = 0.5
N_OXTS = 30
STAMP = re.compile(r"(\d{4}-\d\d-\d\d) (\d\d:\d\d:\d\d(?:\.\d{1,9})?)", re.ASCII)
RAW_SCANS, OXTS, STAMPS = "velodyne_points", "oxts", "timestamps.txt"
DEFAULT_CAMERA = "2"


def is_kitti_raw(folder: Path) -> bool:
    """Whether a folder is a drive of KITTI's raw data."""
    return (folder / OXTS).is_dir() or (folder / RAW_SCANS).is_dir()


def is_kitti_sequence(folder: Path) -> bool:
    """Whether a folder is a sequence of KITTI's odometry benchmark."""
    return (folder / "calib.txt").is_file() and (folder / "times.txt").is_file()


def read_kitti_raw(folder: Path, camera: str = "") -> Drive:
    """A drive of the raw data: `FOLDER/velodyne_points`, `oxts` and the images of a camera (0 to 3, by default
    `image_02`), with the calibration in FOLDER or the folder above it. The car's motion within a turn is undone: all
    points are in the lidar's frame at the moment when it looked ahead. The world's x is east, y north, z up. Raises
    FormatError."""
    number = _camera_number(camera)
    calibrations = _calibration_folder(folder)
    rectified = read_calibration(calibrations / "calib_cam_to_cam.txt")
    velo, imu = (read_calibration(calibrations / f"calib_{name}.txt") for name in ("velo_to_cam", "imu_to_velo"))
    where = str(calibrations / "calib_cam_to_cam.txt")
    cam_from_velo = _rotated(rectified, "R_rect_00", where) @ _placed(velo, str(calibrations / "calib_velo_to_cam.txt"))
    velo_from_imu = _placed(imu, str(calibrations / "calib_imu_to_velo.txt"))
    images = _stamped(folder / f"image_{number:02d}", ("png", "jpg"), "images")
    scans = _stamped(folder / RAW_SCANS, ("bin",), "scans")
    found = _camera(rectified, f"P_rect_{number:02d}", cam_from_velo, where, images)
    of_lidar = _oxts_track(folder / OXTS).of(in_ours(invert(velo_from_imu), "flu", "flu"))
    turn = [folder / RAW_SCANS / f"timestamps_{name}.txt" for name in ("start", "end")]
    turns_s = None
    if len(scans) and all(path.exists() for path in turn):
        begins, ends = (_of_sequence(folder / RAW_SCANS / "data", ("bin",), _stamps(path), "scans") for path in turn)
        turns_s = begins.times_s, ends.times_s
    recording = Recording(scans, images, of_lidar, np.eye(4), OURS_FROM["flu"], turns_s)
    return gather(folder.name, recording, found)


def read_kitti_sequence(folder: Path, camera: str = "") -> Drive:
    """A sequence of the odometry benchmark: `FOLDER/calib.txt`, `times.txt`, `velodyne`, the images of a camera (by
    default `image_2`), and the poses of camera 0 in `FOLDER/poses.txt` or `FOLDER/../../poses/NAME.txt`. The car's
    motion within a turn is already undone in the points. Raises FormatError."""
    number = _camera_number(camera)
    where = folder / "calib.txt"
    calibration = read_calibration(where)
    key = "Tr" if "Tr" in calibration else "Tr_velo_to_cam"
    cam_from_velo = matrix34(_numbers(calibration, key, 12, str(where)), f"{where}: {key}")
    times_s = read_rows(folder / "times.txt", 1, "seconds")[:, 0]
    images = _of_sequence(folder / f"image_{number}", ("png", "jpg"), times_s, "images")
    scans = _of_sequence(folder / "velodyne", ("bin",), times_s, "scans")
    beside, shared = folder / "poses.txt", folder.parent.parent / "poses" / f"{folder.name}.txt"
    path = shared if shared.exists() and not beside.exists() else beside
    of_lidar = read_kitti_poses(path, times_s, "rdf").of(in_ours(cam_from_velo, "rdf", "flu"))
    found = _camera(calibration, f"P{number}", cam_from_velo, str(where), images)
    return gather(folder.name, Recording(scans, images, of_lidar, np.eye(4), OURS_FROM["flu"]), found)


def read_calibration(path: Path) -> dict[str, Float[np.ndarray, " _"]]:
    """The numbers of a calibration file of KITTI by their keys; lines of words, such as dates, are left out."""
    found = {}
    for where, line in read_lines(path):
        key, colon, values = line.partition(":")
        if not colon:
            raise FormatError(f"{where}: expected a key, a colon and numbers, got {line[:60]!r}")
        words = values.split()
        try:
            numbers = np.array([float(word) for word in words])
        except ValueError:
            continue
        if not np.isfinite(numbers).all():
            raise FormatError(f"{where}: {key[:40]}: expected finite numbers, got others")
        found[key.strip()] = numbers
    return found


def _numbers(calibration: dict[str, Float[np.ndarray, " _"]], key: str, n: int, where: str) -> Float[np.ndarray, " _"]:
    values = calibration.get(key, np.zeros(0))
    if len(values) != n:
        raise FormatError(f"{where}: {key}: expected {n} numbers, got {len(values) or 'no such key'}")
    return values


def _placed(calibration: dict[str, Float[np.ndarray, " _"]], where: str) -> Matrix4:
    turned = _numbers(calibration, "R", 9, where).reshape(3, 3)
    return rigid(turned, _numbers(calibration, "T", 3, where), f"{where}: R")


def _rotated(calibration: dict[str, Float[np.ndarray, " _"]], key: str, where: str) -> Matrix4:
    return rigid(_numbers(calibration, key, 9, where).reshape(3, 3), np.zeros(3), f"{where}: {key}")


def _camera(
    calibration: dict[str, Float[np.ndarray, " _"]], key: str, cam_from_velo: Matrix4, where: str, images: TimedFiles
) -> DriveCamera:
    """The camera of a projection matrix K [I | t], relative to rectified camera 0. Its size is the first image's, or
    twice the principal point if there is no image."""
    projection = _numbers(calibration, key, 12, where).reshape(3, 4)
    matrix = projection[:, :3]
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    if not (min(fx, fy, cx, cy) > 0 and matrix[2].tolist() == [0, 0, 1]):
        raise FormatError(f"{where}: {key}: expected [fx 0 cx; 0 fy cy; 0 0 1] and a column, got {matrix.tolist()}")
    from_first = np.eye(4)
    from_first[:3, 3] = np.linalg.inv(matrix) @ projection[:, 3]
    path = next((path for path in images.paths if path.exists()), None)
    width_px, height_px = image_size(path) if path else (round(2 * cx), round(2 * cy))
    size_key = key.replace("P_rect", "S_rect")
    told = calibration.get(size_key, np.zeros(0)) if size_key != key else np.zeros(0)
    if path and len(told) == 2 and (width_px, height_px) != tuple(told.astype(int)):
        told_size = f"{told[0]:.0f}x{told[1]:.0f}"
        raise FormatError(f"{path}: expected the size of its calibration, {told_size}, got {width_px}x{height_px}")
    host_from_cam = in_ours(invert(from_first @ cam_from_velo), "flu", "rdf")
    img_from_cam = camera_matrix(fx, fy, cx + HALF_PX, cy + HALF_PX)
    return DriveCamera(width_px, height_px, img_from_cam, host_from_cam, PINHOLE, f"image_{int(key[-1])}")


def _camera_number(camera: str) -> int:
    name = (camera or DEFAULT_CAMERA).removeprefix("image_").removeprefix("0") or "0"
    if name not in ("0", "1", "2", "3"):
        raise FormatError(f"camera: expected 0, 1, 2 or 3, got {camera[:40]!r}")
    return int(name)


def _calibration_folder(folder: Path) -> Path:
    for place in (folder, folder.resolve().parent):
        if (place / "calib_cam_to_cam.txt").exists():
            return place
    raise FormatError(f"{folder}: expected calib_cam_to_cam.txt in it or in the folder above, got none")


def _of_sequence(folder: Path, endings: tuple[str, ...], times_s: Scalars, what: str) -> TimedFiles:
    """Files whose names are numbers of lines of `times.txt`."""
    paths = sorted(path for ending in endings for path in folder.glob(f"*.{ending}"))
    unnumbered = [
        path for path in paths if not (path.stem.isdecimal() and len(path.stem) < 19 and int(path.stem) < len(times_s))
    ]
    if unnumbered:
        told = f"the number of one of {len(times_s)} times as its name"
        raise FormatError(f"{unnumbered[0]}: expected {told}, got {unnumbered[0].stem[:40]}")
    return timed(paths, times_s[[int(path.stem) for path in paths]], str(folder), what)


def _stamped(folder: Path, endings: tuple[str, ...], what: str) -> TimedFiles:
    """Files of `FOLDER/data`, whose names are numbers of lines of `timestamps.txt`; a few may be missing."""
    if not folder.is_dir():
        return TimedFiles()
    return _of_sequence(folder / "data", endings, _stamps(folder / STAMPS), what)


def _stamps(path: Path) -> Scalars:
    """A line of date and time for each file, as seconds since 1970."""
    times = []
    for where, line in read_lines(path):
        told = STAMP.fullmatch(line)
        try:
            times.append(np.datetime64(f"{told[1]}T{told[2]}" if told else "", "ns").astype(np.int64))
        except (ValueError, OverflowError):
            told = None
        if told is None:
            raise FormatError(f"{where}: expected a date and a time, got {line[:60]!r}")
    return np.array(times, float) * 1e-9


def _oxts_track(folder: Path) -> PoseTrack:
    """The poses of the IMU: a Mercator projection at the first latitude, and roll, pitch and yaw (0 = east)."""
    files = _of_sequence(folder / "data", ("txt",), _stamps(folder / STAMPS), "packets of the IMU")
    rows = []
    for path in files.paths:
        lines = list(read_lines(path))
        if len(lines) != 1:
            raise FormatError(f"{path}: expected one line of {N_OXTS} numbers, got {len(lines)} lines")
        rows.append(floats(lines[0][1], str(path), N_OXTS, "latitude, longitude, altitude, roll, pitch, yaw and so on"))
    if not rows:
        raise FormatError(f"{folder}: expected data/*.txt, got none")
    latitude, longitude, up, roll, pitch, yaw = np.array(rows)[:, :6].T
    if not (np.abs(latitude) < MOST_LATITUDE_DEG).all():
        raise FormatError(f"{folder}: expected latitudes of less than {MOST_LATITUDE_DEG:g} degrees, got others")
    scale = np.cos(np.radians(latitude[0]))
    east = scale * EARTH_M * np.radians(longitude)
    north = scale * EARTH_M * np.log(np.tan(np.radians(90 + latitude) / 2))
    places = np.stack([east, north, up], axis=-1)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    rotations = scipy.spatial.transform.Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1))
    poses[:, :3, :3] = rotations.as_matrix()
    poses[:, :3, 3] = places - places[0]
    return track(folder, files.times_s, poses @ invert(OURS_FROM["flu"]))
