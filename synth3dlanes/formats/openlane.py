"""OpenLane v1: lane lines and kerbs in 3D with their categories, one JSON a frame, image 1920x1280.

| theirs | ours | unit, frame |
|---|---|---|
| `xyz` | delimiters and kerbs, near to far | m, camera with Waymo's axes (`_waymo`): x forward, y left, z up |
| `uv` | the projections of visible points | px |
| `category` | marking, colour, double, pair (PAINTS); kerbs left and right | |
| `attribute` | the two nearest lines on either side, 1 to 4 from the left | |
| `track_id` | the lane's id in a clip | |
| `extrinsic` | vehicle_from_camera in these axes, from the camera's foot on the road | m |
"""

import json
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field, model_validator

from synth3dlanes.formats.comparing import (
    NEAR_START_M,
    Comparison,
    ExportView,
    FoundLines,
    Gap,
    Rule,
    SourceSample,
    compare_lines,
    distances,
    pixels,
    places_beside,
)
from synth3dlanes.formats.format import FrameList, PinholeFormat, Rates, ReadFrame
from synth3dlanes.formats.lines import LaneAhead, ego_places, keep_lines, lines_ahead
from synth3dlanes.formats.reading import (
    UNKNOWN,
    ForeignLane,
    ForeignSample,
    JsonLine,
    image_size,
    labels_of,
    listed_files,
    read_file,
    read_image,
    read_text,
)
from synth3dlanes.formats.scoring import EVERY, OPENLANE, Line3d, LinePair, line_score, scored
from synth3dlanes.formats.writing import CV_FROM_CAM, POINT_DECIMALS, FrameAnnotation, Pinhole, PinholeFrame
from synth3dlanes.labels.labels import Labels, Lane, Marking, PaintColor, Pair
from synth3dlanes.system import schema
from synth3dlanes.system.arrays import Matrix4, Polyline2, Polyline3
from synth3dlanes.system.json_arrays import JsonMatrix3, JsonMatrix4
from synth3dlanes.system.schema import Excerpt, Number, PathBelow

CAMERA = Pinhole(1920, 1280, 2015.0)
PAINTS: dict[int, tuple[Marking, PaintColor, bool, Pair | None]] = {
    1: ("dashed", "white", False, None),
    2: ("solid", "white", False, None),
    3: ("dashed", "white", True, None),
    4: ("solid", "white", True, None),
    5: ("solid", "white", True, "dashed_solid"),
    6: ("solid", "white", True, "solid_dashed"),
    7: ("dashed", "yellow", False, None),
    8: ("solid", "yellow", False, None),
    9: ("dashed", "yellow", True, None),
    10: ("solid", "yellow", True, None),
    11: ("solid", "yellow", True, "dashed_solid"),
    12: ("solid", "yellow", True, "solid_dashed"),
}
"""Marking, colour, whether the line is double, and its stripes if they differ, by the field `category`."""
KERB_LEFT, KERB_RIGHT = 20, 21
CASES = {
    "curve": "1000_curve.txt",
    "extreme_weather": "1000_extreme_weather.txt",
    "intersection": "1000_intersection.txt",
    "merge_split": "1000_merge_split_case.txt",
    "night": "1000_night.txt",
    "up_down": "1000_updown.txt",
}
"""The lists that evaluation scripts open, by kind of scene."""
WAYMO_FROM_CAM = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
MAX_LINES = 20
MIN_LENGTH_M = 5.0
POINT_STEP_M = 0.5
FRAMES_PER_SEGMENT = 100
UV_DECIMALS = 4
# Points between those of the labels lie on a spline.
RULE = Rule("m", 0.001, most=20, slack=0.2)
# Pixels have four decimals.
TOLERANCE_PX = 0.001

README = """OpenLane v1 layout.

- `images/{training,validation}/segment-*_with_camera_labels/`. Loaders assume 1920x1280 unless they are told another
  size. Intrinsics per frame: c in the middle of the image (pixel corners at whole numbers); f = 2015 for a width of
  1920, or longer where the frame's own field of view is narrower than that.
- `lane3d_1000/{training,validation}/segment-*/`: one JSON a frame, on one line. Test frames are in `validation`, or in
  `test` beside the cases where the data set has val frames too.
- Lists: `lists/*.txt`, and `data_lists/*.txt` for Anchor3DLane; `lane3d_1000/test/1000_*.txt` with copies of the labels
  in `lane3d_1000/test/*_case/`. docs/exports.md has the rules by which a frame is in them.
- `xyz`: 3 x n, metres, camera frame with Waymo axes (x forward, y left, z up), every 0.5 m or closer, near to far
  from the image border. `extrinsic`: vehicle_from_camera in the same axes, the vehicle's origin at the camera's foot
  on the road plane. `uv`: exact projections of the visible points, in their order.
- `visibility` is a prefix: terrain hides lanes, cars do not. `category`: 1 white dashed, 2 white solid, 3 and 4 the
  same doubled, 5 and 6 double with the left or the right stripe dashed and the other solid, 7 to 12 the same six in
  yellow, 20 and 21 kerbs on the left and right. `attribute`: 1 to 4 = the lines left-left, left, right, right-right of
  the camera, 0 all others.
- A clip of one camera is a segment, in which a line keeps its `track_id`. Single pictures are scenes of their own, 100
  of them in a segment: no id occurs in two of them.
- Centre lines are not part of the format. PersFormer caches `.cache/*.pkl` by name: delete it after exporting again.
"""


def vehicle_from_cam_waymo(height_m: float, pitch_rad: float) -> Matrix4:
    """The field `extrinsic`, the vehicle's origin at the camera's foot on the road plane: pitched about the left axis,
    then raised by the height."""
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    return np.array([[c, 0, s, 0], [0, 1.0, 0, 0], [-s, 0, c, height_m], [0, 0, 0, 1]])


def ground_from_waymo(
    points_waymo: Float[np.ndarray, "n 3"], vehicle_from_cam: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "n 3"]:
    """The frame of OpenLane's evaluator: x right, y forward, z up, origin exactly under the camera."""
    points_vehicle = points_waymo @ vehicle_from_cam[:3, :3].T + np.array([0.0, 0.0, vehicle_from_cam[2, 3]])
    return np.asarray(points_vehicle @ WAYMO_FROM_CAM)


def write(frame: PinholeFrame) -> FrameAnnotation:
    """The frame's label file, copies for the test cases that it belongs to, and its list entries."""
    labels, dropped = frame.labels, Counter[str]()
    folder = "training" if frame.is_train else "validation" if frame.serves_as("val") else "test"
    segment, track_ids = _segment(frame)
    # Loaders look for "/segment-(.*)_with_camera_labels"; they cut at the first dot and replace every "jpg".
    name = f"segment-{segment}_with_camera_labels/{frame.split}-{frame.key}"
    file_path = f"{folder}/{name}.jpg"
    ahead = lines_ahead(labels, frame.pinhole, "delimiter", POINT_STEP_M)
    kerbs = lines_ahead(replace(labels, lanes=frame.kerbs), frame.pinhole, "delimiter", POINT_STEP_M)
    lines = _kept((*ahead, *kerbs), dropped)
    attributes = ego_places(ahead, labels.camera)
    document = {
        "extrinsic": np.round(vehicle_from_cam_waymo(labels.camera.height_m, labels.camera.pitch_rad), 12).tolist(),
        "intrinsic": frame.pinhole.img_from_cv.tolist(),
        "lane_lines": [
            _line_document(line, frame, attributes.get(line.id, 0), track_ids(i, line.id))
            for i, line in enumerate(lines)
        ],
        "file_path": file_path,
    }
    text = json.dumps(document)
    files, listed = {f"lane3d_1000/{folder}/{name}.json": text}, [f"lists/{folder}.txt"]
    for case in [case for case in CASES if case in frame.tags and not frame.is_train]:
        files[f"lane3d_1000/test/{case}_case/{name}.json"] = text
        listed.append(f"lane3d_1000/test/{CASES[case]}")
    # Anchor3DLane has no cache of training frames without lanes.
    cached = (f"data_lists/{folder}.txt",) if lines or not frame.is_train else ()
    shared = ((file_path, tuple(sorted(listed))), (f"{folder}/{name}", cached))
    return FrameAnnotation(f"images/{file_path}", len(lines), dropped, files, shared)


def _segment(frame: PinholeFrame) -> tuple[str, Callable[[int, str], int]]:
    """The name of the frame's segment, and the track of line i, of this id, in it."""
    if frame.clip is not None:
        return f"{frame.clip:08d}", lambda _, line_id: zlib.crc32(line_id.encode()) >> 1
    segment, place = divmod(frame.number, FRAMES_PER_SEGMENT)
    return f"{segment:06d}", lambda i, _: place * (MAX_LINES + 1) + i + 1


def category(lane: Lane) -> int:
    """The number of the line's paint, 0 if unknown. Older labels have no colour: their lines count as single and
    white."""
    paint = (lane.marking, lane.color or "white", bool(lane.double), lane.pair)
    return next((number for number, other in PAINTS.items() if other == paint), 0)


def _kept(ahead: tuple[LaneAhead, ...], dropped: Counter[str]) -> tuple[LaneAhead, ...]:
    kept = []
    for line in ahead:
        entered = np.flatnonzero(line.in_view & line.visible)
        line = line.part(slice(int(entered[0]), None)) if len(entered) else line
        length_m = np.linalg.norm(np.diff(line.points_cv[line.visible], axis=0), axis=1).sum()
        if len(entered) and length_m < MIN_LENGTH_M:
            dropped[f"its visible part is shorter than {MIN_LENGTH_M:g} m (Anchor3DLane drops those)"] += 1
        else:
            kept.append(line)
    return keep_lines(kept, dropped, MAX_LINES, f"beyond the {MAX_LINES} nearest (Anchor3DLane drops such frames)")


def _line_document(line: LaneAhead, frame: PinholeFrame, attribute: int, track_id: int) -> dict[str, Any]:
    points_cv = np.round(line.points_cv, POINT_DECIMALS)
    kerb = KERB_LEFT if line.points_cv[0, 0] < 0 else KERB_RIGHT
    return {
        "category": kerb if line.lane in frame.kerbs else category(line.lane),
        "visibility": line.visible.astype(float).tolist(),
        "uv": np.round(frame.pinhole.project(points_cv[line.visible]), UV_DECIMALS).T.tolist(),
        "xyz": (points_cv @ CV_FROM_CAM @ WAYMO_FROM_CAM.T + 0.0).T.tolist(),
        "attribute": attribute,
        "track_id": track_id,
    }


class OpenLaneLine(Excerpt):
    """One line of a frame. Some files lack `attribute` and `track_id`."""

    xyz: tuple[list[Number], list[Number], list[Number]]
    visibility: list[Number]
    uv: tuple[list[Number], list[Number]] = ([], [])
    category: int
    attribute: int = 0
    track_id: int = 0

    @model_validator(mode="after")
    def _has_whole_points(self) -> "OpenLaneLine":
        if len({*map(len, self.xyz), len(self.visibility)}) > 1:
            raise ValueError("expected as many x, y and z as values of visibility")
        if len(self.uv[0]) != len(self.uv[1]):
            raise ValueError("uv: expected as many u as v")
        return self

    @property
    def xyz_waymo(self) -> Polyline3:
        """Its points."""
        return np.array(self.xyz, dtype=float).T

    @property
    def visible(self) -> Bool[np.ndarray, " _"]:
        return np.array(self.visibility) > 0

    @property
    def uv_img(self) -> Polyline2:
        """Its visible points in the image."""
        return np.array(self.uv, dtype=float).T


class OpenLaneFrame(Excerpt):
    file_path: PathBelow
    img_from_cv: JsonMatrix3 = Field(alias="intrinsic")
    vehicle_from_cam_waymo: JsonMatrix4 = Field(alias="extrinsic")
    lines: list[OpenLaneLine] = Field(alias="lane_lines")

    @model_validator(mode="after")
    def _has_a_camera(self) -> "OpenLaneFrame":
        turn = self.vehicle_from_cam_waymo[:3, :3]
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3):
            raise ValueError("extrinsic: expected a rotation and a place")
        if min(self.img_from_cv[0, 0], self.img_from_cv[1, 1]) <= 0:
            raise ValueError("intrinsic: expected focal lengths above 0")
        return self

    @property
    def height_m(self) -> float:
        """The camera's height over the road plane."""
        return float(self.vehicle_from_cam_waymo[2, 3])

    @property
    def pitch_rad(self) -> float:
        """How far the camera's forward axis points down in the vehicle's frame."""
        return float(np.arcsin(-self.vehicle_from_cam_waymo[2, 0]))

    def labels(self, size_px: tuple[int, int]) -> Labels:
        """The lines in our camera frame, of an image of this width and height; the format has no centre lines."""
        lanes = [
            ForeignLane("delimiter", line.xyz_waymo @ WAYMO_FROM_CAM, line.visible, PAINTS.get(line.category, UNKNOWN))
            for line in self.lines
        ]
        return labels_of(size_px, self.img_from_cv @ CV_FROM_CAM, self.height_m, self.pitch_rad, lanes)


def parse(text: str | bytes, where: str) -> OpenLaneFrame:
    """One label file; FormatErrors begin with `where`."""
    return schema.parse(OpenLaneFrame, text, where, "a frame of OpenLane")


@dataclass(frozen=True, eq=False)
class OpenLaneSplit:
    """`.../lane3d_1000/validation`; images lie in `.../images`."""

    path: Path

    @cached_property
    def files(self) -> Sequence[Path]:
        return sorted(self.path.glob("seg*/*.json"))

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int, /) -> ForeignSample:
        frame = self.frame(index)
        image = read_image(self._image(frame))
        return ForeignSample(frame.file_path, image, frame.labels((image.shape[1], image.shape[0])))

    def frame(self, index: int) -> OpenLaneFrame:
        return parse(read_file(self.files[index]), str(self.files[index]))

    def key(self, index: int) -> str:
        """`file_path`."""
        return self.frame(index).file_path

    def labels(self, index: int) -> Labels:
        """The labels; of the image only its size is read."""
        frame = self.frame(index)
        return frame.labels(image_size(self._image(frame)))

    def _image(self, frame: OpenLaneFrame) -> Path:
        return self.path.parents[1] / "images" / frame.file_path


def is_openlane(path: Path) -> bool:
    """Whether the folder holds OpenLane segments."""
    return path.is_dir() and any(child.is_dir() for child in path.glob("seg*"))


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    for path in sorted([*(out / "lists").glob("*.txt"), *(out / "lane3d_1000/test").glob("*.txt")]):
        yield FrameList(str(path.relative_to(out)), _frames(out, path, most_frames))


def _frames(out: Path, path: Path, most_frames: int) -> Iterator[ReadFrame]:
    case = {name: case for case, name in CASES.items()}.get(path.name)
    for image in listed_files(path, most_frames):
        label = image.replace("jpg", "json")
        if case is not None:
            label = f"test/{case}_case/{label.partition('/')[2]}"
        file = f"lane3d_1000/{label}"
        frame = parse(read_text(out / file), str(out / file))
        yield ReadFrame(file, str(out / file), f"images/{image}", frame)


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lines in metres; their pixels; category, place beside the camera and track."""
    found: OpenLaneFrame = frame.content
    k, delimiters = found.img_from_cv, truth.lanes("delimiter")
    lines = [line.xyz_waymo @ WAYMO_FROM_CAM for line in found.lines]
    read_back = FoundLines(lines, ExportView.around(k), None, found.height_m, found.pitch_rad)
    compared, ids = compare_lines(read_back, truth, RULE, [*delimiters, *truth.upright(truth.kerbs)])
    problems, gaps, tracks = list[str](), list[Gap](), dict[str, str]()
    if PurePath(frame.image or "").relative_to("images") != PurePath(found.file_path):
        problems.append(f"expected the file_path {frame.image}, got {found.file_path}")
    by_id: dict[str, Lane] = {lane.id: lane for lane in (*truth.labels.lanes, *truth.kerbs)}
    places = places_beside(delimiters, NEAR_START_M)
    points_of = {lane.id: lane.points_up for lane in delimiters}
    for i, (line, name) in enumerate(zip(found.lines, ids, strict=False)):
        seen = pixels(k, lines[i][line.visible])
        if len(seen) != len(line.uv_img):
            problems.append(f"line {i}: expected {len(seen)} uv, one for each visible point, got {len(line.uv_img)}")
        elif len(seen):
            apart = np.linalg.norm(seen - line.uv_img, axis=1)
            gaps.append(Gap.of(name, "px", apart))
            if not apart.max() <= TOLERANCE_PX:
                problems.append(f"line {i} ({name}): expected uv where xyz is seen, got it {apart.max():.3g} px away")
        kerb = KERB_LEFT if lines[i][0, 0] < 0 else KERB_RIGHT
        wanted = kerb if name.startswith("kerb_") else category(by_id[name])
        if line.category != wanted:
            problems.append(f"line {i}: expected the category {wanted} of {name}, got {line.category}")
        if line.attribute != places.get(name, 0):
            there = (other for other, place in places.items() if place == line.attribute)
            told = (f": that of {other}, {distances(lines[i], points_of[other]).max():.3g} m away" for other in there)
            expected = f"expected the attribute {places.get(name, 0)} of {name}"
            problems.append(f"line {i}: {expected}, got {line.attribute}{''.join(told)}")
        scene = f"{truth.reader.url}:{truth.reader.scene_of[truth.place]} {name}"
        tracks[f"{PurePath(found.file_path).parent.name}/{line.track_id}"] = scene
    if len(tracks) < len(found.lines) == len(ids):
        problems.append(f"expected a track_id for each of {len(found.lines)} lines, got {len(tracks)} different ones")
    return replace(compared, tracks=tracks) + Comparison(tuple(gaps), tuple(problems))


class _FoundLine(Excerpt):
    xyz: JsonLine
    category: int


class _Prediction(Excerpt):
    lane_lines: list[_FoundLine]


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A folder with a file for each image, as `validation/segment-*/*.json`: `lane_lines`, each with `category` and
    `xyz`, n points in the ground frame of the evaluator."""

    def of_frame(frame: ReadFrame) -> LinePair | None:
        path = predictions / PurePath(frame.content.file_path).with_suffix(".json")
        if not path.exists():
            return None
        lines = schema.parse(_Prediction, read_text(path), str(path), "predictions of OpenLane").lane_lines
        pose = frame.content.vehicle_from_cam_waymo
        true = [
            Line3d(ground_from_waymo(line.xyz_waymo, pose), line.visible, line.category) for line in frame.content.lines
        ]
        return true, [Line3d.whole(line.xyz, line.category) for line in lines]

    return scored(read(out, EVERY), of_frame, partial(line_score, rules=OPENLANE), predictions)


FORMAT = PinholeFormat(
    title="OpenLane: lane lines and kerbs in 3D, with categories",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    score=score,
    tolerances={RULE.unit: RULE.limit, "px": TOLERANCE_PX},
    camera=CAMERA,
    is_f_free=True,
    is_size_free=True,
    has_kerbs=True,
    lists=tuple(f"lane3d_1000/test/{name}" for name in CASES.values()),
)
