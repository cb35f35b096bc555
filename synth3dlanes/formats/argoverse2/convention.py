"""Argoverse 2's folders, names, codes and frames.

The vehicle frame (`_ego`) is x forward, y left, z up, metres, its origin in the middle of the rear axle; the city frame
is our world frame. Pixels count from the middle of the first one.
"""

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from synth3dlanes.labels.labels import Marking, PaintColor, Pair
from synth3dlanes.scene.assets.catalogue import VehicleClass

FRONT_CAMERA = "ring_front_center"
RING_CAMERAS = (
    FRONT_CAMERA, "ring_front_left", "ring_front_right", "ring_rear_left", "ring_rear_right", "ring_side_left",
    "ring_side_right",
)  # fmt: skip
CAMERAS = (*RING_CAMERAS, "stereo_front_left", "stereo_front_right")
LIDARS = ("up_lidar", "down_lidar")
"""The original has two on top of each other; readers want a pose of each."""
HOST_FROM_EGO = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, -1.3], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]])
"""The rear axle in our host's road frame, as in the rig argoverse2."""
HALF_PX = 0.5
CATEGORIES: dict[VehicleClass, str] = {
    "car": "REGULAR_VEHICLE", "van": "REGULAR_VEHICLE", "truck": "TRUCK", "bus": "BUS", "trailer": "TRUCK"
}  # fmt: skip
"""A tractor with its semitrailer is one truck."""
START_NS, ROOM_NS = 10**18, 4 * 10**9
"""The first timestamp of an export, and how much later the next picture's log begins at least: tools name frames by
timestamps alone, which must differ between logs and have equal numbers of digits."""
CITY = "SYN"
MOST_PIECES = 1000
CELL_M, MARGIN_M = 0.3, 5.0
"""Size of the cells of the ground's heights, and how far beyond the pavement there are any."""

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


@dataclass(frozen=True)
class LogFiles:
    """The paths of a log's files in an export."""

    part: str
    log: str

    def __str__(self) -> str:
        return f"{self.part}/{self.log}"

    @property
    def annotations(self) -> str:
        """Boxes at all instants."""
        return f"{self}/annotations.feather"

    @property
    def poses(self) -> str:
        """City from vehicle at all instants."""
        return f"{self}/city_SE3_egovehicle.feather"

    @property
    def sensors(self) -> str:
        """Vehicle from sensors."""
        return f"{self}/calibration/egovehicle_SE3_sensor.feather"

    @property
    def intrinsics(self) -> str:
        """Lenses of the cameras."""
        return f"{self}/calibration/intrinsics.feather"

    @property
    def vector_map(self) -> str:
        """Lanes, areas and crossings."""
        return f"{self}/map/log_map_archive_{self.log}____{CITY}_city_0.json"

    @property
    def heights(self) -> str:
        """Heights of the ground by cells."""
        return f"{self}/map/{self.log}_ground_height_surface____{CITY}.npy"

    @property
    def cells(self) -> str:
        """Which cell a place is in."""
        return f"{self}/map/{self.log}___img_Sim2_city.json"

    def image(self, camera: str, timestamp_ns: int) -> str:
        """A picture."""
        return f"{self}/sensors/cameras/{camera}/{timestamp_ns}.jpg"

    def sweep(self, timestamp_ns: int) -> str:
        """The points of the lidar at an instant."""
        return f"{self}/sensors/lidar/{timestamp_ns}.feather"


def log_name(first: int) -> str:
    """The log whose first picture has this number in the export."""
    return f"{first:09d}"


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
