"""The catalogue of models, textures and skies, which scenes number from 1: the built-in ones or a user's own.

`blender_assets/` builds the built-in meshes to these sizes; the sampler uses the footprints, geometry the wheels.
`blender.check_assets` measures a user's files in the same way. Metres.
"""

import re
from typing import Annotated, ClassVar, Literal, get_args

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from synth3dlanes.scene.things import ThingKind, VehicleClass
from synth3dlanes.system.schema import is_empty

ThingFolder = Literal["pedestrians", "cyclists", "motorcyclists", "cones", "barrels", "barricades"]
AssetKind = Literal["cars", "trees", "roads", "terrains", "skies", ThingFolder]
# The kinds of things by their folders.
THING_FOLDERS: dict[AssetKind, ThingKind] = dict(zip(get_args(ThingFolder), get_args(ThingKind), strict=True))
FIRST_KINDS: tuple[AssetKind, ...] = ("cars", "trees", "roads", "terrains", "skies")
KINDS: tuple[AssetKind, ...] = (*FIRST_KINDS, *THING_FOLDERS)
STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
PositiveMetres = Annotated[float, Field(gt=0)]
# Words in the names of a user's files that tell the class, and sizes that do where none is there: all cars are lower
# than vans, vans than trucks, and only a tractor with its semitrailer is as long.
CLASS_WORDS: tuple[tuple[str, VehicleClass], ...] = (
    ("trailer", "trailer"), ("bus", "bus"), ("coach", "bus"), ("truck", "truck"), ("lorry", "truck"), ("van", "van")
)  # fmt: skip
TALL_M, TRUCK_M, TRAILER_M = 2.1, 2.8, 13.5


@dataclass(frozen=True, config=STRICT)
class CarModel:
    """Body size and wheels: axles at y = +-wheelbase/2 from the origin, wheels at x = +-track/2, tyres on z = 0. Where
    there are more axles, these are the middles of the front and the rear ones.
    `sha256` is the digest of a user's file, empty for a built-in model. Scenes of older versions call all models of a
    user cars."""

    name: str
    length_m: PositiveMetres
    width_m: PositiveMetres
    height_m: PositiveMetres
    wheelbase_m: PositiveMetres
    track_m: PositiveMetres
    wheel_radius_m: PositiveMetres
    sha256: str = ""
    category: VehicleClass = "car"


@dataclass(frozen=True, config=STRICT)
class TreeModel:
    """Height over the ground and the radius of the crown, at scale 1."""

    name: str
    height_m: PositiveMetres
    crown_radius_m: PositiveMetres
    sha256: str = ""


@dataclass(frozen=True, config=STRICT)
class ThingModel:
    """A person, a rider or a piece of road works at scale 1: the box around all its poses, whose middle is over the
    foot; the names of its paints; and how many poses a cycle of `stride_m` metres of its way has, besides the one at
    rest. `sha256` is the digest of a user's file, or files, as of cars."""

    name: str
    width_m: PositiveMetres
    length_m: PositiveMetres
    height_m: PositiveMetres
    paints: tuple[str, ...] = ()
    n_poses: Annotated[int, Field(ge=0, le=100)] = 0
    stride_m: PositiveMetres = 1.0
    sha256: str = ""

    @property
    def poses(self) -> range:
        """The numbers of its poses: 0 is at rest, the others are the cycle."""
        return range(self.n_poses + 1)

    def pose(self, phase: float, is_moving: bool) -> int:
        """The number of the pose at a phase of its cycle: 0 at rest, else from 1 on."""
        return 1 + int(phase * self.n_poses) % self.n_poses if is_moving and self.n_poses else 0


@dataclass(frozen=True, config=STRICT)
class Texture:
    """A set of albedo, roughness and normal map."""

    name: str
    sha256: str


@dataclass(frozen=True, config=STRICT)
class Sky:
    """A picture of the whole sky. `sun_azimuth_rad` is the azimuth of its sun, measured from the picture's middle
    column to the left, which is counter-clockwise seen from above."""

    name: str
    sun_azimuth_rad: float
    sha256: str


CARS = (
    CarModel("hatchback", 4.05, 1.76, 1.47, 2.55, 1.52, 0.31),
    CarModel("sedan", 4.75, 1.83, 1.45, 2.80, 1.58, 0.33),
    CarModel("suv", 4.65, 1.88, 1.70, 2.70, 1.60, 0.36),
    CarModel("pickup", 5.35, 1.92, 1.80, 3.25, 1.64, 0.38),
    CarModel("van", 5.50, 2.00, 2.35, 3.40, 1.72, 0.35, category="van"),
    CarModel("truck", 8.20, 2.45, 3.30, 4.60, 2.05, 0.48, category="truck"),
    CarModel("compact", 4.40, 1.78, 1.46, 2.65, 1.54, 0.31),
    CarModel("estate", 4.80, 1.84, 1.50, 2.85, 1.59, 0.33),
    CarModel("crossover", 4.35, 1.82, 1.58, 2.64, 1.56, 0.34),
    CarModel("semitrailer", 16.50, 2.55, 4.00, 10.10, 2.10, 0.50, category="trailer"),
    CarModel("bus", 12.00, 2.55, 3.10, 5.90, 2.10, 0.48, category="bus"),
)


def vehicle_class(name: str, length_m: float, height_m: float) -> VehicleClass:
    """The class of a model, by its name or else its size; a pickup is a car, as it is among the built-in ones."""
    found = re.findall("[a-z]+", name.lower())
    words = (category for word, category in CLASS_WORDS if {word, f"semi{word}", f"mini{word}"} & {*found})
    by_size: VehicleClass = "trailer" if length_m > TRAILER_M else "truck" if height_m > TRUCK_M else "van"
    return next(words, by_size if height_m > TALL_M else "car")


TREES = (
    TreeModel("broadleaf", 9.0, 3.2),
    TreeModel("conifer", 12.0, 2.4),
    TreeModel("poplar", 14.0, 1.6),
    TreeModel("bush", 1.8, 1.3),
    TreeModel("dead", 7.5, 2.2),
    TreeModel("young", 4.2, 1.1),
)


# The length of a cycle is twice a step, or one turn of a bicycle's cranks.
PERSON = ("upper", "lower", "skin", "hair")
HOLDS, RIDER = (*PERSON, "umbrella"), ("upper", "lower", "skin", "helmet", "vehicle")
THINGS: dict[ThingKind, tuple[ThingModel, ...]] = {
    "pedestrian": (
        ThingModel("man", 0.505, 0.97, 1.79, PERSON, 8, 1.28),
        ThingModel("woman", 0.421, 0.899, 1.67, PERSON, 8, 1.19),
        ThingModel("child", 0.31, 0.637, 1.235, PERSON, 8, 0.85),
        ThingModel("heavy_man", 0.583, 0.953, 1.75, PERSON, 8, 1.26),
        ThingModel("woman_in_skirt", 0.425, 0.911, 1.69, PERSON, 8, 1.21),
        ThingModel("man_in_coat", 0.533, 0.981, 1.81, PERSON, 8, 1.30),
        ThingModel("man_with_umbrella", 1.054, 1.237, 2.101, HOLDS, 8, 1.27),
        ThingModel("woman_with_umbrella", 1.054, 1.187, 2.024, HOLDS, 8, 1.20),
    ),
    "cyclist": (
        ThingModel("man_on_bicycle", 0.751, 1.784, 1.811, RIDER, 6, 5.0),
        ThingModel("woman_on_bicycle", 0.677, 1.784, 1.764, RIDER, 6, 5.0),
    ),
    "motorcyclist": (ThingModel("motorcyclist", 0.992, 2.04, 1.767, RIDER),),
    "cone": (ThingModel("cone", 0.375, 0.375, 0.75), ThingModel("low_cone", 0.25, 0.25, 0.5)),
    "barrel": (ThingModel("barrel", 0.72, 0.72, 1),),
    "barricade": (ThingModel("barricade", 1.6, 0.6, 1.165),),
}

# Left out of scenes without any, as older scenes are.
OwnThings = Annotated[tuple[ThingModel, ...], Field(exclude_if=is_empty)]

# Mean albedo (linear red, green, blue) and roughness of the built-in roads.
ROAD_MEANS = {
    "road_1": ((0.075, 0.075, 0.075), 0.62),
    "road_2": ((0.114, 0.112, 0.107), 0.74),
    "road_3": ((0.213, 0.206, 0.188), 0.70),
}


@dataclass(frozen=True, config=STRICT)
class Assets:
    """A user's own models, textures and skies. The built-in ones are used for a kind that is empty."""

    OURS: ClassVar[dict[AssetKind, int]] = {
        "cars": len(CARS),
        "trees": len(TREES),
        "roads": 3,
        "terrains": 2,
        "skies": 0,
        **{folder: len(THINGS[kind]) for folder, kind in THING_FOLDERS.items()},
    }

    # Numbers of built-in assets of which a preset draws all; see `params.numbers`. The paper's presets have six cars,
    # and umbrellas, which are for rain, are the last two.
    WHOLE: ClassVar[dict[AssetKind, tuple[int, ...]]] = {kind: (number,) for kind, number in OURS.items()} | {
        "cars": (6, len(CARS)),
        "pedestrians": (6, len(THINGS["pedestrian"])),
    }

    cars: tuple[CarModel, ...] = ()
    trees: tuple[TreeModel, ...] = ()
    roads: tuple[Texture, ...] = ()
    terrains: tuple[Texture, ...] = ()
    skies: tuple[Sky, ...] = ()
    pedestrians: OwnThings = ()
    cyclists: OwnThings = ()
    motorcyclists: OwnThings = ()
    cones: OwnThings = ()
    barrels: OwnThings = ()
    barricades: OwnThings = ()

    @property
    def car_models(self) -> tuple[CarModel, ...]:
        """The car models in use: the user's own, or else the built-in ones."""
        return self.cars or CARS

    @property
    def tree_models(self) -> tuple[TreeModel, ...]:
        """The tree models in use: the user's own, or else the built-in ones."""
        return self.trees or TREES

    def thing_models(self, kind: ThingKind) -> tuple[ThingModel, ...]:
        """The models of a kind of things in use: the user's own, or else the built-in ones."""
        own: tuple[ThingModel, ...] = getattr(self, f"{kind}s")
        return own or THINGS[kind]

    def count(self, kind: AssetKind) -> int:
        """Number of models, textures or skies of a kind."""
        return len(self.own(kind)) or self.OURS[kind]

    def own(self, kind: AssetKind) -> tuple[CarModel | TreeModel | Texture | Sky | ThingModel, ...]:
        """The user's own models, textures or skies of a kind."""
        own: tuple[CarModel | TreeModel | Texture | Sky | ThingModel, ...] = getattr(self, kind)
        return own


@dataclass(frozen=True, config=STRICT)
class Library:
    """A folder of a user's own assets on this machine and its contents; `folder` is "" for the built-in assets."""

    folder: str
    assets: Assets


BUILT_IN = Library("", Assets())
