"""What a world holds: the one table of kinds, with what ids, labels, pictures and foreign formats call each.

A row of KINDS is a semantic class of pixels. A new kind of thing is a row, its models in the catalogue, and who places
it. Things of a kind have numbers in one of the series of `instance_ids`.
"""

from dataclasses import dataclass
from typing import Literal, get_args

Rgb = tuple[int, int, int]
# What detectors call vehicles. A `trailer` is a tractor with its semitrailer.
VehicleClass = Literal["car", "van", "truck", "bus", "trailer"]
# Kinds of `Scene.things`, each a category of labels of its own: people, riders with what they ride, and road works.
ThingKind = Literal["pedestrian", "cyclist", "motorcyclist", "cone", "barrel", "barricade"]
# What traffic must see: the head of a signal, one over a lane on a gantry, the face of a sign.
ElementCategory = Literal["traffic_light", "lane_signal", "road_sign"]
ObjectCategory = Literal[VehicleClass, ThingKind, ElementCategory]
ClassNaming = Literal["kitti", "argoverse2", "nuscenes", "cosmos", "lanelet2"]
# Windows and lenses that are lit; sheeting and reflectors, which throw light back.
Glow = Literal["", "window", "lens", "sheeting", "reflector"]


@dataclass(frozen=True)
class ObjectClass:
    """A category of object labels, and its class in each format; "" where a format has none, and leaves it out. Those
    of traffic elements (`is_element`) are listed apart from all others."""

    category: ObjectCategory
    kitti: str = ""
    argoverse2: str = ""
    nuscenes: str = ""
    cosmos: str = ""
    lanelet2: str = ""
    is_element: bool = False


@dataclass(frozen=True)
class Kind:
    """A semantic class: its id in the pass `semantic`; the series of its instance ids, "" for stuff, which has none;
    its colour in our pictures, with the word for it, and in Cosmos's segmentation videos (Cityscapes' where it has the
    class). `reflectance` is the reflectance of lidar points on it. `is_ground`: it lies flat. `is_capped`: snow lies on
    it. `is_cleared`: most drivers have removed the snow. `keeps_pace`: it is assumed to drive as fast as the host, so
    motion blur leaves it sharp. `is_own`: it moves with the camera. `glow` is its part that shines in the dark or in
    the host's headlights. `objects` are its categories of labels."""

    name: str
    semantic_id: int
    series: str
    color: Rgb
    word: str
    video_color: Rgb
    reflectance: float = 0.0
    is_ground: bool = False
    is_capped: bool = False
    is_cleared: bool = False
    keeps_pace: bool = False
    is_own: bool = False
    glow: Glow = ""
    objects: tuple[ObjectClass, ...] = ()


VEHICLES = (
    ObjectClass("car", "Car", "REGULAR_VEHICLE", "vehicle.car", "automobile"),
    ObjectClass("van", "Van", "REGULAR_VEHICLE", "vehicle.car", "automobile"),
    ObjectClass("truck", "Truck", "TRUCK", "vehicle.truck", "heavy_truck"),
    # KITTI has no buses. A tractor with its semitrailer is one truck.
    ObjectClass("bus", "Misc", "BUS", "vehicle.bus.rigid", "bus"),
    ObjectClass("trailer", "Truck", "TRUCK", "vehicle.truck", "heavy_truck"),
)
# A rider's box includes the bicycle or motorcycle, as in KITTI, nuScenes and Cosmos.
PEDESTRIAN = ObjectClass("pedestrian", "Pedestrian", "PEDESTRIAN", "human.pedestrian.adult", "person")
CYCLIST = ObjectClass("cyclist", "Cyclist", "BICYCLIST", "vehicle.bicycle", "rider")
MOTORCYCLIST = ObjectClass("motorcyclist", "Misc", "MOTORCYCLIST", "vehicle.motorcycle", "rider")
CONE = ObjectClass("cone", "", "CONSTRUCTION_CONE", "movable_object.trafficcone")
BARREL = ObjectClass("barrel", "", "CONSTRUCTION_BARREL", "movable_object.barrier")
BARRICADE = ObjectClass("barricade", "", "", "movable_object.barrier")
SIGN = ObjectClass("road_sign", cosmos="traffic_sign", lanelet2="traffic_sign", is_element=True)
SIGNALS = (
    ObjectClass(
        "traffic_light", nuscenes="traffic_light", cosmos="traffic_light", lanelet2="traffic_light", is_element=True
    ),
    ObjectClass("lane_signal", cosmos="traffic_light", is_element=True),
)

# `symbol` is paint that bounds no lane (arrows, stop lines, crosswalks, gores), `host` the host's own bonnet. Botts'
# dots are markings, tar lines are road, grass is terrain. `signal` is the head of a signal with its lenses, `barrier` a
# rail or wall, `barricade` one of road works.
KINDS = (
    Kind("sky", 0, "", (150, 158, 166), "gray", (70, 130, 180)),
    Kind("terrain", 1, "", (122, 150, 96), "green", (152, 251, 152), 0.35, is_ground=True),
    Kind("road", 2, "", (84, 88, 94), "dark gray", (128, 64, 128), 0.15, is_ground=True),
    Kind("shoulder", 3, "", (168, 148, 118), "brown", (81, 0, 81), 0.2, is_ground=True),
    Kind("marking", 4, "delimiter", (250, 250, 245), "white", (157, 234, 50), 0.8, is_ground=True),
    Kind("car", 5, "car", (214, 60, 70), "red", (0, 0, 142), 0.5, is_capped=True, is_cleared=True, keeps_pace=True,
         objects=VEHICLES),
    Kind("tree", 6, "tree", (40, 98, 48), "dark green", (107, 142, 35), is_capped=True),
    Kind("symbol", 7, "symbol", (236, 190, 60), "yellow", (227, 227, 227), 0.8, is_ground=True),
    Kind("barrier", 8, "structure", (120, 170, 200), "pale blue", (180, 165, 180), is_capped=True),
    Kind("pole", 9, "structure", (60, 60, 120), "dark blue", (153, 153, 153), is_capped=True, glow="reflector"),
    Kind("sign", 10, "structure", (30, 90, 220), "blue", (220, 220, 0), is_capped=True, glow="sheeting",
         objects=(SIGN,)),
    Kind("bridge", 11, "structure", (190, 180, 210), "pale violet", (150, 100, 100), is_capped=True),
    Kind("building", 12, "structure", (200, 130, 90), "orange", (70, 70, 70), is_capped=True, glow="window"),
    Kind("kerb", 13, "structure", (205, 205, 160), "pale yellow", (244, 35, 232), is_capped=True),
    Kind("host", 14, "bonnet", (20, 20, 24), "black", (0, 0, 0), keeps_pace=True, is_own=True),
    Kind("signal", 15, "structure", (250, 120, 20), "bright orange", (250, 170, 30), is_capped=True, glow="lens",
         objects=SIGNALS),
    Kind("pedestrian", 16, "thing", (230, 60, 200), "pink", (220, 20, 60), objects=(PEDESTRIAN,)),
    Kind("cyclist", 17, "thing", (150, 70, 230), "violet", (255, 0, 0), objects=(CYCLIST,)),
    Kind("motorcyclist", 18, "thing", (90, 40, 160), "dark violet", (0, 0, 230), keeps_pace=True,
         objects=(MOTORCYCLIST,)),
    Kind("cone", 19, "thing", (255, 150, 110), "salmon", (250, 90, 30), is_capped=True, objects=(CONE,)),
    Kind("barrel", 20, "thing", (180, 70, 30), "rust", (190, 70, 20), is_capped=True, objects=(BARREL,)),
    Kind("barricade", 21, "thing", (240, 210, 150), "cream", (200, 130, 60), is_capped=True, objects=(BARRICADE,)),
)  # fmt: skip

SEMANTIC_IDS = {kind.name: kind.semantic_id for kind in KINDS}
STUFF = tuple(kind.name for kind in KINDS if not kind.series)
BOXED = tuple(kind.semantic_id for kind in KINDS if any(not of.is_element for of in kind.objects))
DRIVEN = frozenset(get_args(VehicleClass))
ELEMENTS = frozenset(of.category for kind in KINDS for of in kind.objects if of.is_element)
OWN = tuple(kind.semantic_id for kind in KINDS if kind.is_own)
GROUND = tuple(kind.semantic_id for kind in KINDS if kind.is_ground)
# The first kind of each series of instance ids.
FIRST_OF = {series: next(kind for kind in KINDS if kind.series == series) for series in {kind.series for kind in KINDS}}
# The kind of objects by their categories.
KIND_OF_CATEGORY: dict[ObjectCategory, Kind] = {of.category: kind for kind in KINDS for of in kind.objects}


def classes_in(name: ClassNaming, of_elements: bool = False) -> dict[ObjectCategory, str]:
    """A format's classes by our categories of objects, or of traffic elements. Categories without a class there are
    left out."""
    rows = (of for kind in KINDS for of in kind.objects if of.is_element == of_elements)
    found = {of.category: str(getattr(of, name)) for of in rows}
    return {category: class_ for category, class_ in found.items() if class_}
