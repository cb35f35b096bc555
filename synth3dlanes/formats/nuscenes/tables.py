"""The tables, maps and masks of nuScenes from the lines of pictures."""

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

from synth3dlanes.formats.nuscenes.convention import (
    ATTRIBUTES,
    CLASSES,
    DATE,
    LAYERS,
    LIDAR,
    LINKS,
    LOCATIONS,
    MASK_M,
    MASK_PX_PER_M,
    MASKS,
    PATHS,
    VERSIONS,
    VISIBLE,
    level_from_world,
    mask_file,
    matrix,
    pose_record,
    scene_name,
    token,
)
from synth3dlanes.formats.writing import PARTS, Part
from synth3dlanes.roads.network import SEARCH_RATIO
from synth3dlanes.system.arrays import Matrix4


@dataclass(frozen=True, eq=False)
class _Scene:
    """A scene in a file of lines: the number of its first picture, how far its map reaches, and where its lines are."""

    first: int
    part: Part
    reach_m: float
    offsets: list[int]


@dataclass(frozen=True)
class _Place:
    """Where a scene is: a place of the original, and a point there. `number` counts the scenes of its part."""

    location: str
    x_m: float
    y_m: float
    number: int


@dataclass(frozen=True)
class _Grid:
    """The cells of a place, as large as its largest map, with scenes from the south west, row by row."""

    size_m: float
    columns: int
    rows: int

    @classmethod
    def of(cls, scenes: Sequence[_Scene]) -> "_Grid":
        """A square or nearly one."""
        reach_m = max((scene.reach_m for scene in scenes), default=0.0)
        columns = max(1, int(np.ceil(np.sqrt(len(scenes)))))
        return cls(10 * np.ceil(2 * SEARCH_RATIO * reach_m / 10 + 1), columns, max(1, -(-len(scenes) // columns)))


def _scenes(lines: Path) -> list[_Scene]:
    """The scenes of a file of lines, in their order."""
    found, offset = dict[int, _Scene](), 0
    with lines.open("rb") as stream:
        for line in stream:
            first, part, reach_m = line[:100].decode(errors="replace").split(" ")[:3]
            assert part in PARTS, "written by `annotate`"
            scene = found.setdefault(int(first), _Scene(int(first), part, float(reach_m), []))
            scene.offsets.append(offset)
            offset += len(line)
    return [found[first] for first in sorted(found)]


def _documents(lines: Path, scene: _Scene) -> Iterator[dict[str, Any]]:
    with lines.open("rb") as stream:
        for offset in scene.offsets:
            stream.seek(offset)
            yield json.loads(stream.readline().split(b" ", 3)[3])


def _at(scenes: Sequence[_Scene], location: str) -> list[_Scene]:
    """The scenes of a place, which has those of one part, or every second of them."""
    for part, places in LOCATIONS.items():
        if location in places:
            return [scene for scene in scenes if scene.part == part][places.index(location) :: len(places)]
    raise ValueError(location)


def _places(scenes: Sequence[_Scene]) -> dict[int, _Place]:
    """The places of scenes by the numbers of their first pictures."""
    found = dict[int, _Place]()
    for part, locations in LOCATIONS.items():
        number_of = {scene.first: i for i, scene in enumerate(scene for scene in scenes if scene.part == part)}
        for location in locations:
            here = _at(scenes, location)
            grid = _Grid.of(here)
            for cell, scene in enumerate(here):
                row, column = divmod(cell, grid.columns)
                x_m, y_m = (column + 0.5) * grid.size_m, (row + 0.5) * grid.size_m
                found[scene.first] = _Place(location, x_m, y_m, number_of[scene.first])
    return found


def document(path: str, lines: Path) -> Iterator[str] | Iterator[bytes]:
    """A table, a map or a mask from the lines of its pictures."""
    folder, name = PurePath(path).parent.name, PurePath(path).stem
    if folder == "expansion":
        return _map_document(name, lines)
    if folder == "maps":
        return _mask_document(next(location for location in MASKS if MASKS[location] == name), lines)
    if name == "splits":
        return _splits(folder, lines)
    return _table(folder, name, lines)


def _table(version: str, name: str, lines: Path) -> Iterator[str]:
    """A table, with a row a line; no row twice."""
    scenes, seen, mark = _scenes(lines), set[str](), "[\n"
    places = _places(scenes)
    made: Iterator[JsonRow] = (
        row for scene in scenes for row in TABLES[name](_clip(version, lines, scene, places[scene.first]))
    )
    rows = _mask_rows(lines, scenes, places) if name == "map" else made
    for row in rows:
        if row["token"] not in seen:
            seen.add(row["token"])
            yield f"{mark}{json.dumps(row)}"
            mark = ",\n"
    yield "\n]\n" if seen else "[]\n"


def _splits(version: str, lines: Path) -> Iterator[str]:
    """The names of the scenes of each part, under names that the devkit does not have."""
    scenes, found = _scenes(lines), defaultdict[str, list[str]](list)
    places = _places(scenes)
    for scene in scenes:
        part = _serves_as(version, scene.part)
        found[f"synth3dlanes_{part}"].append(scene_name(part, places[scene.first].number))
    yield json.dumps(found, indent=1) + "\n"


def _serves_as(version: str, part: Part) -> Part:
    """What the scenes of a part are in a version: val and test serve as each other."""
    return part if VERSIONS[part] == version else "val" if part == "test" else "test"


@dataclass(frozen=True, eq=False)
class _Clip:
    """A scene as rows are made of it: its pictures, frame by frame, and the global frame from the world."""

    name: str
    place: _Place
    pictures: list[dict[str, Any]]
    global_from_world: Matrix4

    def token(self, *names: object) -> str:
        """The name of a record of this scene."""
        return token(self.pictures[0]["log"], *names)

    @property
    def frames(self) -> list[tuple[str, str, str, dict[str, Any]]]:
        """The tokens before, of and after each sample, and its first picture."""
        firsts = [next(group) for _, group in groupby(self.pictures, lambda picture: picture["frame"])]
        return self.linked("sample", firsts)

    def linked(self, kind: str, pictures: Sequence[dict[str, Any]]) -> list[tuple[str, str, str, dict[str, Any]]]:
        """The tokens before, of and after a thing of a kind in pictures of each frame."""
        names = ["", *(self.token(kind, picture["frame"]) for picture in pictures), ""]
        return list(zip(names, names[1:], names[2:], pictures, strict=False))

    @property
    def channels(self) -> dict[str, list[tuple[str, str, str, dict[str, Any]]]]:
        """What each sensor measured: tokens before, of and after it, and the picture, with `of` of this sensor."""
        found = defaultdict[str, list[dict[str, Any]]](list)
        for picture in self.pictures:
            for data in picture["data"]:
                found[data["channel"]].append(picture | {"of": data})
        return {channel: self.linked(channel, pictures) for channel, pictures in found.items()}

    @property
    def objects(self) -> dict[int, list[dict[str, Any]]]:
        """The boxes of each car, frame by frame, with the greatest share of it that a camera sees."""
        found, seen = defaultdict[int, list[dict[str, Any]]](list), dict[tuple[int, int], float]()
        for picture in self.pictures:
            for box in picture["boxes"]:
                at = picture["frame"], box["id"]
                if box["visible"] is not None:
                    seen[at] = max(box["visible"], seen.get(at, 0.0))
                if "pose" in box:
                    found[box["id"]].append(box | {"frame": picture["frame"], "from": picture})
        return {key: [box | {"visible": seen.get((box["frame"], key))} for box in of] for key, of in found.items()}

    def placed(self, picture: Mapping[str, Any], ego_from_thing: Matrix4) -> dict[str, list[float]]:
        """The pose of a thing in the global frame."""
        return pose_record(self.global_from_world @ np.array(picture["world_from_ego"]) @ ego_from_thing)


def _clip(version: str, lines: Path, scene: _Scene, place: _Place) -> _Clip:
    # The first of an instant has the lidar too.
    pictures = sorted(_documents(lines, scene), key=lambda picture: (picture["frame"], -len(picture["data"])))
    global_from_world = level_from_world(np.array(pictures[0]["world_from_ego"]))
    global_from_world[:2, 3] += place.x_m, place.y_m
    return _Clip(scene_name(_serves_as(version, scene.part), place.number), place, pictures, global_from_world)


JsonRow = dict[str, Any]


def _scene_rows(clip: _Clip) -> Iterator[JsonRow]:
    samples = clip.frames
    yield {
        "token": clip.token("scene"),
        "log_token": clip.token("log"),
        "nbr_samples": len(samples),
        "first_sample_token": samples[0][1],
        "last_sample_token": samples[-1][1],
        "name": clip.name,
        "description": f"synthetic, {clip.pictures[0]['log']}",
    }


def _sample_rows(clip: _Clip) -> Iterator[JsonRow]:
    for before, own, after, picture in clip.frames:
        links = {"prev": before, "next": after, "scene_token": clip.token("scene")}
        yield {"token": own, "timestamp": picture["time_us"], **links}


def _data_rows(clip: _Clip) -> Iterator[JsonRow]:
    for channel, pictures in clip.channels.items():
        for before, own, after, picture in pictures:
            of = picture["of"]
            yield {
                "token": own,
                "sample_token": clip.token("sample", picture["frame"]),
                "ego_pose_token": own,
                "calibrated_sensor_token": clip.token("calibrated", channel),
                "timestamp": picture["time_us"],
                "fileformat": "pcd" if channel == LIDAR else of["file"].rpartition(".")[2],
                "is_key_frame": True,
                "height": of.get("height", 0),
                "width": of.get("width", 0),
                "filename": of["file"],
                "prev": before,
                "next": after,
            }


def _pose_rows(clip: _Clip) -> Iterator[JsonRow]:
    for pictures in clip.channels.values():
        for _, own, _, picture in pictures:
            yield {"token": own, "timestamp": picture["time_us"], **clip.placed(picture, np.eye(4))}


def _calibrated_rows(clip: _Clip) -> Iterator[JsonRow]:
    for channel, ((_, _, _, picture), *_) in clip.channels.items():
        lens = {"camera_intrinsic": picture["of"].get("camera_intrinsic", [])}
        sensor = {"token": clip.token("calibrated", channel), "sensor_token": token("sensor", channel)}
        yield {**sensor, **picture["of"]["pose"], **lens}


def _sensor_rows(clip: _Clip) -> Iterator[JsonRow]:
    for channel in clip.channels:
        modality = "lidar" if channel == LIDAR else "camera"
        yield {"token": token("sensor", channel), "channel": channel, "modality": modality}


def _instance_rows(clip: _Clip) -> Iterator[JsonRow]:
    for key, boxes in clip.objects.items():
        links = clip.linked(f"box {key}", boxes)
        yield {
            "token": clip.token("instance", key),
            "category_token": token("category", boxes[0]["category"]),
            "nbr_annotations": len(boxes),
            "first_annotation_token": links[0][1],
            "last_annotation_token": links[-1][1],
        }


def _annotation_rows(clip: _Clip) -> Iterator[JsonRow]:
    for key, boxes in clip.objects.items():
        for before, own, after, box in clip.linked(f"box {key}", boxes):
            visible, points, attribute = box["visible"], box["points"], box["attribute"]
            yield {
                "token": own,
                "sample_token": clip.token("sample", box["frame"]),
                "instance_token": clip.token("instance", key),
                "visibility_token": "" if visible is None else str(1 + int(np.searchsorted(VISIBLE, visible, "right"))),
                "attribute_tokens": [] if attribute is None else [token("attribute", attribute)],
                **clip.placed(box["from"], matrix(box["pose"])),
                "size": box["size"],
                "prev": before,
                "next": after,
                "num_lidar_pts": int(bool(visible)) if points is None else points,
                "num_radar_pts": 0,
            }


def _category_rows(clip: _Clip) -> Iterator[JsonRow]:
    for number, name in enumerate(CLASSES, start=1):
        yield {"token": token("category", name), "name": name, "description": "", "index": number}


def _attribute_rows(clip: _Clip) -> Iterator[JsonRow]:
    for name in ATTRIBUTES:
        yield {"token": token("attribute", name), "name": name, "description": ""}


def _visibility_rows(clip: _Clip) -> Iterator[JsonRow]:
    shares = (0, *(int(100 * share) for share in VISIBLE), 100)
    for level, (low, high) in enumerate(pairwise(shares), start=1):
        words = {"level": f"v{low}-{high}", "description": f"a camera sees between {low} and {high} % of it"}
        yield {"token": str(level), **words}


def _log_rows(clip: _Clip) -> Iterator[JsonRow]:
    of = {"logfile": clip.pictures[0]["log"], "vehicle": "synth3dlanes", "date_captured": DATE}
    yield {"token": clip.token("log"), **of, "location": clip.place.location}


def _mask_rows(lines: Path, scenes: Sequence[_Scene], places: Mapping[int, _Place]) -> Iterator[JsonRow]:
    logs = defaultdict[str, list[str]](list)
    for scene in scenes:
        logs[places[scene.first].location].append(token(next(_documents(lines, scene))["log"], "log"))
    for location, name in MASKS.items():
        of = {"category": "semantic_prior", "filename": mask_file(location), "log_tokens": logs[location]}
        yield {"token": name, **of}


TABLES: dict[str, Callable[[_Clip], Iterator[JsonRow]]] = {
    "scene": _scene_rows,
    "sample": _sample_rows,
    "sample_data": _data_rows,
    "ego_pose": _pose_rows,
    "calibrated_sensor": _calibrated_rows,
    "sensor": _sensor_rows,
    "instance": _instance_rows,
    "sample_annotation": _annotation_rows,
    "category": _category_rows,
    "attribute": _attribute_rows,
    "visibility": _visibility_rows,
    "log": _log_rows,
    "map": lambda clip: iter(()),
}


def _map_document(location: str, lines: Path) -> Iterator[str]:
    """The layers of all scenes of a place, one layer after the other, each scene in its cell."""
    every = _scenes(lines)
    scenes, places = _at(every, location), _places(every)
    grid = _Grid.of(scenes)
    canvas = [grid.columns * grid.size_m, grid.rows * grid.size_m]
    yield f'{{"version": "1.3",\n"canvas_edge": {json.dumps(canvas)}'
    for layer in (*LAYERS, PATHS, LINKS):
        first, last = "[]" if layer in LAYERS else "{}"
        yield f',\n"{layer}": {first}'
        mark = "\n"
        for scene in scenes:
            for row in _moved(layer, _layer(lines, scene, layer), places[scene.first]):
                yield f"{mark}{row}"
                mark = ",\n"
        yield f"\n{last}"
    yield "}\n"


def _layer(lines: Path, scene: _Scene, layer: str) -> Any:
    (layers,) = _documents(lines, scene)
    return layers[layer]


def _moved(layer: str, records: Any, at: _Place) -> Iterator[str]:
    """The records of a layer in the cell of their scene, as JSON."""
    if layer == PATHS:
        for name, paths in records.items():
            for path in paths:
                for end in ("start_pose", "end_pose"):
                    x, y, yaw_rad = path[end]
                    path[end] = [x + at.x_m, y + at.y_m, yaw_rad]
            yield f'"{name}": {json.dumps(paths)}'
    elif layer == LINKS:
        yield from (f'"{name}": {json.dumps(links)}' for name, links in records.items())
    else:
        for record in records:
            for of, x, y in ((record, "x", "y"), (record.get("pose", {}), "tx", "ty")):
                if x in of:
                    of |= {x: of[x] + at.x_m, y: of[y] + at.y_m}
            yield json.dumps(record)


def _mask_document(location: str, lines: Path) -> Iterator[bytes]:
    """A PNG with drivable areas and walkways in white: the cells of a place up to MASK_M from its south west."""
    scenes = _at(_scenes(lines), location)
    grid = _Grid.of(scenes)
    n_cells = max(1, int(MASK_M // grid.size_m))
    columns, rows = min(grid.columns, n_cells), min(grid.rows, n_cells)
    cell_px = int(grid.size_m * MASK_PX_PER_M)
    packer = zlib.compressobj(1)
    yield b"\x89PNG\r\n\x1a\n"
    yield _chunk(b"IHDR", struct.pack(">IIBBBBB", columns * cell_px, rows * cell_px, 8, 0, 0, 0, 0))
    for row in reversed(range(rows)):
        cells = [scenes[row * grid.columns + i : row * grid.columns + i + 1] for i in range(columns)]
        strip = np.concatenate([_drawn(lines, cell, cell_px) for cell in cells], axis=1)
        # Each row of pixels begins with the number of its filter.
        yield _chunk(b"IDAT", packer.compress(np.pad(strip, ((0, 0), (1, 0))).tobytes()))
    yield _chunk(b"IDAT", packer.flush()) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _drawn(lines: Path, scenes: Sequence[_Scene], cell_px: int) -> UInt8[np.ndarray, "h w"]:
    """A cell with a scene or none, from above, its first row in the north."""
    image = Image.new("L", (cell_px, cell_px))
    draw = ImageDraw.Draw(image)
    for scene in scenes:
        (layers,) = _documents(lines, scene)
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
