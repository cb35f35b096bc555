"""nuScenes' folders, names, codes and frames.

Vehicle frame (`_ego`): x forward, y left, z up, its origin on the road below the rear axle. Cameras have OpenCV's axes,
the lidar ours; pixels count from the middle of the first one. The level frame of a scene is the vehicle frame of its
first sample, turned so that it has its heading in the world: its plane is the road plane there. In the global frame the
scenes of a place lie beside each other, their level frames in the middles of cells.
"""

import hashlib
from collections.abc import Mapping, Sequence

import numpy as np

from synth3dlanes.formats.writing import Part
from synth3dlanes.geometry.frames import from_axes, invert, quaternion, rotation, turned
from synth3dlanes.labels.labels import Marking, PaintColor, Pair
from synth3dlanes.scene.things import classes_in
from synth3dlanes.system.arrays import Matrix4

FRONT_CAMERA, LIDAR = "CAM_FRONT", "LIDAR_TOP"
REAR_M = 1.4
"""Distance of the rear axle behind our host's middle, as in the rig nuscenes."""
HOST_FROM_EGO = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, -REAR_M], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
EGO_FROM_LIDAR = np.array([[0.0, 1.0, 0.0, 0.94], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.84], [0.0, 0.0, 0.0, 1.0]])
"""The place of the original's lidar, which an empty sweep has too: tools measure from there."""
START_US, ROOM_US = 10**15, 4 * 10**6
"""The first timestamp, and how much later the next picture's scene begins at least."""
DATE = "2001-09-09"
CATEGORIES, ELEMENTS = classes_in("nuscenes"), classes_in("nuscenes", of_elements=True)
CLASSES = (
    "animal", "human.pedestrian.adult", "human.pedestrian.child", "human.pedestrian.construction_worker",
    "human.pedestrian.personal_mobility", "human.pedestrian.police_officer", "human.pedestrian.stroller",
    "human.pedestrian.wheelchair", "movable_object.barrier", "movable_object.debris",
    "movable_object.pushable_pullable", "movable_object.trafficcone", "static_object.bicycle_rack", "vehicle.bicycle",
    "vehicle.bus.bendy", "vehicle.bus.rigid", "vehicle.car", "vehicle.construction", "vehicle.emergency.ambulance",
    "vehicle.emergency.police", "vehicle.motorcycle", "vehicle.trailer", "vehicle.truck",
)  # fmt: skip
"""All classes of the original, numbered from 1."""
ATTRIBUTES = (
    "vehicle.moving", "vehicle.stopped", "vehicle.parked", "cycle.with_rider", "pedestrian.moving",
    "pedestrian.standing",
)  # fmt: skip
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
SCENES: dict[Part, str] = {
    "train": "1-2 4-11 19-34 41-76 120-135 138-139 149-152 154-155 157-168 170-185 187-188 190-196 199-200 202-204 "
    "206-214 218-220 222 224-264 283-306 315-318 321 323-324 328 347-386 388-403 405-408 410-459 461-465 467-469 "
    "471-472 474-480 500-501 504-514 518 525-539 541-546 566 568 570-578 580 582-600 639-679 681 683-689 695-698 "
    "700-701 703-719 726-728 730-731 733-741 744 746-747 749-752 757-765 767-769 786-787 789-792 803-806 808-813 "
    "815-817 819-822 847-856 858 860-866 868-873 875-878 880 882-903 945 947 949 952-953 955-961 975-984 988-992 "
    "994-1025 1044-1058 1074-1102 1104-1110",
    "val": "3 12-18 35-36 38-39 92-110 221 268-278 329-332 344-346 519-524 552-565 625-627 629-630 632-638 770-771 "
    "775 777-778 780-784 794-800 802 904-917 919-931 962-963 966-969 971-972 1059-1073",
    "test": "77-91 111-119 140 142-148 265-266 279-282 307-314 333-343 481-498 547-551 601-604 606-624 827-831 833-842 "
    "844-846 932-933 935-943 1026-1043",
}
"""Numbers of the original's scenes of each part, by which tools tell them; without four that converters leave out."""
MORE_SCENES: dict[Part, int] = {"train": 20_000, "val": 40_000, "test": 60_000}
"""Numbers of scenes beyond these."""
OF_BOXES = "instance", "sample_annotation"
OF_PICTURES = (
    "scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor", "category", "attribute", "visibility",
    "log", "map", "splits",
)  # fmt: skip
"""Tables of boxes and of all else; `splits` is no table, but beside them."""
LAYERS = (
    "node", "line", "polygon", "drivable_area", "road_segment", "road_block", "lane", "lane_connector", "ped_crossing",
    "walkway", "stop_line", "carpark_area", "road_divider", "lane_divider", "traffic_light",
)  # fmt: skip
"""Lists of records; `road_block` and `carpark_area` stay empty."""
PATHS, LINKS = "arcline_path_3", "connectivity"
REACH_M = 150.0
"""Reach of a map ahead of and behind all places of the host in the clip."""


def table_file(version: str, name: str) -> str:
    """The path of a table."""
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


def scene_name(part: Part, number: int) -> str:
    """The name of a scene of a part."""
    spans = [[int(end) for end in span.split("-")] for span in SCENES[part].split()]
    known = [n for span in spans for n in range(span[0], span[-1] + 1)]
    return f"scene-{known[number] if number < len(known) else MORE_SCENES[part] + number - len(known):04d}"


def level_from_world(world_from_ego: Matrix4) -> Matrix4:
    """The level frame of a scene, given the vehicle frame of its first sample."""
    yaw_rad = float(np.arctan2(world_from_ego[1, 0], world_from_ego[0, 0]))
    return np.asarray(turned(yaw_rad) @ invert(world_from_ego))


def segment_type(marking: Marking, color: PaintColor | None, double: bool | None, pair: Pair | None = None) -> str:
    """The name of paint; the stripes of a pair from the left, as the lane's traffic drives."""
    if marking == "none":
        return "NIL"
    stripes = pair or f"{'double' if double else 'single'}_{marking}"
    return f"{stripes}_{color or 'white'}".upper()


def pose_record(pose: Matrix4) -> dict[str, list[float]]:
    """A pose as records have it: a place and a quaternion (w, x, y, z)."""
    return {"translation": pose[:3, 3].tolist(), "rotation": quaternion(pose[:3, :3]).tolist()}


def matrix(record: Mapping[str, Sequence[float]]) -> Matrix4:
    x, y, z = rotation(np.array(record["rotation"])).T
    return from_axes(x, y, z, np.array(record["translation"]))


def attributes_of(class_: str, speed_m_s: float | None) -> tuple[str, ...]:
    """The attributes that an object of a class may have at a speed, one of which it has; none without a speed."""
    if speed_m_s is None:
        return ()
    if class_ in ("vehicle.bicycle", "vehicle.motorcycle"):
        return ("cycle.with_rider",)
    is_moving = speed_m_s > MOVING_M_S
    match class_.split(".")[0]:
        case "human":
            return ("pedestrian.moving",) if is_moving else ("pedestrian.standing",)
        case "vehicle":
            return ("vehicle.moving",) if is_moving else ("vehicle.stopped", "vehicle.parked")
    return ()
