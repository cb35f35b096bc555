"""Cosmos's folders, names, colours, tables and frames.

ClipGT's frames are x forward, y left, z up, metres: the rig's (`_rig`) has its origin on the road below the middle of
the rear axle, the scenario's (`_clip`) is the rig's at the first frame, a camera's (`_flu`) looks along x. Pixel
corners are at whole numbers.
"""

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from synth3dlanes.labels.labels import Marking, PaintColor, Pair
from synth3dlanes.scene.assets.catalogue import VehicleClass
from synth3dlanes.scene.settings import SEMANTIC_IDS

FRONT_VIEW = "camera_front_wide_120fov"
"""The view of a camera that is alone, and the one whose times the readers take."""
CAM_FROM_FLU = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
HOST_FROM_RIG = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, -1.3], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""The rear axle in our host's road frame, as for argoverse2, but on the road."""
VERSION = 1
CATEGORIES: dict[VehicleClass, str] = {
    "car": "automobile", "van": "automobile", "truck": "heavy_truck", "bus": "bus", "trailer": "heavy_truck"
}  # fmt: skip
"""A tractor with its semitrailer is one truck."""

FOLDERS = {"rgb": "videos", "depth": "depth", "seg": "seg", "edge": "edge", "hdmap": "control_input_hdmap_bbox"}
"""The videos of a view, and the folders that the loaders expect them in."""
EDGE_LOW, EDGE_HIGH = 100, 200
"""The thresholds of Canny's edges that inference takes by default."""
CLASS_COLORS = np.zeros((256, 3), np.uint8)
"""The colours of classes in segmentation videos, by semantic id."""
for _name, _color in {
    "sky": (70, 130, 180), "terrain": (152, 251, 152), "road": (128, 64, 128), "shoulder": (81, 0, 81),
    "marking": (157, 234, 50), "car": (0, 0, 142), "tree": (107, 142, 35), "symbol": (227, 227, 227),
    "barrier": (180, 165, 180), "pole": (153, 153, 153), "sign": (220, 220, 0), "bridge": (150, 100, 100),
    "building": (70, 70, 70), "kerb": (244, 35, 232), "host": (0, 0, 0), "signal": (250, 170, 30),
}.items():  # fmt: skip
    CLASS_COLORS[SEMANTIC_IDS[_name]] = _color

Rgb = tuple[int, int, int]
LINE_COLORS: dict[PaintColor, Rgb] = {"white": (255, 255, 255), "yellow": (255, 255, 0)}
BOUNDARY, WAIT_LINE, CROSSWALK, ROAD_MARKING = (253, 1, 232), (108, 179, 59), (139, 93, 255), (20, 254, 185)
SIGN, LIGHT, BOX_EDGE = (8, 2, 255), (100, 100, 100), (200, 200, 200)
"""Colours of the lane-map video, as its renderer's third version has them."""
CAR_COLORS, TRUCK_COLORS = ((126, 206, 255), (0, 46, 136)), ((255, 192, 64), (204, 55, 0))
"""Of the rear and of the front."""
WIDTH_PX, OF_WIDTH_PX = 12.0, 1280.0
"""The width of lines in an image of this width."""

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


@dataclass(frozen=True)
class ClipFiles:
    """The paths of a clip's files in an export."""

    part: str
    clip: str

    def table(self, name: str) -> str:
        """A table of the world scenario."""
        return f"{self.part}/clipgt/{self.clip}/{self.clip}.{name}.parquet"

    @property
    def times(self) -> str:
        """The times of the frames."""
        return f"{self.part}/clipgt/{self.clip}/{self.clip}.{FRONT_VIEW}.json"

    @property
    def depths(self) -> str:
        """What the greys of depth videos are, by view."""
        return f"{self.part}/clipgt/{self.clip}/{self.clip}.depth.json"

    def video(self, kind: str, view: str) -> str:
        """A video of a view."""
        return f"{self.part}/{FOLDERS[kind]}/ftheta_{view}/{self.clip}.mp4"


def line_style(marking: Marking, double: bool | None, pair: Pair | None) -> str:
    """How a lane line is painted. ClipGT names a pair from the right of the line's direction."""
    if marking == "none":
        return "VIRTUAL"
    if pair is not None:
        return "DASHED_SOLID" if pair == "solid_dashed" else "SOLID_DASHED"
    return {("solid", False): "SOLID_SINGLE", ("solid", True): "SOLID_GROUP", ("dashed", False): "LONG_DASHED_SINGLE",
            ("dashed", True): "LONG_DASHED_GROUP"}[marking, bool(double)]  # fmt: skip
