"""Read Argoverse 2: the tables of a log, its map, and a sweep as plain arrays."""

import io
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from synth3dlanes.formats.argoverse2.convention import (
    ANNOTATIONS,
    INTRINSICS,
    POINTS,
    POSES,
    SENSORS,
    LogFiles,
)
from synth3dlanes.formats.reading import read_file
from synth3dlanes.geometry.frames import rotation
from synth3dlanes.system import schema
from synth3dlanes.system.columnar import DAMAGED, TableBounds, read_arrow
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import Excerpt, Number

# A point takes 24 bytes, a box 130; files with boxes have few rows.
BOUNDS = TableBounds(most_rows=1 << 23, row_bytes=128, base_bytes=16 << 20)
IMAGE = re.compile(r"(?P<timestamp>\d{1,19})\.jpg")

Columns = dict[str, np.ndarray]


class _Point(Excerpt):
    x: Number
    y: Number
    z: Number


class LogLane(Excerpt):
    """A lane segment as its file says."""

    id: int
    is_intersection: bool
    left_lane_boundary: list[_Point]
    right_lane_boundary: list[_Point]
    left_lane_mark_type: str
    right_lane_mark_type: str
    successors: list[int]
    predecessors: list[int]
    left_neighbor_id: int | None
    right_neighbor_id: int | None

    @property
    def left(self) -> Float[np.ndarray, "n 3"]:
        """Its left boundary."""
        return _array(self.left_lane_boundary)

    @property
    def right(self) -> Float[np.ndarray, "n 3"]:
        """Its right boundary."""
        return _array(self.right_lane_boundary)


class _Area(Excerpt):
    area_boundary: list[_Point]


class _Crossing(Excerpt):
    edge1: list[_Point]
    edge2: list[_Point]


class _Vectors(Excerpt):
    lane_segments: dict[str, LogLane]
    drivable_areas: dict[str, _Area]
    pedestrian_crossings: dict[str, _Crossing]


class _Cells(Excerpt):
    R: tuple[Number, Number, Number, Number]
    t: tuple[Number, Number]
    s: Number


@dataclass(frozen=True, eq=False)
class LogMap:
    """The map of a log. Heights are NaN where there are none."""

    lanes: tuple[LogLane, ...]
    areas: tuple[Float[np.ndarray, "_ 3"], ...]
    crossings: tuple[Float[np.ndarray, "_ 3"], ...]
    heights: Float[np.ndarray, "rows columns"]
    cell_from_city: Float[np.ndarray, "2 3"]

    def height(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Height of the ground in the cells of places, NaN outside."""
        columns, rows = np.floor(xy @ self.cell_from_city[:, :2].T + self.cell_from_city[:, 2]).T
        found = np.full(len(xy), np.nan)
        inside = (rows >= 0) & (rows < self.heights.shape[0]) & (columns >= 0) & (columns < self.heights.shape[1])
        found[inside] = self.heights[rows[inside].astype(int), columns[inside].astype(int)]
        return found


@dataclass(frozen=True, eq=False)
class Log:
    """A log below the folder of an export; its files are read when they are asked for."""

    out: Path
    files: LogFiles

    @cached_property
    def annotations(self) -> Columns:
        """Boxes at all instants, in the vehicle frame."""
        return self._table(self.files.annotations, ANNOTATIONS)

    @cached_property
    def poses(self) -> dict[int, Float[np.ndarray, "4 4"]]:
        """City from vehicle by timestamp."""
        table = self._table(self.files.poses, POSES)
        return dict(zip(table["timestamp_ns"].tolist(), matrices(table), strict=True))

    @cached_property
    def sensors(self) -> dict[str, Float[np.ndarray, "4 4"]]:
        """Vehicle from sensor by name."""
        table = self._table(self.files.sensors, SENSORS)
        return dict(zip(table["sensor_name"].tolist(), matrices(table), strict=True))

    @cached_property
    def lenses(self) -> dict[str, tuple[Float[np.ndarray, "3 3"], tuple[int, int]]]:
        """Matrix K, and width and height of the image, by camera."""
        table = self._table(self.files.intrinsics, INTRINSICS)
        found = {}
        for i, name in enumerate(table["sensor_name"].tolist()):
            fx, fy, cx, cy = (float(table[key][i]) for key in ("fx_px", "fy_px", "cx_px", "cy_px"))
            size = int(table["width_px"][i]), int(table["height_px"][i])
            found[name] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), size
        return found

    def sweep(self, timestamp_ns: int) -> Float[np.ndarray, "n 3"]:
        """Points of the lidar, in the vehicle frame."""
        table = self._table(self.files.sweep(timestamp_ns), POINTS)
        return np.column_stack([table[axis] for axis in "xyz"]).astype(float)

    @cached_property
    def map(self) -> LogMap:
        """Its map."""
        files = self.files
        where = str(self.out / files.vector_map)
        found = schema.parse(_Vectors, read_file(Path(where)), where, "a map of Argoverse 2", 1 << 28)
        lanes = tuple(found.lane_segments.values())
        areas = tuple(_array(area.area_boundary) for area in found.drivable_areas.values())
        crossings = tuple(_array([*c.edge1, *c.edge2]) for c in found.pedestrian_crossings.values())
        if any(min(len(lane.left), len(lane.right)) < 2 for lane in lanes) or any(len(area) < 3 for area in areas):
            raise FormatError(f"{where}: expected boundaries of two points and areas of three or more, got fewer")
        where = str(self.out / files.cells)
        cells = schema.parse(_Cells, read_file(Path(where)), where, "a similarity")
        matrix = cells.s * np.column_stack([np.array(cells.R).reshape(2, 2), cells.t])
        return LogMap(lanes, areas, crossings, _heights(self.out / files.heights), matrix)

    def _table(self, path: str, wanted: pa.Schema) -> Columns:
        where = self.out / path
        data = read_file(where)
        try:
            table = read_arrow(data, str(where), BOUNDS, wanted.names).cast(wanted)
            if any(column.null_count for column in table.columns):
                raise ValueError("missing values")
            return {name: table[name].to_numpy() for name in wanted.names}
        except FormatError:
            raise
        except DAMAGED as error:
            reason = " ".join(str(error).split())[:120]
            raise FormatError(f"{where}: expected a table of {', '.join(wanted.names)}, got {reason}") from None


def matrices(table: Columns) -> Float[np.ndarray, "n 4 4"]:
    """Poses of a table's rows."""
    found = np.tile(np.eye(4), (len(table["qw"]), 1, 1))
    wxyz = np.column_stack([table[key] for key in ("qw", "qx", "qy", "qz")])
    found[:, :3, 3] = np.column_stack([table[key] for key in ("tx_m", "ty_m", "tz_m")])
    for pose, row in zip(found, wxyz, strict=True):
        pose[:3, :3] = rotation(row) if np.isfinite(row).all() and row.any() else np.nan
    return found


def _heights(path: Path) -> Float[np.ndarray, "rows columns"]:
    try:
        heights = np.load(io.BytesIO(read_file(path)), allow_pickle=False)
    except (ValueError, EOFError, OSError, MemoryError) as error:
        raise FormatError(f"{path}: expected heights as an array of numpy, got {str(error)[:80]}") from None
    if not isinstance(heights, np.ndarray) or heights.ndim != 2 or heights.dtype.kind != "f":
        raise FormatError(f"{path}: expected heights in rows and columns, got something else")
    return heights.astype(float)


def _array(points: list[_Point]) -> Float[np.ndarray, "n 3"]:
    return np.array([(point.x, point.y, point.z) for point in points]).reshape(-1, 3)
