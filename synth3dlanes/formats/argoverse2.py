"""Argoverse 2's sensor data set: for each picture its image, for each instant a sweep and rows of the log's tables, and
with the first picture of a log its calibration and its map, around all places of the host in the clip.

| theirs | ours | unit, frame |
|---|---|---|
| `annotations` | all objects of the labels, with the points of the lidar on them | m, `_ego` |
| `city_SE3_egovehicle` | world from vehicle at each instant | m |
| `calibration/*` | cameras (OpenCV's axes) and lidar in `_ego`; K, pixels from the middle of the first | m, px |
| `sensors/lidar/*` | points of the sweep, with the number of their beam | m, `_ego` |
| `lane_segments` | pieces of the segments of the lane graph; `id` is (segment + 1) * 1000 + piece | m, city |
| `*_lane_mark_type` | the paint along most of the segment (`mark_type`) | |
| `successors`, `predecessors`, `*_neighbor_id` | links and neighbours of the lane graph | |
| `drivable_areas` | strips of the pavement | m, city |
| `pedestrian_crossings` | crosswalks, by both of their edges | m, city |

The vehicle frame (`_ego`) is x forward, y left, z up, its origin in the middle of the rear axle; the city frame is our
world frame.
"""

import io
import json
import re
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import pyarrow as pa
import shapely
from jaxtyping import Bool, Float, Int
from pyarrow import feather
from scipy.spatial import cKDTree

from synth3dlanes.formats.comparing import (
    FROM_MIDDLE,
    Comparison,
    FoundBox,
    SourceSample,
    compare_boxes,
    compare_pinhole,
    compare_sweep,
    distances,
)
from synth3dlanes.formats.comparing_maps import (
    FoundLane,
    MapRule,
    area_problems,
    compare_lanes,
    half_widths,
    middle_of,
    symbol_problems,
)
from synth3dlanes.formats.format import FrameList, ReadFrame, SampleFormat, SampleFrame, of_parts
from synth3dlanes.formats.lane_map import LaneSegment, lane_segments
from synth3dlanes.formats.reading import pose_of, read_file
from synth3dlanes.formats.writing import (
    FrameAnnotation,
    expect_objects,
    expect_pinhole,
    host_from_flu,
    img_from_cv_centred,
    objects_of,
    with_cv_axes,
    with_flu_axes,
    world_from_vehicle,
)
from synth3dlanes.geometry.frames import invert, quaternion, transform
from synth3dlanes.geometry.polylines import distances_between, thinned
from synth3dlanes.labels.labels import CameraLabel, LaneGraph, Marking, PaintColor, Pair, Segment
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.scene.things import classes_in
from synth3dlanes.system import schema
from synth3dlanes.system.arrays import Matrix4, Points3
from synth3dlanes.system.columnar import TableBounds, read_arrow, reading_table
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import encoded
from synth3dlanes.system.schema import Excerpt, Number
from synth3dlanes.world.motion import host_driven
from synth3dlanes.world.world import World, resolve

FRONT_CAMERA = "ring_front_center"
RING_CAMERAS = (
    FRONT_CAMERA, "ring_front_left", "ring_front_right", "ring_rear_left", "ring_rear_right", "ring_side_left",
    "ring_side_right",
)  # fmt: skip
CAMERAS = (*RING_CAMERAS, "stereo_front_left", "stereo_front_right")
LIDARS = ("up_lidar", "down_lidar")
"""The original has two on top of each other; readers want a pose of each."""
REAR_M, AXLE_M = 1.3, 0.3
"""Where the rear axle is, behind the middle of our host and over the road, as in the rig argoverse2."""
HOST_FROM_EGO = host_from_flu(REAR_M, AXLE_M)
_LIDAR_FROM_AV2 = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
CATEGORIES = classes_in("argoverse2")
START_NS, ROOM_NS = 10**18, 4 * 10**9
"""The first timestamp of an export, and how much later the next picture's log begins at least: tools name frames by
timestamps alone, which must differ between logs and have equal numbers of digits."""
CITY = "SYN"
POSE = {name: pa.float64() for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")}
ANNOTATIONS = pa.schema(
    {
        "timestamp_ns": pa.int64(), "track_uuid": pa.string(), "category": pa.string(), "length_m": pa.float64(),
        "width_m": pa.float64(), "height_m": pa.float64(), **POSE, "num_interior_pts": pa.int64(),
    }
)  # fmt: skip
POSES = pa.schema({"timestamp_ns": pa.int64(), **POSE})
SENSORS = pa.schema({"sensor_name": pa.string(), **POSE})
INTRINSICS = pa.schema(
    {
        "sensor_name": pa.string(), **{name: pa.float64() for name in ("fx_px", "fy_px", "cx_px", "cy_px")},
        **{name: pa.float64() for name in ("k1", "k2", "k3")}, "height_px": pa.uint16(), "width_px": pa.uint16(),
    }
)  # fmt: skip
POINTS = pa.schema(
    {
        **{name: pa.float32() for name in "xyz"}, "intensity": pa.uint8(), "laser_number": pa.uint8(),
        "offset_ns": pa.int32(),
    }
)  # fmt: skip
# A point takes 24 bytes, a box 130; files with boxes have few rows.
BOXES, EGO = "annotations.feather", "city_SE3_egovehicle.feather"
MOUNTS, LENSES = "calibration/egovehicle_SE3_sensor.feather", "calibration/intrinsics.feather"
TABLES = {BOXES: ANNOTATIONS, EGO: POSES, MOUNTS: SENSORS, LENSES: INTRINSICS}
"""The tables of a log; those of its instants have POINTS."""
BOUNDS = TableBounds(most_rows=1 << 23, row_bytes=128, base_bytes=16 << 20)
IMAGE = re.compile(r"(?P<timestamp>\d{1,19})\.jpg")
Columns = dict[str, np.ndarray]
# Labels of boxes and points are rounded.
LIMIT_PX, POINT_M = 0.02, 0.001

PIECE_M = 30.0
"""The API draws the middle of a lane segment with ten points, however long it is."""
REACH_M = 150.0
"""Reach of the map ahead of and behind all places of the host in the clip."""
MOST_PIECES = 1000
CELL_M, MARGIN_M, BLOCK = 0.3, 5.0, 16
"""Size of the cells of the ground's heights, how far beyond the pavement there are any, and cells along a block."""
LINE_M, MM_DECIMALS = 0.005, 3
"""How far written lines may be from those with all points."""
SAME_LINE_M = 0.2
GROUND_M = 0.2
# Drivable areas have seams where one begins at the end of another.
SEAM_M = 0.01
Sides = Float[np.ndarray, "_ k 3"]


README = f"""Argoverse 2's sensor data set: a log for each scene, its frames those of the clip.

- `{{train,val,test}}/LOG/sensors/cameras/CAMERA/TIMESTAMP.jpg`, `sensors/lidar/TIMESTAMP.feather`,
  `annotations.feather`, `city_SE3_egovehicle.feather`, `calibration/*.feather`, `map/*`. Timestamps (ns) differ between
  logs too. Tools of map learners drop frames without one of the seven cameras `ring_*`: generate with
  `--rig argoverse2`. A camera without such a rig is `{FRONT_CAMERA}`.
- Vehicle frame: x forward, y left, z up, from the rear axle, {REAR_M:g} m behind the middle of the host
  and {AXLE_M:g} m over the road. City frame: the scene's world. Pixels count from the middle of the first
  one. All sensors of an instant measure at once, so `offset_ns` is 0. There is no intensity.
- Without a lidar, sweeps have no points: tools step through their timestamps. One lidar is both `up_lidar` and
  `down_lidar`; points have 4 bytes a coordinate, where the original has 2.
- Boxes are those of all objects of the labels but barricades, which it has no class for, seen or not, with the points
  of the sweep on them. A rider and what is ridden are one box, of the rider's class. The API's evaluation leaves out
  those without points from the truth, but not from detections, where a found one is a false alarm: without a lidar
  nothing is left of the truth. Take detections without points out as well, or those that are far away.
- Lane segments are those of the lane graph, cut into pieces of at most {PIECE_M:g} m: ids count the segment from 1 and
  its pieces from 0, as 2003. Boundaries are half a lane's width beside the middle; their mark type is the paint along
  most of the segment. An oncoming lane across one line is a neighbour.
"""


def map_paths(log: str) -> tuple[str, str, str]:
    """Where in a log its map is: lanes, areas and crossings; heights of the ground by cells; the cell of a place."""
    return (
        f"map/log_map_archive_{log}____{CITY}_city_0.json",
        f"map/{log}_ground_height_surface____{CITY}.npy",
        f"map/{log}___img_Sim2_city.json",
    )


def write(frame: SampleFrame) -> FrameAnnotation:
    """The files of a picture; with the first of an instant also its sweep and rows, with the first of a log its
    calibration and map."""
    labels, shot = frame.labels, frame.scene.shot
    expect_objects(frame)
    name = _name(labels.camera, shot.n_cameras, frame.where)
    first = frame.number - shot.frame * shot.n_cameras - shot.camera
    log, timestamp_ns = f"{first:09d}", START_NS + first * ROOM_NS + round(shot.time_s * 1e9)
    folder = f"{frame.part}/{log}"
    image = f"{folder}/sensors/cameras/{name}/{timestamp_ns}.jpg"
    if not frame.cameras:
        return FrameAnnotation(image, 0)
    world_from_ego = world_from_vehicle(labels.camera, frame.scene, HOST_FROM_EGO)
    ego_from_cam = invert(world_from_ego) @ labels.camera.world_from_cam
    own: dict[str, str | bytes] = {f"sensors/lidar/{timestamp_ns}.feather": _sweep(frame, ego_from_cam)}
    n_lanes = 0
    if frame.is_first:
        mapped, n_lanes = map_files(resolve(frame.scene), labels.graph)
        own |= {**_calibration(frame, world_from_ego), **dict(zip(map_paths(log), mapped, strict=True))}
    boxes = [_box(item, ego_from_cam, log, timestamp_ns) for item in objects_of(labels, CATEGORIES)]
    rows = (
        (json.dumps([{"timestamp_ns": timestamp_ns, **_pose(world_from_ego)}]), (f"{folder}/{EGO}",)),
        (json.dumps(boxes), (f"{folder}/{BOXES}",)),
    )
    files = {f"{folder}/{path}": content for path, content in own.items()}
    return FrameAnnotation(image, n_lanes, files=files, shared=rows)


def document(path: str, lines: Path) -> Iterator[bytes]:
    """A table of a log from its rows, which are those of an instant in each line."""
    rows = [row for line in lines.read_text().splitlines() for row in json.loads(line)]
    yield _table(sorted(rows, key=lambda row: row["timestamp_ns"]), TABLES[PurePath(path).name])


def _name(camera: CameraLabel, n_cameras: int, where: str) -> str:
    expect_pinhole(camera, where)
    if camera.name in CAMERAS:
        return camera.name
    if n_cameras > 1:
        names = ", ".join(RING_CAMERAS)
        raise InputError(f"{where}: expected a rig with cameras of Argoverse 2 ({names}), got {camera.name}")
    return FRONT_CAMERA


def _sweep(frame: SampleFrame, ego_from_cam: Matrix4) -> bytes:
    """The points of the lidar, in the vehicle frame."""
    if frame.sweep is None:
        return _table([], POINTS)
    points = frame.sweep.points()
    xyz_ego, zeros = transform(ego_from_cam, points.xyz_cam), np.zeros(len(points.beam), int)
    columns = [*xyz_ego.T, zeros, points.beam, zeros]
    return _bytes(pa.table([pa.array(c).cast(t) for c, t in zip(columns, POINTS.types, strict=True)], schema=POINTS))


def _calibration(frame: SampleFrame, world_from_ego: Matrix4) -> dict[str, bytes]:
    ego_from_world, n_cameras = invert(world_from_ego), frame.scene.shot.n_cameras
    sensors, lenses = list[dict[str, Any]](), list[dict[str, Any]]()
    for key, camera in frame.cameras.items():
        name = _name(camera, n_cameras, f"{frame.split}:{key}")
        (fx, _, cx), (_, fy, cy), _ = img_from_cv_centred(camera)
        lens = {"fx_px": fx, "fy_px": fy, "cx_px": cx, "cy_px": cy}
        sensors.append({"sensor_name": name, **_pose(with_cv_axes(ego_from_world @ camera.world_from_cam))})
        size = {"height_px": camera.height_px, "width_px": camera.width_px}
        lenses.append({"sensor_name": name, **lens, **dict.fromkeys(("k1", "k2", "k3"), 0.0), **size})
    ego_from_lidar, labels = np.eye(4), frame.labels
    if labels.lidar is not None:
        ego_from_lidar = ego_from_world @ labels.camera.world_from_cam @ labels.lidar.cam_from_lidar @ _LIDAR_FROM_AV2
    sensors += ({"sensor_name": name, **_pose(ego_from_lidar)} for name in LIDARS)
    return {MOUNTS: _table(sensors, SENSORS), LENSES: _table(lenses, INTRINSICS)}


def _box(item: ObjectLabel, ego_from_cam: Matrix4, log: str, timestamp_ns: int) -> dict[str, Any]:
    """A row of the annotations. The box's own frame is x forward, y left, z up."""
    width_m, length_m, height_m = item.size_m.tolist()
    return {
        "timestamp_ns": timestamp_ns,
        "track_uuid": str(uuid.uuid5(uuid.NAMESPACE_OID, f"{log}/{item.id}")),
        "category": CATEGORIES[item.category],
        "length_m": length_m,
        "width_m": width_m,
        "height_m": height_m,
        **_pose(with_flu_axes(ego_from_cam @ item.cam_from_object)),
        "num_interior_pts": item.lidar_points or 0,
    }


def _pose(pose: Float[np.ndarray, "4 4"]) -> dict[str, float]:
    wxyz = quaternion(pose[:3, :3]).tolist()
    return dict(zip(("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"), [*wxyz, *pose[:3, 3].tolist()], strict=True))


def _table(rows: Sequence[Mapping[str, Any]], schema: pa.Schema) -> bytes:
    return _bytes(pa.Table.from_pylist(rows, schema=schema))


def _bytes(table: pa.Table) -> bytes:
    return encoded(lambda stream: feather.write_feather(table, stream))


# -- the map


def piece_id(segment: int, number: int) -> int:
    """The id of a piece of a lane segment by its place in the lane graph, from 0, and its number along it."""
    return (segment + 1) * MOST_PIECES + number


def place_of(lane_id: int) -> tuple[int, int]:
    """The inverse of `piece_id`."""
    segment, number = divmod(lane_id, MOST_PIECES)
    return segment - 1, number


def mark_type(marking: Marking, color: PaintColor | None, double: bool | None, pair: Pair | None = None) -> str:
    """The code of paint; a pair is named from the left, as the lane's traffic drives."""
    if marking == "none":
        return "NONE"
    if pair is not None:
        pattern = "SOLID_DASH" if pair == "solid_dashed" else "DASH_SOLID"
    elif double:
        pattern = "DOUBLE_SOLID" if marking == "solid" else "DOUBLE_DASH"
    else:
        pattern = "SOLID" if marking == "solid" else "DASHED"
    return f"{pattern}_{(color or 'white').upper()}"


# Lanes are within this of the labels from above; heights within the slack.
RULE = MapRule("m", 0.05, slack=0.3, word=mark_type)


def map_files(world: World, graph: LaneGraph) -> tuple[tuple[str, bytes, str], int]:
    """The files of the map of a world in the order of their paths, and how many lane segments are in it."""
    place, shot = world.view.world_from_host[:3, 3], world.scene.shot
    reach_m = REACH_M + host_driven(shot, shot.duration_s)
    strips = [np.stack(edges, axis=1) for edges in world.ground.paved.strips(place[:2], reach_m)]
    lanes = list(lane_segments(world, graph.segments, place, reach_m))
    rows = list(_lanes(lanes, graph, world))
    vectors = {
        "pedestrian_crossings": {str(row["id"]): row for row in _crossings(world)},
        "lane_segments": {str(row["id"]): row for row in rows},
        "drivable_areas": {str(i): {"area_boundary": _outline(strip), "id": i} for i, strip in enumerate(strips, 1)},
    }
    heights, west_south = _heights(world, np.concatenate([strip.reshape(-1, 3)[:, :2] for strip in strips]))
    cells = {"R": [1.0, 0.0, 0.0, 1.0], "t": (-west_south).tolist(), "s": 1 / CELL_M}
    saved = encoded(lambda stream: np.save(stream, heights))
    return (json.dumps(vectors), saved, json.dumps(cells)), len(rows)


@dataclass(frozen=True, eq=False)
class _Piece:
    """A piece of a lane segment of the lane graph, as long as lane segments of the original are."""

    lane: LaneSegment
    first: int
    last: int
    number: int

    @property
    def id(self) -> int:
        return piece_id(self.lane.index, self.number)

    @property
    def left_world(self) -> Points3:
        return self.lane.left.points_world[self.first : self.last + 1]

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        return np.asarray(self.lane.points_world[(self.first + self.last) // 2])


def _pieces(lane: LaneSegment) -> list[_Piece]:
    """Lanes beside each other, with as many points, are cut at the same places."""
    length_m = float(np.linalg.norm(np.diff(lane.points_world, axis=0), axis=1).sum())
    ends = np.rint(np.linspace(0, len(lane.points_world) - 1, 1 + int(np.ceil(length_m / PIECE_M)))).astype(int)
    return [_Piece(lane, *pair, number) for number, pair in enumerate(pairwise(ends.tolist()))]


def _lanes(lanes: Sequence[LaneSegment], graph: LaneGraph, world: World) -> Iterator[dict[str, Any]]:
    pieces = {lane.id: _pieces(lane) for lane in lanes}
    for lane in lanes:
        left, right = world.network.neighbours(graph.segments[lane.index])
        opposite = [] if left else _opposite(lane, lanes, world)
        after = [pieces[name][0].id for name in graph.successors.get(lane.id, ()) if name in pieces]
        before = [pieces[name][-1].id for name in pieces if lane.id in graph.successors.get(name, ())]
        paint = [mark_type(side.marking, side.color, side.double, side.pair) for side in (lane.left, lane.right)]
        sides = np.stack([lane.left.points_world, lane.right.points_world], axis=1)
        own = pieces[lane.id]
        for piece in own:
            lines = sides[piece.first : piece.last + 1]
            # A line between both directions has the same points from either side, as in the original: MapTRv2 leaves
            # such lines out, and would take the pieces of one that has others.
            lines = lines if opposite else thinned(lines, LINE_M)
            yield {
                "id": piece.id,
                "is_intersection": lane.is_connector,
                "lane_type": "VEHICLE",
                "left_lane_boundary": _points(lines[:, 0]),
                "left_lane_mark_type": paint[0],
                "right_lane_boundary": _points(lines[:, 1]),
                "right_lane_mark_type": paint[1],
                "successors": after if piece is own[-1] else [piece.id + 1],
                "predecessors": before if piece is own[0] else [piece.id - 1],
                "right_neighbor_id": _beside(piece, pieces.get(right or "", ())),
                "left_neighbor_id": _beside(piece, _across(piece, opposite, pieces))
                if opposite
                else _beside(piece, pieces.get(left or "", ())),
            }


def _beside(piece: _Piece, others: Sequence[_Piece]) -> int | None:
    """The piece of another lane that is nearest to the middle of one."""
    return min(others, key=lambda other: float(np.linalg.norm(other.middle - piece.middle))).id if others else None


def _across(piece: _Piece, opposite: Sequence[str], pieces: Mapping[str, Sequence[_Piece]]) -> list[_Piece]:
    """The pieces of lanes of the other direction that share a stretch of the left line of one."""
    tree = cKDTree(piece.left_world)
    others = [other for name in opposite for other in pieces[name]]
    return [other for other in others if np.min(tree.query(other.left_world)[0]) < SAME_LINE_M]


def _opposite(lane: LaneSegment, lanes: Sequence[LaneSegment], world: World) -> list[str]:
    """The lanes of the other direction whose left boundaries are one line with that of a lane."""
    found, own = [], world.network.lanes[lane.id]
    for other in lanes:
        its = world.network.lanes[other.id]
        if own.road == its.road and own.ascends != its.ascends:
            short, long = sorted((lane.left.points_world, other.left.points_world), key=len)
            apart = distances_between(short[::10, :2], long[:, :2]).min(axis=1)
            if np.median(apart) < SAME_LINE_M:
                found.append(other.id)
    return found


def _crossings(world: World) -> Iterator[dict[str, Any]]:
    """Crosswalks by both of their edges in the direction of their walkers."""
    for index, form in enumerate(world.symbol_shapes, start=1):
        if form.kind == "crosswalk":
            (x0, y0), (x1, y1) = form.outline.min(axis=0), form.outline.max(axis=0)
            edges = (form.points_world(np.array([[x0, y], [x1, y]])) for y in (y0, y1))
            yield {**{f"edge{i}": _points(edge) for i, edge in enumerate(edges, start=1)}, "id": index}


def _outline(strip: Sides) -> list[dict[str, float]]:
    """A strip between two lines as a polygon, whose last point is not the first one again."""
    kept = thinned(strip, LINE_M)
    return _points(np.concatenate([kept[:, 0], kept[::-1, 1]]))


def _heights(
    world: World, paved: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "2"]]:
    """Heights of the ground in cells, NaN far from the pavement, and where the first cell begins. A row goes east."""
    low, high = np.floor(paved.min(axis=0) - MARGIN_M), np.ceil(paved.max(axis=0) + MARGIN_M)
    columns, rows = np.ceil((high - low) / CELL_M).astype(int).tolist()

    def is_near(at: Int[np.ndarray, "n 2"], size_m: float, room_m: float) -> Bool[np.ndarray, " n"]:
        return ~world.ground.paved.is_clear(low + (at + 0.5) * size_m, room_m)

    # Most cells are far from the pavement: it is asked for blocks of them first.
    block_m, m, n = BLOCK * CELL_M, -(-columns // BLOCK), -(-rows // BLOCK)
    blocks = is_near(_places(m, n), block_m, MARGIN_M + block_m / np.sqrt(2)).reshape(n, m)
    near = blocks.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)[:rows, :columns].ravel()
    at = _places(columns, rows)
    near[near] = is_near(at[near], CELL_M, MARGIN_M)
    heights = np.full(rows * columns, np.nan, np.float32)
    heights[near] = world.ground.height(low + (at[near] + 0.5) * CELL_M)
    return heights.reshape(rows, columns), low


def _places(columns: int, rows: int) -> Int[np.ndarray, "_ 2"]:
    """The column and the row of each cell, row by row."""
    return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)


def _points(points: Points3) -> list[dict[str, float]]:
    return [dict(zip("xyz", row, strict=True)) for row in (np.round(points, MM_DECIMALS) + 0.0).tolist()]


# -- read back


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
        return _array(self.left_lane_boundary)

    @property
    def right(self) -> Float[np.ndarray, "n 3"]:
        return _array(self.right_lane_boundary)

    @property
    def middle(self) -> Float[np.ndarray, "n 3"]:
        """The middle between them."""
        return middle_of(self.left, self.right)


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


def read_map(vectors: Path, heights: Path, cells: Path) -> LogMap:
    """The map of a log by its three files."""
    found = schema.parse(_Vectors, read_file(vectors), str(vectors), "a map of Argoverse 2", 1 << 28)
    lanes = tuple(found.lane_segments.values())
    areas = tuple(_array(area.area_boundary) for area in found.drivable_areas.values())
    crossings = tuple(_array([*c.edge1, *c.edge2[::-1]]) for c in found.pedestrian_crossings.values())
    if any(min(len(lane.left), len(lane.right)) < 2 for lane in lanes) or any(len(area) < 3 for area in areas):
        raise FormatError(f"{vectors}: expected boundaries of two points and areas of three or more, got fewer")
    similar = schema.parse(_Cells, read_file(cells), str(cells), "a similarity")
    cell_from_city = similar.s * np.column_stack([np.array(similar.R).reshape(2, 2), similar.t])
    return LogMap(lanes, areas, crossings, _read_heights(heights), cell_from_city)


def _read_heights(path: Path) -> Float[np.ndarray, "rows columns"]:
    try:
        heights = np.load(io.BytesIO(read_file(path)), allow_pickle=False)
    except (ValueError, EOFError, OSError, MemoryError) as error:
        raise FormatError(f"{path}: expected heights as an array of numpy, got {str(error)[:80]}") from None
    if not isinstance(heights, np.ndarray) or heights.ndim != 2 or heights.dtype.kind != "f":
        raise FormatError(f"{path}: expected heights in rows and columns, got something else")
    return heights.astype(float)


def _array(points: list[_Point]) -> Float[np.ndarray, "n 3"]:
    return np.array([(point.x, point.y, point.z) for point in points]).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Log:
    """A log of an export; its files are read when they are asked for."""

    folder: Path

    @cached_property
    def annotations(self) -> Columns:
        """Boxes at all instants, in the vehicle frame."""
        return self._table(BOXES)

    @cached_property
    def poses(self) -> dict[int, Float[np.ndarray, "4 4"]]:
        """City from vehicle by timestamp."""
        table = self._table(EGO)
        return dict(zip(table["timestamp_ns"].tolist(), matrices(table), strict=True))

    @cached_property
    def sensors(self) -> dict[str, Float[np.ndarray, "4 4"]]:
        """Vehicle from sensor by name."""
        table = self._table(MOUNTS)
        return dict(zip(table["sensor_name"].tolist(), matrices(table), strict=True))

    @cached_property
    def lenses(self) -> dict[str, tuple[Float[np.ndarray, "3 3"], tuple[int, int]]]:
        """Matrix K, and width and height of the image, by camera."""
        table = self._table(LENSES)
        found = {}
        for i, name in enumerate(table["sensor_name"].tolist()):
            fx, fy, cx, cy = (float(table[key][i]) for key in ("fx_px", "fy_px", "cx_px", "cy_px"))
            size = int(table["width_px"][i]), int(table["height_px"][i])
            found[name] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), size
        return found

    def sweep(self, timestamp_ns: int) -> Float[np.ndarray, "n 3"]:
        """Points of the lidar, in the vehicle frame."""
        table = self._table(f"sensors/lidar/{timestamp_ns}.feather")
        return np.column_stack([table[axis] for axis in "xyz"]).astype(float)

    @cached_property
    def map(self) -> LogMap:
        return read_map(*(self.folder / path for path in map_paths(self.folder.name)))

    def _table(self, path: str) -> Columns:
        where, wanted = self.folder / path, TABLES.get(path, POINTS)
        data = read_file(where)
        with reading_table(str(where), wanted.names):
            table = read_arrow(data, str(where), BOUNDS, wanted.names).cast(wanted)
            if any(column.null_count for column in table.columns):
                raise ValueError("missing values")
            return {name: table[name].to_numpy() for name in wanted.names}


def matrices(table: Columns) -> Float[np.ndarray, "n 4 4"]:
    """Poses of a table's rows."""
    wxyz = np.column_stack([table[key] for key in ("qw", "qx", "qy", "qz")])
    places = np.column_stack([table[key] for key in ("tx_m", "ty_m", "tz_m")])
    return np.array([pose_of(*row) for row in zip(places, wxyz, strict=True)]).reshape(-1, 4, 4)


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    return of_parts(out, "picture", lambda part: _frames(out, part, most_frames))


def _frames(out: Path, part: str, most: int) -> Iterator[ReadFrame]:
    for folder in sorted(path for path in (out / part).iterdir() if path.is_dir()):
        log = Log(folder)
        found = [(int(match["timestamp"]), path) for path in folder.glob("sensors/cameras/*/*")
                 if (match := IMAGE.fullmatch(path.name))]  # fmt: skip
        cameras = list(log.lenses)
        for timestamp_ns, path in sorted(found, key=lambda pair: (pair[0], pair[1].parent.name)):
            if most == 0:
                return
            most -= 1
            camera = path.parent.name
            if camera not in log.lenses or camera not in log.sensors:
                raise FormatError(f"{folder / LENSES}: expected a row of {camera}, got none")
            name = str(path.relative_to(out))
            yield ReadFrame(name, str(path), name, (log, camera, timestamp_ns, camera == cameras[0]))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """The camera of every picture; of an instant the boxes, the sweep and the map."""
    log, camera, timestamp_ns, is_first = frame.content
    if timestamp_ns not in log.poses:
        raise FormatError(f"{log.folder / EGO}: expected a pose at {timestamp_ns}, got none")
    cam_from_ego = invert(truth.labels.camera.world_from_cam) @ log.poses[timestamp_ns]
    compared = _camera(log, camera, cam_from_ego, truth.labels.camera)
    if not is_first:
        return compared
    compared += _boxes(log, timestamp_ns, cam_from_ego, truth) + _lidar(log, timestamp_ns, cam_from_ego, truth)
    return compared + compare_log_map(log.map, truth)


def _camera(log: Log, name: str, cam_from_ego: Matrix4, camera: CameraLabel) -> Comparison:
    """How far places that a camera sees are from their pixels."""
    k, size_px = log.lenses[name]
    cv_from_cam = invert(cam_from_ego @ log.sensors[name])
    return compare_pinhole(name, camera, k + FROM_MIDDLE, cv_from_cam, LIMIT_PX, size_px)


def _boxes(log: Log, timestamp_ns: int, cam_from_ego: Matrix4, truth: SourceSample) -> Comparison:
    """Corners of boxes in metres, their class, points and track."""
    every = log.annotations
    table = {key: values[every["timestamp_ns"] == timestamp_ns] for key, values in every.items()}
    sizes_m = np.column_stack([table[key] for key in ("length_m", "width_m", "height_m")])
    told = ({"class": category, "number of points": points}
            for category, points in zip(table["category"], table["num_interior_pts"], strict=True))  # fmt: skip
    return compare_boxes(
        map(FoundBox, map(str, table["track_uuid"]), matrices(table), sizes_m, told),
        objects_of(truth.labels, CATEGORIES),
        lambda item: {"class": CATEGORIES[item.category], "number of points": item.lidar_points or 0},
        cam_from_ego,
        f"{log.folder.parent.name}/{log.folder.name}",
    )


def _lidar(log: Log, timestamp_ns: int, cam_from_ego: Matrix4, truth: SourceSample) -> Comparison:
    """Points of the lidar beside those of our sweep, and its place."""
    compared = compare_sweep(transform(cam_from_ego, log.sweep(timestamp_ns)), truth, POINT_M)
    lidar = truth.labels.lidar
    if not compared.gaps or lidar is None:
        return compared
    place = (cam_from_ego @ log.sensors["up_lidar"])[:3, 3] if "up_lidar" in log.sensors else np.full(3, np.nan)
    off_m = float(np.linalg.norm(place - lidar.cam_from_lidar[:3, 3]))
    problems = [] if off_m <= POINT_M else [f"expected the lidar at its place, got it {off_m:.3g} m off"]
    return compared.because(problems)


PiecesOf = dict[str, list[LogLane]]
"""The pieces of each segment, in order."""


def compare_log_map(found: LogMap, truth: SourceSample) -> Comparison:
    """Lanes in metres; sides, links, neighbours and paint; crossings, areas and heights."""
    segments = truth.labels.graph.segments
    pieces = {place_of(lane.id): lane for lane in found.lanes}
    if any(not 0 <= i < len(segments) for i, _ in pieces) or len(pieces) < len(found.lanes):
        text = f"expected ids of lanes of their own, those of {len(segments)} segments, got {[*pieces][:20]}"
        return Comparison(problems=(text,))
    lanes: PiecesOf = {}
    for i, number in sorted(pieces):
        lanes.setdefault(segments[i].id, []).append(pieces[i, number])
    every = [
        FoundLane(
            str(piece.id),
            name,
            piece.middle,
            {"left": piece.left, "right": piece.right},
            {"left": piece.left_lane_mark_type, "right": piece.right_lane_mark_type},
            [str(other) for other in piece.successors],
            [str(other) for other in piece.predecessors],
        )
        for name, own in lanes.items()
        for piece in own
    ]
    problems = [*_neighbour_problems(lanes, truth, half_widths(truth.scene, lanes)), *_ground_problems(found, truth)]
    problems += symbol_problems("pedestrian crossing", found.crossings, truth, ("crosswalk",), RULE.limit)
    return compare_lanes(every, truth, RULE).because(problems)


def _neighbour_problems(
    lanes: PiecesOf, truth: SourceSample, halves_m: Mapping[str, tuple[float, float]]
) -> Iterator[str]:
    """Findings where a lane has another neighbour than in the lane graph: to the left it may have an oncoming one,
    across a line that both share."""
    owner = {piece.id: (name, piece) for name, pieces in lanes.items() for piece in pieces}
    by_id = {segment.id: segment for segment in truth.labels.graph.segments}
    for name, lane in ((name, piece) for name, pieces in lanes.items() for piece in pieces):
        segment, is_oncoming = by_id[name], _is_oncoming(by_id[name])
        swaps = is_oncoming and truth.scene.roads.sides_are_hosts
        sides = (segment.right, segment.left) if swaps else (segment.left, segment.right)
        for side, number, wanted in zip(
            ("left", "right"), (lane.left_neighbor_id, lane.right_neighbor_id), sides, strict=True
        ):
            got, other = (None, None) if number is None else owner.get(number, (str(number), None))
            apart_m = 0.0 if got is None else np.inf
            if other is not None:
                own, its = (lane.left, other.left if wanted is None else other.right)
                own, its = (own, its) if side == "left" else (lane.right, other.left)
                apart_m = float(distances(own, its).min())
            is_across = wanted is None and side == "left" and got in lanes
            is_across = is_across and is_oncoming != _is_oncoming(by_id[str(got)])
            # Where a lane opens, it is beside its neighbour only farther on.
            most_m = RULE.slack if is_across else 2 * halves_m[name][1]
            if not (got == (wanted if wanted in lanes else None) or is_across) or not apart_m <= most_m:
                yield f"lane {name}: expected {wanted} on its {side}, got {got}, {apart_m:.3g} m off"


def _is_oncoming(segment: Segment) -> bool:
    return segment.s_start_m > segment.s_end_m


def _ground_problems(found: LogMap, truth: SourceSample) -> Iterator[str]:
    """Findings where lanes are not in a drivable area or not on the ground's heights."""
    outlines = [shapely.make_valid(shapely.Polygon(outline[:, :2])) for outline in found.areas if len(outline) > 2]
    yield from area_problems(shapely.buffer(shapely.union_all(outlines), SEAM_M), truth)
    for lane in (lane for lane in truth.labels.lanes if lane.kind == "centerline"):
        points = transform(truth.labels.camera.world_from_cam, lane.xyz_cam)
        over_m = np.abs(found.height(points[:, :2]) - points[:, 2])
        # Where a ramp leaves a road, the higher one is the ground.
        if not np.median(over_m) <= GROUND_M:
            yield f"lane {lane.id}: expected the ground at its height, got it {np.median(over_m):.3g} m away"


FORMAT = SampleFormat(
    title="Argoverse 2: cameras, lidar, boxes and the map of a log",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit, "px": LIMIT_PX},
    links={"val": "test", "test": "val"},
    document=document,
    takes_sweeps=True,
    counted="lane segments",
)
