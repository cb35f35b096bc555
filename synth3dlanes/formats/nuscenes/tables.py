"""nuScenes' folders, names, codes and frames; the fields of its tables and maps, and a reader of both.

Vehicle frame (`_ego`): x forward, y left, z up, its origin on the road below the rear axle. Cameras have OpenCV's axes,
the lidar ours; pixels count from the middle of the first one. The level frame of a scene is the vehicle frame of its
first sample, turned so that it has its heading in the world: its plane is the road plane there. In the global frame the
scenes of a place lie beside each other, their level frames in the middles of cells.
"""

import hashlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import shapely
from pydantic import Field, TypeAdapter, ValidationError, create_model

from synth3dlanes.formats.reading import pose_of, read_file
from synth3dlanes.formats.writing import Part
from synth3dlanes.labels.labels import Marking, PaintColor, Pair
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import classes_in
from synth3dlanes.system.arrays import Matrix4, Points2
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import Row3, Row4
from synth3dlanes.system.schema import Excerpt, Number, PathBelow, Positive, validation_problems

FRONT_CAMERA, LIDAR = "CAM_FRONT", "LIDAR_TOP"
REAR_M = 1.4
"""Distance of the rear axle behind our host's middle, as in the rig nuscenes."""
CATEGORIES, ELEMENTS = classes_in("nuscenes"), classes_in("nuscenes", of_elements=True)
MOVING_M_S = 0.2
VISIBLE = (0.4, 0.6, 0.8)
"""Shares from which the levels of visibility 2, 3 and 4 begin."""
VERSIONS: dict[Part, str] = {"train": "v1.0-trainval", "val": "v1.0-trainval", "test": "v1.0-test"}
LOCATIONS: dict[Part, tuple[str, ...]] = {
    "train": ("boston-seaport", "singapore-onenorth"),
    "val": ("singapore-queenstown",),
    "test": ("singapore-hollandvillage",),
}
MASKS = {
    "boston-seaport": "36092f0b03a857c6a3403e25b4b7aab3",
    "singapore-onenorth": "53992ee3023e5494b90c316c183be829",
    "singapore-queenstown": "93406b464a165eaba6d9de76ca09f5da",
    "singapore-hollandvillage": "37819e65e09e5547b8a3ceaefba56bb2",
}
"""The files of masks that the devkit looks for by the name of a place."""
MASK_PX_PER_M, MASK_M = 10, 3000.0
"""The devkit's resolution, and the reach of masks, which is the original's."""
BOXES = "instance", "sample_annotation"
"""Tables of boxes; all others are made of the pictures."""
_TOKENS, _POSE = list[str], {"translation": Row3, "rotation": Row4}
TABLES: dict[str, dict[str, Any]] = {
    "scene": {"log_token": str, "first_sample_token": str},
    "sample": {"scene_token": str, "timestamp": int},
    "sample_data": {
        "sample_token": str, "ego_pose_token": str, "calibrated_sensor_token": str, "filename": PathBelow,
        "width": int, "height": int, "timestamp": int,
    },
    "ego_pose": _POSE,
    "calibrated_sensor": {**_POSE, "sensor_token": str, "camera_intrinsic": list[Row3]},
    "sensor": {"channel": str, "modality": str},
    "instance": {"category_token": str},
    "sample_annotation": {
        **_POSE, "sample_token": str, "instance_token": str, "visibility_token": str, "attribute_tokens": _TOKENS,
        "size": Row3, "num_lidar_pts": int,
    },
    "category": {"name": str},
    "attribute": {"name": str},
    "visibility": {},
    "log": {"logfile": str, "location": str},
    "map": {"filename": PathBelow},
}  # fmt: skip
"""What is read of the rows of each table, beside their tokens."""


class _Hole(Excerpt):
    node_tokens: list[str]


class _Paint(Excerpt):
    node_token: str
    segment_type: str


class _Place(Excerpt):
    tx: Number
    ty: Number
    tz: Number


_AREA, _LINE, _SIDE = {"polygon_token": str}, {"line_token": str}, list[_Paint]
LAYERS: dict[str, dict[str, Any]] = {
    "node": {"x": Number, "y": Number},
    "line": {"node_tokens": _TOKENS},
    "polygon": {"exterior_node_tokens": _TOKENS, "holes": list[_Hole]},
    "drivable_area": {"polygon_tokens": _TOKENS},
    "road_segment": _AREA,
    "road_block": {},
    "lane": {**_AREA, "left_lane_divider_segments": _SIDE, "right_lane_divider_segments": _SIDE},
    "lane_connector": _AREA,
    "ped_crossing": _AREA,
    "walkway": _AREA,
    "stop_line": _AREA,
    "carpark_area": {},
    "road_divider": _LINE,
    "lane_divider": {**_LINE, "lane_divider_segments": _SIDE},
    "traffic_light": {"pose": _Place},
}
"""The lists of a map, and what is read of their records; `road_block` and `carpark_area` stay empty."""
PATHS, LINKS = "arcline_path_3", "connectivity"
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


def table_file(version: str, name: str) -> str:
    """The path of a table, or of the list `splits` beside the tables."""
    return f"{version}/{name}.json"


def map_file(location: str) -> str:
    """The path of the map of a place."""
    return f"maps/expansion/{location}.json"


def mask_file(location: str) -> str:
    """The path of the mask of a place."""
    return f"maps/{MASKS[location]}.png"


def token(*names: object) -> str:
    """The 32 hex digits that name a record, by what it is."""
    return hashlib.md5("/".join(map(str, names)).encode(), usedforsecurity=False).hexdigest()


def segment_type(marking: Marking, color: PaintColor | None, double: bool | None, pair: Pair | None = None) -> str:
    """The name of paint; the stripes of a pair from the left, as the lane's traffic drives."""
    if marking == "none":
        return "NIL"
    stripes = pair or f"{'double' if double else 'single'}_{marking}"
    return f"{stripes}_{color or 'white'}".upper()


def parked_of(scene: Scene, objects: Sequence[ObjectLabel]) -> set[int]:
    """The ids of parked cars, which stand beside their lanes. Cars come first among the objects."""
    return {item.id for item, car in zip(objects, scene.cars, strict=False) if car.offset_m and not car.track}


def attribute_of(item: ObjectLabel, is_parked: bool) -> str | None:
    """The attribute of an object by its speed; None where that is not known."""
    if item.velocity_cam is None:
        return None
    is_moving, class_ = np.linalg.norm(item.velocity_cam) > MOVING_M_S, CATEGORIES[item.category]
    if class_ in ("vehicle.bicycle", "vehicle.motorcycle"):
        return "cycle.with_rider"
    match class_.split(".")[0]:
        case "human":
            return "pedestrian.moving" if is_moving else "pedestrian.standing"
        case "vehicle":
            return "vehicle.moving" if is_moving else "vehicle.parked" if is_parked else "vehicle.stopped"
    return None


def visibility_of(share: float | None) -> str:
    """The level of visibility of what is seen to a share; none where nothing is known of it."""
    return "" if share is None else str(1 + sum(share >= least for least in VISIBLE))


def points_of(points: int | None, share: float | None) -> int:
    """The points of the lidar on an object; without a lidar, one that keeps it in tools' lists if a camera sees it."""
    return int(bool(share)) if points is None else points


Row = Any
"""A row of a table, or a record of a layer of a map: an excerpt with what TABLES and LAYERS have of it."""


def _excerpt(**fields: Any) -> Any:
    made: Any = {name: (of, ...) for name, of in fields.items()}
    return create_model("row", __base__=Excerpt, **made)


def _records(fields: Mapping[str, Any]) -> Any:
    return list[_excerpt(token=str, **fields)]  # type: ignore[misc]


_READ = {name: TypeAdapter[Any](_records(fields)) for name, fields in TABLES.items()}
_READ["splits"] = TypeAdapter(dict[str, list[str]])
_MAP = TypeAdapter[Any](
    _excerpt(
        canvas_edge=tuple[Positive, Positive],
        arcline_path_3=dict[str, list[Arc]],
        connectivity=dict[str, _Links],
        **{name: _records(fields) for name, fields in LAYERS.items()},
    )
)


def matrix_of(row: Row) -> Matrix4:
    """The pose of a row."""
    return pose_of(row.translation, row.rotation)


@dataclass(frozen=True, eq=False)
class PlaceMap:
    """A place's map as its file says."""

    layers: Row

    def places(self, tokens: list[str]) -> Points2:
        return np.array([self._nodes[name] for name in tokens]).reshape(-1, 2)

    @cached_property
    def _nodes(self) -> dict[str, tuple[float, float]]:
        return {node.token: (node.x, node.y) for node in self.layers.node}

    @cached_property
    def lines(self) -> dict[str, Points2]:
        return {line.token: self.places(line.node_tokens) for line in self.layers.line}

    @cached_property
    def polygons(self) -> dict[str, shapely.Polygon]:
        """Polygons by their tokens; empty ones of rings that are none."""
        found = dict[str, shapely.Polygon]()
        for of in self.layers.polygon:
            shell, *holes = map(self.places, (of.exterior_node_tokens, *(at.node_tokens for at in of.holes)))
            rings = [ring for ring in holes if len(ring) > 2]
            found[of.token] = shapely.Polygon(shell, rings) if len(shell) > 2 else shapely.Polygon()
        return found


@dataclass(eq=False)
class Version:
    """The tables of a version below the folder of an export; a file is read when it is asked for. `anchors` are the
    global frames from the world by the first picture of each scene that was compared."""

    out: Path
    name: str
    anchors: dict[str, Matrix4] = field(default_factory=dict)
    _read: dict[str, Any] = field(default_factory=dict)

    def table(self, name: str) -> Any:
        """The rows of a table by their tokens; what is in `splits`."""
        if name not in self._read:
            found = _validated(_READ[name], self.out / table_file(self.name, name))
            self._read[name] = {row.token: row for row in found} if name in TABLES else found
        return self._read[name]

    def row(self, table: str, name: str) -> Row:
        """The row of a token. Raises FormatError where there is none."""
        if name not in self.table(table):
            path = self.out / table_file(self.name, table)
            raise FormatError(f"{path}: expected a row with the token {name[:40]}, got none")
        return self.table(table)[name]

    def map(self, location: str) -> PlaceMap:
        if location not in self._read:
            self._read[location] = PlaceMap(_validated(_MAP, self.out / map_file(location)))
        found: PlaceMap = self._read[location]
        return found

    @cached_property
    def boxes(self) -> dict[str, list[Row]]:
        """The boxes of each sample."""
        found = defaultdict[str, list[Row]](list)
        for row in self.table("sample_annotation").values():
            found[row.sample_token].append(row)
        return found

    @cached_property
    def sensors(self) -> dict[str, dict[str, Row]]:
        """What each sample's sensors measured, by their channels."""
        found = defaultdict[str, dict[str, Row]](dict)
        for row in self.table("sample_data").values():
            calibrated = self.row("calibrated_sensor", row.calibrated_sensor_token)
            found[row.sample_token][self.row("sensor", calibrated.sensor_token).channel] = row
        return found

    def cameras(self, sample: str) -> list[tuple[str, Row]]:
        """The channels and pictures of a sample's cameras."""
        return [(channel, data) for channel, data in self.sensors.get(sample, {}).items() if channel != LIDAR]


@dataclass(frozen=True, eq=False)
class CameraPicture:
    """A camera's picture: the version, its row, its channel, and whether it is the first of its sample."""

    version: Version
    data: Row
    channel: str
    is_first: bool

    @property
    def scene(self) -> Row:
        return self.version.row("scene", self.version.row("sample", self.data.sample_token).scene_token)

    @property
    def log(self) -> Row:
        return self.version.row("log", self.scene.log_token)

    def calibrated(self, data: Row) -> Row:
        return self.version.row("calibrated_sensor", data.calibrated_sensor_token)

    def pose(self, data: Row) -> Matrix4:
        """The global frame from the vehicle as a sensor measured."""
        return matrix_of(self.version.row("ego_pose", data.ego_pose_token))


def _validated(adapter: Any, path: Path) -> Any:
    try:
        return adapter.validate_json(read_file(path), strict=True)
    except ValidationError as error:
        raise FormatError("\n".join(validation_problems(error, str(path)))) from None
