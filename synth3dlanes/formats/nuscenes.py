"""nuScenes (v1.0) with its map expansion: for each picture its image and lines of which rows are made, for each instant
a sweep, and with the first picture of a scene its map.

| theirs | ours | unit, frame |
|---|---|---|
| `scene`, `sample`, `sample_data` | scenes, frames of their clips, pictures and sweeps | |
| `ego_pose` | the host: global from `_ego` | m |
| `calibrated_sensor` | cameras (OpenCV's axes) and lidar in `_ego`; K, pixels from the middle of the first | m, px |
| `sample_annotation` | objects: box, level of visibility, points of the lidar, attribute by speed | m, global |
| layers of the map, `arcline_path_3`, `connectivity` | see `nuscenes_maps` | m, global from above |

A line has the number of the scene's first picture, its part, the reach of its map, and a document.

Vehicle frame (`_ego`): x forward, y left, z up, its origin on the road below the rear axle. Cameras have OpenCV's axes,
the lidar ours; pixels count from the middle of the first one. The level frame of a scene is the vehicle frame of its
first sample, turned so that it has its heading in the world: its plane is the road plane there. In the global frame the
scenes of a place lie beside each other, their level frames in the middles of cells.
"""

import json
import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby, islice, pairwise
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw
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
    LAYERS,
    LINKS,
    MAP_FILE,
    PATHS,
    POSE_FIELDS,
    RULE,
    TOKENS,
    PlaceMap,
    compare_place,
    level_from_world,
    map_layers,
    records,
    token,
)
from synth3dlanes.formats.reading import pose_of, read_file
from synth3dlanes.formats.writing import (
    PARTS,
    FrameAnnotation,
    Part,
    expect_objects,
    expect_pinhole,
    img_from_cv_centred,
    objects_of,
    with_cv_axes,
    with_flu_axes,
    world_from_vehicle,
)
from synth3dlanes.geometry.frames import invert, quaternion, transform, turned
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.roads.network import SEARCH_RATIO
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import Row3
from synth3dlanes.system.schema import PathBelow, validation_problems
from synth3dlanes.world.motion import host_driven
from synth3dlanes.world.world import resolve

FRONT_CAMERA, LIDAR = "CAM_FRONT", "LIDAR_TOP"
REAR_M = 1.4
"""Distance of the rear axle behind our host's middle, as in the rig nuscenes."""
MOVING_M_S = 0.2
VISIBLE = (0.4, 0.6, 0.8)
"""Shares from which the levels of visibility 2, 3 and 4 begin."""
VERSIONS: dict[Part, str] = {"train": "v1.0-trainval", "val": "v1.0-trainval", "test": "v1.0-test"}
LOCATIONS: dict[Part, tuple[str, ...]] = {
    "train": ("boston-seaport", "singapore-onenorth"),
    "val": ("singapore-queenstown",),
    "test": ("singapore-hollandvillage",),
}
MASKS = {
    "boston-seaport": "36092f0b03a857c6a3403e25b4b7aab3",
    "singapore-onenorth": "53992ee3023e5494b90c316c183be829",
    "singapore-queenstown": "93406b464a165eaba6d9de76ca09f5da",
    "singapore-hollandvillage": "37819e65e09e5547b8a3ceaefba56bb2",
}
"""The files of masks that the devkit looks for by the name of a place."""
MASK_PX_PER_M, MASK_M = 10, 3000.0
"""The devkit's resolution, and the reach of masks, which is the original's."""
BOXES = "instance", "sample_annotation"
"""Tables of boxes; all others are made of the pictures."""
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


def table_file(version: str, name: str) -> str:
    """The path of a table, or of the list `splits` beside the tables."""
    return f"{version}/{name}.json"


def map_file(location: str) -> str:
    """The path of the map of a place."""
    return f"maps/expansion/{location}.json"


def mask_file(location: str) -> str:
    """The path of the mask of a place."""
    return f"maps/{MASKS[location]}.png"


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


def visibility_of(share: float | None) -> str:
    """The level of visibility of what is seen to a share; none where nothing is known of it."""
    return "" if share is None else str(1 + sum(share >= least for least in VISIBLE))


def points_of(points: int | None, share: float | None) -> int:
    """The points of the lidar on an object; without a lidar, one that keeps it in tools' lists if a camera sees it."""
    return int(bool(share)) if points is None else points


HOST_FROM_EGO = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, -REAR_M], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
EGO_FROM_LIDAR = np.array([[0.0, 1.0, 0.0, 0.94], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.84], [0.0, 0.0, 0.0, 1.0]])
"""The place of the original's lidar, which an empty sweep has too: tools measure from there."""
START_US, ROOM_US = 10**15, 4 * 10**6
"""The first timestamp, and how much later the next picture's scene begins at least."""
DATE = "2001-09-09"
CLASSES = (
    "animal", "human.pedestrian.adult", "human.pedestrian.child", "human.pedestrian.construction_worker",
    "human.pedestrian.personal_mobility", "human.pedestrian.police_officer", "human.pedestrian.stroller",
    "human.pedestrian.wheelchair", "movable_object.barrier", "movable_object.debris",
    "movable_object.pushable_pullable", "movable_object.trafficcone", "static_object.bicycle_rack", "vehicle.bicycle",
    "vehicle.bus.bendy", "vehicle.bus.rigid", "vehicle.car", "vehicle.construction", "vehicle.emergency.ambulance",
    "vehicle.emergency.police", "vehicle.motorcycle", "vehicle.trailer", "vehicle.truck",
)  # fmt: skip
"""All classes of the original, numbered from 1."""
ATTRIBUTES = (
    "vehicle.moving", "vehicle.stopped", "vehicle.parked", "cycle.with_rider", "pedestrian.moving",
    "pedestrian.standing",
)  # fmt: skip
SCENES: dict[Part, str] = {
    "train": "1-2 4-11 19-34 41-76 120-135 138-139 149-152 154-155 157-168 170-185 187-188 190-196 199-200 202-204 "
    "206-214 218-220 222 224-264 283-306 315-318 321 323-324 328 347-386 388-403 405-408 410-459 461-465 467-469 "
    "471-472 474-480 500-501 504-514 518 525-539 541-546 566 568 570-578 580 582-600 639-679 681 683-689 695-698 "
    "700-701 703-719 726-728 730-731 733-741 744 746-747 749-752 757-765 767-769 786-787 789-792 803-806 808-813 "
    "815-817 819-822 847-856 858 860-866 868-873 875-878 880 882-903 945 947 949 952-953 955-961 975-984 988-992 "
    "994-1025 1044-1058 1074-1102 1104-1110",
    "val": "3 12-18 35-36 38-39 92-110 221 268-278 329-332 344-346 519-524 552-565 625-627 629-630 632-638 770-771 "
    "775 777-778 780-784 794-800 802 904-917 919-931 962-963 966-969 971-972 1059-1073",
    "test": "77-91 111-119 140 142-148 265-266 279-282 307-314 333-343 481-498 547-551 601-604 606-624 827-831 833-842 "
    "844-846 932-933 935-943 1026-1043",
}
"""Numbers of the original's scenes of each part, by which tools tell them; without four that converters leave out."""
MORE_SCENES: dict[Part, int] = {"train": 20_000, "val": 40_000, "test": 60_000}
"""Numbers of scenes beyond these."""
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


def scene_name(part: Part, number: int) -> str:
    """The name of a scene of a part."""
    spans = [[int(end) for end in span.split("-")] for span in SCENES[part].split()]
    known = [n for span in spans for n in range(span[0], span[-1] + 1)]
    return f"scene-{known[number] if number < len(known) else MORE_SCENES[part] + number - len(known):04d}"


def pose_record(pose: Matrix4) -> dict[str, list[float]]:
    """A pose as records have it: a place and a quaternion (w, x, y, z)."""
    return {"translation": pose[:3, 3].tolist(), "rotation": quaternion(pose[:3, :3]).tolist()}


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
    versions = dict.fromkeys(VERSIONS[part] for part in PARTS if frame.serves_as(part))
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


# -- lines to tables


@dataclass(eq=False)
class _Scene:
    """A scene in a file of lines: the number of its first picture, its part, the reach of its map, and where its lines
    are; its number within its part, and its place with the middle of its cell there."""

    lines: Path
    first: int
    part: Part
    reach_m: float
    offsets: list[int]
    number: int = 0
    location: str = ""
    x_m: float = 0.0
    y_m: float = 0.0

    def documents(self) -> Iterator[dict[str, Any]]:
        with self.lines.open("rb") as stream:
            for offset in self.offsets:
                stream.seek(offset)
                yield json.loads(stream.readline().split(b" ", 3)[3])

    def serves_as(self, version: str) -> Part:
        """What it is in a version: val and test serve as each other."""
        return self.part if VERSIONS[self.part] == version else "val" if self.part == "test" else "test"


def _scenes(lines: Path) -> list[_Scene]:
    """The scenes of a file of lines in their order, each in a cell of a place: the places of a part take turns."""
    found, offset = dict[int, _Scene](), 0
    with lines.open("rb") as stream:
        for line in stream:
            first, part, reach_m = line[:100].decode(errors="replace").split(" ")[:3]
            assert part in PARTS, "written by `write`"
            scene = found.setdefault(int(first), _Scene(lines, int(first), part, float(reach_m), []))
            scene.offsets.append(offset)
            offset += len(line)
    scenes = [found[first] for first in sorted(found)]
    for part, locations in LOCATIONS.items():
        own = [scene for scene in scenes if scene.part == part]
        for number, scene in enumerate(own):
            scene.number, scene.location = number, locations[number % len(locations)]
        for here in (own[i :: len(locations)] for i in range(len(locations))):
            size_m, columns, _ = _grid(here)
            for cell, scene in enumerate(here):
                row, column = divmod(cell, columns)
                scene.x_m, scene.y_m = (column + 0.5) * size_m, (row + 0.5) * size_m
    return scenes


def _grid(scenes: Sequence[_Scene]) -> tuple[float, int, int]:
    """The size of the cells of a place, as large as its largest map, and its columns and rows: as many or nearly so.
    Scenes are in them from the south west, row by row."""
    reach_m = max((scene.reach_m for scene in scenes), default=0.0)
    columns = max(1, int(np.ceil(np.sqrt(len(scenes)))))
    return 10 * np.ceil(2 * SEARCH_RATIO * reach_m / 10 + 1), columns, max(1, -(-len(scenes) // columns))


def document(path: str, lines: Path) -> Iterator[str] | Iterator[bytes]:
    """A table, a map or a mask from the lines of its pictures."""
    folder, name, scenes = PurePath(path).parent.name, PurePath(path).stem, _scenes(lines)
    if folder == "expansion":
        return _map_document([scene for scene in scenes if scene.location == name])
    if folder == "maps":
        return _mask_document([scene for scene in scenes if MASKS[scene.location] == name])
    return _splits(folder, scenes) if name == "splits" else _table(folder, name, scenes)


def _splits(version: str, scenes: Sequence[_Scene]) -> Iterator[str]:
    """The names of the scenes of each part, under names that the devkit does not have."""
    found = defaultdict[str, list[str]](list)
    for scene in scenes:
        part = scene.serves_as(version)
        found[f"synth3dlanes_{part}"].append(scene_name(part, scene.number))
    yield json.dumps(found, indent=1) + "\n"


JsonRow = dict[str, Any]


def _table(version: str, name: str, scenes: Sequence[_Scene]) -> Iterator[str]:
    """A table, with a row a line; no row twice."""
    seen, mark = set[str](), "[\n"
    of_clips = (found for scene in scenes for found in ROWS[name](_clip(version, scene)))
    found = (row for table, row in (of_clips if name in ROWS else _words()) if scenes and table == name)
    for row in _mask_rows(scenes) if name == "map" else found:
        if row["token"] not in seen:
            seen.add(row["token"])
            yield f"{mark}{json.dumps(row)}"
            mark = ",\n"
    yield "\n]\n" if seen else "[]\n"


@dataclass(frozen=True, eq=False)
class _Clip:
    """A scene as rows are made of it: its pictures, frame by frame, and the global frame from the world."""

    name: str
    location: str
    pictures: list[dict[str, Any]]
    global_from_world: Matrix4

    def token(self, *names: object) -> str:
        """The name of a record of this scene."""
        return token(self.pictures[0]["log"], *names)

    def linked(self, kind: str, pictures: Sequence[dict[str, Any]]) -> list[tuple[str, str, str, dict[str, Any]]]:
        """The tokens before, of and after a thing of a kind in pictures of each frame."""
        names = ["", *(self.token(kind, picture["frame"]) for picture in pictures), ""]
        return list(zip(names, names[1:], names[2:], pictures, strict=False))

    def placed(self, picture: Mapping[str, Any], ego_from_thing: Matrix4) -> dict[str, list[float]]:
        """The pose of a thing in the global frame."""
        return pose_record(self.global_from_world @ np.array(picture["world_from_ego"]) @ ego_from_thing)


def _clip(version: str, scene: _Scene) -> _Clip:
    # The first of an instant has the lidar too.
    pictures = sorted(scene.documents(), key=lambda picture: (picture["frame"], -len(picture["data"])))
    global_from_world = level_from_world(np.array(pictures[0]["world_from_ego"]))
    global_from_world[:2, 3] += scene.x_m, scene.y_m
    return _Clip(scene_name(scene.serves_as(version), scene.number), scene.location, pictures, global_from_world)


def _of_scene(clip: _Clip) -> Iterator[tuple[str, JsonRow]]:
    firsts = [next(group) for _, group in groupby(clip.pictures, lambda picture: picture["frame"])]
    samples, logfile = clip.linked("sample", firsts), clip.pictures[0]["log"]
    yield (
        "scene",
        {
            "token": clip.token("scene"),
            "log_token": clip.token("log"),
            "nbr_samples": len(samples),
            "first_sample_token": samples[0][1],
            "last_sample_token": samples[-1][1],
            "name": clip.name,
            "description": f"synthetic, {logfile}",
        },
    )
    for before, own, after, picture in samples:
        links = {"prev": before, "next": after, "scene_token": clip.token("scene")}
        yield "sample", {"token": own, "timestamp": picture["time_us"], **links}
    of = {"logfile": logfile, "vehicle": "synth3dlanes", "date_captured": DATE}
    yield "log", {"token": clip.token("log"), **of, "location": clip.location}


def _of_sensors(clip: _Clip) -> Iterator[tuple[str, JsonRow]]:
    measured = defaultdict[str, list[dict[str, Any]]](list)
    for picture in clip.pictures:
        for data in picture["data"]:
            measured[data["channel"]].append(picture | {"of": data})
    for channel, pictures in measured.items():
        calibrated, of, is_lidar = clip.token("calibrated", channel), pictures[0]["of"], channel == LIDAR
        sensor = {"token": token("sensor", channel), "channel": channel}
        yield "sensor", sensor | {"modality": "lidar" if is_lidar else "camera"}
        lens = {"camera_intrinsic": of.get("camera_intrinsic", [])}
        yield "calibrated_sensor", {"token": calibrated, "sensor_token": sensor["token"], **of["pose"], **lens}
        for before, own, after, picture in clip.linked(channel, pictures):
            of, time_us = picture["of"], picture["time_us"]
            yield "ego_pose", {"token": own, "timestamp": time_us, **clip.placed(picture, np.eye(4))}
            yield (
                "sample_data",
                {
                    "token": own,
                    "sample_token": clip.token("sample", picture["frame"]),
                    "ego_pose_token": own,
                    "calibrated_sensor_token": calibrated,
                    "timestamp": time_us,
                    "fileformat": "pcd" if is_lidar else of["file"].rpartition(".")[2],
                    "is_key_frame": True,
                    "height": of.get("height", 0),
                    "width": of.get("width", 0),
                    "filename": of["file"],
                    "prev": before,
                    "next": after,
                },
            )


def _of_boxes(clip: _Clip) -> Iterator[tuple[str, JsonRow]]:
    tracks, seen = defaultdict[int, list[dict[str, Any]]](list), dict[tuple[int, int], float]()
    for picture in clip.pictures:
        for box in picture["boxes"]:
            at = picture["frame"], box["id"]
            if box["visible"] is not None:
                seen[at] = max(box["visible"], seen.get(at, 0.0))
            if "pose" in box:
                tracks[box["id"]].append(box | {"frame": picture["frame"], "from": picture})
    for key, boxes in tracks.items():
        links, instance = clip.linked(f"box {key}", boxes), clip.token("instance", key)
        yield (
            "instance",
            {
                "token": instance,
                "category_token": token("category", boxes[0]["category"]),
                "nbr_annotations": len(boxes),
                "first_annotation_token": links[0][1],
                "last_annotation_token": links[-1][1],
            },
        )
        for before, own, after, box in links:
            # The greatest share that a camera sees.
            share, attribute = seen.get((box["frame"], key)), box["attribute"]
            yield (
                "sample_annotation",
                {
                    "token": own,
                    "sample_token": clip.token("sample", box["frame"]),
                    "instance_token": instance,
                    "visibility_token": visibility_of(share),
                    "attribute_tokens": [] if attribute is None else [token("attribute", attribute)],
                    **clip.placed(box["from"], pose_of(box["pose"]["translation"], box["pose"]["rotation"])),
                    "size": box["size"],
                    "prev": before,
                    "next": after,
                    "num_lidar_pts": points_of(box["points"], share),
                    "num_radar_pts": 0,
                },
            )


def _words() -> Iterator[tuple[str, JsonRow]]:
    """The words of all scenes."""
    for number, name in enumerate(CLASSES, start=1):
        yield "category", {"token": token("category", name), "name": name, "description": "", "index": number}
    for name in ATTRIBUTES:
        yield "attribute", {"token": token("attribute", name), "name": name, "description": ""}
    for level, (low, high) in enumerate(pairwise((0, *(int(100 * share) for share in VISIBLE), 100)), start=1):
        words = {"level": f"v{low}-{high}", "description": f"a camera sees between {low} and {high} % of it"}
        yield "visibility", {"token": str(level), **words}


def _mask_rows(scenes: Sequence[_Scene]) -> Iterator[JsonRow]:
    logs = defaultdict[str, list[str]](list)
    for scene in scenes:
        logs[scene.location].append(token(next(scene.documents())["log"], "log"))
    for location, name in MASKS.items():
        of = {"category": "semantic_prior", "filename": mask_file(location), "log_tokens": logs[location]}
        yield {"token": name, **of}


ROWS: dict[str, Callable[[_Clip], Iterator[tuple[str, JsonRow]]]] = {
    **dict.fromkeys(("scene", "sample", "log"), _of_scene),
    **dict.fromkeys(("sample_data", "ego_pose", "calibrated_sensor", "sensor"), _of_sensors),
    **dict.fromkeys(BOXES, _of_boxes),
}
"""What makes the rows of each table of which a scene has its own; `_words` are the same for all."""


# -- maps and masks of places


def _map_document(scenes: Sequence[_Scene]) -> Iterator[str]:
    """The layers of all scenes of a place, one layer after the other, each scene in its cell."""
    size_m, columns, rows = _grid(scenes)
    yield f'{{"version": "1.3",\n"canvas_edge": {json.dumps([columns * size_m, rows * size_m])}'
    for layer in (*LAYERS, PATHS, LINKS):
        first, last = "[]" if layer in LAYERS else "{}"
        yield f',\n"{layer}": {first}'
        mark = "\n"
        for scene in scenes:
            for record in _moved(next(scene.documents())[layer], scene):
                yield f"{mark}{record}"
                mark = ",\n"
        yield f"\n{last}"
    yield "}\n"


def _moved(records: Any, scene: _Scene) -> Iterator[str]:
    """The records of a layer in the cell of their scene, as JSON: those of a list, or those of names."""
    if isinstance(records, dict):
        for name, found in records.items():
            for path in found if isinstance(found, list) else ():
                for end in ("start_pose", "end_pose"):
                    x, y, yaw_rad = path[end]
                    path[end] = [x + scene.x_m, y + scene.y_m, yaw_rad]
            yield f'"{name}": {json.dumps(found)}'
        return
    for record in records:
        for of, x, y in ((record, "x", "y"), (record.get("pose", {}), "tx", "ty")):
            if x in of:
                of |= {x: of[x] + scene.x_m, y: of[y] + scene.y_m}
        yield json.dumps(record)


PNG_HEAD = b"\x89PNG\r\n\x1a\n"


def _mask_document(scenes: Sequence[_Scene]) -> Iterator[bytes]:
    """A PNG with drivable areas and walkways in white: the cells of a place up to MASK_M from its south west."""
    size_m, all_columns, all_rows = _grid(scenes)
    n_cells, cell_px = max(1, int(MASK_M // size_m)), int(size_m * MASK_PX_PER_M)
    columns, rows = min(all_columns, n_cells), min(all_rows, n_cells)
    packer = zlib.compressobj(1)
    yield PNG_HEAD
    yield _chunk(b"IHDR", struct.pack(">IIBBBBB", columns * cell_px, rows * cell_px, 8, 0, 0, 0, 0))
    for row in reversed(range(rows)):
        cells = [scenes[row * all_columns + i : row * all_columns + i + 1] for i in range(columns)]
        strip = np.concatenate([_drawn(cell, cell_px) for cell in cells], axis=1)
        # Each row of pixels begins with the number of its filter.
        yield _chunk(b"IDAT", packer.compress(np.pad(strip, ((0, 0), (1, 0))).tobytes()))
    yield _chunk(b"IDAT", packer.flush()) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _drawn(scenes: Sequence[_Scene], cell_px: int) -> UInt8[np.ndarray, "h w"]:
    """A cell with a scene or none, from above, its first row in the north."""
    image = Image.new("L", (cell_px, cell_px))
    draw = ImageDraw.Draw(image)
    for scene in scenes:
        (layers,) = scene.documents()
        nodes = {node["token"]: (node["x"], node["y"]) for node in layers["node"]}
        polygons = {polygon["token"]: polygon for polygon in layers["polygon"]}
        names = [name for area in layers["drivable_area"] for name in area["polygon_tokens"]]
        names += (path["polygon_token"] for path in layers["walkway"])
        # What lies in a hole is smaller than what has it.
        for polygon in sorted((polygons[name] for name in names), key=lambda polygon: -_area(polygon, nodes)):
            for ring, color in (
                (polygon["exterior_node_tokens"], 255),
                *((of["node_tokens"], 0) for of in polygon["holes"]),
            ):
                places = np.array([nodes[node] for node in ring]) * [1, -1] * MASK_PX_PER_M + cell_px / 2
                draw.polygon([*map(tuple, places.tolist())], fill=color)
    return np.asarray(image)


def _area(polygon: Mapping[str, Any], nodes: Mapping[str, tuple[float, float]]) -> float:
    x, y = np.array([nodes[node] for node in polygon["exterior_node_tokens"]]).T
    return float(abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))) / 2


# -- read back


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
    """Read what no picture is compared with. Raises FormatError where it is not what tools expect."""
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
    """What a box tells but for its place and size."""
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
