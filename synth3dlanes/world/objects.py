"""What has a box in labels, as it stands at the instant of a view: cars, then people, riders and road works. World
frame; models have x right, y forward, z up and stand on z = 0."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import turned
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.scene.scene import Car, Scene
from synth3dlanes.scene.things import ObjectCategory, ThingKind
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.schema import Color
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.motion import thing_at
from synth3dlanes.world.placement import worlds_from_cars

# Over this time a slope of the ground tells how fast a thing goes up.
CLIMB_S = 0.01


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """An object by its instance id: the `pose` of model `model` of `kind` (None of a car), where it stands, without its
    scale, the size of its box (width, length, height), its velocity in metres per second, and the colours of its
    paints, of a car with their gloss."""

    id: int
    kind: ThingKind | None
    category: ObjectCategory
    model: int
    pose: int
    scale: float
    size_m: Float[np.ndarray, "3"]
    world_from_object: Matrix4
    velocity_world: Float[np.ndarray, "3"]
    colors: tuple[Color, ...]
    gloss: float = 0.0


def body_color(car: Car) -> Color:
    """The colour of a car's body: its drawn colour mixed with the gray of its first channel by `saturation`."""
    red, green, blue = (car.saturation * channel + (1 - car.saturation) * car.color[0] for channel in car.color)
    return red, green, blue


def placed_cars(scene: Scene, network: Network, cars: tuple[Car, ...]) -> Iterator[PlacedObject]:
    """The cars of a scene at an instant, in its order."""
    models = [scene.assets.car_models[car.model - 1] for car in cars]
    poses = worlds_from_cars(network, cars, models)
    for number, (car, model, pose) in enumerate(zip(cars, models, poses, strict=True)):
        yield PlacedObject(
            id=instance_id("car", number),
            kind=None,
            category=model.category,
            model=car.model,
            pose=0,
            scale=car.scale,
            size_m=car.scale * np.array([model.width_m, model.length_m, model.height_m]),
            world_from_object=pose,
            velocity_world=pose[:3, 1] * car.speed_m_s,
            colors=(body_color(car),),
            gloss=car.gloss,
        )


def placed_things(scene: Scene, ground: Ground) -> Iterator[PlacedObject]:
    """The things of a scene at its instant, in its order."""
    if not scene.things:
        return
    moved = [thing_at(thing, scene.shot.time_s) for thing in scene.things]
    velocities = np.array([at.velocity_world for at in moved])
    xy_world = np.array([(at.thing.x_m, at.thing.y_m) for at in moved])
    step_m = velocities * CLIMB_S / 2
    places, z = np.stack([xy_world - step_m, xy_world, xy_world + step_m]), np.zeros((3, len(moved)))
    walks = np.array([len(thing.track) > 1 for thing in scene.things])
    for of, height in ((walks, ground.foot_height), (~walks, ground.height)):
        if of.any():
            z[:, of] = height(places[:, of])
    low, foot, high = z
    for number, (at, foot_m, climbs) in enumerate(zip(moved, foot, (high - low) / CLIMB_S, strict=True)):
        thing = at.thing
        model = scene.assets.thing_models(thing.kind)[thing.model - 1]
        pose = turned(thing.yaw_rad, thing.x_m, thing.y_m)
        pose[2, 3] = foot_m + thing.above_m
        phase = thing.phase + at.driven_m / (model.stride_m * thing.scale)
        yield PlacedObject(
            id=instance_id("thing", number),
            kind=thing.kind,
            category=thing.kind,
            model=thing.model,
            pose=model.pose(phase, thing.speed_m_s > 0),
            scale=thing.scale,
            size_m=thing.scale * np.array([model.width_m, model.length_m, model.height_m]),
            world_from_object=pose,
            velocity_world=np.array([*at.velocity_world, climbs]),
            colors=thing.colors,
        )
