"""Open a drive, of whichever layout it is. Our own clips with a lidar are drives of which the truth is known: the
host's frame is the camera's road frame, its origin the camera's foot."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from synth3dlanes.dataset.read import Reader
from synth3dlanes.geometry.frames import invert
from synth3dlanes.labels.labels import Labels
from synth3dlanes.recorded.drives.argoverse import is_argoverse, read_argoverse
from synth3dlanes.recorded.drives.described import DRIVE_FILE, read_described
from synth3dlanes.recorded.drives.drive import Drive, DriveCamera, DriveFrame, MadeFrames, Scan
from synth3dlanes.recorded.drives.gather import with_lines
from synth3dlanes.recorded.drives.kitti import is_kitti_raw, is_kitti_sequence, read_kitti_raw, read_kitti_sequence
from synth3dlanes.recorded.drives.lines import read_lines_of
from synth3dlanes.recorded.drives.marks import read_marks, with_review
from synth3dlanes.scene.things import KINDS
from synth3dlanes.system.arrays import Matrix4, Polyline2
from synth3dlanes.system.errors import FormatError, InputError

# What a clip's points reflect, by their semantic id: its sweeps have no intensity of their own.
REFLECTS = np.zeros(256)
for _kind in KINDS:
    REFLECTS[_kind.semantic_id] = _kind.reflectance


def read_clip(reader: Reader, scene: int, camera: str = "") -> Drive:
    """A clip of a data set, by one of its cameras (the first unless one is named). Lanes in its images are the visible
    delimiters of its labels; `marked` is empty. Raises FormatError for a data set without a lidar."""
    names = [spec.name for spec in reader.cameras] or [""]
    if camera and camera not in names:
        raise FormatError(f"{reader.url}: expected a camera of {', '.join(names) or 'none'}, got {camera[:40]}")
    if reader.description.get("shots", {}).get("views", 1) > 1:
        raise FormatError(f"{reader.url}: expected clips (generate --frames), got several views of each world")
    positions = reader.clip(scene, names.index(camera) if camera else 0)
    first = reader.labels(positions[0])
    if first.lidar is None or not reader.has_lidar:
        raise FormatError(f"{reader.url}: expected a data set with a lidar (generate --lidar), got one without")
    told = first.camera
    found = DriveCamera(
        told.width_px, told.height_px, told.img_from_cam, told.road_from_cam, told.lens, told.name or camera
    )
    host_from_lidar = told.road_from_cam @ first.lidar.cam_from_lidar

    image_format = reader.description["image_format"]

    def make(number: int) -> DriveFrame:
        at = positions[number]
        labels = reader.labels(at)
        time_s, pose = labels.time_s or 0.0, labels.camera.world_from_cam @ invert(labels.camera.road_from_cam)
        return DriveFrame(
            reader.key(at),
            time_s,
            pose,
            Path(f"{reader.key(at)}.{image_format}"),
            partial(_scan, reader, at, time_s, pose),
            lanes_in_image(labels),
            partial(reader.member, at, image_format),
        )

    name = f"{_name_of(reader)}:{reader.key(positions[0])}"
    return Drive(name, MadeFrames(len(positions), make), found, host_from_lidar)


def _name_of(reader: Reader) -> str:
    """The names of its data set and split, however the address is written."""
    url = reader.url.rstrip("/")
    return "/".join(url.split("/")[-2:] if "://" in url else Path(url).resolve().parts[-2:])


def lanes_in_image(labels: Labels) -> tuple[Polyline2, ...]:
    """The visible delimiters of a picture as lines of pixels, near to far."""
    parts = [part for lane in labels.lanes if lane.kind == "delimiter" for part in lane.visible_parts()]
    lines = (labels.camera.project(part) for part in parts if len(part) > 1)
    return tuple(line for line in lines if np.isfinite(line).all())


def _scan(reader: Reader, at: int, time_s: float, world_from_host: Matrix4) -> Scan:
    points = reader.lidar(at).points()
    return Scan(points.xyz_lidar, REFLECTS[points.semantic], time_s, world_from_host)


LAYOUTS = (
    "drive.yaml, a log of Argoverse 2, a drive of KITTI (raw or odometry), or a split of clips with a lidar (DIR/train)"
)


def open_drive(source: str, camera: str = "", lanes: str = "", marked: str = "", review: str = "") -> Drive:
    """The drive at `source`: a folder of a known layout, a file `drive.yaml`, or `DIR/SPLIT:SCENE` of a data set of
    clips with a lidar. `camera` names one of its cameras; `lanes` is a file of 2D lanes of its images, `marked` one of
    lanes marked in the top view, `review` one of verdicts on what was lifted of it before. Nothing but small files is
    read before frames are asked for.

    Raises InputError where `source` is none of these or `review` is of another drive, FormatError for files that do
    not follow their format.
    """
    drive = _opened(source, camera)
    if lanes:
        drive = with_lines(drive, read_lines_of(Path(lanes)))
    if marked:
        x, y, _ = drive.origin_m
        drive = replace(
            drive, marked=tuple(replace(lane, xy_world=lane.xy_world - [x, y]) for lane in read_marks(Path(marked)))
        )
    return with_review(drive, Path(review)) if review else drive


def _of_one_camera(drive: Drive, path: Path, camera: str) -> Drive:
    """The drive; raise InputError for a camera other than its own."""
    if camera not in ("", drive.camera.name):
        raise InputError(f"camera: expected {drive.camera.name or 'none'}, which {path} has, got {camera[:40]}")
    return drive


def _opened(source: str, camera: str) -> Drive:
    path = Path(source)
    try:
        if path.is_file() and path.suffix in (".yaml", ".yml"):
            return _of_one_camera(read_described(path), path, camera)
        if path.is_dir():
            if (path / DRIVE_FILE).is_file():
                return _of_one_camera(read_described(path / DRIVE_FILE), path, camera)
            if is_argoverse(path):
                return read_argoverse(path, camera)
            if is_kitti_sequence(path):
                return read_kitti_sequence(path, camera)
            if is_kitti_raw(path):
                return read_kitti_raw(path, camera)
            if (path.parent / "dataset.json").is_file():
                reader = Reader(source)
                return read_clip(reader, reader.scenes[0], camera)
            raise InputError(f"{source}: expected {LAYOUTS}, got a folder of another layout")
    except OSError as error:
        raise FormatError(f"{source}: cannot be read: {error.strerror or error}") from None
    url, _, scene = source.rpartition(":")
    if url and scene.isdecimal() and len(scene) < 10:
        return read_clip(Reader(url), int(scene), camera)
    raise InputError(f"{source}: expected {LAYOUTS}, got nothing of the kind")
