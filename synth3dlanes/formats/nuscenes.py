"""nuScenes (v1.0) with its map expansion: for each picture its image and lines, of which `nuscenes_tables` makes rows,
for each instant a sweep, and with the first picture of a scene its map.

| theirs | ours | unit, frame |
|---|---|---|
| `scene`, `sample`, `sample_data` | scenes, frames of their clips, pictures and sweeps | |
| `ego_pose` | the host: global from `_ego` | m |
| `calibrated_sensor` | cameras (OpenCV's axes) and lidar in `_ego`; K, pixels from the middle of the first | m, px |
| `sample_annotation` | objects: box, level of visibility, points of the lidar, attribute by speed | m, global |
| layers of the map, `arcline_path_3`, `connectivity` | see `nuscenes_maps` | m, global from above |

Vehicle frame (`_ego`): x forward, y left, z up, its origin on the road below the rear axle. Cameras have OpenCV's axes,
the lidar ours; pixels count from the middle of the first one. The level frame of a scene is the vehicle frame of its
first sample, turned so that it has its heading in the world: its plane is the road plane there.
"""

import json
import struct
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from synth3dlanes.formats.comparing import (
    FROM_MIDDLE,
    Comparison,
    FoundBox,
    Gap,
    SourceSample,
    compare_boxes,
    compare_pinhole,
    compare_sweep,
)
from synth3dlanes.formats.format import FrameList, ReadFrame, SampleFormat, SampleFrame
from synth3dlanes.formats.nuscenes_maps import (
    CATEGORIES,
    MAP_FILE,
    PATHS,
    POSE_FIELDS,
    RULE,
    TOKENS,
    PlaceMap,
    compare_place,
    map_layers,
    records,
)
from synth3dlanes.formats.nuscenes_tables import (
    BOXES,
    LIDAR,
    LOCATIONS,
    MASK_M,
    MASK_PX_PER_M,
    MASKS,
    MORE_SCENES,
    PNG_HEAD,
    VERSIONS,
    document,
    map_file,
    mask_file,
    points_of,
    pose_record,
    table_file,
    visibility_of,
)
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
from synth3dlanes.geometry.frames import invert, transform, turned
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import Row3
from synth3dlanes.system.schema import PathBelow, validation_problems
from synth3dlanes.world.motion import host_driven
from synth3dlanes.world.world import resolve

FRONT_CAMERA = "CAM_FRONT"
REAR_M = 1.4
"""Distance of the rear axle behind our host's middle, as in the rig nuscenes."""
MOVING_M_S = 0.2
TABLES: dict[str, dict[str, Any]] = {
    "scene": {"log_token": str, "first_sample_token": str},
    "sample": {"scene_token": str, "timestamp": int},
    "sample_data": {
        "sample_token": str, "ego_pose_token": str, "calibrated_sensor_token": str, "filename": PathBelow,
        "width": int, "height": int, "timestamp": int,
    },
    "ego_pose": POSE_FIELDS,
    "calibrated_sensor": {**POSE_FIELDS, "sensor_token": str, "camera_intrinsic": list[Row3]},
    "sensor": {"channel": str, "modality": str},
    "instance": {"category_token": str},
    "sample_annotation": {
        **POSE_FIELDS, "sample_token": str, "instance_token": str, "visibility_token": str, "attribute_tokens": TOKENS,
        "size": Row3, "num_lidar_pts": int,
    },
    "category": {"name": str},
    "attribute": {"name": str},
    "visibility": {},
    "log": {"logfile": str, "location": str},
    "map": {"filename": PathBelow},
}  # fmt: skip
"""What is read of the rows of each table, beside their tokens."""


def parked_of(scene: Scene, objects: Sequence[ObjectLabel]) -> set[int]:
    """The ids of parked cars, which stand beside their lanes. Cars come first among the objects."""
    return {item.id for item, car in zip(objects, scene.cars, strict=False) if car.offset_m and not car.track}


def attribute_of(item: ObjectLabel, is_parked: bool) -> str | None:
    """The attribute of an object by its speed; None where that is not known."""
    if item.velocity_cam is None:
        return None
    is_moving, class_ = np.linalg.norm(item.velocity_cam) > MOVING_M_S, CATEGORIES[item.category]
    if class_ in ("vehicle.bicycle", "vehicle.motorcycle"):
        return "cycle.with_rider"
    match class_.split(".")[0]:
        case "human":
            return "pedestrian.moving" if is_moving else "pedestrian.standing"
        case "vehicle":
            return "vehicle.moving" if is_moving else "vehicle.parked" if is_parked else "vehicle.stopped"
    return None


HOST_FROM_EGO = host_from_flu(REAR_M, 0.0)
EGO_FROM_LIDAR = np.array([[0.0, 1.0, 0.0, 0.94], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.84], [0.0, 0.0, 0.0, 1.0]])
"""The place of the original's lidar, which an empty sweep has too: tools measure from there."""
START_US, ROOM_US = 10**15, 4 * 10**6
"""The first timestamp, and how much later the next picture's scene begins at least."""
REACH_M = 150.0
"""Reach of a map ahead of and behind all places of the host in the clip."""

README = f"""nuScenes (v1.0) with its map expansion: a scene for each of ours, a sample for each frame of its clip.

- `v1.0-trainval` (and `v1.0-test`): the tables; `samples/CHANNEL/*`: images and sweeps; `maps/expansion/*.json` and
  `maps/*.png`: the maps and their masks. All samples are key frames; there are no sweeps between them and no radar.
- Scenes have the names of the original's train, val and test scenes, and the names of its four places, because tools
  tell parts and maps by these: train is in {" and ".join(LOCATIONS["train"])}, val in {LOCATIONS["val"][0]}, test in
  {LOCATIONS["test"][0]}. Nothing else is of these places. Scenes beyond the original's number (700, 150 and 150, less
  four that converters leave out) are named from scene-{MORE_SCENES["train"]} on: `splits.json` beside the tables lists
  all of a part under `synth3dlanes_train`, `synth3dlanes_val` and `synth3dlanes_test`.
- Vehicle frame: x forward, y left, z up, on the road below the rear axle, {REAR_M:g} m behind the middle of the host.
  Global frame: that of the vehicle at the first sample of a scene is level and at height 0, so the map's plane is the
  road plane there. Poses are 3D; the road leaves the plane where it bends up or down.
- Tools of map learners want the six cameras and `{LIDAR}`: generate with `--rig nuscenes`. One camera is
  `{FRONT_CAMERA}`. Without a lidar sweeps are empty, and `num_lidar_pts` is 1 for a box that a camera sees and 0 for
  others: tools leave out boxes without points.
- Boxes are those of all objects of the labels; barrels and barricades are barriers, a rider is what he rides.
  Attributes are by speed; single pictures have none.
- `visibility` is the greatest share that one camera sees.
"""


def write(frame: SampleFrame) -> FrameAnnotation:
    """The image of a picture and its lines; with the first of an instant also its sweep, with the first of a scene its
    map."""
    labels, shot, objects = frame.labels, frame.scene.shot, expect_objects(frame)
    expect_pinhole(labels.camera, frame.where)
    before = shot.frame * shot.n_cameras + shot.camera
    first, log = frame.number - before, f"{frame.split}-{int(frame.key) - before:08d}"
    time_us = START_US + first * ROOM_US + round(shot.time_s * 1e6)
    reach_m = REACH_M + host_driven(shot, shot.duration_s)
    world_from_ego = world_from_vehicle(labels.camera, frame.scene, HOST_FROM_EGO)
    ego_from_cam = invert(world_from_ego) @ labels.camera.world_from_cam

    def data(channel: str, ending: str, ego_from_sensor: Matrix4) -> dict[str, Any]:
        name = f"samples/{channel}/{log}__{channel}__{time_us}.{ending}"
        return {"channel": channel, "file": name, "pose": pose_record(ego_from_sensor)}

    camera = data(labels.camera.name or FRONT_CAMERA, frame.image_format, with_cv_axes(ego_from_cam))
    size_px = {"width": labels.camera.width_px, "height": labels.camera.height_px}
    camera |= {"camera_intrinsic": img_from_cv_centred(labels.camera).tolist(), **size_px}
    told = {"log": log, "frame": shot.frame, "time_us": time_us, "world_from_ego": world_from_ego.tolist()}
    sensors, files = [camera], dict[str, str | bytes]()
    if frame.cameras:
        lidar = labels.lidar
        ego_from_lidar = EGO_FROM_LIDAR if lidar is None else ego_from_cam @ lidar.cam_from_lidar
        sensors.append(data(LIDAR, "pcd.bin", ego_from_lidar))
        files[sensors[1]["file"]] = _sweep(frame)
    picture = {**told, "data": sensors}
    parked = parked_of(frame.scene, objects)
    boxes = [_box(item, item.id in parked, ego_from_cam if frame.cameras else None)
             for item in objects_of(labels, CATEGORIES)]  # fmt: skip
    versions = dict.fromkeys(VERSIONS[part] for part in frame.served)
    documents: list[tuple[dict[str, Any], list[str]]] = [
        (picture, [table_file(at, name) for at in versions for name in (*TABLES, "splits") if name not in BOXES]),
        (picture | {"boxes": boxes}, [table_file(at, name) for at in versions for name in BOXES]),
    ]
    n_lanes = 0
    if frame.is_first:
        layers = map_layers(resolve(frame.scene), labels.graph, log, world_from_ego, reach_m)
        n_lanes = len(layers[PATHS])
        documents.append((layers, [path(at) for at in LOCATIONS[frame.part] for path in (map_file, mask_file)]))
    head = f"{first} {frame.part} {reach_m:.1f}"
    shared = tuple((f"{head} {json.dumps(document)}", tuple(paths)) for document, paths in documents)
    return FrameAnnotation(camera["file"], n_lanes, files=files, shared=shared)


def _sweep(frame: SampleFrame) -> bytes:
    """Points in the lidar's frame: x, y, z, no intensity, the number of the beam."""
    if frame.sweep is None:
        return b""
    points = frame.sweep.points()
    columns = np.column_stack([points.xyz_lidar, np.zeros(len(points.beam)), points.beam])
    return columns.astype("<f4").tobytes()


def _box(item: ObjectLabel, is_parked: bool, ego_from_cam: Matrix4 | None) -> dict[str, Any]:
    """An object as a picture sees it; for the first of an instant with its box, whose frame is x forward, y left, z
    up."""
    seen = {"id": item.id, "visible": item.visible_fraction}
    if ego_from_cam is None:
        return seen
    return seen | {
        "category": CATEGORIES[item.category],
        "size": item.size_m.tolist(),
        "pose": pose_record(with_flu_axes(ego_from_cam @ item.cam_from_object)),
        "attribute": attribute_of(item, is_parked),
        "points": item.lidar_points,
    }


Row = Any
"""A row of a table, or a record of a layer of a map: an excerpt with what TABLES and LAYERS have of it."""


_READ = {name: TypeAdapter[Any](records(fields)) for name, fields in TABLES.items()}
_READ["splits"] = TypeAdapter(dict[str, list[str]])


def matrix_of(row: Row) -> Matrix4:
    """The pose of a row."""
    return pose_of(row.translation, row.rotation)


@dataclass(eq=False)
class Version:
    """The tables of a version below the folder of an export; a file is read when it is asked for. `anchors` are the
    global frames from the world by the first picture of each scene that was compared."""

    out: Path
    name: str
    anchors: dict[str, Matrix4] = field(default_factory=dict)
    _read: dict[str, Any] = field(default_factory=dict)

    def table(self, name: str) -> Any:
        """The rows of a table by their tokens; what is in `splits`."""
        if name not in self._read:
            found = _validated(_READ[name], self.out / table_file(self.name, name))
            self._read[name] = {row.token: row for row in found} if name in TABLES else found
        return self._read[name]

    def row(self, table: str, name: str) -> Row:
        """The row of a token. Raises FormatError where there is none."""
        if name not in self.table(table):
            path = self.out / table_file(self.name, table)
            raise FormatError(f"{path}: expected a row with the token {name[:40]}, got none")
        return self.table(table)[name]

    def map(self, location: str) -> PlaceMap:
        if location not in self._read:
            self._read[location] = PlaceMap(_validated(MAP_FILE, self.out / map_file(location)))
        found: PlaceMap = self._read[location]
        return found

    @cached_property
    def boxes(self) -> dict[str, list[Row]]:
        """The boxes of each sample."""
        found = defaultdict[str, list[Row]](list)
        for row in self.table("sample_annotation").values():
            found[row.sample_token].append(row)
        return found

    @cached_property
    def sensors(self) -> dict[str, dict[str, Row]]:
        """What each sample's sensors measured, by their channels."""
        found = defaultdict[str, dict[str, Row]](dict)
        for row in self.table("sample_data").values():
            calibrated = self.row("calibrated_sensor", row.calibrated_sensor_token)
            found[row.sample_token][self.row("sensor", calibrated.sensor_token).channel] = row
        return found

    def cameras(self, sample: str) -> list[tuple[str, Row]]:
        """The channels and pictures of a sample's cameras."""
        return [(channel, data) for channel, data in self.sensors.get(sample, {}).items() if channel != LIDAR]


@dataclass(frozen=True, eq=False)
class CameraPicture:
    """A camera's picture: the version, its row, its channel, and whether it is the first of its sample."""

    version: Version
    data: Row
    channel: str
    is_first: bool

    @property
    def scene(self) -> Row:
        return self.version.row("scene", self.version.row("sample", self.data.sample_token).scene_token)

    @property
    def log(self) -> Row:
        return self.version.row("log", self.scene.log_token)

    def calibrated(self, data: Row) -> Row:
        return self.version.row("calibrated_sensor", data.calibrated_sensor_token)

    def pose(self, data: Row) -> Matrix4:
        """The global frame from the vehicle as a sensor measured."""
        return matrix_of(self.version.row("ego_pose", data.ego_pose_token))


def _validated(adapter: Any, path: Path) -> Any:
    try:
        return adapter.validate_json(read_file(path), strict=True)
    except ValidationError as error:
        raise FormatError("\n".join(validation_problems(error, str(path)))) from None


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    for name in dict.fromkeys(VERSIONS.values()):
        if (out / name).is_dir():
            yield FrameList(name, _frames(Version(out, name), most_frames), "picture")


def _frames(version: Version, most: int) -> Iterator[ReadFrame]:
    _read_others(version)
    pictures = (
        CameraPicture(version, data, channel, i == 0)
        for sample in sorted(version.table("sample").values(), key=lambda sample: sample.timestamp)
        for i, (channel, data) in enumerate(version.cameras(sample.token))
    )
    for picture in islice(pictures, most):
        file = picture.data.filename
        yield ReadFrame(file, str(version.out / file), file, picture)


def _read_others(version: Version) -> None:
    """Read the files that no picture is compared with. Raises FormatError where they are not as tools expect."""
    for name in ("category", "attribute", "visibility", "splits"):
        version.table(name)
    files = [row.filename for row in version.table("map").values()]
    if sorted(files) != sorted(map(mask_file, MASKS)):
        path = version.out / table_file(version.name, "map")
        raise FormatError(f"{path}: expected the masks of all places, got {files}")
    for place in MASKS:
        path, canvas_m = version.out / mask_file(place), version.map(place).layers.canvas_edge
        # Pillow takes an image of this size for an attack.
        head, size_px = read_file(path)[:24], [round(MASK_PX_PER_M * edge) for edge in canvas_m]
        is_whole = head[16:] == struct.pack(">II", *size_px)
        if head[:16] != PNG_HEAD + b"\0\0\0\rIHDR" or not (is_whole or max(canvas_m) > MASK_M):
            raise FormatError(f"{path}: expected a PNG of {size_px[0]}x{size_px[1]} as its map says, got another file")


LIMIT_PX, POINT_M, POSE_M, LEVEL_TOLERANCE = 0.02, 0.001, 0.001, 1e-6
EGO_FROM_HOST = np.array([[0, 1.0, 0, REAR_M], [-1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])
CV_FROM_OURS = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """The camera and the pose of every picture; of a sample the boxes, the sweep and the map."""
    picture: CameraPicture = frame.content
    global_from_ego = picture.pose(picture.data)
    global_from_cam = global_from_ego @ matrix_of(picture.calibrated(picture.data)) @ CV_FROM_OURS
    compared = _camera(picture, truth) + _pose(picture, global_from_ego, global_from_cam, truth)
    if not picture.is_first or compared.problems:
        return compared
    compared += _boxes(picture, global_from_cam, truth) + _compared_sweep(picture, global_from_cam, truth)
    location, version = picture.log.location, picture.version
    where = str(version.out / map_file(location))
    return compared + compare_place(version.map(location), picture.log.logfile, where, global_from_cam, truth)


def _camera(picture: CameraPicture, truth: SourceSample) -> Comparison:
    """How far places that a camera sees are from their pixels, by its place on the vehicle."""
    camera, mounted, data = truth.labels.camera, truth.scene.camera, picture.data
    calibrated = picture.calibrated(data)
    if len(calibrated.camera_intrinsic) != 3:
        return Comparison(problems=(f"camera {picture.channel}: expected a matrix, got none",))
    host_from_cam = turned(0.0, mounted.right_m, mounted.forward_m) @ camera.road_from_cam
    cv_from_cam = invert(matrix_of(calibrated)) @ EGO_FROM_HOST @ host_from_cam
    k, size_px = np.array(calibrated.camera_intrinsic) + FROM_MIDDLE, (data.width, data.height)
    return compare_pinhole(picture.channel, camera, k, cv_from_cam, LIMIT_PX, size_px)


def _pose(
    picture: CameraPicture, global_from_ego: Matrix4, global_from_cam: Matrix4, truth: SourceSample
) -> Comparison:
    """How far places are from where the first picture of the scene has them; the first vehicle must be level."""
    global_from_world = global_from_cam @ invert(truth.labels.camera.world_from_cam)
    anchor = picture.version.anchors.setdefault(picture.scene.token, global_from_world)
    around = truth.labels.camera.world_from_cam[:3, 3] + 50 * np.eye(3)
    apart = np.linalg.norm(transform(global_from_world, around) - transform(anchor, around), axis=1)
    compared = Comparison.within([Gap.of("the vehicle", "m", apart, "pose")], {"m": POSE_M})
    is_level = np.abs([*(global_from_ego[:3, 2] - [0, 0, 1]), global_from_ego[2, 3]]).max() < LEVEL_TOLERANCE
    if picture.data.sample_token == picture.scene.first_sample_token and not is_level:
        return compared.because(["expected the first vehicle of the scene level and at height 0, got another pose"])
    return compared


def _boxes(picture: CameraPicture, global_from_cam: Matrix4, truth: SourceSample) -> Comparison:
    """Corners of boxes in metres, their class, attribute, visibility, points and track."""
    version, seen = picture.version, _seen(picture, truth)
    rows, parked = version.boxes.get(picture.data.sample_token, []), parked_of(truth.scene, truth.labels.objects or ())

    def expected(item: ObjectLabel) -> dict[str, object]:
        return {
            "class": CATEGORIES[item.category],
            "attribute": attribute_of(item, item.id in parked),
            "level of visibility": visibility_of(seen[item.id]),
            "number of points": points_of(item.lidar_points, seen[item.id]),
        }

    # Sizes are width, length and height.
    boxes = (
        FoundBox(row.instance_token, matrix_of(row), np.array(row.size)[[1, 0, 2]], _told(version, row)) for row in rows
    )
    items, log = objects_of(truth.labels, CATEGORIES), picture.log.logfile
    return compare_boxes(boxes, items, expected, invert(global_from_cam), log)


def _told(version: Version, row: Row) -> dict[str, object]:
    """What else a box says beside its place and size."""
    category = version.row("instance", row.instance_token).category_token
    attributes = [version.row("attribute", name).name for name in row.attribute_tokens]
    return {
        "class": version.row("category", category).name,
        "attribute": ", ".join(attributes) or None,
        "level of visibility": row.visibility_token,
        "number of points": row.num_lidar_pts,
    }


def _seen(picture: CameraPicture, truth: SourceSample) -> dict[int, Any]:
    """The greatest share of each object that a camera of the sample sees, None where nothing is known of it."""
    channels, found = picture.version.sensors[picture.data.sample_token], dict[int, Any]()
    for other in truth.moment:
        if (other.labels.camera.name or FRONT_CAMERA) in channels:
            for item in other.labels.objects or ():
                shares = (item.visible_fraction, found.get(item.id))
                found[item.id] = max((share for share in shares if share is not None), default=None)
    return found


def _compared_sweep(picture: CameraPicture, global_from_cam: Matrix4, truth: SourceSample) -> Comparison:
    """How far points of the lidar are from those of our sweep."""
    data = picture.version.sensors[picture.data.sample_token].get(LIDAR)
    if data is None:
        return Comparison(problems=(f"expected a sweep of {LIDAR}, got none",))
    path, numbers = picture.version.out / data.filename, read_file(picture.version.out / data.filename)
    if len(numbers) % 20:
        raise FormatError(f"{path}: expected points of five numbers of 4 bytes, got {len(numbers)} bytes")
    found = np.frombuffer(numbers, "<f4").reshape(-1, 5).astype(float)
    cam_from_lidar = invert(global_from_cam) @ picture.pose(data) @ matrix_of(picture.calibrated(data))
    compared = compare_sweep(transform(cam_from_lidar, found[:, :3]), truth, POINT_M)
    is_other = bool(compared.gaps and truth.sweep is not None and (found[:, 4] != truth.sweep.points().beam).any())
    return compared.because(["expected the beams of our sweep, got others"] if is_other else [])


FORMAT = SampleFormat(
    title="nuScenes with its map expansion: cameras, lidar, boxes and maps",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit, "px": LIMIT_PX},
    lists=tuple(path(place) for places in LOCATIONS.values() for place in places for path in (map_file, mask_file)),
    document=document,
    takes_sweeps=True,
    counted="lanes",
)
