"""Write a clip for Cosmos: with the first picture of a scene the tables of its world scenario, and for each of its
cameras the video and its control videos."""

import io
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, get_args

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from synth3dlanes.formats.comparing import SourceSample
from synth3dlanes.formats.cosmos.controls import depth_picture, edge_picture, nearness_span, seg_picture
from synth3dlanes.formats.cosmos.convention import (
    CAM_FROM_FLU,
    CATEGORIES,
    FOLDERS,
    FRONT_VIEW,
    HOST_FROM_RIG,
    TABLES,
    VERSION,
    ClipFiles,
    line_style,
)
from synth3dlanes.formats.cosmos.drawing import lane_map_picture
from synth3dlanes.formats.cosmos.ftheta import fitted
from synth3dlanes.formats.cosmos.scenario import Scenario, scenario
from synth3dlanes.formats.format import SampleFrame
from synth3dlanes.formats.lane_map import Boundary
from synth3dlanes.formats.writing import FrameAnnotation, world_from_host
from synth3dlanes.geometry.frames import invert, quaternion, transform
from synth3dlanes.imaging.video import mp4
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.traffic_elements import SignKind
from synth3dlanes.system.arrays import Matrix4, Points3
from synth3dlanes.system.errors import InputError
from synth3dlanes.world.world import resolve

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

CRF = 12
"""Finer than a film's: the greys of depth and the edges are data."""
NAME = re.compile("[A-Za-z0-9_-]{1,80}")
MOVING = ("calibration_estimate", "egomotion_estimate", "obstacle")
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


def annotate(frame: SampleFrame) -> FrameAnnotation:
    """The files of a clip, with its first picture."""
    where, shot = f"{frame.split}:{frame.key}", frame.scene.shot
    if frame.labels.objects is None or frame.labels.traffic_elements is None:
        raise InputError(f"{where}: expected labels with objects and traffic elements, got older ones; generate again")
    if shot.n_frames < 2:
        raise InputError(f"{where}: expected a clip of two frames or more (generate --frames), got a single picture")
    views = {key: _view(camera, shot.n_cameras, where) for key, camera in frame.cameras.items()}
    files = ClipFiles(frame.part, f"{frame.split}-{frame.key}")
    every = (picture.labels for key in views for picture in frame.pictures(key))
    around = scenario(resolve(frame.scene), frame.labels, every)
    clip_from_world = invert(_world_from_rig(frame.labels.camera, frame.scene))
    depths, own = dict[str, Any](), dict[str, str | bytes]()
    for key, view in views.items():
        depths[view], videos = _videos(partial(frame.pictures, key), around, shot.fps)
        own |= {files.video(kind, view): data for kind, data in videos.items()}
    rows = {"calibration_estimate": [_calibration(frame, views, where)], **_moving(frame, clip_from_world)}
    rows |= _still(around, clip_from_world)
    own |= {files.table(name): _table(name, rows[name], files.clip) for name in TABLES}
    times = [{"timestamp": _micros(picture.scene)} for picture in frame.pictures(frame.key)]
    own |= {files.times: json.dumps(times), files.depths: json.dumps(depths)}
    return FrameAnnotation(None, len(around.lines), files=own)


def _view(camera: CameraLabel, n_cameras: int, where: str) -> str:
    """The name of a camera's videos."""
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
            out["rgb"].add(picture.image)
            out["depth"].add(depth_picture(picture.passes, span))
            out["seg"].add(seg_picture(picture.passes))
            out["edge"].add(edge_picture(picture.image))
            out["hdmap"].add(lane_map_picture(picture, around))
    return {"low": span[0], "high": span[1]}, {kind: stream.getvalue() for kind, stream in streams.items()}


def _world_from_rig(camera: CameraLabel, scene: Scene) -> Matrix4:
    return np.asarray(world_from_host(camera, scene.camera.right_m, scene.camera.forward_m) @ HOST_FROM_RIG)


def _calibration(frame: SampleFrame, views: Mapping[str, str], where: str) -> dict[str, Any]:
    """The cameras' lenses and places, in the form of DriveWorks."""
    sensors = []
    for key, view in views.items():
        first = next(iter(frame.pictures(key)))
        camera = first.labels.camera
        lens, rig_from_cam = fitted(camera, where), invert(_world_from_rig(camera, first.scene)) @ camera.world_from_cam
        turn = rig_from_cam[:3, :3] @ CAM_FROM_FLU
        yaw, pitch = np.arctan2(turn[1, 0], turn[0, 0]), np.arcsin(np.clip(-turn[2, 0], -1, 1))
        roll = np.arctan2(turn[2, 1], turn[2, 2])
        properties = {
            "Model": "ftheta", "cx": repr(lens.cx_px), "cy": repr(lens.cy_px), "width": str(camera.width_px),
            "height": str(camera.height_px), "polynomial": " ".join(map(repr, lens.polynomial)),
            "polynomial-type": "angle-to-pixeldistance", "linear-c": repr(lens.stretch), "linear-d": "0.0",
            "linear-e": "0.0",
        }  # fmt: skip
        place = {"t": rig_from_cam[:3, 3].tolist(), "roll-pitch-yaw": np.degrees([roll, pitch, yaw]).tolist()}
        sensors.append({"name": view.replace("_", ":"), "properties": properties, "nominalSensor2Rig_FLU": place})
    return {"name": "synth3dlanes", "rig_json": json.dumps({"rig": {"sensors": sensors}})}


def _moving(frame: SampleFrame, clip_from_world: Matrix4) -> dict[str, list[dict[str, Any]]]:
    """Rows of the host's poses and of all cars, at all frames."""
    poses, boxes = list[dict[str, Any]](), list[dict[str, Any]]()
    for picture in frame.pictures(frame.key):
        camera, micros = picture.labels.camera, _micros(picture.scene)
        pose = clip_from_world @ _world_from_rig(camera, picture.scene)
        told = {"location": _xyz(pose[:3, 3]), "orientation": _xyzw(pose)}
        poses.append({"timestamp_micros": micros, "name": "synth3dlanes", **told})
        for item in picture.labels.objects or ():
            width_m, length_m, height_m = item.size_m.tolist()
            placed = clip_from_world @ camera.world_from_cam @ item.cam_from_object
            boxes.append(
                {
                    "timestamp_micros": micros,
                    "trackline_id": str(item.id),
                    "center": _xyz(placed[:3, 3]),
                    "size": _xyz((length_m, width_m, height_m)),
                    "orientation": _xyzw(_flu(placed)),
                    "category": CATEGORIES[item.category],
                }
            )
    return {"egomotion_estimate": poses, "obstacle": boxes}


def _still(around: Scenario, clip_from_world: Matrix4) -> dict[str, list[dict[str, Any]]]:
    """Rows of what stands still."""

    def points(points_world: Points3) -> list[dict[str, float]]:
        return [_xyz(point) for point in transform(clip_from_world, points_world)]

    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in TABLES}
    for lane in around.lanes:
        row: dict[str, Any] = {"map_id": lane.id}
        for side, boundary in (("left", lane.left), ("right", lane.right)):
            row |= {f"{side}_rail": points(boundary.points_world), **_edge_paint(side, boundary)}
        rows["lane"].append(row)
    for line in around.lines:
        n, style = len(line.points_world), line_style(line.marking, line.double, line.pair)
        paint = {"styles": [style] * n, "colors": [line.color.upper()] * n}
        rows["lane_line"].append({"map_id": line.id, "line_rail": points(line.points_world), **paint})
    rows["road_boundary"] = [{"category": "road_boundary", "location": points(edge)} for edge in around.edges]
    for symbol in around.symbols:
        location = points(symbol.points_world)
        if symbol.kind == "crosswalk":
            rows["crosswalk"].append({"category": "PEDESTRIAN", "location": location})
        elif symbol.kind in WAIT_CATEGORIES:
            told = {"category": WAIT_CATEGORIES[symbol.kind], "is_implicit": False}
            rows["wait_line"].append({**told, "location": location})
        elif symbol.kind in ARROW_CATEGORIES:
            rows["road_marking"].append({"category": ARROW_CATEGORIES[symbol.kind], "location": location})
    for element in around.elements:
        label, placed = element.label, clip_from_world @ element.world_from_element
        width_m, depth_m, height_m = label.size_m.tolist()
        box = {"map_id": str(label.id), "center": _xyz(placed[:3, 3]), "orientation": _xyzw(_flu(placed))}
        box["dimensions"] = _xyz((depth_m, width_m, height_m))
        is_sign = label.category == "road_sign"
        category = SIGN_CATEGORIES.get(label.kind, "TRAFFIC_SIGN_INFORMATION") if is_sign else "traffic_light"
        rows["traffic_sign" if is_sign else "traffic_light"].append({**box, "category": category})
    return {name: rows[name] for name in TABLES if name not in MOVING}


def _edge_paint(side: str, boundary: Boundary) -> dict[str, list[str]]:
    style = line_style(boundary.marking, boundary.double, boundary.pair)
    n = len(boundary.points_world) - 1
    return {f"{side}_edge_styles": [style] * n, f"{side}_edge_colors": [(boundary.color or "white").upper()] * n}


def _micros(scene: Scene) -> int:
    return round(scene.shot.time_s * 1e6)


def _flu(pose: Matrix4) -> Matrix4:
    """A pose with its axes forward, left, up in place of right, forward, up."""
    turned = pose.copy()
    turned[:3, :3] = pose[:3, :3] @ CAM_FROM_FLU
    return turned


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
    stream = io.BytesIO()
    parquet.write_table(pa.Table.from_pylist(nested, schema=schema), stream)
    return stream.getvalue()
