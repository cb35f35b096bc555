"""Read OpenLane-V2: the frames of a collection and the lanes of a label file as plain arrays."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, RootModel

from synth3dlanes.formats.openlane_v2.convention import COLLECTIONS, ROOT
from synth3dlanes.formats.reading import MOST_BYTES, read_file
from synth3dlanes.system import schema
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import JsonMatrix3, JsonPoints, Row3
from synth3dlanes.system.schema import Excerpt, Number, PathBelow

LEAST_POINTS = 11  # what the benchmark compares


@dataclass(frozen=True, eq=False)
class FoundElement:
    """A traffic element of a label file: its codes, and left, top, right and bottom in the first image."""

    id: int
    category: int
    attribute: int
    box_px: Float[np.ndarray, "4"]


@dataclass(frozen=True, eq=False)
class FoundCamera:
    """A camera of a label file: its image, its place in the vehicle frame with the axes of OpenCV, and its matrix K."""

    image: str
    ego_from_cv: Float[np.ndarray, "4 4"]
    img_from_cv: Float[np.ndarray, "3 3"]


@dataclass(frozen=True, eq=False)
class TopologyFrame:
    """One label file: the cameras by name, the ids of the lanes, the polylines of each (the centre line, and in `-ls`
    files left and right boundary) in the vehicle frame, which lane (column) follows which (row), the vehicle's pose;
    the traffic elements, and which of them (column) governs which lane (row).
    """

    cameras: dict[str, FoundCamera]
    ids: tuple[int, ...]
    lanes_ego: tuple[tuple[Float[np.ndarray, "_ 3"], ...], ...]
    follows: Float[np.ndarray, "n n"]
    world_from_ego: Float[np.ndarray, "4 4"]
    elements: tuple[FoundElement, ...]
    governs: Float[np.ndarray, "n t"]


def frames(out: Path) -> dict[str, list[Path]]:
    """The label files of centre lines of each part."""
    root = out / ROOT
    paths = [root / f"{name}.json" for name in COLLECTIONS]
    path = next((path for path in paths if path.exists()), paths[0])
    listed = schema.parse(_Collection, read_file(path), str(path), "a collection of OpenLane-V2", MOST_BYTES).root
    return {
        part: [root / part / segment / "info" / name for segment, names in segments.items() for name in names]
        for part, segments in listed.items()
    }


def parse(text: str, where: str) -> TopologyFrame:
    """One label file, of centre lines or of lane segments; FormatErrors begin with `where`."""
    found = schema.parse(_Frame, text, where, "a frame of OpenLane-V2")
    annotation = found.annotation
    lanes: tuple[tuple[Float[np.ndarray, "_ 3"], ...], ...]
    ids: tuple[int, ...]
    if isinstance(annotation, _Segments):
        ids = tuple(lane.id for lane in annotation.lane_segment)
        lanes = tuple((lane.centerline, lane.left_laneline, lane.right_laneline) for lane in annotation.lane_segment)
        follows, governs = annotation.topology_lsls, annotation.topology_lste
    else:
        ids = tuple(lane.id for lane in annotation.lane_centerline)
        lanes = tuple((lane.points,) for lane in annotation.lane_centerline)
        follows, governs = annotation.topology_lclc, annotation.topology_lcte
    if {len(lanes)} != {len(follows), *map(len, follows)} and (lanes or follows):
        raise FormatError(f"{where}: topology: expected a row and a column for each of {len(lanes)} lanes, got others")
    if any(len(line) < LEAST_POINTS for lane in lanes for line in lane):
        raise FormatError(f"{where}: expected lanes of {LEAST_POINTS} points or more, got fewer")
    elements = tuple(
        FoundElement(item.id, item.category, item.attribute, np.array(item.points).ravel())
        for item in annotation.traffic_element
    )
    if len(governs) != len(lanes) or any(len(row) != len(elements) for row in governs):
        raise FormatError(
            f"{where}: topology: expected {len(lanes)} rows of {len(elements)} traffic elements, got others"
        )
    cameras = {
        name: FoundCamera(sensor.image_path, _matrix(sensor.extrinsic), np.array(sensor.intrinsic.K))
        for name, sensor in found.sensor.items()
    }
    follows_of = np.array(follows, dtype=float).reshape(len(lanes), len(lanes))
    governs_of = np.array(governs, dtype=float).reshape(len(lanes), len(elements))
    return TopologyFrame(cameras, ids, lanes, follows_of, _matrix(found.pose), elements, governs_of)


class _Collection(RootModel[dict[PathBelow, dict[PathBelow, list[PathBelow]]]]):
    """Names of label files by part and segment."""


Row2 = tuple[Number, Number]


class _Element(Excerpt):
    id: int
    category: Literal[1, 2]
    attribute: Annotated[int, Field(ge=0, le=12)]
    points: tuple[Row2, Row2]


class _Centerline(Excerpt):
    id: int
    points: JsonPoints


class _Centerlines(Excerpt):
    lane_centerline: list[_Centerline]
    topology_lclc: list[list[Literal[0, 1]]]
    traffic_element: list[_Element]
    topology_lcte: list[list[Literal[0, 1]]]


class _Segment(Excerpt):
    id: int
    centerline: JsonPoints
    left_laneline: JsonPoints
    right_laneline: JsonPoints


class _Segments(Excerpt):
    lane_segment: list[_Segment]
    topology_lsls: list[list[Literal[0, 1]]]
    traffic_element: list[_Element]
    topology_lste: list[list[Literal[0, 1]]]


class _Pose(Excerpt):
    rotation: JsonMatrix3
    translation: Row3


class _Intrinsic(Excerpt):
    K: JsonMatrix3


class _Sensor(Excerpt):
    image_path: PathBelow
    extrinsic: _Pose
    intrinsic: _Intrinsic


def _matrix(pose: _Pose) -> Float[np.ndarray, "4 4"]:
    return np.vstack([np.column_stack([pose.rotation, pose.translation]), [0, 0, 0, 1]])


class _Frame(Excerpt):
    pose: _Pose
    sensor: dict[str, _Sensor]
    annotation: _Segments | _Centerlines
