"""Argoverse 2's sensor data set: for each picture its image, for each instant a sweep and rows of the log's tables, and
with the first picture of a log its calibration and its map.

| theirs | ours | unit, frame |
|---|---|---|
| `annotations` | all objects of the labels, with the points of the lidar on them | m, `_ego` |
| `city_SE3_egovehicle` | world from vehicle at each instant | m |
| `calibration/*` | cameras (OpenCV's axes) and lidar in `_ego`; K, pixels from the middle of the first | m, px |
| `sensors/lidar/*` | points of the sweep, with the number of their beam | m, `_ego` |
| `map/*` | see `argoverse2_maps` | m, city |

The vehicle frame (`_ego`) is x forward, y left, z up, its origin in the middle of the rear axle; the city frame is our
world frame.
"""

import io
import json
import re
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float
from pyarrow import feather

from synth3dlanes.formats.argoverse2_maps import PIECE_M, RULE, LogMap, compare_log_map, map_files, read_map
from synth3dlanes.formats.comparing import (
    FROM_MIDDLE,
    Comparison,
    FoundBox,
    SourceSample,
    compare_boxes,
    compare_pinhole,
    compare_sweep,
)
from synth3dlanes.formats.format import FrameList, ReadFrame, SampleFormat, SampleFrame, of_parts
from synth3dlanes.formats.reading import pose_of, read_file
from synth3dlanes.formats.writing import (
    FrameAnnotation,
    expect_objects,
    expect_pinhole,
    host_from_flu,
    img_from_cv_centred,
    objects_of,
    with_cv_axes,
    with_flu_axes,
    world_from_vehicle,
)
from synth3dlanes.geometry.frames import invert, quaternion, transform
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.scene.things import classes_in
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.columnar import TableBounds, read_arrow, reading_table
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.world.world import resolve

FRONT_CAMERA = "ring_front_center"
RING_CAMERAS = (
    FRONT_CAMERA, "ring_front_left", "ring_front_right", "ring_rear_left", "ring_rear_right", "ring_side_left",
    "ring_side_right",
)  # fmt: skip
CAMERAS = (*RING_CAMERAS, "stereo_front_left", "stereo_front_right")
LIDARS = ("up_lidar", "down_lidar")
"""The original has two on top of each other; readers want a pose of each."""
REAR_M, AXLE_M = 1.3, 0.3
"""Where the rear axle is, behind the middle of our host and over the road, as in the rig argoverse2."""
HOST_FROM_EGO = host_from_flu(REAR_M, AXLE_M)
_LIDAR_FROM_AV2 = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
CATEGORIES = classes_in("argoverse2")
START_NS, ROOM_NS = 10**18, 4 * 10**9
"""The first timestamp of an export, and how much later the next picture's log begins at least: tools name frames by
timestamps alone, which must differ between logs and have equal numbers of digits."""
CITY = "SYN"
POSE = {name: pa.float64() for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")}
ANNOTATIONS = pa.schema(
    {
        "timestamp_ns": pa.int64(), "track_uuid": pa.string(), "category": pa.string(), "length_m": pa.float64(),
        "width_m": pa.float64(), "height_m": pa.float64(), **POSE, "num_interior_pts": pa.int64(),
    }
)  # fmt: skip
POSES = pa.schema({"timestamp_ns": pa.int64(), **POSE})
SENSORS = pa.schema({"sensor_name": pa.string(), **POSE})
INTRINSICS = pa.schema(
    {
        "sensor_name": pa.string(), **{name: pa.float64() for name in ("fx_px", "fy_px", "cx_px", "cy_px")},
        **{name: pa.float64() for name in ("k1", "k2", "k3")}, "height_px": pa.uint16(), "width_px": pa.uint16(),
    }
)  # fmt: skip
POINTS = pa.schema(
    {
        **{name: pa.float32() for name in "xyz"}, "intensity": pa.uint8(), "laser_number": pa.uint8(),
        "offset_ns": pa.int32(),
    }
)  # fmt: skip
# A point takes 24 bytes, a box 130; files with boxes have few rows.
BOUNDS = TableBounds(most_rows=1 << 23, row_bytes=128, base_bytes=16 << 20)
IMAGE = re.compile(r"(?P<timestamp>\d{1,19})\.jpg")
Columns = dict[str, np.ndarray]
# Labels of boxes and points are rounded.
LIMIT_PX, POINT_M = 0.02, 0.001

README = f"""Argoverse 2's sensor data set: a log for each scene, its frames those of the clip.

- `{{train,val,test}}/LOG/sensors/cameras/CAMERA/TIMESTAMP.jpg`, `sensors/lidar/TIMESTAMP.feather`,
  `annotations.feather`, `city_SE3_egovehicle.feather`, `calibration/*.feather`, `map/*`. Timestamps (ns) differ between
  logs too. Tools of map learners drop frames without one of the seven cameras `ring_*`: generate with
  `--rig argoverse2`. A camera without such a rig is `{FRONT_CAMERA}`.
- Vehicle frame: x forward, y left, z up, from the rear axle, {REAR_M:g} m behind the middle of the host
  and {AXLE_M:g} m over the road. City frame: the scene's world. Pixels count from the middle of the first
  one. All sensors of an instant measure at once, so `offset_ns` is 0. There is no intensity.
- Without a lidar, sweeps have no points: tools step through their timestamps. One lidar is both `up_lidar` and
  `down_lidar`; points have 4 bytes a coordinate, where the original has 2.
- Boxes are those of all objects of the labels but barricades, which it has no class for, seen or not, with the points
  of the sweep on them. A rider and what is ridden are one box, of the rider's class. The API's evaluation leaves out
  those without points from the truth, but not from detections, where a found one is a false alarm: without a lidar
  nothing is left of the truth. Take detections without points out as well, or those that are far away.
- Lane segments are those of the lane graph, cut into pieces of at most {PIECE_M:g} m: ids count the segment from 1 and
  its pieces from 0, as 2003. Boundaries are half a lane's width beside the middle; their mark type is the paint along
  most of the segment. An oncoming lane across one line is a neighbour.
"""


@dataclass(frozen=True)
class LogFiles:
    """The paths of a log's files in an export."""

    part: str
    log: str

    def __str__(self) -> str:
        return f"{self.part}/{self.log}"

    @property
    def annotations(self) -> str:
        return f"{self}/annotations.feather"

    @property
    def poses(self) -> str:
        """City from vehicle at all instants."""
        return f"{self}/city_SE3_egovehicle.feather"

    @property
    def sensors(self) -> str:
        """Vehicle from sensors."""
        return f"{self}/calibration/egovehicle_SE3_sensor.feather"

    @property
    def intrinsics(self) -> str:
        return f"{self}/calibration/intrinsics.feather"

    @property
    def map(self) -> tuple[str, str, str]:
        """Lanes, areas and crossings; heights of the ground by cells; which cell a place is in."""
        return (
            f"{self}/map/log_map_archive_{self.log}____{CITY}_city_0.json",
            f"{self}/map/{self.log}_ground_height_surface____{CITY}.npy",
            f"{self}/map/{self.log}___img_Sim2_city.json",
        )

    def image(self, camera: str, timestamp_ns: int) -> str:
        return f"{self}/sensors/cameras/{camera}/{timestamp_ns}.jpg"

    def sweep(self, timestamp_ns: int) -> str:
        """The points of the lidar at an instant."""
        return f"{self}/sensors/lidar/{timestamp_ns}.feather"


def log_name(first: int) -> str:
    """The log whose first picture has this number in the export."""
    return f"{first:09d}"


def write(frame: SampleFrame) -> FrameAnnotation:
    """The files of a picture; with the first of an instant also its sweep and rows, with the first of a log its
    calibration and map."""
    labels, shot = frame.labels, frame.scene.shot
    expect_objects(frame)
    name = _name(labels.camera, shot.n_cameras, frame.where)
    first = frame.number - shot.frame * shot.n_cameras - shot.camera
    files = LogFiles(frame.part, log_name(first))
    timestamp_ns = START_NS + first * ROOM_NS + round(shot.time_s * 1e9)
    image = files.image(name, timestamp_ns)
    if not frame.cameras:
        return FrameAnnotation(image, 0)
    world_from_ego = world_from_vehicle(labels.camera, frame.scene, HOST_FROM_EGO)
    ego_from_cam = invert(world_from_ego) @ labels.camera.world_from_cam
    own: dict[str, str | bytes] = {files.sweep(timestamp_ns): _sweep(frame, ego_from_cam)}
    n_lanes = 0
    if frame.is_first:
        own |= _calibration(frame, files, world_from_ego)
        mapped, n_lanes = map_files(resolve(frame.scene), labels.graph)
        own |= dict(zip(files.map, mapped, strict=True))
    boxes = [_box(item, ego_from_cam, files.log, timestamp_ns) for item in objects_of(labels, CATEGORIES)]
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


def _name(camera: CameraLabel, n_cameras: int, where: str) -> str:
    expect_pinhole(camera, where)
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
        (fx, _, cx), (_, fy, cy), _ = img_from_cv_centred(camera)
        lens = {"fx_px": fx, "fy_px": fy, "cx_px": cx, "cy_px": cy}
        sensors.append({"sensor_name": name, **_pose(with_cv_axes(ego_from_world @ camera.world_from_cam))})
        size = {"height_px": camera.height_px, "width_px": camera.width_px}
        lenses.append({"sensor_name": name, **lens, **dict.fromkeys(("k1", "k2", "k3"), 0.0), **size})
    ego_from_lidar, labels = np.eye(4), frame.labels
    if labels.lidar is not None:
        ego_from_lidar = ego_from_world @ labels.camera.world_from_cam @ labels.lidar.cam_from_lidar @ _LIDAR_FROM_AV2
    sensors += ({"sensor_name": name, **_pose(ego_from_lidar)} for name in LIDARS)
    return {files.sensors: _table(sensors, SENSORS), files.intrinsics: _table(lenses, INTRINSICS)}


def _box(item: ObjectLabel, ego_from_cam: Matrix4, log: str, timestamp_ns: int) -> dict[str, Any]:
    """A row of the annotations. The box's own frame is x forward, y left, z up."""
    width_m, length_m, height_m = item.size_m.tolist()
    return {
        "timestamp_ns": timestamp_ns,
        "track_uuid": str(uuid.uuid5(uuid.NAMESPACE_OID, f"{log}/{item.id}")),
        "category": CATEGORIES[item.category],
        "length_m": length_m,
        "width_m": width_m,
        "height_m": height_m,
        **_pose(with_flu_axes(ego_from_cam @ item.cam_from_object)),
        "num_interior_pts": item.lidar_points or 0,
    }


def _pose(pose: Float[np.ndarray, "4 4"]) -> dict[str, float]:
    wxyz = quaternion(pose[:3, :3]).tolist()
    return dict(zip(("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"), [*wxyz, *pose[:3, 3].tolist()], strict=True))


def _table(rows: Sequence[Mapping[str, Any]], schema: pa.Schema) -> bytes:
    return _bytes(pa.Table.from_pylist(rows, schema=schema))


def _bytes(table: pa.Table) -> bytes:
    stream = io.BytesIO()
    feather.write_feather(table, stream)
    return stream.getvalue()


@dataclass(frozen=True, eq=False)
class Log:
    """A log below the folder of an export; its files are read when they are asked for."""

    out: Path
    files: LogFiles

    @cached_property
    def annotations(self) -> Columns:
        """Boxes at all instants, in the vehicle frame."""
        return self._table(self.files.annotations, ANNOTATIONS)

    @cached_property
    def poses(self) -> dict[int, Float[np.ndarray, "4 4"]]:
        """City from vehicle by timestamp."""
        table = self._table(self.files.poses, POSES)
        return dict(zip(table["timestamp_ns"].tolist(), matrices(table), strict=True))

    @cached_property
    def sensors(self) -> dict[str, Float[np.ndarray, "4 4"]]:
        """Vehicle from sensor by name."""
        table = self._table(self.files.sensors, SENSORS)
        return dict(zip(table["sensor_name"].tolist(), matrices(table), strict=True))

    @cached_property
    def lenses(self) -> dict[str, tuple[Float[np.ndarray, "3 3"], tuple[int, int]]]:
        """Matrix K, and width and height of the image, by camera."""
        table = self._table(self.files.intrinsics, INTRINSICS)
        found = {}
        for i, name in enumerate(table["sensor_name"].tolist()):
            fx, fy, cx, cy = (float(table[key][i]) for key in ("fx_px", "fy_px", "cx_px", "cy_px"))
            size = int(table["width_px"][i]), int(table["height_px"][i])
            found[name] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), size
        return found

    def sweep(self, timestamp_ns: int) -> Float[np.ndarray, "n 3"]:
        """Points of the lidar, in the vehicle frame."""
        table = self._table(self.files.sweep(timestamp_ns), POINTS)
        return np.column_stack([table[axis] for axis in "xyz"]).astype(float)

    @cached_property
    def map(self) -> LogMap:
        return read_map(*(self.out / path for path in self.files.map))

    def _table(self, path: str, wanted: pa.Schema) -> Columns:
        where = self.out / path
        data = read_file(where)
        with reading_table(str(where), wanted.names):
            table = read_arrow(data, str(where), BOUNDS, wanted.names).cast(wanted)
            if any(column.null_count for column in table.columns):
                raise ValueError("missing values")
            return {name: table[name].to_numpy() for name in wanted.names}


def matrices(table: Columns) -> Float[np.ndarray, "n 4 4"]:
    """Poses of a table's rows."""
    wxyz = np.column_stack([table[key] for key in ("qw", "qx", "qy", "qz")])
    places = np.column_stack([table[key] for key in ("tx_m", "ty_m", "tz_m")])
    return np.array([pose_of(*row) for row in zip(places, wxyz, strict=True)]).reshape(-1, 4, 4)


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    return of_parts(out, "picture", lambda part: _frames(out, part, most_frames))


def _frames(out: Path, part: str, most: int) -> Iterator[ReadFrame]:
    for folder in sorted(path for path in (out / part).iterdir() if path.is_dir()):
        log = Log(out, LogFiles(part, folder.name))
        found = [(int(match["timestamp"]), path) for path in folder.glob("sensors/cameras/*/*")
                 if (match := IMAGE.fullmatch(path.name))]  # fmt: skip
        cameras = list(log.lenses)
        for timestamp_ns, path in sorted(found, key=lambda pair: (pair[0], pair[1].parent.name)):
            if most == 0:
                return
            most -= 1
            camera = path.parent.name
            if camera not in log.lenses or camera not in log.sensors:
                raise FormatError(f"{out / log.files.intrinsics}: expected a row of {camera}, got none")
            name = str(path.relative_to(out))
            yield ReadFrame(name, str(path), name, (log, camera, timestamp_ns, camera == cameras[0]))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """The camera of every picture; of an instant the boxes, the sweep and the map."""
    log, camera, timestamp_ns, is_first = frame.content
    if timestamp_ns not in log.poses:
        raise FormatError(f"{log.out / log.files.poses}: expected a pose at {timestamp_ns}, got none")
    cam_from_ego = invert(truth.labels.camera.world_from_cam) @ log.poses[timestamp_ns]
    compared = _camera(log, camera, cam_from_ego, truth.labels.camera)
    if not is_first:
        return compared
    compared += _boxes(log, timestamp_ns, cam_from_ego, truth) + _lidar(log, timestamp_ns, cam_from_ego, truth)
    return compared + compare_log_map(log.map, truth)


def _camera(log: Log, name: str, cam_from_ego: Matrix4, camera: CameraLabel) -> Comparison:
    """How far places that a camera sees are from their pixels."""
    k, size_px = log.lenses[name]
    cv_from_cam = invert(cam_from_ego @ log.sensors[name])
    return compare_pinhole(name, camera, k + FROM_MIDDLE, cv_from_cam, LIMIT_PX, size_px)


def _boxes(log: Log, timestamp_ns: int, cam_from_ego: Matrix4, truth: SourceSample) -> Comparison:
    """Corners of boxes in metres, their class, points and track."""
    every = log.annotations
    table = {key: values[every["timestamp_ns"] == timestamp_ns] for key, values in every.items()}
    sizes_m = np.column_stack([table[key] for key in ("length_m", "width_m", "height_m")])
    told = ({"class": category, "number of points": points}
            for category, points in zip(table["category"], table["num_interior_pts"], strict=True))  # fmt: skip
    return compare_boxes(
        map(FoundBox, map(str, table["track_uuid"]), matrices(table), sizes_m, told),
        objects_of(truth.labels, CATEGORIES),
        lambda item: {"class": CATEGORIES[item.category], "number of points": item.lidar_points or 0},
        cam_from_ego,
        str(log.files),
    )


def _lidar(log: Log, timestamp_ns: int, cam_from_ego: Matrix4, truth: SourceSample) -> Comparison:
    """Points of the lidar beside those of our sweep, and its place."""
    compared = compare_sweep(transform(cam_from_ego, log.sweep(timestamp_ns)), truth, POINT_M)
    lidar = truth.labels.lidar
    if not compared.gaps or lidar is None:
        return compared
    place = (cam_from_ego @ log.sensors["up_lidar"])[:3, 3] if "up_lidar" in log.sensors else np.full(3, np.nan)
    off_m = float(np.linalg.norm(place - lidar.cam_from_lidar[:3, 3]))
    problems = [] if off_m <= POINT_M else [f"expected the lidar at its place, got it {off_m:.3g} m off"]
    return compared.because(problems)


FORMAT = SampleFormat(
    title="Argoverse 2: cameras, lidar, boxes and the map of a log",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit, "px": LIMIT_PX},
    links={"val": "test", "test": "val"},
    document=document,
    takes_sweeps=True,
    counted="lane segments",
)
