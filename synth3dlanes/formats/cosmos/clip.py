"""A clip of Cosmos: what stands still around it, the files and tables of its scenario, and a reader of them and of its
videos.

ClipGT's frames are x forward, y left, z up, metres: the rig's (`_rig`) has its origin on the road below the middle of
the rear axle, the scenario's (`_clip`) is the rig's at the first frame, a camera's (`_flu`) looks along x. Pixel
corners are at whole numbers.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float
from pydantic import RootModel
from scipy.spatial.transform import Rotation

from synth3dlanes.formats.lane_map import Boundary, LaneSegment, lane_segments
from synth3dlanes.formats.reading import json_object, pose_of, read_file
from synth3dlanes.imaging.video import open_video
from synth3dlanes.labels.labels import Labels
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.system import schema
from synth3dlanes.system.arrays import Matrix4, Points3, Polyline3, RgbImage
from synth3dlanes.system.columnar import TableBounds, read_parquet, reading_table
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import Excerpt, Number, SymbolKind
from synth3dlanes.world.motion import host_driven
from synth3dlanes.world.paint import is_double, paint_color, pair_of
from synth3dlanes.world.world import World

REACH_M = 150.0
"""Reach of lanes ahead of and behind all places of the host in the clip."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """What stands still around a clip. Painted lines by their ids go in the host's driving direction. Of symbols, which
    bound no lane, it has the outlines; of lines across the road their middles from one end to the other. Traffic
    elements have the poses of their frames in the world."""

    lanes: tuple[LaneSegment, ...]
    lines: dict[str, Boundary]
    edges: tuple[Polyline3, ...]
    symbols: tuple[tuple[SymbolKind, Polyline3], ...]
    elements: tuple[tuple[ObjectLabel, Matrix4], ...]


def scenario(world: World, labels: Labels, pictures: Iterable[Labels]) -> Scenario:
    """The scenario of a world by the labels of the clip's first picture, with the traffic elements of all
    `pictures`."""
    place, shot = world.view.world_from_host[:3, 3], world.scene.shot
    reach_m = REACH_M + host_driven(shot, shot.duration_s)
    return Scenario(
        tuple(lane_segments(world, labels.graph.segments, place, reach_m)),
        dict(_lines(world, place, reach_m)),
        tuple(world.ground.paved.edges(place[:2], reach_m)),
        tuple(_symbols(world)),
        _elements(pictures),
    )


def _lines(world: World, place: Float[np.ndarray, "3"], reach_m: float) -> Iterator[tuple[str, Boundary]]:
    network, markings = world.network, world.scene.markings
    for line, s in network.delimiters_near(place[:2], reach_m).items():
        points = line.points_world(s)
        points = points[np.linalg.norm(points[:, :2] - place[:2], axis=1) < 2 * reach_m]
        if line.marking != "none" and len(points) > 1:
            paint = paint_color(line, markings), is_double(line, markings), pair_of(line, markings)
            # Stations may fall as the host drives.
            yield line.id, Boundary(points[:: int(network.onwards)], line.marking, *paint)


def _symbols(world: World) -> Iterator[tuple[SymbolKind, Polyline3]]:
    for form in world.symbol_shapes:
        outline = form.outline
        if form.kind in ("stop_line", "give_way_line"):
            (x0, y0), (x1, y1) = outline.min(axis=0), outline.max(axis=0)
            outline = np.array([[x0, (y0 + y1) / 2], [x1, (y0 + y1) / 2]])
        yield form.kind, form.points_world(outline)


def _elements(pictures: Iterable[Labels]) -> tuple[tuple[ObjectLabel, Matrix4], ...]:
    found = dict[int, tuple[ObjectLabel, Matrix4]]()
    for labels in pictures:
        for item in labels.traffic_elements or ():
            found.setdefault(item.id, (item, labels.camera.world_from_cam @ item.cam_from_object))
    return tuple(found[number] for number in sorted(found))


FRONT_VIEW = "camera_front_wide_120fov"
"""The view of a camera that is alone, and the one whose times the readers take."""
VERSION = 1
FOLDERS = {"rgb": "videos", "depth": "depth", "seg": "seg", "edge": "edge", "hdmap": "control_input_hdmap_bbox"}
"""The videos of a view, and the folders that the loaders expect them in."""
POINT = pa.struct([(axis, pa.float64()) for axis in "xyz"])
QUATERNION = pa.struct([(axis, pa.float64()) for axis in "xyzw"])
_POINTS, _TEXTS = pa.list_(POINT), pa.list_(pa.string())
_MAP_KEY = pa.struct([(name, pa.string()) for name in ("clip_id", "label_class_id", "map_id", "map_id_version")])
_TIME_KEY = pa.struct([("clip_id", pa.string()), ("timestamp_micros", pa.int64()), ("label_class_id", pa.string())])
_BOX = {"center": POINT, "dimensions": POINT, "orientation": QUATERNION, "category": pa.string()}
_PLACE = {"category": pa.string(), "location": _POINTS}


def _schema(name: str, key: pa.DataType, fields: dict[str, pa.DataType]) -> pa.Schema:
    return pa.schema({"key": key, name: pa.struct(list(fields.items())), "version": pa.uint64()})


TABLES = {
    "calibration_estimate": _schema(
        "calibration_estimate", _TIME_KEY, {"name": pa.string(), "rig_json": pa.string()}
    ),
    "egomotion_estimate": _schema(
        "egomotion_estimate", _TIME_KEY, {"name": pa.string(), "location": POINT, "orientation": QUATERNION}
    ),
    "obstacle": _schema(
        "obstacle",
        _TIME_KEY,
        {
            "trackline_id": pa.string(), "center": POINT, "size": POINT, "orientation": QUATERNION,
            "category": pa.string(),
        },
    ),
    "lane": _schema(
        "lane",
        _MAP_KEY,
        {
            "left_rail": _POINTS, "right_rail": _POINTS, "left_edge_styles": _TEXTS, "right_edge_styles": _TEXTS,
            "left_edge_colors": _TEXTS, "right_edge_colors": _TEXTS,
        },
    ),
    "lane_line": _schema("lane_line", _MAP_KEY, {"line_rail": _POINTS, "styles": _TEXTS, "colors": _TEXTS}),
    "road_boundary": _schema("road_boundary", _MAP_KEY, _PLACE),
    "crosswalk": _schema("crosswalk", _MAP_KEY, _PLACE),
    "road_marking": _schema("road_marking", _MAP_KEY, _PLACE),
    "wait_line": _schema("wait_line", _MAP_KEY, {**_PLACE, "is_implicit": pa.bool_()}),
    "traffic_light": _schema("traffic_light", _MAP_KEY, _BOX),
    "traffic_sign": _schema("traffic_sign", _MAP_KEY, _BOX),
}  # fmt: skip
"""The tables of a clip. `map_id` of a lane line is the id of the delimiter, that of a lane the segment's of the lane
graph, that of a light or a sign the id of the traffic element."""
# Rows are few, and may have long lines.
BOUNDS = TableBounds(most_rows=1 << 20, row_bytes=256, base_bytes=256 << 20)


@dataclass(frozen=True)
class ClipFiles:
    """The paths of a clip's files in an export."""

    part: str
    clip: str

    def table(self, name: str) -> str:
        return f"{self.part}/clipgt/{self.clip}/{self.clip}.{name}.parquet"

    @property
    def times(self) -> str:
        return f"{self.part}/clipgt/{self.clip}/{self.clip}.{FRONT_VIEW}.json"

    @property
    def depths(self) -> str:
        """What the greys of depth videos are, by view."""
        return f"{self.part}/clipgt/{self.clip}/{self.clip}.depth.json"

    def video(self, kind: str, view: str) -> str:
        return f"{self.part}/{FOLDERS[kind]}/ftheta_{view}/{self.clip}.mp4"


class _Time(Excerpt):
    timestamp: int


class _Times(RootModel[list[_Time]]):
    """The times of the frames."""


class _Span(Excerpt):
    low: Number
    high: Number


class _Spans(RootModel[dict[str, _Span]]):
    """Spans of depth videos by view."""


@dataclass(frozen=True, eq=False)
class CosmosView:
    """A camera of a clip: its place in the rig's frame, and its f-theta lens."""

    rig_from_flu: Matrix4
    size_px: tuple[int, int]
    center_px: Float[np.ndarray, "2"]
    stretch: float
    polynomial: Float[np.ndarray, " _"]

    def project(self, points_flu: Points3) -> Float[np.ndarray, "n 2"]:
        """Pixels of points, as the readers compute them."""
        forward, left, up = points_flu.T
        aside = np.hypot(left, up)
        angle = np.arctan2(aside, forward)
        radius = (angle[:, None] ** np.arange(len(self.polynomial))) @ self.polynomial
        scale = radius / np.maximum(aside, 1e-12)
        return np.column_stack([-left * scale * self.stretch, -up * scale]) + self.center_px


@dataclass(frozen=True, eq=False)
class Box:
    """A box: its class, its pose (x forward, y left, z up), and its length, width and height."""

    name: str
    category: str
    clip_from_box: Matrix4
    size_m: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class CosmosClip:
    """A clip below the folder of an export; its files are read when they are asked for."""

    out: Path
    files: ClipFiles

    @cached_property
    def views(self) -> dict[str, CosmosView]:
        (row,), where = self.rows("calibration_estimate"), str(self.out / self.files.table("calibration_estimate"))
        document = json_object(row["rig_json"], where)
        try:
            return {sensor["name"].replace(":", "_"): _view(sensor, where) for sensor in document["rig"]["sensors"]}
        except (KeyError, TypeError, ValueError, AttributeError):
            raise FormatError(f"{where}: expected cameras in rig_json, got something else") from None

    @cached_property
    def poses(self) -> dict[int, Matrix4]:
        """The rig in the clip's frame by time (microseconds)."""
        return {row["timestamp_micros"]: _pose(row, "location") for row in self.rows("egomotion_estimate")}

    @cached_property
    def times(self) -> list[int]:
        """The times of the frames (microseconds), as the readers take them."""
        where = self.out / self.files.times
        return [frame.timestamp for frame in schema.parse(_Times, read_file(where), str(where), "times of frames").root]

    def obstacles(self, micros: int) -> list[Box]:
        """The cars at an instant."""
        rows = [row for row in self.rows("obstacle") if row["timestamp_micros"] == micros]
        return [_box(row, row["trackline_id"], "size") for row in rows]

    def elements(self, name: str) -> list[Box]:
        return [_box(row, row["map_id"], "dimensions") for row in self.rows(name)]

    def lines(self, name: str, field: str) -> list[tuple[dict[str, Any], Points3]]:
        """Rows of a table, each with the points of a field."""
        return [(row, _points(row[field])) for row in self.rows(name)]

    def span(self, view: str) -> tuple[float, float]:
        """The least and the greatest nearness that the greys of a depth video stand for (1/m)."""
        where = self.out / self.files.depths
        found = schema.parse(_Spans, read_file(where), str(where), "spans of depth videos").root
        if view not in found:
            raise FormatError(f"{where}: expected a span of {view}, got none")
        return found[view].low, found[view].high

    def frames(self, kind: str, view: str, rate_hz: float) -> Iterator[RgbImage]:
        """The frames of a video, whose rate must be this."""
        path = self.out / self.files.video(kind, view)
        with open_video(path) as video:
            if not np.isclose(video.rate_hz, rate_hz, rtol=1e-3):
                raise FormatError(f"{path}: expected {rate_hz:g} frames a second, got {video.rate_hz:g}")
            yield from video.frames

    def rows(self, name: str) -> list[dict[str, Any]]:
        """Rows of a table: the values of the key and of the element together."""
        if name not in self._tables:
            self._tables[name] = self._rows(name)
        return self._tables[name]

    @cached_property
    def _tables(self) -> dict[str, list[dict[str, Any]]]:
        return {}

    def _rows(self, name: str) -> list[dict[str, Any]]:
        where, wanted = self.out / self.files.table(name), TABLES[name]
        with reading_table(str(where), wanted.names):
            table = read_parquet(read_file(where), str(where), BOUNDS)
            if table.schema.names != wanted.names:
                raise ValueError(f"columns {', '.join(table.schema.names)}")
            rows = [{**row["key"], **row[name]} for row in table.cast(wanted).to_pylist()]
        if any(value is None for row in rows for value in row.values()):
            raise FormatError(f"{where}: expected a value in every field, got none in some")
        return rows


def _view(sensor: Any, where: str) -> CosmosView:
    lens, place = sensor["properties"], sensor["nominalSensor2Rig_FLU"]
    if (lens["Model"], lens["polynomial-type"]) != ("ftheta", "angle-to-pixeldistance"):
        raise FormatError(f"{where}: expected f-theta cameras from angle to distance, got others")
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", np.radians(np.array(place["roll-pitch-yaw"], float))).as_matrix()
    pose[:3, 3] = np.array(place["t"], float)
    numbers = [float(text) for text in (*lens["polynomial"].split(), lens["cx"], lens["cy"], lens["linear-c"])]
    if not np.isfinite([*numbers, *pose.ravel()]).all() or len(numbers) < 4:
        raise FormatError(f"{where}: expected finite numbers of a camera, got others")
    *polynomial, cx, cy, stretch = numbers
    size_px = int(lens["width"]), int(lens["height"])
    return CosmosView(pose, size_px, np.array([cx, cy]), stretch, np.array(polynomial))


def _box(row: dict[str, Any], name: str, size: str) -> Box:
    return Box(name, row["category"], _pose(row, "center"), _xyz(row[size]))


def _pose(row: dict[str, Any], place: str) -> Matrix4:
    return pose_of(_xyz(row[place]), [row["orientation"][axis] or 0.0 for axis in "wxyz"])


def _points(points: list[dict[str, float]]) -> Points3:
    return np.array([[point[axis] for axis in "xyz"] for point in points], float).reshape(-1, 3)


def _xyz(point: dict[str, float]) -> Float[np.ndarray, "3"]:
    return np.array([point[axis] for axis in "xyz"], float)
