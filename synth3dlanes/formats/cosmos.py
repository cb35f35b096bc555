"""Cosmos: control videos of clips, and their world scenarios as ClipGT tables; a scene is a clip.

| theirs | ours | unit, frame |
|---|---|---|
| `egomotion_estimate`, `calibration_estimate` | the host's poses; cameras as f-theta polynomials | m, `_clip`, `_rig` |
| `obstacle`; `traffic_light`, `traffic_sign` | objects; traffic elements | m, `_clip` |
| `lane`, `lane_line` | segments of the lane graph, delimiters with their paint (`line_style`) | m, `_clip` |
| `road_boundary` | edges of the pavement | m, `_clip` |
| `crosswalk`, `wait_line`, `road_marking` | symbols | m, `_clip` |
| `map_id`, `trackline_id` | ids of the labels | |

ClipGT's frames are x forward, y left, z up, metres: the rig's (`_rig`) has its origin on the road below the middle of
the rear axle, the scenario's (`_clip`) is the rig's at the first frame, a camera's (`_flu`) looks along x. Pixel
corners are at whole numbers. `cosmos_videos` has the control videos.
"""

import io
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pyarrow as pa
from jaxtyping import Float
from pyarrow import parquet
from pydantic import RootModel
from scipy.spatial.transform import Rotation

from synth3dlanes.formats.comparing import (
    Comparison,
    FoundBox,
    Gap,
    SourceSample,
    back_along,
    compare_boxes,
    compare_camera,
    distances,
)
from synth3dlanes.formats.comparing_maps import FoundLane, MapRule, compare_lanes, middle_of, symbol_problems
from synth3dlanes.formats.cosmos_videos import (
    CATEGORIES,
    DRAWN,
    ELEMENTS,
    GREYS,
    Scenario,
    frame_problem,
    nearness_span,
    scenario,
)
from synth3dlanes.formats.format import FrameList, ReadFrame, SampleFormat, SampleFrame, of_parts
from synth3dlanes.formats.reading import json_object, pose_of, read_file
from synth3dlanes.formats.writing import (
    CV_FROM_CAM,
    FrameAnnotation,
    host_from_flu,
    objects_of,
    with_flu_axes,
    world_from_vehicle,
)
from synth3dlanes.geometry.frames import invert, quaternion, transform
from synth3dlanes.imaging.video import mp4, open_video
from synth3dlanes.labels.labels import CameraLabel, Marking, PaintColor, Pair
from synth3dlanes.scene.traffic_elements import SignKind
from synth3dlanes.system import schema
from synth3dlanes.system.arrays import Matrix4, Points3, RgbImage
from synth3dlanes.system.columnar import TableBounds, read_parquet, reading_table
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import encoded
from synth3dlanes.system.schema import Excerpt, Number
from synth3dlanes.world.world import resolve

FRONT_VIEW = "camera_front_wide_120fov"
"""The view of a camera that is alone, and the one whose times the readers take."""
TIMES, DEPTHS = f"{FRONT_VIEW}.json", "depth.json"
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


_FIELDS = {
    "calibration_estimate": {"name": pa.string(), "rig_json": pa.string()},
    "egomotion_estimate": {"name": pa.string(), "location": POINT, "orientation": QUATERNION},
    "obstacle": {
        "trackline_id": pa.string(), "center": POINT, "size": POINT, "orientation": QUATERNION, "category": pa.string()
    },
    "lane": {
        "left_rail": _POINTS, "right_rail": _POINTS, "left_edge_styles": _TEXTS, "right_edge_styles": _TEXTS,
        "left_edge_colors": _TEXTS, "right_edge_colors": _TEXTS,
    },
    "lane_line": {"line_rail": _POINTS, "styles": _TEXTS, "colors": _TEXTS},
    **dict.fromkeys(("road_boundary", "crosswalk", "road_marking"), _PLACE),
    "wait_line": {**_PLACE, "is_implicit": pa.bool_()},
    **dict.fromkeys(("traffic_light", "traffic_sign"), _BOX),
}  # fmt: skip
MOVING = ("calibration_estimate", "egomotion_estimate", "obstacle")
TABLES = {
    name: pa.schema(
        {
            "key": _TIME_KEY if name in MOVING else _MAP_KEY,
            name: pa.struct(list(fields.items())),
            "version": pa.uint64(),
        }
    )
    for name, fields in _FIELDS.items()
}
"""The tables of a clip. `map_id` of a lane line is the id of the delimiter, that of a lane the segment's of the lane
graph, that of a light or a sign the id of the traffic element."""
# Rows are few, and may have long lines.
BOUNDS = TableBounds(most_rows=1 << 20, row_bytes=256, base_bytes=256 << 20)


@dataclass(frozen=True)
class ClipFiles:
    """The paths of a clip's files in an export."""

    part: str
    clip: str

    def of_scenario(self, ending: str) -> str:
        """A table (NAME.parquet), the times of frames (TIMES) or the spans of depth videos (DEPTHS)."""
        return f"{self.part}/clipgt/{self.clip}/{self.clip}.{ending}"

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
class CosmosClip:
    """A clip below the folder of an export; its files are read when they are asked for."""

    out: Path
    files: ClipFiles
    _tables: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    @cached_property
    def views(self) -> dict[str, CosmosView]:
        (row,), where = self.rows("calibration_estimate"), str(self._path("calibration_estimate.parquet"))
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
        where = self._path(TIMES)
        return [frame.timestamp for frame in schema.parse(_Times, read_file(where), str(where), "times of frames").root]

    def boxes(self, name: str, micros: int) -> list[FoundBox]:
        """The boxes of a table, of objects those at an instant; the class of an element says less than ours."""
        track, size = ("trackline_id", "size") if name == "obstacle" else ("map_id", "dimensions")
        rows = [row for row in self.rows(name) if row.get("timestamp_micros", micros) == micros]
        told = ({"id": row[track], "class": row["category"] if name == "obstacle" else None} for row in rows)
        return [
            FoundBox(row[track], _pose(row, "center"), _array(row[size]), of)
            for row, of in zip(rows, told, strict=True)
        ]

    def lines(self, name: str, field: str) -> list[tuple[dict[str, Any], Points3]]:
        """Rows of a table, each with the points of a field."""
        return [(row, _points(row[field])) for row in self.rows(name)]

    def span(self, view: str) -> tuple[float, float]:
        """The least and the greatest nearness that the greys of a depth video stand for (1/m)."""
        where = self._path(DEPTHS)
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

    def _path(self, ending: str) -> Path:
        return self.out / self.files.of_scenario(ending)

    def rows(self, name: str) -> list[dict[str, Any]]:
        """Rows of a table: the values of the key and of the element together."""
        if name not in self._tables:
            where, wanted = self._path(f"{name}.parquet"), TABLES[name]
            with reading_table(str(where), wanted.names):
                table = read_parquet(read_file(where), str(where), BOUNDS)
                if table.schema.names != wanted.names:
                    raise ValueError(f"columns {', '.join(table.schema.names)}")
                rows = [{**row["key"], **row[name]} for row in table.cast(wanted).to_pylist()]
            if any(value is None for row in rows for value in row.values()):
                raise FormatError(f"{where}: expected a value in every field, got none in some")
            self._tables[name] = rows
        return self._tables[name]


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


def _pose(row: dict[str, Any], place: str) -> Matrix4:
    return pose_of(_array(row[place]), [row["orientation"][axis] or 0.0 for axis in "wxyz"])


def _points(points: list[dict[str, float]]) -> Points3:
    return np.array([[point[axis] for axis in "xyz"] for point in points], float).reshape(-1, 3)


def _array(point: dict[str, float]) -> Float[np.ndarray, "3"]:
    return np.array([point[axis] for axis in "xyz"], float)


CAM_FROM_FLU = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
HOST_FROM_RIG = host_from_flu(1.3, 0.0)
"""The rear axle in our host's road frame, as for argoverse2, but on the road."""
DEGREE, GRID, ROUNDS = 5, (41, 31), 30
LIMIT_PX = 1.0
"""How far an f-theta polynomial may be from the camera: 0.4 px for a pinhole of 110 degrees and 1600 columns."""
CRF = 12
"""Finer than a film's: the greys of depth and the edges are data."""
NAME = re.compile("[A-Za-z0-9_-]{1,80}")
NO_TIME = {"timestamp_micros": -1}
WAIT_CATEGORIES = {"stop_line": "STOP", "give_way_line": "YIELD"}
ARROW_CATEGORIES = {
    "arrow_straight": "ROI_POLYGON_DIRECTION_PAINT_FORWARD",
    "arrow_left": "ROI_POLYGON_DIRECTION_PAINT_LEFT",
    "arrow_right": "ROI_POLYGON_DIRECTION_PAINT_RIGHT",
    "arrow_straight_left": "ROI_POLYGON_DIRECTION_PAINT_FORWARD_LEFT",
    "arrow_straight_right": "ROI_POLYGON_DIRECTION_PAINT_FORWARD_RIGHT",
}
SIGN_CATEGORIES = {"stop": "TRAFFIC_SIGN_REGULATORY_R1_STOP", "give_way": "TRAFFIC_SIGN_REGULATORY_R1_YIELD"}
SIGN_CATEGORIES |= {
    kind: "TRAFFIC_SIGN_REGULATORY_R2_SPEED_LIMIT" for kind in get_args(SignKind) if kind.startswith("speed_")
}
# Greatest step back from one point of a line to the next: labels are rounded.
BACK_M = 0.01
CAM_OF_FLU = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
# Pixels, as shares of the image, at which a camera is compared.
SHARES = (0.05, 0.3, 0.5, 0.7, 0.95)
SYMBOLS = {"crosswalk": ["crosswalk"], "wait_line": [*WAIT_CATEGORIES], "road_marking": [*ARROW_CATEGORIES]}
"""The symbols of each table."""

README = """Cosmos: control videos of clips, and their world scenarios as ClipGT tables. A scene is a clip.

- `{train,val,test}/videos/ftheta_VIEW/CLIP.mp4`: what a camera saw; beside them `depth`, `seg`, `edge` and
  `control_input_hdmap_bbox`, the control videos. A camera that is alone is `camera_front_wide_120fov`; those of a rig
  keep their names.
- Videos have the frames of the clip at its own rate, and tables their times. Cosmos's tools interpolate the tables and
  draw 30 frames a second of them: take clips of `--fps 30`, or the lane-map videos here and not those of the tools.
- Depth videos: 1 / depth from black to white, over the least and the greatest of the clip by this camera;
  `CLIP.depth.json` tells these, so that depth_m = 1 / (low + grey / 255 * (high - low)). The sky is black; what is
  nearer than a metre along the viewing direction, as is all behind a fisheye, is as white as that.
- Segmentation videos: a colour for each class, each car one of its own. Edge videos: Canny, thresholds 100 and 200.
- `clipgt/CLIP/CLIP.*.parquet`: poses, calibration, obstacles, lanes, lane lines, road boundaries, crosswalks, road
  markings, wait lines, traffic lights and signs. Frames: x forward, y left, z up, metres; the origin is on the road
  below the rear axle at the first frame. Cameras are f-theta polynomials. `CLIP.camera_front_wide_120fov.json` has the
  times of the frames.
- `map_id` is the id of the line, segment or element in the labels, `trackline_id` that of the object.
"""


def color_name(color: PaintColor | None) -> str:
    """The name of a colour; what has none is white."""
    return (color or "white").upper()


def line_style(marking: Marking, double: bool | None, pair: Pair | None) -> str:
    """How a lane line is painted. ClipGT names a pair from the right of the line's direction."""
    if marking == "none":
        return "VIRTUAL"
    if pair is not None:
        return "DASHED_SOLID" if pair == "solid_dashed" else "SOLID_DASHED"
    return {("solid", False): "SOLID_SINGLE", ("solid", True): "SOLID_GROUP", ("dashed", False): "LONG_DASHED_SINGLE",
            ("dashed", True): "LONG_DASHED_GROUP"}[marking, bool(double)]  # fmt: skip


# Lanes are within this of the labels from above, heights within the slack; painted lines in space.
RULE = MapRule(
    "m",
    0.05,
    slack=0.3,
    word=lambda marking, color, double, pair: f"{line_style(marking, double, pair)} {color_name(color)}",
)


def annotate(frame: SampleFrame) -> FrameAnnotation:
    """The files of a clip, with its first picture."""
    where, shot = frame.where, frame.scene.shot
    if frame.labels.objects is None or frame.labels.traffic_elements is None:
        raise InputError(f"{where}: expected labels with objects and traffic elements, got older ones; generate again")
    if shot.n_frames < 2:
        raise InputError(f"{where}: expected a clip of two frames or more (generate --frames), got a single picture")
    views = {key: _view_name(camera, shot.n_cameras, where) for key, camera in frame.cameras.items()}
    files = ClipFiles(frame.part, f"{frame.split}-{frame.key}")
    every = (picture.labels for key in views for picture in frame.pictures(key))
    around = scenario(resolve(frame.scene), frame.labels, every)
    clip_from_world = invert(world_from_vehicle(frame.labels.camera, frame.scene, HOST_FROM_RIG))
    depths, own = dict[str, Any](), dict[str, str | bytes]()
    for key, view in views.items():
        depths[view], videos = _videos(partial(frame.pictures, key), around, shot.fps)
        own |= {files.video(kind, view): data for kind, data in videos.items()}
    rows = {"calibration_estimate": [_calibration(frame, views, where)], **_moving(frame, clip_from_world)}
    rows |= _still(around, clip_from_world)
    own |= {files.of_scenario(f"{name}.parquet"): _table(name, rows[name], files.clip) for name in TABLES}
    times = [{"timestamp": round(picture.scene.shot.time_s * 1e6)} for picture in frame.pictures(frame.key)]
    own |= {files.of_scenario(TIMES): json.dumps(times), files.of_scenario(DEPTHS): json.dumps(depths)}
    return FrameAnnotation(None, len(around.lines), files=own)


def _view_name(camera: CameraLabel, n_cameras: int, where: str) -> str:
    if n_cameras == 1:
        return FRONT_VIEW
    name = camera.name.replace(":", "_")
    if not NAME.fullmatch(name):
        raise InputError(f"{where}: expected a camera's name of letters, digits, - and _, got {camera.name!r:.80}")
    return name if name.startswith("camera_") else f"camera_{name}"


def _videos(
    pictures: Callable[[], Iterator[SourceSample]], around: Scenario, rate_hz: float
) -> tuple[dict[str, float], dict[str, bytes]]:
    """The span of the depth video of a view, and all of its videos by their kinds."""
    spans = np.array([nearness_span(picture.passes) for picture in pictures()])
    span = float(spans[:, 0].min()), float(spans[:, 1].max())
    streams = {kind: io.BytesIO() for kind in FOLDERS}
    with ExitStack() as stack:
        out = {kind: stack.enter_context(mp4(kind, stream, rate_hz, CRF)) for kind, stream in streams.items()}
        for picture in pictures():
            for kind, video in out.items():
                video.add(DRAWN[kind](picture, around, span))
    return {"low": span[0], "high": span[1]}, {kind: stream.getvalue() for kind, stream in streams.items()}


def _calibration(frame: SampleFrame, views: Mapping[str, str], where: str) -> dict[str, Any]:
    """The cameras' lenses and places, in the form of DriveWorks."""
    sensors = []
    for key, view in views.items():
        first = next(iter(frame.pictures(key)))
        camera = first.labels.camera
        (fx, _, cx), (_, fy, cy), _ = (camera.img_from_cam @ CV_FROM_CAM.T).tolist()
        rig_from_cam = invert(world_from_vehicle(camera, first.scene, HOST_FROM_RIG)) @ camera.world_from_cam
        turn = rig_from_cam[:3, :3] @ CAM_FROM_FLU
        yaw, pitch = np.arctan2(turn[1, 0], turn[0, 0]), np.arcsin(np.clip(-turn[2, 0], -1, 1))
        roll = np.arctan2(turn[2, 1], turn[2, 2])
        properties = {
            "Model": "ftheta", "cx": repr(cx), "cy": repr(cy), "width": str(camera.width_px),
            "height": str(camera.height_px), "polynomial": " ".join(map(repr, fitted(camera, where))),
            "polynomial-type": "angle-to-pixeldistance", "linear-c": repr(fx / fy), "linear-d": "0.0",
            "linear-e": "0.0",
        }  # fmt: skip
        place = {"t": rig_from_cam[:3, 3].tolist(), "roll-pitch-yaw": np.degrees([roll, pitch, yaw]).tolist()}
        sensors.append({"name": view.replace("_", ":"), "properties": properties, "nominalSensor2Rig_FLU": place})
    return {"name": "synth3dlanes", "rig_json": json.dumps({"rig": {"sensors": sensors}})}


def fitted(camera: CameraLabel, where: str) -> tuple[float, ...]:
    """The coefficients of rising powers by which the angle of a ray gives its distance from the principal point (px):
    least squares over the image, weighted towards the worst places. Raises InputError for a camera that is farther than
    LIMIT_PX from all of these."""
    (fx, _, cx), (_, fy, cy), _ = camera.img_from_cam @ CV_FROM_CAM.T
    steps = (np.linspace(0.0, size, n) for size, n in zip((camera.width_px, camera.height_px), GRID, strict=True))
    uv = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    rays = camera.rays(uv)
    known = np.isfinite(rays).all(axis=1)
    uv, rays = uv[known], rays[known]
    angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 2]), rays[:, 1])
    radius = np.hypot((uv[:, 0] - cx) * fy / fx, uv[:, 1] - cy)
    powers, weights = angle[:, None] ** np.arange(1, DEGREE + 1), np.ones(len(angle))
    for _ in range(ROUNDS):
        factors = np.linalg.lstsq(powers * weights[:, None], radius * weights, rcond=None)[0]
        apart = np.abs(powers @ factors - radius)
        weights *= np.sqrt(1 + apart / max(apart.max(), 1e-12))
    factors = np.array([float(f"{factor:.8g}") for factor in factors])  # the rest depends on threads and processors
    aside = rays[:, [0, 2]] * [1, -1] / np.maximum(np.hypot(rays[:, 0], rays[:, 2]), 1e-12)[:, None]
    found = aside * (powers @ factors)[:, None] * [fx / fy, 1] + [cx, cy]
    worst_px = float(np.linalg.norm(found - uv, axis=1).max())
    if not worst_px <= LIMIT_PX:
        raise InputError(
            f"{where}: expected a camera that an f-theta polynomial follows within {LIMIT_PX:g} px, got"
            f" {camera.name or 'one'} that it misses by {worst_px:.1f} px"
        )
    return (0.0, *factors.tolist())


def _moving(frame: SampleFrame, clip_from_world: Matrix4) -> dict[str, list[dict[str, Any]]]:
    """Rows of the host's poses and of all objects of classes that Cosmos has, at all frames."""
    poses, boxes = list[dict[str, Any]](), list[dict[str, Any]]()
    for picture in frame.pictures(frame.key):
        camera, micros = picture.labels.camera, round(picture.scene.shot.time_s * 1e6)
        pose = clip_from_world @ world_from_vehicle(camera, picture.scene, HOST_FROM_RIG)
        told = {"location": _xyz(pose[:3, 3]), "orientation": _xyzw(pose)}
        poses.append({"timestamp_micros": micros, "name": "synth3dlanes", **told})
        for item in objects_of(picture.labels, CATEGORIES):
            width_m, length_m, height_m = item.size_m.tolist()
            placed = clip_from_world @ camera.world_from_cam @ item.cam_from_object
            boxes.append(
                {
                    "timestamp_micros": micros,
                    "trackline_id": str(item.id),
                    "center": _xyz(placed[:3, 3]),
                    "size": _xyz((length_m, width_m, height_m)),
                    "orientation": _xyzw(with_flu_axes(placed)),
                    "category": CATEGORIES[item.category],
                }
            )
    return {"egomotion_estimate": poses, "obstacle": boxes}


def _still(around: Scenario, clip_from_world: Matrix4) -> dict[str, list[dict[str, Any]]]:
    def points(points_world: Points3) -> list[dict[str, float]]:
        return [_xyz(point) for point in transform(clip_from_world, points_world)]

    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in TABLES}
    for lane in around.lanes:
        row: dict[str, Any] = {"map_id": lane.id}
        for side, boundary in (("left", lane.left), ("right", lane.right)):
            style, n = line_style(boundary.marking, boundary.double, boundary.pair), len(boundary.points_world) - 1
            row |= {f"{side}_rail": points(boundary.points_world), f"{side}_edge_styles": [style] * n}
            row[f"{side}_edge_colors"] = [color_name(boundary.color)] * n
        rows["lane"].append(row)
    for name, line in around.lines.items():
        n, style = len(line.points_world), line_style(line.marking, line.double, line.pair)
        paint = {"styles": [style] * n, "colors": [color_name(line.color)] * n}
        rows["lane_line"].append({"map_id": name, "line_rail": points(line.points_world), **paint})
    rows["road_boundary"] = [{"category": "road_boundary", "location": points(edge)} for edge in around.edges]
    for kind, outline in around.symbols:
        if kind == "crosswalk":
            rows["crosswalk"].append({"category": "PEDESTRIAN", "location": points(outline)})
        elif kind in WAIT_CATEGORIES:
            told = {"category": WAIT_CATEGORIES[kind], "is_implicit": False}
            rows["wait_line"].append({**told, "location": points(outline)})
        elif kind in ARROW_CATEGORIES:
            rows["road_marking"].append({"category": ARROW_CATEGORIES[kind], "location": points(outline)})
    for label, world_from_element in around.elements:
        placed = clip_from_world @ world_from_element
        width_m, depth_m, height_m = label.size_m.tolist()
        box = {"map_id": str(label.id), "center": _xyz(placed[:3, 3]), "orientation": _xyzw(with_flu_axes(placed))}
        box["dimensions"] = _xyz((depth_m, width_m, height_m))
        table = ELEMENTS[label.category]
        category = SIGN_CATEGORIES.get(label.kind or "", "TRAFFIC_SIGN_INFORMATION") if label.state is None else table
        rows[table].append({**box, "category": category})
    return {name: rows[name] for name in TABLES if name not in MOVING}


def _xyz(values: Sequence[float] | np.ndarray) -> dict[str, float]:
    return {axis: float(value) for axis, value in zip("xyz", values, strict=True)}


def _xyzw(pose: Matrix4) -> dict[str, float]:
    w, *xyz = quaternion(pose[:3, :3]).tolist()
    return {**_xyz(xyz), "w": w}


def _table(name: str, rows: Sequence[Mapping[str, Any]], clip: str) -> bytes:
    """A table of rows whose values are those of its key or of its element, by their names."""
    schema = TABLES[name]
    keys, fields = ([field.name for field in schema.field(part).type] for part in ("key", name))
    nested = [
        {
            "key": {key: clip if key == "clip_id" else row.get(key, NO_TIME.get(key, "")) for key in keys},
            name: {field: row[field] for field in fields},
            "version": VERSION,
        }
        for row in rows
    ]
    return encoded(lambda stream: parquet.write_table(pa.Table.from_pylist(nested, schema=schema), stream))


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    return of_parts(out, "clip", lambda part: _clips(out, part, most_frames))


def _clips(out: Path, part: str, most: int) -> Iterator[ReadFrame]:
    for folder in sorted(path for path in (out / part / "clipgt").glob("*") if path.is_dir())[:most]:
        files = ClipFiles(part, folder.name)
        name = files.of_scenario("egomotion_estimate.parquet")
        yield ReadFrame(name, str(out / part / "clipgt" / folder.name), None, CosmosClip(out, files))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Every picture of a clip; with the first ones what stands still, and the videos."""
    clip: CosmosClip = frame.content
    found, views = Comparison(), {name: _pictures(name, truth) for name in clip.views}
    around = scenario(resolve(truth.scene), truth.labels, (at.labels for every in views.values() for at in every))
    for name, view in clip.views.items():
        if not views[name]:
            found = found.because([f"view {name}: expected a camera of the data set, got none of this name"])
            continue
        found += _compared_view(clip, name, view, views[name], around)
    if not any(truth.place == picture.place for pictures in views.values() for picture in pictures[:1]):
        found = found.because([f"expected a view of {truth.labels.camera.name or FRONT_VIEW}, got none"])
    return found


def _pictures(view: str, truth: SourceSample) -> list[SourceSample]:
    """The pictures of the scene by the camera of a view, in order."""
    reader, cameras = truth.reader, truth.reader.cameras
    named = {f"camera_{camera.name.replace(':', '_').removeprefix('camera_')}": i for i, camera in enumerate(cameras)}
    number = named.get(view) if len(cameras) > 1 else 0 if view == FRONT_VIEW else None
    if number is None:
        return []
    return [SourceSample(reader, place) for place in reader.clip(int(reader.scene_of[truth.place]), number)]


def _compared_view(
    clip: CosmosClip, name: str, view: CosmosView, pictures: list[SourceSample], around: Scenario
) -> Comparison:
    micros = [round(1e6 * picture.scene.shot.time_s) for picture in pictures]
    problems = [
        f"expected {what} at {_shown(micros)} microseconds, got {_shown(got)}"
        for what, got in (("times", clip.times), ("poses", list(clip.poses)))
        if got != micros
    ]
    if problems:
        return Comparison(problems=tuple(problems))
    camera = pictures[0].labels.camera
    compared = compare_camera(name, camera, lambda at: view.project(at @ CAM_FROM_FLU), LIMIT_PX, SHARES, view.size_px)
    for number, (at, picture) in enumerate(zip(micros, pictures, strict=True)):
        cam_from_clip = CAM_OF_FLU @ invert(view.rig_from_flu) @ invert(clip.poses[at])
        here = _lines(clip, cam_from_clip, picture) + _objects(clip, at, cam_from_clip, picture)
        if number == 0:
            here += _mapped(clip, cam_from_clip, picture)
        told = tuple(f"{name} frame {number}: {problem}" for problem in here.problems)
        named = tuple(replace(gap, name=f"{name} {number} {gap.name}") for gap in here.gaps)
        compared += replace(here, gaps=named, problems=told)
    return compared.because(video_problems(clip, name, pictures, around))


def video_problems(
    clip: CosmosClip, view: str, pictures: list[SourceSample], around: Scenario, kinds: Iterable[str] = FOLDERS
) -> Iterator[str]:
    """Findings in the videos of a view."""
    rate_hz, span = pictures[0].scene.shot.fps, clip.span(view)
    for kind in kinds:
        path, n = clip.files.video(kind, view), 0
        for frame in clip.frames(kind, view, rate_hz):
            n += 1
            if n > len(pictures):
                break
            picture = pictures[n - 1]
            height, width = picture.image.shape[:2]
            if frame.shape != (height + height % 2, width + width % 2, 3):
                yield f"{path}: frame {n - 1}: expected {width}x{height} pixels, got {frame.shape[1]}x{frame.shape[0]}"
                break
            expected = DRAWN[kind](picture, around, span).astype(np.float32)
            problem = frame_problem(frame[:height, :width], expected, GREYS[kind])
            if problem:
                yield f"{path}: frame {n - 1}: {problem}"
        if n != len(pictures):
            yield f"{path}: expected {len(pictures)} frames, got {'more' if n > len(pictures) else n}"


def _lines(clip: CosmosClip, cam_from_clip: Matrix4, picture: SourceSample) -> Comparison:
    """Painted lines by the ids of the delimiters, in space, with their paint and direction."""
    lines = {row["map_id"]: (row, points) for row, points in clip.lines("lane_line", "line_rail")}
    gaps, problems = [], list[str]()
    for lane in picture.labels.lanes:
        if lane.kind != "delimiter" or lane.marking == "none" or len(lane.xyz_cam) < 2:
            continue
        row, points = lines.get(lane.id, ({}, np.zeros((0, 3))))
        if len(points) < 2:
            others = (transform(cam_from_clip, line) for _, line in lines.values() if len(line) > 1)
            apart = min((float(distances(lane.xyz_cam, line).max()) for line in others), default=np.inf)
            problems.append(f"line {lane.id}: expected it in lane_line, got none nearer than {apart:.3g} m")
            continue
        ours = transform(cam_from_clip, points)
        gaps.append(Gap.of(lane.id, "m", distances(lane.xyz_cam, ours)))
        back = back_along(lane.xyz_cam, ours, RULE.limit)
        if not back <= BACK_M:
            problems.append(f"line {lane.id}: expected points as in the labels, got them {back:.3g} m back")
        expected = (line_style(lane.marking, lane.double, lane.pair), color_name(lane.color))
        got = {*zip(row["styles"], row["colors"], strict=False)}
        if got != {expected} or len(row["styles"]) != len(points):
            problems.append(f"line {lane.id}: expected {' '.join(expected)} at each point, got {sorted(got)[:3]}")
    return Comparison.within(gaps, {"m": RULE.limit}).because(problems)


def _objects(clip: CosmosClip, micros: int, cam_from_clip: Matrix4, picture: SourceSample) -> Comparison:
    """Corners of the boxes of an instant, and of traffic lights and signs, of which those of other pictures of the clip
    are left out; their ids, and the class of objects."""
    compared, elements = Comparison(), picture.labels.traffic_elements or ()
    tables = {name: [item for item in elements if ELEMENTS[item.category] == name] for name in ELEMENTS.values()}
    for table, items in {**tables, "obstacle": objects_of(picture.labels, CATEGORIES)}.items():
        word, ids = "object" if table == "obstacle" else table.replace("_", " "), {str(item.id) for item in items}
        compared += compare_boxes(
            (box for box in clip.boxes(table, micros) if table == "obstacle" or box.track in ids),
            items,
            lambda item: {"id": str(item.id), "class": CATEGORIES.get(item.category)},
            cam_from_clip,
            str(clip.files.clip),
            (word, word),
        )
    # Tracks are ids of the labels, which are those of each clip alone.
    return replace(compared, tracks={})


def _mapped(clip: CosmosClip, cam_from_clip: Matrix4, picture: SourceSample) -> Comparison:
    """Lanes by their segments of the lane graph, with their rails and the paint of these; crosswalks, arrows and lines
    across the road."""
    world_from_clip, found = picture.labels.camera.world_from_cam @ cam_from_clip, []
    left, right = clip.lines("lane", "left_rail"), clip.lines("lane", "right_rail")
    for (row, one), (_, other) in zip(left, right, strict=True):
        if len(one) != len(other) or len(one) < 2:
            text = f"lane {row['map_id']}: expected rails of as many points, got {len(one)} and {len(other)}"
            return Comparison(problems=(text,))
        sides = {side: transform(world_from_clip, rail) for side, rail in (("left", one), ("right", other))}
        # The paint of a line, whose points should have one.
        words = {side: (row[f"{side}_edge_styles"], row[f"{side}_edge_colors"]) for side in sides}
        paint = {side: " ".join(", ".join(sorted({*of})) for of in both) for side, both in words.items()}
        found.append(FoundLane(row["map_id"], row["map_id"], middle_of(*sides.values()), sides, paint))
    compared = compare_lanes(found, picture, RULE)
    for table, kinds in SYMBOLS.items():
        outlines = [transform(world_from_clip, points) for _, points in clip.lines(table, "location")]
        compared = compared.because(symbol_problems(table, outlines, picture, kinds, RULE.limit))
    return compared


def _shown(times: list[int]) -> str:
    return f"{times[:3]}... ({len(times)})" if len(times) > 3 else str(times)


FORMAT = SampleFormat(
    title="Cosmos: control videos and the world scenario of a clip",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit, "px": LIMIT_PX},
    passes=("depth", "semantic", "instance"),
    is_per_scene=True,
)
