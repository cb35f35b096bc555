"""Read nuScenes: the tables of a version and the map of a place."""

import struct
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import shapely
from pydantic import BaseModel, Field, RootModel, ValidationError

from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.nuscenes.convention import (
    LIDAR,
    MASK_M,
    MASK_PX_PER_M,
    MASKS,
    VERSIONS,
    map_file,
    mask_file,
    table_file,
)
from synth3dlanes.formats.reading import read_file
from synth3dlanes.geometry.frames import from_axes, rotation
from synth3dlanes.system.arrays import Matrix4, Points2
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import Row3, Row4
from synth3dlanes.system.schema import Excerpt, Number, PathBelow, Positive, validation_problems

PNG_HEAD = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"


class TableRow(Excerpt):
    """A row of a table."""

    token: str


class _Mask(TableRow):
    filename: PathBelow


class _Splits(RootModel[dict[str, list[str]]]):
    """The names of scenes by parts."""


class PosedRow(TableRow):
    translation: Row3
    rotation: Row4

    @property
    def matrix(self) -> Matrix4:
        wxyz = np.array(self.rotation)
        x, y, z = rotation(wxyz).T if wxyz.any() else np.full((3, 3), np.nan)
        return from_axes(x, y, z, np.array(self.translation))


class SceneRow(TableRow):
    log_token: str
    first_sample_token: str


class LogRow(TableRow):
    """A log, which says in which place its scene is."""

    logfile: str
    location: str


class SampleRow(TableRow):
    scene_token: str
    timestamp: int


class DataRow(TableRow):
    """What a sensor measured at a sample."""

    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    filename: PathBelow
    width: int
    height: int
    timestamp: int


class CalibratedRow(PosedRow):
    """A sensor on the vehicle; cameras have a matrix K."""

    sensor_token: str
    camera_intrinsic: list[Row3]


class _Sensor(TableRow):
    channel: str
    modality: str


class BoxRow(PosedRow):
    """A box of an object at a sample, in the global frame."""

    sample_token: str
    instance_token: str
    visibility_token: str
    attribute_tokens: list[str]
    size: Row3
    num_lidar_pts: int


class InstanceRow(TableRow):
    category_token: str


class NamedRow(TableRow):
    name: str


class _Node(TableRow):
    x: Number
    y: Number


class _Line(TableRow):
    node_tokens: list[str]


class _Polygon(TableRow):
    exterior_node_tokens: list[str]
    holes: list["_Hole"]


class _Hole(Excerpt):
    node_tokens: list[str]


class _Area(TableRow):
    polygon_token: str


class _Drivable(TableRow):
    polygon_tokens: list[str]


class _Paint(Excerpt):
    node_token: str
    segment_type: str


class LaneOfMap(_Area):
    """A lane with the paint along its sides."""

    left_lane_divider_segments: list[_Paint]
    right_lane_divider_segments: list[_Paint]


class _RoadDivider(TableRow):
    line_token: str


class _LaneDivider(_RoadDivider):
    lane_divider_segments: list[_Paint]


class _Place(Excerpt):
    tx: Number
    ty: Number
    tz: Number


class _Light(TableRow):
    pose: _Place


_Length = Annotated[float, Field(ge=0, le=1e4)]


class Arc(Excerpt):
    """A piece of a path: up to three arcs and straight pieces, by the letters of its shape."""

    start_pose: Row3
    shape: str
    radius: Positive
    segment_length: tuple[_Length, _Length, _Length]


class _Links(Excerpt):
    incoming: list[str]
    outgoing: list[str]


class PlaceMap(Excerpt):
    """A place's map as its file says."""

    canvas_edge: tuple[Positive, Positive]
    node: list[_Node]
    line: list[_Line]
    polygon: list[_Polygon]
    drivable_area: list[_Drivable]
    lane: list[LaneOfMap]
    lane_connector: list[_Area]
    ped_crossing: list[_Area]
    stop_line: list[_Area]
    road_divider: list[_RoadDivider]
    lane_divider: list[_LaneDivider]
    traffic_light: list[_Light]
    arcline_path_3: dict[str, list[Arc]]
    connectivity: dict[str, _Links]

    def places(self, tokens: list[str]) -> Points2:
        return np.array([self._nodes[name] for name in tokens]).reshape(-1, 2)

    @cached_property
    def _nodes(self) -> dict[str, tuple[float, float]]:
        return {node.token: (node.x, node.y) for node in self.node}

    @cached_property
    def lines(self) -> dict[str, Points2]:
        return {line.token: self.places(line.node_tokens) for line in self.line}

    @cached_property
    def polygons(self) -> dict[str, shapely.Polygon]:
        """Polygons by their tokens; empty ones of rings that are none."""
        found = dict[str, shapely.Polygon]()
        for of in self.polygon:
            shell, *holes = (
                self.places(ring) for ring in (of.exterior_node_tokens, *(at.node_tokens for at in of.holes))
            )
            rings = [ring for ring in holes if len(ring) > 2]
            found[of.token] = shapely.Polygon(shell, rings) if len(shell) > 2 else shapely.Polygon()
        return found


AnyRow = TypeVar("AnyRow", bound=TableRow)
Model = TypeVar("Model", bound=BaseModel)


@dataclass(eq=False)
class Version:
    """The tables of a version below the folder of an export; a file is read when it is asked for. `anchors` are the
    global frames from the world by the first picture of each scene that was compared."""

    out: Path
    name: str
    anchors: dict[str, Matrix4] = field(default_factory=dict)
    _read: dict[str, Any] = field(default_factory=dict)

    def rows(self, table: str, model: type[AnyRow]) -> dict[str, AnyRow]:
        """The rows of a table by their tokens."""
        if table not in self._read:
            path = self.out / table_file(self.name, table)
            rows: list[AnyRow] = _validated(RootModel[list[model]], path).root  # type: ignore[valid-type]
            self._read[table] = {row.token: row for row in rows}
        found: dict[str, AnyRow] = self._read[table]
        return found

    def row(self, table: str, model: type[AnyRow], name: str) -> AnyRow:
        """The row of a token. Raises FormatError where there is none."""
        rows = self.rows(table, model)
        if name not in rows:
            path = self.out / table_file(self.name, table)
            raise FormatError(f"{path}: expected a row with the token {name[:40]}, got none")
        return rows[name]

    def map(self, location: str) -> PlaceMap:
        if location not in self._read:
            self._read[location] = _validated(PlaceMap, self.out / map_file(location))
        found: PlaceMap = self._read[location]
        return found

    @cached_property
    def boxes(self) -> dict[str, list[BoxRow]]:
        found = defaultdict[str, list[BoxRow]](list)
        for row in self.rows("sample_annotation", BoxRow).values():
            found[row.sample_token].append(row)
        return found

    @cached_property
    def sensors(self) -> dict[str, dict[str, DataRow]]:
        """What each sample's sensors measured, by their channels."""
        found = defaultdict[str, dict[str, DataRow]](dict)
        for row in self.rows("sample_data", DataRow).values():
            calibrated = self.row("calibrated_sensor", CalibratedRow, row.calibrated_sensor_token)
            found[row.sample_token][self.row("sensor", _Sensor, calibrated.sensor_token).channel] = row
        return found


def _validated(model: type[Model], path: Path) -> Model:
    try:
        return model.model_validate_json(read_file(path), strict=True)
    except ValidationError as error:
        raise FormatError("\n".join(validation_problems(error, str(path)))) from None


@dataclass(frozen=True, eq=False)
class CameraPicture:
    """A camera's picture: the version, its row, its channel, and whether it is the first of its sample."""

    version: Version
    data: DataRow
    channel: str
    is_first: bool

    @property
    def sample(self) -> SampleRow:
        return self.version.row("sample", SampleRow, self.data.sample_token)

    @property
    def scene(self) -> SceneRow:
        return self.version.row("scene", SceneRow, self.sample.scene_token)

    @property
    def log(self) -> LogRow:
        return self.version.row("log", LogRow, self.scene.log_token)

    def calibrated(self, data: DataRow) -> CalibratedRow:
        return self.version.row("calibrated_sensor", CalibratedRow, data.calibrated_sensor_token)

    def pose(self, data: DataRow) -> Matrix4:
        """The global frame from the vehicle as a sensor measured."""
        return self.version.row("ego_pose", PosedRow, data.ego_pose_token).matrix


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    for name in dict.fromkeys(VERSIONS.values()):
        if (out / name).is_dir():
            yield FrameList(name, _frames(Version(out, name), most_frames), "picture")


def _read_others(version: Version) -> None:
    """Read what no picture is compared with. Raises FormatError where it is not what tools expect."""
    for name in ("category", "attribute", "visibility"):
        version.rows(name, TableRow if name == "visibility" else NamedRow)
    _validated(_Splits, version.out / table_file(version.name, "splits"))
    files = [row.filename for row in version.rows("map", _Mask).values()]
    if sorted(files) != sorted(map(mask_file, MASKS)):
        raise FormatError(
            f"{version.out / table_file(version.name, 'map')}: expected the masks of all places, got {files}"
        )
    for place in MASKS:
        path, canvas_m = version.out / mask_file(place), version.map(place).canvas_edge
        # Pillow takes an image of this size for an attack.
        head, size_px = read_file(path)[:24], [round(MASK_PX_PER_M * edge) for edge in canvas_m]
        is_whole = head[16:] == struct.pack(">II", *size_px)
        if head[:16] != PNG_HEAD or not (is_whole or max(canvas_m) > MASK_M):
            raise FormatError(f"{path}: expected a PNG of {size_px[0]}x{size_px[1]} as its map says, got another file")


def _frames(version: Version, most: int) -> Iterator[ReadFrame]:
    _read_others(version)
    samples = sorted(version.rows("sample", SampleRow).values(), key=lambda sample: sample.timestamp)
    for sample in samples:
        cameras = [channel for channel in version.sensors.get(sample.token, {}) if channel != LIDAR]
        for channel in cameras:
            if most == 0:
                return
            most -= 1
            data = version.sensors[sample.token][channel]
            picture = CameraPicture(version, data, channel, channel == cameras[0])
            yield ReadFrame(data.filename, str(version.out / data.filename), data.filename, picture)
