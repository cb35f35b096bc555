"""The tables, maps and masks of nuScenes that many scenes share, made of the lines that pictures write to them. A line
has the number of the scene's first picture, its part, the reach of its map, and a document.

In the global frame the scenes of a place lie beside each other, their level frames in the middles of cells.
"""

import json
import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw

from synth3dlanes.formats.nuscenes_maps import LAYERS, LINKS, PATHS, level_from_world, token
from synth3dlanes.formats.reading import pose_of
from synth3dlanes.formats.writing import PARTS, Part
from synth3dlanes.geometry.frames import quaternion
from synth3dlanes.roads.network import SEARCH_RATIO
from synth3dlanes.system.arrays import Matrix4

LIDAR = "LIDAR_TOP"
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


def table_file(version: str, name: str) -> str:
    """The path of a table, or of the list `splits` beside the tables."""
    return f"{version}/{name}.json"


def map_file(location: str) -> str:
    """The path of the map of a place."""
    return f"maps/expansion/{location}.json"


def mask_file(location: str) -> str:
    """The path of the mask of a place."""
    return f"maps/{MASKS[location]}.png"


def visibility_of(share: float | None) -> str:
    """The level of visibility of what is seen to a share; none where nothing is known of it."""
    return "" if share is None else str(1 + sum(share >= least for least in VISIBLE))


def points_of(points: int | None, share: float | None) -> int:
    """The points of the lidar on an object; without a lidar, one that keeps it in tools' lists if a camera sees it."""
    return int(bool(share)) if points is None else points


def scene_name(part: Part, number: int) -> str:
    """The name of a scene of a part."""
    spans = [[int(end) for end in span.split("-")] for span in SCENES[part].split()]
    known = [n for span in spans for n in range(span[0], span[-1] + 1)]
    return f"scene-{known[number] if number < len(known) else MORE_SCENES[part] + number - len(known):04d}"


def pose_record(pose: Matrix4) -> dict[str, list[float]]:
    """A pose as records have it: a place and a quaternion (w, x, y, z)."""
    return {"translation": pose[:3, 3].tolist(), "rotation": quaternion(pose[:3, :3]).tolist()}


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
