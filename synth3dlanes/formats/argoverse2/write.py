"""Write Argoverse 2: for each picture its image, for each instant a sweep and rows of the log's tables, and with the
first picture of a log its calibration and its map."""

import io
import json
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float
from pyarrow import feather

from synth3dlanes.formats.argoverse2.convention import (
    ANNOTATIONS,
    CAMERAS,
    CATEGORIES,
    FRONT_CAMERA,
    HALF_PX,
    HOST_FROM_EGO,
    INTRINSICS,
    LIDARS,
    POINTS,
    POSES,
    RING_CAMERAS,
    ROOM_NS,
    SENSORS,
    START_NS,
    LogFiles,
    log_name,
)
from synth3dlanes.formats.argoverse2.maps import PIECE_M, map_files
from synth3dlanes.formats.format import SampleFrame
from synth3dlanes.formats.writing import CV_FROM_CAM, FrameAnnotation, world_from_host
from synth3dlanes.geometry.frames import from_axes, invert, quaternion, transform
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.errors import InputError
from synth3dlanes.world.world import resolve

README = f"""Argoverse 2's sensor data set: a log for each scene, its frames those of the clip.

- `{{train,val,test}}/LOG/sensors/cameras/CAMERA/TIMESTAMP.jpg`, `sensors/lidar/TIMESTAMP.feather`,
  `annotations.feather`, `city_SE3_egovehicle.feather`, `calibration/*.feather`, `map/*`. Timestamps (ns) differ between
  logs too. Tools of map learners drop frames without one of the seven cameras `ring_*`: generate with
  `--rig argoverse2`. A camera without such a rig is `{FRONT_CAMERA}`.
- Vehicle frame: x forward, y left, z up, from the rear axle, {-HOST_FROM_EGO[1, 3]:g} m behind the middle of the host
  and {HOST_FROM_EGO[2, 3]:g} m over the road. City frame: the scene's world. Pixels count from the middle of the first
  one. All sensors of an instant measure at once, so `offset_ns` is 0. There is no intensity.
- Without a lidar, sweeps have no points: tools step through their timestamps. One lidar is both `up_lidar` and
  `down_lidar`; points have 4 bytes a coordinate, where the original has 2.
- Boxes are those of all cars of the labels, seen or not, with the points of the sweep on them. The API's evaluation
  leaves out those without points from the truth, but not from detections, where a found one is a false alarm: without
  a lidar nothing is left of the truth. Take detections without points out as well, or those that are far away.
- Lane segments are those of the lane graph, cut into pieces of at most {PIECE_M:g} m: ids count the segment from 1 and
  its pieces from 0, as 2003. Boundaries are half a lane's width beside the middle; their mark type is the paint along
  most of the segment. An oncoming lane across one line is a neighbour.
"""


def annotate(frame: SampleFrame) -> FrameAnnotation:
    """The files of a picture; with the first of an instant also its sweep and rows, with the first of a log its
    calibration and map."""
    labels, shot, where = frame.labels, frame.scene.shot, f"{frame.split}:{frame.key}"
    if labels.objects is None:
        raise InputError(f"{where}: expected labels with objects, got older ones; generate the data set again")
    name = _name(labels.camera, shot.n_cameras, where)
    first = frame.number - shot.frame * shot.n_cameras - shot.camera
    files = LogFiles(frame.part, log_name(first))
    timestamp_ns = START_NS + first * ROOM_NS + round(shot.time_s * 1e9)
    image = files.image(name, timestamp_ns)
    if not frame.cameras:
        return FrameAnnotation(image, 0)
    world_from_ego = ego_frame(frame)
    ego_from_cam = invert(world_from_ego) @ labels.camera.world_from_cam
    own: dict[str, str | bytes] = {files.sweep(timestamp_ns): _sweep(frame, ego_from_cam)}
    n_lanes = 0
    if frame.is_first:
        own |= _calibration(frame, files, world_from_ego)
        mapped, n_lanes = map_files(resolve(frame.scene), labels.graph, files)
        own |= mapped
    boxes = [_box(item, ego_from_cam, files.log, timestamp_ns) for item in labels.objects]
    rows = (
        (json.dumps([{"timestamp_ns": timestamp_ns, **_pose(world_from_ego)}]), (files.poses,)),
        (json.dumps(boxes), (files.annotations,)),
    )
    return FrameAnnotation(image, n_lanes, files=own, shared=rows)


def document(path: str, lines: Path) -> Iterator[bytes]:
    """A table of a log from its rows, which are those of an instant in each line."""
    rows = [row for line in lines.read_text().splitlines() for row in json.loads(line)]
    schema = ANNOTATIONS if PurePath(path).stem == "annotations" else POSES
    yield _table(sorted(rows, key=lambda row: row["timestamp_ns"]), schema)


def ego_frame(frame: SampleFrame) -> Matrix4:
    """World from the vehicle frame, in which sensors keep their places through a clip."""
    mounted = frame.scene.camera
    return world_from_host(frame.labels.camera, mounted.right_m, mounted.forward_m) @ HOST_FROM_EGO


def _name(camera: CameraLabel, n_cameras: int, where: str) -> str:
    if not camera.lens.is_pinhole:
        raise InputError(f"{where}: expected a camera without distortion, got {camera.lens}")
    if camera.name in CAMERAS:
        return camera.name
    if n_cameras > 1:
        names = ", ".join(RING_CAMERAS)
        raise InputError(f"{where}: expected a rig with cameras of Argoverse 2 ({names}), got {camera.name}")
    return FRONT_CAMERA


def _sweep(frame: SampleFrame, ego_from_cam: Matrix4) -> bytes:
    """The points of the lidar, in the vehicle frame."""
    if frame.sweep is None:
        return _table([], POINTS)
    points = frame.sweep.points()
    xyz_ego, zeros = transform(ego_from_cam, points.xyz_cam), np.zeros(len(points.beam), int)
    columns = [*xyz_ego.T, zeros, points.beam, zeros]
    return _bytes(pa.table([pa.array(c).cast(t) for c, t in zip(columns, POINTS.types, strict=True)], schema=POINTS))


def _calibration(frame: SampleFrame, files: LogFiles, world_from_ego: Matrix4) -> dict[str, bytes]:
    ego_from_world, n_cameras = invert(world_from_ego), frame.scene.shot.n_cameras
    sensors, lenses = list[dict[str, Any]](), list[dict[str, Any]]()
    for key, camera in frame.cameras.items():
        name = _name(camera, n_cameras, f"{frame.split}:{key}")
        ego_from_cv = ego_from_world @ camera.world_from_cam
        ego_from_cv[:3, :3] = ego_from_cv[:3, :3] @ CV_FROM_CAM.T
        (fx, _, cx), (_, fy, cy), _ = camera.img_from_cam @ CV_FROM_CAM.T
        lens = {"fx_px": fx, "fy_px": fy, "cx_px": cx - HALF_PX, "cy_px": cy - HALF_PX}
        sensors.append({"sensor_name": name, **_pose(ego_from_cv)})
        size = {"height_px": camera.height_px, "width_px": camera.width_px}
        lenses.append({"sensor_name": name, **lens, **dict.fromkeys(("k1", "k2", "k3"), 0.0), **size})
    ego_from_lidar, labels = np.eye(4), frame.labels
    if labels.lidar is not None:
        ego_from_lidar = ego_from_world @ labels.camera.world_from_cam @ labels.lidar.cam_from_lidar @ _LIDAR_FROM_AV2
    sensors += ({"sensor_name": name, **_pose(ego_from_lidar)} for name in LIDARS)
    return {files.sensors: _table(sensors, SENSORS), files.intrinsics: _table(lenses, INTRINSICS)}


def _box(item: ObjectLabel, ego_from_cam: Matrix4, log: str, timestamp_ns: int) -> dict[str, Any]:
    """A row of the annotations. The box's own frame is x forward, y left, z up."""
    pose = ego_from_cam @ item.cam_from_object
    x, y, z = pose[:3, :3].T
    width_m, length_m, height_m = item.size_m.tolist()
    return {
        "timestamp_ns": timestamp_ns,
        "track_uuid": str(uuid.uuid5(uuid.NAMESPACE_OID, f"{log}/{item.id}")),
        "category": CATEGORIES[item.category],
        "length_m": length_m,
        "width_m": width_m,
        "height_m": height_m,
        **_pose(from_axes(y, -x, z, pose[:3, 3])),
        "num_interior_pts": item.lidar_points or 0,
    }


_LIDAR_FROM_AV2 = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def _pose(pose: Float[np.ndarray, "4 4"]) -> dict[str, float]:
    wxyz = quaternion(pose[:3, :3]).tolist()
    return dict(zip(("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"), [*wxyz, *pose[:3, 3].tolist()], strict=True))


def _table(rows: Sequence[Mapping[str, Any]], schema: pa.Schema) -> bytes:
    return _bytes(pa.Table.from_pylist(rows, schema=schema))


def _bytes(table: pa.Table) -> bytes:
    stream = io.BytesIO()
    feather.write_feather(table, stream)
    return stream.getvalue()
