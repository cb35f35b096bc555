"""Open a drive, of whichever layout it is."""

from dataclasses import replace
from pathlib import Path

from synth3dlanes.dataset.read import Reader
from synth3dlanes.recorded.drives.argoverse import is_argoverse, read_argoverse
from synth3dlanes.recorded.drives.clips import read_clip
from synth3dlanes.recorded.drives.described import DRIVE_FILE, read_described
from synth3dlanes.recorded.drives.drive import Drive
from synth3dlanes.recorded.drives.gather import with_lines
from synth3dlanes.recorded.drives.kitti import is_kitti_raw, is_kitti_sequence, read_kitti_raw, read_kitti_sequence
from synth3dlanes.recorded.drives.lines import read_lines_of
from synth3dlanes.recorded.drives.marks import read_marks
from synth3dlanes.recorded.drives.review import with_review
from synth3dlanes.system.errors import FormatError, InputError

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
