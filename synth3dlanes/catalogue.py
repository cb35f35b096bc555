"""The car and tree models that exist: their names and sizes, in metres.

`blender_assets/` builds its meshes to these sizes, the sampler keeps their footprints apart, and geometry stands
their wheels on the surface. A model's number in a scene is its place in the tuple, counted from 1.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class CarModel:
    """Body size and wheels: axles at y = +-wheelbase/2 from the origin, wheels at x = +-track/2, tyres on z = 0."""

    name: str
    length_m: float
    width_m: float
    height_m: float
    wheelbase_m: float
    track_m: float
    wheel_radius_m: float


@dataclass(frozen=True)
class TreeModel:
    """Height over the ground and the radius of the crown, at scale 1."""

    name: str
    height_m: float
    crown_radius_m: float


CARS = (
    CarModel("hatchback", 4.05, 1.76, 1.47, 2.55, 1.52, 0.31),
    CarModel("sedan", 4.75, 1.83, 1.45, 2.80, 1.58, 0.33),
    CarModel("suv", 4.65, 1.88, 1.70, 2.70, 1.60, 0.36),
    CarModel("pickup", 5.35, 1.92, 1.80, 3.25, 1.64, 0.38),
    CarModel("van", 5.50, 2.00, 2.35, 3.40, 1.72, 0.35),
    CarModel("truck", 8.20, 2.45, 3.30, 4.60, 2.05, 0.48),
)

TREES = (
    TreeModel("broadleaf", 9.0, 3.2),
    TreeModel("conifer", 12.0, 2.4),
    TreeModel("poplar", 14.0, 1.6),
    TreeModel("bush", 1.8, 1.3),
    TreeModel("dead", 7.5, 2.2),
    TreeModel("young", 4.2, 1.1),
)
