"""A drive that a file of ours describes, `drive.yaml`: which files its sensors left, and how they are to be read
(docs/drives.md)."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from synth3dlanes.formats.reading import image_size
from synth3dlanes.geometry.frames import invert, road_from_cam, turned
from synth3dlanes.params.camera_files import load_camera
from synth3dlanes.recorded.drives.drive import Drive, DriveCamera
from synth3dlanes.recorded.drives.gather import Recording, TimedFiles, gather, timed
from synth3dlanes.recorded.drives.lines import ImageLines, read_lines_of
from synth3dlanes.recorded.drives.marks import read_marks
from synth3dlanes.recorded.drives.poses import (
    OURS_FROM,
    AxesName,
    PoseTrack,
    camera_matrix,
    in_ours,
    matrix34,
    read_kitti_poses,
    read_pose_feather,
    read_pose_json,
    read_tum,
)
from synth3dlanes.recorded.drives.tables import matching, read_lines, read_rows
from synth3dlanes.system.arrays import Matrix4, Scalars
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.schema import DocumentPart, Name, PathBelow, validation_problems
from synth3dlanes.system.yaml_text import read_yaml, text_of

DRIVE_FILE = "drive.yaml"
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
MAX_FILES = 2_000_000
KITTI_COLUMNS = 12
# Whole numbers in a name, none of them behind a decimal point.
NUMBERS = re.compile(r"(?<!\d\.)(?<!\d)\d+")
LONGEST = 40

_Value = Annotated[float, Field(ge=-1e6, le=1e6)]
_Row = tuple[_Value, _Value, _Value, _Value]
_Matrix = tuple[_Row, _Row, _Row] | tuple[_Row, _Row, _Row, _Row]


class _Sensor(DocumentPart):
    files: PathBelow
    times: PathBelow | None = None
    unit: Literal["s", "ms", "us", "ns"] = "s"


class _Lidar(_Sensor):
    axes: AxesName = "flu"
    metres: Annotated[float, Field(ge=1e-6, le=1e6)] = 1.0
    host_from_lidar: _Matrix | None = None


class _Images(_Sensor):
    camera: str
    cam_from_lidar: _Matrix | None = None


class _Poses(DocumentPart):
    file: PathBelow
    of: Literal["host", "lidar", "camera"] = "host"
    axes: AxesName = "flu"


class _Described(DocumentPart):
    name: Name | None = None
    lidar: _Lidar | None = None
    images: _Images
    poses: _Poses
    lanes: PathBelow | None = None
    marked: PathBelow | None = None


def read_described(path: Path) -> Drive:
    """The drive of a file `drive.yaml`; paths in it are below its folder. Raises InputError for the file itself,
    FormatError for a file that it names."""
    document, problems = read_yaml(text_of(path, str(path)), str(path))
    if problems:
        raise InputError(*problems)
    try:
        told = _Described.model_validate(document)
    except ValidationError as error:
        raise InputError(*validation_problems(error, str(path))) from None
    folder = path.parent
    lines = read_lines_of(folder / told.lanes) if told.lanes else None
    images = _files(folder, told.images, "images", lines)
    if lines:
        lines.expect_some(images.paths)
    scans = _files(folder, told.lidar, "scans") if told.lidar else TimedFiles()
    host_from_lidar, ours_from_file = np.eye(4), np.eye(4)
    if told.lidar:
        ours_from_file = OURS_FROM[told.lidar.axes] @ np.diag([told.lidar.metres] * 3 + [1.0])
        if told.lidar.host_from_lidar is not None:
            given = _given(told.lidar.host_from_lidar, f"{path}: lidar.host_from_lidar")
            host_from_lidar = in_ours(given, "flu" if told.lidar.axes == "rdf" else told.lidar.axes, told.lidar.axes)
    camera = _camera(told, folder, images, host_from_lidar, path)
    bodies = {"host": np.eye(4), "lidar": host_from_lidar, "camera": camera.host_from_cam}
    host = _track(folder / told.poses.file, told.poses.axes, scans if len(scans) else images)
    if told.poses.of != "host":
        host = host.of(invert(bodies[told.poses.of]))
    marked = read_marks(folder / told.marked) if told.marked else ()
    recording = Recording(scans, images, host, host_from_lidar, ours_from_file, None, lines.of if lines else None)
    return gather(told.name or path.resolve().parent.name, recording, camera, marked)


def _files(folder: Path, told: _Sensor, what: str, lines: ImageLines | None = None) -> TimedFiles:
    """The files of a pattern in the order of their names, or the images that a file of lanes lists, with their
    times."""
    paths = sorted(matching(folder, told.files, MAX_FILES))
    if not paths and lines is not None:
        paths = [folder / name for name in lines.names]
    if not 0 < len(paths) <= MAX_FILES:
        raise FormatError(f"{folder / told.files}: expected 1 to {MAX_FILES:,} {what}, got {len(paths) or 'none'}")
    if told.times:
        _expect_one_order(paths)
        return timed(paths, _times(folder / told.times) * SECONDS[told.unit], str(folder / told.times), what)
    names = [path.stem.replace("_", ".", 1) for path in paths]
    if not all(name.replace(".", "", 1).isdecimal() and len(name) < 25 for name in names):
        told_names = f"names that are times in {told.unit}, or a file `times`"
        raise FormatError(f"{folder / told.files}: expected {told_names}, got {paths[0].name[:60]}")
    times_s = np.array([float(name) for name in names]) * SECONDS[told.unit]
    order = np.argsort(times_s, kind="stable")
    return timed([paths[at] for at in order], times_s[order], str(folder / told.files), what)


def _expect_one_order(paths: Sequence[Path]) -> None:
    """Raise FormatError for names whose order as texts is not that of their numbers: which time is whose?"""

    def padded(path: Path) -> list[str]:
        return [NUMBERS.sub(lambda number: number[0].zfill(LONGEST), part) for part in path.parts]

    by_number = sorted(paths, key=padded)
    found = next(((path, other) for path, other in zip(paths, by_number, strict=True) if path != other), None)
    if found:
        told = f"{found[0].name[:60]} before {found[1].name[:60]}: write numbers with leading zeros"
        raise FormatError(f"{paths[0].parent}: expected names in the order of their numbers, got {told}")


def _times(path: Path) -> Scalars:
    return read_rows(path, 1, "a time")[:, 0]


def _given(rows: Any, where: str) -> Matrix4:
    return matrix34(np.array(rows[:3], float).ravel(), where)


def _track(path: Path, axes: AxesName, of_files: TimedFiles) -> PoseTrack:
    """The poses of a file, by its ending and its columns. KITTI's poses have no times: they belong to the scans, or to
    the images of a drive without scans."""
    if path.suffix == ".feather":
        return read_pose_feather(path, axes)
    if path.suffix == ".json":
        return read_pose_json(path)
    _, first = next(read_lines(path), ("", ""))
    columns = len(first.replace(",", " ").split())
    return read_kitti_poses(path, of_files.times_s, axes) if columns == KITTI_COLUMNS else read_tum(path, axes)


def _camera(told: _Described, folder: Path, images: TimedFiles, host_from_lidar: Matrix4, where: Path) -> DriveCamera:
    """A file's camera: ours, OpenCV, ROS or Kalibr, or a ready one. Its place is its own, or `cam_from_lidar`."""
    source = str(folder / told.images.camera) if (folder / told.images.camera).is_file() else told.images.camera
    spec = load_camera(source)
    values = spec.drawn(lambda: 0.5)
    place = turned(0.0, values["right_m"], values["forward_m"])
    host_from_cam = place @ road_from_cam(
        values["height_m"], values["pitch_rad"], values["roll_rad"], values["yaw_rad"]
    )
    if told.images.cam_from_lidar is not None:
        if told.lidar is None:
            raise InputError(f"{where}: images.cam_from_lidar: expected a lidar in the file, got none")
        given = _given(told.images.cam_from_lidar, f"{where}: images.cam_from_lidar")
        host_from_cam = host_from_lidar @ invert(in_ours(given, "rdf", told.lidar.axes))
    size = values["width_px"], values["height_px"]
    path = next((path for path in images.paths[:1] if path.exists()), None)
    if path is not None and (found := image_size(path)) != size:
        raise FormatError(f"{path}: expected the size of its camera, {size[0]}x{size[1]}, got {found[0]}x{found[1]}")
    matrix = camera_matrix(values["fx_px"], values["fy_px"], values["cx_px"], values["cy_px"])
    return DriveCamera(*size, matrix, np.asarray(host_from_cam), values["lens"], spec.name)
