"""Read a nuScenes export back and compare it with our labels: what its cameras see in pixels; poses, boxes, sweeps and
lanes in metres. Maps are compared from above, in the global frame."""

import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import shapely
from jaxtyping import Float
from pydantic import BaseModel, Field, RootModel, ValidationError

from synth3dlanes.formats.comparing import (
    Comparison,
    Gap,
    Rule,
    SourceSample,
    compare_camera,
    compare_map,
    compare_sweep,
    distances,
    is_beside,
    pinhole_pixels,
    stations,
)
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.lane_map import link_gaps
from synth3dlanes.formats.nuscenes.convention import (
    ATTRIBUTES,
    CATEGORIES,
    FRONT_CAMERA,
    LIDAR,
    MASK_M,
    MASK_PX_PER_M,
    MASKS,
    MOVING_M_S,
    REAR_M,
    VERSIONS,
    VISIBLE,
    map_file,
    mask_file,
    segment_type,
    table_file,
    token,
)
from synth3dlanes.formats.reading import read_file
from synth3dlanes.geometry.frames import from_axes, invert, rotation, transform, turned
from synth3dlanes.labels.labels import Labels, Lane
from synth3dlanes.labels.object_labels import CORNERS
from synth3dlanes.system.arrays import Matrix4, Points2, Points3
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import Row3, Row4
from synth3dlanes.system.schema import Excerpt, Number, PathBelow, Positive, validation_problems
from synth3dlanes.world.world import scene_network

# Lanes are within this of the labels from above: arcs are fitted, and on a slope heights between the labels' points
# count too, for which other formats have a limit of their own. A map has no heights.
RULE = Rule("m", 0.1, name="lane", slack=np.inf)
LIMIT_PX, BOX_M, POINT_M, POSE_M = 0.02, 0.001, 0.001, 0.001
SIDE_M, GAP_M, LEVEL = 0.05, 0.03, 1e-6
# A label's line between two lanes is in a map if so much of it is this near to dividers.
ON_LINE_M, ON_LINE, LEAST_POINTS = 0.06, 0.9, 10
# A line that has a lane on one side only may be one between lanes farther on, along at most so much of it.
MOST = 0.5
# Lanes of the other direction are at most so far beyond the line beside a median.
FACING_M = 25.0
# An endless road of the paper is measured so far.
ARC_STEP_M, ENDLESS_M = 0.5, 300.0
PNG_HEAD = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
TURN = {"L": 1, "S": 0, "R": -1}
MIRRORED = {"SOLID_DASHED": "DASHED_SOLID", "DASHED_SOLID": "SOLID_DASHED"}
EGO_FROM_HOST = np.array([[0, 1.0, 0, REAR_M], [-1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])
CV_FROM_OURS = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])


class _Row(Excerpt):
    token: str


class _Mask(_Row):
    filename: PathBelow


class _Splits(RootModel[dict[str, list[str]]]):
    """The names of scenes by parts."""


class _Posed(_Row):
    translation: Row3
    rotation: Row4

    @property
    def matrix(self) -> Matrix4:
        """The pose."""
        wxyz = np.array(self.rotation)
        x, y, z = rotation(wxyz).T if wxyz.any() else np.full((3, 3), np.nan)
        return from_axes(x, y, z, np.array(self.translation))


class _Scene(_Row):
    log_token: str
    first_sample_token: str


class _Log(_Row):
    logfile: str
    location: str


class _Sample(_Row):
    scene_token: str
    timestamp: int


class _Data(_Row):
    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    filename: PathBelow
    width: int
    height: int
    timestamp: int


class _Calibrated(_Posed):
    sensor_token: str
    camera_intrinsic: list[Row3]


class _Sensor(_Row):
    channel: str
    modality: str


class _Annotation(_Posed):
    sample_token: str
    instance_token: str
    visibility_token: str
    attribute_tokens: list[str]
    size: Row3
    num_lidar_pts: int


class _Instance(_Row):
    category_token: str


class _Named(_Row):
    name: str


class _Node(_Row):
    x: Number
    y: Number


class _Line(_Row):
    node_tokens: list[str]


class _Polygon(_Row):
    exterior_node_tokens: list[str]
    holes: list["_Hole"]


class _Hole(Excerpt):
    node_tokens: list[str]


class _Area(_Row):
    polygon_token: str


class _Drivable(_Row):
    polygon_tokens: list[str]


class _Paint(Excerpt):
    node_token: str
    segment_type: str


class _Lane(_Area):
    left_lane_divider_segments: list[_Paint]
    right_lane_divider_segments: list[_Paint]


class _RoadDivider(_Row):
    line_token: str


class _LaneDivider(_RoadDivider):
    lane_divider_segments: list[_Paint]


class _Place(Excerpt):
    tx: Number
    ty: Number
    tz: Number


class _Light(_Row):
    pose: _Place


_Length = Annotated[float, Field(ge=0, le=1e4)]


class _Arc(Excerpt):
    start_pose: Row3
    shape: str
    radius: Positive
    segment_length: tuple[_Length, _Length, _Length]


class _Links(Excerpt):
    incoming: list[str]
    outgoing: list[str]


class _Map(Excerpt):
    """A place's map as its file says."""

    canvas_edge: tuple[Positive, Positive]
    node: list[_Node]
    line: list[_Line]
    polygon: list[_Polygon]
    drivable_area: list[_Drivable]
    lane: list[_Lane]
    lane_connector: list[_Area]
    ped_crossing: list[_Area]
    stop_line: list[_Area]
    road_divider: list[_RoadDivider]
    lane_divider: list[_LaneDivider]
    traffic_light: list[_Light]
    arcline_path_3: dict[str, list[_Arc]]
    connectivity: dict[str, _Links]

    def places(self, tokens: list[str]) -> Points2:
        """The places of nodes."""
        return np.array([self._nodes[name] for name in tokens]).reshape(-1, 2)

    @cached_property
    def _nodes(self) -> dict[str, tuple[float, float]]:
        return {node.token: (node.x, node.y) for node in self.node}

    @cached_property
    def lines(self) -> dict[str, Points2]:
        """Lines by their tokens."""
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


Line = Float[np.ndarray, "_ 2"]
Row = TypeVar("Row", bound=_Row)
Model = TypeVar("Model", bound=BaseModel)


@dataclass(eq=False)
class _Version:
    """The tables of a version below the folder of an export; a file is read when it is asked for. `anchors` are the
    global frames from the world by the first picture of each scene that was compared."""

    out: Path
    name: str
    anchors: dict[str, Matrix4] = field(default_factory=dict)
    _read: dict[str, Any] = field(default_factory=dict)

    def rows(self, table: str, model: type[Row]) -> dict[str, Row]:
        """The rows of a table by their tokens."""
        if table not in self._read:
            path = self.out / table_file(self.name, table)
            rows: list[Row] = _validated(RootModel[list[model]], path).root  # type: ignore[valid-type]
            self._read[table] = {row.token: row for row in rows}
        found: dict[str, Row] = self._read[table]
        return found

    def row(self, table: str, model: type[Row], name: str) -> Row:
        """The row of a token. Raises FormatError where there is none."""
        rows = self.rows(table, model)
        if name not in rows:
            path = self.out / table_file(self.name, table)
            raise FormatError(f"{path}: expected a row with the token {name[:40]}, got none")
        return rows[name]

    def map(self, location: str) -> _Map:
        """The map of a place."""
        if location not in self._read:
            self._read[location] = _validated(_Map, self.out / map_file(location))
        found: _Map = self._read[location]
        return found

    @cached_property
    def boxes(self) -> dict[str, list[_Annotation]]:
        """The boxes of each sample."""
        found = defaultdict[str, list[_Annotation]](list)
        for row in self.rows("sample_annotation", _Annotation).values():
            found[row.sample_token].append(row)
        return found

    @cached_property
    def sensors(self) -> dict[str, dict[str, _Data]]:
        """What each sample's sensors measured, by their channels."""
        found = defaultdict[str, dict[str, _Data]](dict)
        for row in self.rows("sample_data", _Data).values():
            calibrated = self.row("calibrated_sensor", _Calibrated, row.calibrated_sensor_token)
            found[row.sample_token][self.row("sensor", _Sensor, calibrated.sensor_token).channel] = row
        return found


def _validated(model: type[Model], path: Path) -> Model:
    try:
        return model.model_validate_json(read_file(path), strict=True)
    except ValidationError as error:
        raise FormatError("\n".join(validation_problems(error, str(path)))) from None


@dataclass(frozen=True, eq=False)
class _Picture:
    """A camera's picture: the version, its row, its channel, and whether it is the first of its sample."""

    version: _Version
    data: _Data
    channel: str
    is_first: bool

    @property
    def sample(self) -> _Sample:
        """Its sample."""
        return self.version.row("sample", _Sample, self.data.sample_token)

    @property
    def scene(self) -> _Scene:
        """Its scene."""
        return self.version.row("scene", _Scene, self.sample.scene_token)

    @property
    def log(self) -> _Log:
        """Its log."""
        return self.version.row("log", _Log, self.scene.log_token)

    def calibrated(self, data: _Data) -> _Calibrated:
        """The calibration of a sensor."""
        return self.version.row("calibrated_sensor", _Calibrated, data.calibrated_sensor_token)

    def pose(self, data: _Data) -> Matrix4:
        """The global frame from the vehicle as a sensor measured."""
        return self.version.row("ego_pose", _Posed, data.ego_pose_token).matrix


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """The pictures of each version."""
    for name in dict.fromkeys(VERSIONS.values()):
        if (out / name).is_dir():
            yield FrameList(name, _frames(_Version(out, name), most_frames), "picture")


def _read_others(version: _Version) -> None:
    """Read what no picture is compared with. Raises FormatError where it is not what tools expect."""
    for name in ("category", "attribute", "visibility"):
        version.rows(name, _Row if name == "visibility" else _Named)
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


def _frames(version: _Version, most: int) -> Iterator[ReadFrame]:
    _read_others(version)
    samples = sorted(version.rows("sample", _Sample).values(), key=lambda sample: sample.timestamp)
    for sample in samples:
        cameras = [channel for channel in version.sensors.get(sample.token, {}) if channel != LIDAR]
        for channel in cameras:
            if most == 0:
                return
            most -= 1
            data = version.sensors[sample.token][channel]
            picture = _Picture(version, data, channel, channel == cameras[0])
            yield ReadFrame(data.filename, str(version.out / data.filename), data.filename, picture)


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """The camera and the pose of every picture; of a sample the boxes, the sweep and the map."""
    picture: _Picture = frame.content
    global_from_ego = picture.pose(picture.data)
    global_from_cam = global_from_ego @ picture.calibrated(picture.data).matrix @ CV_FROM_OURS
    compared = _camera(picture, truth) + _pose(picture, global_from_ego, global_from_cam, truth)
    if not picture.is_first or compared.problems:
        return compared
    compared += _boxes(picture, global_from_cam, truth) + _sweep(picture, global_from_cam, truth)
    return compared + _map(picture, global_from_cam, truth)


def _camera(picture: _Picture, truth: SourceSample) -> Comparison:
    """How far places that a camera sees are from their pixels, by its place on the vehicle."""
    camera, mounted, data = truth.labels.camera, truth.scene.camera, picture.data
    calibrated = picture.calibrated(data)
    if (data.width, data.height) != (camera.width_px, camera.height_px) or len(calibrated.camera_intrinsic) != 3:
        expected = f"a matrix and a size of {camera.width_px}x{camera.height_px}"
        return Comparison(problems=(f"camera: expected {expected}, got {data.width}x{data.height}",))
    host_from_cam = turned(0.0, mounted.right_m, mounted.forward_m) @ camera.road_from_cam
    img_from_cv = np.array(calibrated.camera_intrinsic) + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    cv_from_cam = invert(calibrated.matrix) @ EGO_FROM_HOST @ host_from_cam
    return compare_camera(picture.channel, camera, partial(pinhole_pixels, img_from_cv, cv_from_cam), LIMIT_PX)


def _pose(picture: _Picture, global_from_ego: Matrix4, global_from_cam: Matrix4, truth: SourceSample) -> Comparison:
    """How far places are from where the first picture of the scene has them; the first vehicle must be level."""
    global_from_world = global_from_cam @ invert(truth.labels.camera.world_from_cam)
    anchor = picture.version.anchors.setdefault(picture.sample.scene_token, global_from_world)
    around = truth.labels.camera.world_from_cam[:3, 3] + 50 * np.eye(3)
    apart = np.linalg.norm(transform(global_from_world, around) - transform(anchor, around), axis=1)
    compared = Comparison.within([Gap.of("the vehicle", "m", apart, "pose")], {"m": POSE_M})
    is_level = np.abs([*(global_from_ego[:3, 2] - [0, 0, 1]), global_from_ego[2, 3]]).max() < LEVEL
    if picture.data.sample_token == picture.scene.first_sample_token and not is_level:
        return compared.because(["expected the first vehicle of the scene level and at height 0, got another pose"])
    return compared


def _boxes(picture: _Picture, global_from_cam: Matrix4, truth: SourceSample) -> Comparison:
    """Corners of boxes in metres, their class, attribute, visibility, points and track."""
    version, items = picture.version, list(truth.labels.objects or ())
    problems, gaps, tracks, left = list[str](), list[Gap](), dict[str, str](), {item.id: item for item in items}
    seen = _seen(picture, truth)
    for row in version.boxes.get(picture.data.sample_token, []):
        width, length, height = row.size
        found = transform(row.matrix, CORNERS[:, [1, 0, 2]] * [1, -1, 1] * np.array([length, width, height]) / 2)
        if not left:
            problems.append(f"object {row.instance_token}: expected one of the labels, got none left")
            continue
        ours = {key: transform(global_from_cam, item.corners_cam) for key, item in left.items()}
        middle = found.mean(axis=0)
        nearest = min(ours, key=lambda key: float(np.linalg.norm(ours[key].mean(axis=0) - middle)))
        item = left.pop(nearest)
        gaps.append(Gap.of(f"object {item.id}", "m", np.linalg.norm(found - ours[item.id], axis=1), "box"))
        tracks[row.instance_token] = f"object {item.id} of {picture.log.logfile}"
        instance = version.row("instance", _Instance, row.instance_token)
        attributes = [version.row("attribute", _Named, name).name for name in row.attribute_tokens]
        speed_m_s = None if item.velocity_cam is None else float(np.linalg.norm(item.velocity_cam))
        allowed = [()] if speed_m_s is None else [(name,) for name in ATTRIBUTES[:1] if speed_m_s > MOVING_M_S]
        shares = None if seen[item.id] is None else str(1 + sum(seen[item.id] >= least for least in VISIBLE))
        points = int(bool(seen[item.id])) if item.lidar_points is None else item.lidar_points
        for what, got, expected in (
            ("class", version.row("category", _Named, instance.category_token).name, [CATEGORIES[item.category]]),
            ("attribute", tuple(attributes), allowed or [(name,) for name in ATTRIBUTES[1:]]),
            ("level of visibility", row.visibility_token, [shares or ""]),
            ("number of points", row.num_lidar_pts, [points]),
        ):
            if got not in expected:
                problems.append(f"object {item.id}: expected the {what} {expected[0]}, got {got}")
    problems += (f"expected {item.category} {item.id}, got it in no row" for item in left.values())
    return Comparison.within(gaps, {"m": BOX_M}).because(problems) + Comparison(tracks=tracks)


def _seen(picture: _Picture, truth: SourceSample) -> dict[int, Any]:
    """The greatest share of each object that a camera of the sample sees, None where nothing is known of it."""
    channels, found = picture.version.sensors[picture.data.sample_token], dict[int, Any]()
    for other in truth.moment:
        if (other.labels.camera.name or FRONT_CAMERA) in channels:
            for item in other.labels.objects or ():
                shares = (item.visible_fraction, found.get(item.id))
                found[item.id] = max((share for share in shares if share is not None), default=None)
    return found


def _sweep(picture: _Picture, global_from_cam: Matrix4, truth: SourceSample) -> Comparison:
    """How far points of the lidar are from those of our sweep."""
    data = picture.version.sensors[picture.data.sample_token].get(LIDAR)
    if data is None:
        return Comparison(problems=(f"expected a sweep of {LIDAR}, got none",))
    path, numbers = picture.version.out / data.filename, read_file(picture.version.out / data.filename)
    if len(numbers) % 20:
        raise FormatError(f"{path}: expected points of five numbers of 4 bytes, got {len(numbers)} bytes")
    found = np.frombuffer(numbers, "<f4").reshape(-1, 5).astype(float)
    cam_from_lidar = invert(global_from_cam) @ picture.pose(data) @ picture.calibrated(data).matrix
    compared = compare_sweep(transform(cam_from_lidar, found[:, :3]), truth, POINT_M)
    is_other = bool(compared.gaps and truth.sweep is not None and (found[:, 4] != truth.sweep.points().beam).any())
    return compared.because(["expected the beams of our sweep, got others"] if is_other else [])


class _FromAbove(SourceSample):
    """A sample whose world frame is an export's global frame, and whose lines lie in its plane."""

    def __init__(self, truth: SourceSample, global_from_cam: Matrix4) -> None:
        super().__init__(truth.reader, truth.place)
        self.global_from_cam = global_from_cam

    @cached_property
    def labels(self) -> Labels:
        """Its labels."""
        own = SourceSample(self.reader, self.place).labels
        lanes = tuple(replace(lane, xyz_cam=self._flat(lane.xyz_cam)) for lane in own.lanes)
        symbols = tuple(replace(symbol, xyz_cam=self._flat(symbol.xyz_cam)) for symbol in own.symbols)
        return replace(own, camera=replace(own.camera, world_from_cam=np.eye(4)), lanes=lanes, symbols=symbols)

    def _flat(self, points_cam: Points3) -> Points3:
        return np.asarray(transform(self.global_from_cam, points_cam) * [1, 1, 0])


def _map(picture: _Picture, global_from_cam: Matrix4, truth: SourceSample) -> Comparison:
    """Lanes in metres; sides, links and paint; what else is on the road."""
    found, above = picture.version.map(picture.log.location), _FromAbove(truth, global_from_cam)
    names = {token(picture.log.logfile, "lane", segment.id): segment.id for segment in truth.labels.graph.segments}
    try:
        paths = {names[key]: _places(arcs) for key, arcs in found.arcline_path_3.items() if key in names and arcs}
        problems = [
            *_side_problems(found, names, paths, _half_widths(truth, [*paths], global_from_cam)),
            *_link_problems(found, names, paths, truth),
            *_divider_problems(found, above.labels),
            *_thing_problems(found, above.labels, truth, global_from_cam),
        ]
    except KeyError as error:
        path = picture.version.out / map_file(picture.log.location)
        raise FormatError(f"{path}: expected a record with the token {error}, got none") from None
    flat = [(name, np.column_stack([path, np.zeros(len(path))])) for name, path in paths.items()]
    return compare_map(flat, above, RULE).because(problems)


def _places(arcs: list[_Arc]) -> Points2:
    """Places along the arcs of a path."""
    found = list[tuple[float, float]]()
    for arc in arcs:
        x, y, yaw = arc.start_pose
        for letter, length in zip(arc.shape, arc.segment_length, strict=False):
            k = TURN.get(letter, 0) / arc.radius
            steps = np.linspace(0, length, 1 + max(1, int(np.ceil(length / ARC_STEP_M)))) if length else np.zeros(1)
            # sinc keeps straight pieces in the same formula: the chord of an arc, in the direction of its middle.
            chords, headings = steps * np.sinc(k * steps / 2 / np.pi), yaw + k * steps / 2
            found += zip(x + chords * np.cos(headings), y + chords * np.sin(headings), strict=True)
            (x, y), yaw = found[-1], yaw + k * length
    return np.array(found)


def _half_widths(truth: SourceSample, names: list[str], global_from_cam: Matrix4) -> dict[str, tuple[float, float]]:
    """Half the least and the greatest width of each lane from above: in a tilted plane, that of its edges in space."""
    global_from_world = global_from_cam @ invert(truth.labels.camera.world_from_cam)
    found, network = dict[str, tuple[float, float]](), scene_network(truth.scene)
    for name in names:
        lane = network.lanes[name]
        road = network.road(lane.road)
        first_m, last_m = np.nan_to_num([lane.start_m, lane.end_m], posinf=ENDLESS_M, neginf=-ENDLESS_M)
        s = np.linspace(first_m, last_m, 50)
        left, right = (transform(global_from_world, road.points(s, edge(s)))[:, :2] for edge in road.lines_of(lane)[1:])
        # On a slope what is beside a place is not square to the road from above.
        (dx, dy), (x, y) = np.gradient((left + right) / 2, axis=0).T, (right - left).T
        widths_m = np.abs(dx * y - dy * x) / np.hypot(dx, dy)
        found[name] = float(widths_m.min()) / 2, float(widths_m.max()) / 2
    return found


def _side_problems(
    found: _Map, names: Mapping[str, str], paths: Mapping[str, Points2], halves_m: Mapping[str, tuple[float, float]]
) -> Iterator[str]:
    """Findings where a boundary is on the other side, or not half a lane's width from the middle, or the middle is not
    in the lane's polygon."""
    own = [lane for lane in (*found.lane, *found.lane_connector) if names.get(lane.token) in paths]
    yield from (f"lane {name}: expected a polygon, got none" for name in {*paths} - {names[lane.token] for lane in own})
    for lane in own:
        name = names[lane.token]
        path, (least_m, most_m) = paths[name], halves_m[name]
        area = shapely.buffer(found.polygons[lane.polygon_token], SIDE_M)
        if not shapely.contains_xy(area, *path.T).all():
            yield f"lane {name}: expected its middle in its polygon, got it outside"
        if not isinstance(lane, _Lane):
            continue
        for side, sign, segments in (
            ("left", 1, lane.left_lane_divider_segments), ("right", -1, lane.right_lane_divider_segments)
        ):  # fmt: skip
            line = found.places([segment.node_token for segment in segments])
            fine = shapely.get_coordinates(shapely.segmentize(shapely.LineString(line), 1.0)) if len(line) > 1 else line
            if not len(fine):
                yield f"lane {name}: expected a {side} boundary, got none"
                continue
            at = np.argmin(np.linalg.norm(fine[:, None] - path, axis=2), axis=1)
            (dx, dy), (x, y) = np.gradient(path, axis=0)[at].T, (fine - path[at]).T
            got_m = float(np.median(sign * (dx * y - dy * x) / np.maximum(np.hypot(dx, dy), 1e-9)))
            if not least_m - SIDE_M <= got_m <= most_m + SIDE_M:
                yield f"lane {name}: expected its {side} boundary {most_m:.3f} m on that side, got {got_m:.3f} m"


def _link_problems(
    found: _Map, names: Mapping[str, str], paths: Mapping[str, Points2], truth: SourceSample
) -> Iterator[str]:
    """Findings where links are not those of the lane graph, or lanes do not meet."""
    links = [(a, b) for a, after in truth.labels.graph.successors.items() for b in after if a in paths and b in paths]
    gaps_m = link_gaps(truth.scene, links)
    for key, name in names.items():
        if name not in paths:
            continue
        got = found.connectivity[key]
        for word, tokens, expected in (
            ("follow", got.outgoing, {b for a, b in links if a == name}),
            ("precede", got.incoming, {a for a, b in links if b == name}),
        ):
            others = {names.get(other, other) for other in tokens}
            if others != expected:
                yield f"lane {name}: expected {sorted(expected) or 'none'} to {word} it, got {sorted(others) or 'none'}"
    for (a, b), most_m in gaps_m.items():
        gap_m = float(np.linalg.norm(paths[a][-1] - paths[b][0]))
        if not gap_m <= GAP_M + most_m:
            yield f"lane {a}: expected {b} to begin where it ends, got it {gap_m:.3f} m away"


def _divider_problems(found: _Map, labels: Labels) -> Iterator[str]:
    """Findings where a painted line between two lanes is no divider, or one of another kind or paint."""
    centers = {lane.id: lane for lane in labels.lanes if lane.kind == "centerline" and len(lane.xyz_cam) > 1}
    kinds: dict[str, list[tuple[Points2, set[str] | None]]] = {
        "road divider": [(found.lines[row.line_token], None) for row in found.road_divider],
        "lane divider": [
            (found.lines[row.line_token], {of.segment_type for of in row.lane_divider_segments})
            for row in found.lane_divider
        ],
    }
    kinds = {kind: [divider for divider in of if len(divider[0]) > 1] for kind, of in kinds.items()}
    every = [divider for dividers in kinds.values() for divider in dividers]
    for line in labels.lanes:
        if line.kind != "delimiter" or line.junction is not None:
            continue
        sides = [centers[name] for name in (line.left, line.right) if name in centers]
        if len(sides) < 2:
            if len(line.xyz_cam) >= LEAST_POINTS and not (sides and _faces_others(line, sides[0], centers)):
                xy = line.xyz_cam[:, :2]
                on = [distances(xy, of) < ON_LINE_M for of, _ in every if _may_touch(of, xy)]
                share = np.any(on, axis=0).mean() if on else 0.0
                if share > MOST:
                    yield f"{line.id}: expected no divider along the edge of a road, got one along {share:.0%} of it"
            continue
        xy = line.xyz_cam[:, :2]
        xy = xy[np.all([is_beside(xy, side.xyz_cam[:, :2]) for side in sides], axis=0)]
        if len(xy) < LEAST_POINTS:
            continue
        kind = "lane divider" if len({_goes_on(side, xy) for side in sides}) == 1 else "road divider"
        near = [(of, paint, distances(xy, of) < ON_LINE_M) for of, paint in kinds[kind] if _may_touch(of, xy)]
        covered = np.any([at for _, _, at in near], axis=0).mean() if near else 0.0
        if not covered >= ON_LINE:
            yield f"{line.id}: expected a {kind} along it, got one along {covered:.0%} of it"
            continue
        for of, paint, at in near:
            if paint is not None and at.mean() > ON_LINE:
                expected = _paint(line, of, xy)
                if paint != {expected}:
                    told = ", ".join(sorted(paint))
                    yield f"{line.id}: expected the paint {expected}, got {told}"


def _faces_others(line: Lane, own: Lane, centers: Mapping[str, Lane]) -> bool:
    """Whether a line is on that side of its lane where others drive the other way, beyond a median."""
    xy, middle = line.xyz_cam[:, :2], own.xyz_cam[:, :2]
    is_onward = _goes_on(own, xy)
    for other in centers.values():
        its = other.xyz_cam[:, :2]
        if is_beside(xy, its).sum() > LEAST_POINTS and _goes_on(other, xy) != is_onward:
            apart_m = float(np.median(distances(xy, its)))
            if apart_m < min(float(np.median(distances(middle, its))), FACING_M):
                return True
    return False


def _goes_on(lane: Lane, xy: Points2) -> bool:
    """Whether the traffic of a lane goes from the first to the last of some places beside it."""
    first_m, last_m = stations(xy[[0, -1]], lane.xyz_cam[:, :2])
    return bool((last_m > first_m) != (lane.direction == "oncoming"))


def _may_touch(of: Line, xy: Line) -> bool:
    """Whether the boxes around two lines touch."""
    return bool((of.min(axis=0) <= xy.max(axis=0) + 1).all() and (of.max(axis=0) >= xy.min(axis=0) - 1).all())


def _paint(line: Lane, of: Line, xy: Line) -> str:
    """The paint of a line of the labels as the traffic along a divider sees it."""
    text = segment_type(line.marking, line.color, line.double, line.pair)
    if line.pair is not None and (xy[-1] - xy[0]) @ (of[-1] - of[0]) < 0:
        stripes = line.pair.upper()
        return text.replace(stripes, MIRRORED[stripes])
    return text


def _thing_problems(found: _Map, above: Labels, truth: SourceSample, global_from_cam: Matrix4) -> Iterator[str]:
    """Findings where symbols, signals or the pavement below lanes are not in the map."""
    for word, rows, kinds in (
        ("pedestrian crossing", found.ped_crossing, ("crosswalk",)),
        ("stop line", found.stop_line, ("stop_line", "give_way_line")),
    ):
        areas = [found.polygons[row.polygon_token] for row in rows]
        for symbol in (symbol for symbol in above.symbols if symbol.kind in kinds):
            ours = shapely.Polygon(symbol.xyz_cam[:, :2])
            off_m = min((float(shapely.hausdorff_distance(ours, area)) for area in areas), default=np.inf)
            if not off_m <= RULE.limit:
                yield f"expected a {word} on a {symbol.kind}, got none nearer than {off_m:.3g} m"
    lights = np.array([(row.pose.tx, row.pose.ty, row.pose.tz) for row in found.traffic_light]).reshape(-1, 3)
    for item in truth.labels.traffic_elements or ():
        if item.category == "traffic_light":
            (place,) = transform(global_from_cam, item.center_cam[None])
            off_m = float(np.linalg.norm(lights - place, axis=1).min(initial=np.inf))
            if not off_m <= RULE.limit:
                yield f"expected a traffic light at that of the labels, got none nearer than {off_m:.3g} m"
    names = [name for row in found.drivable_area for name in row.polygon_tokens]
    area = shapely.buffer(shapely.union_all([found.polygons[name] for name in names]), RULE.limit)
    shapely.prepare(area)
    for lane in above.lanes:
        inside = shapely.contains_xy(area, *lane.xyz_cam[:, :2].T)
        if lane.kind == "centerline" and not inside.all():
            yield f"lane {lane.id}: expected it in the drivable area, got {int((~inside).sum())} points outside"
