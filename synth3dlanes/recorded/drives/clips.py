"""Our own clips with a lidar, read as drives of which the truth is known. The host's frame is the camera's road frame:
its origin is the camera's foot."""

from functools import partial
from pathlib import Path

import numpy as np

from synth3dlanes.dataset.read import Reader
from synth3dlanes.geometry.frames import invert
from synth3dlanes.labels.labels import Labels
from synth3dlanes.recorded.drives.drive import Drive, DriveCamera, DriveFrame, MadeFrames, Scan
from synth3dlanes.scene.things import KINDS
from synth3dlanes.system.arrays import Matrix4, Polyline2
from synth3dlanes.system.errors import FormatError

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
