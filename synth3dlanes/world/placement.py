"""Poses and footprints of cars and trees, and what has a box in labels as it stands at the instant of a view: cars,
then people, riders and road works. World frame; models have x right, y forward, z up and stand on z = 0."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import cross, from_axes, transform, turned
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.assets.catalogue import CarModel
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.scene.scene import Car, Scene, Tree
from synth3dlanes.scene.things import ObjectCategory, ThingKind
from synth3dlanes.system.arrays import Matrix4, Points3
from synth3dlanes.system.schema import Color
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.motion import thing_at

# Length and width of the host's own body, which is centred on the camera.
HOST_SIZE_M = (5.0, 2.0)
# Depth of trunks in the ground, so that none floats on a slope; and how far under and over the faces that are drawn
# they may begin, with roots that reach 0.3 m deeper: far from the host these faces are metres long, and cut off the
# edges of banks and the bottoms of ditches.
TREE_SINK_M, TREE_UNDER_M, TREE_OVER_M = 0.1, 0.25, 0.1
UP = np.array([0.0, 0.0, 1.0])
# Where the wheels of a car are (model frame), as shares of half its track and half its wheelbase.
WHEELS = np.array([[-1, 1, 0], [1, 1, 0], [-1, -1, 0], [1, -1, 0]])
Footprint = Float[np.ndarray, "4 2"]
# By how much circles around footprints are larger, because numbers are rounded.
SLACK_M = 0.01
# A thing's speed upwards is measured over this time.
CLIMB_S = 0.01


def car_place(
    network: Network, lane: str, driven_m: float, offset_m: float = 0.0
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """World (x, y) `offset_m` to the driver's right of a lane's centre line, or of its path beyond it, at a station as
    the host drives, and the unit heading of its traffic there."""
    path = network.path(lane)
    s = path.stations_on(lane, driven_m * network.onwards) + np.array([-0.5, 0.0, 0.5])
    before, middle, beyond = path.xy_world(s)
    heading = beyond - before if path.ascends else before - beyond
    heading = heading / np.linalg.norm(heading)
    return middle + offset_m * np.array([heading[1], -heading[0]]), heading


def worlds_from_cars(network: Network, cars: Sequence[Car], models: Sequence[CarModel]) -> list[Matrix4]:
    """The cars' poses (without scale): least-squares fits of their four tyres to the road surface."""
    if not cars:
        return []
    places = [car_place(network, car.lane, car.s_m, car.offset_m) for car in cars]
    sizes = [
        (model.track_m * car.scale, model.wheelbase_m * car.scale, 0.0) for car, model in zip(cars, models, strict=True)
    ]
    wheels_car = np.array(sizes)[:, None] / 2 * WHEELS
    poses = [
        from_axes(np.array([hy, -hx, 0]), np.array([hx, hy, 0]), UP, np.array([*xy, 0.0])) for xy, (hx, hy) in places
    ]
    on: dict[str, list[int]] = {}
    for number, car in enumerate(cars):
        on.setdefault(network.lanes[car.lane].road, []).append(number)
    raised = [(network.road(name), numbers) for name, numbers in on.items() if network.road(name).is_raised]
    guesses = np.repeat([[car.s_m * network.onwards] for car in cars], 4, axis=1)
    for _ in range(3):
        wheels = np.stack([transform(pose, four)[:, :2] for pose, four in zip(poses, wheels_car, strict=True)])
        above = np.zeros(wheels.shape[:2])
        for road, numbers in raised:
            above[numbers] = road.raised(*road.line.project(wheels[numbers], guesses[numbers]))
        contacts = network.lift(wheels, above)
        poses = [_pose_on(four, *place) for four, place in zip(contacts, places, strict=True)]
    return poses


def _pose_on(contacts: Points3, middle: Float[np.ndarray, "2"], heading: Float[np.ndarray, "2"]) -> Matrix4:
    """The pose of a car with this middle and heading, by the points where its tyres meet the road."""
    hx, hy = heading
    flat = np.column_stack([contacts[:, :2] - middle, np.ones(4)])
    slope_x, slope_y, z = np.linalg.lstsq(flat, contacts[:, 2], rcond=None)[0]
    up = np.array([-slope_x, -slope_y, 1.0])
    up /= np.linalg.norm(up)
    forward = np.array([hx, hy, slope_x * hx + slope_y * hy])
    forward /= np.linalg.norm(forward)
    return from_axes(cross(forward, up), forward, up, np.array([*middle, z]))


def tree_positions(ground: Ground, trees: tuple[Tree, ...]) -> Float[np.ndarray, "n 3"]:
    """The base points of trees on the ground as built, and as drawn where that is elsewhere."""
    xy = np.array([[tree.x_m, tree.y_m] for tree in trees]).reshape(-1, 2)
    drawn_m = ground.drawn_height(xy)
    z = np.clip(ground.height(xy) - TREE_SINK_M, drawn_m - TREE_UNDER_M, drawn_m + TREE_OVER_M)
    return np.column_stack([xy, z])


def tree_poses(trees: tuple[Tree, ...], trees_world: Float[np.ndarray, "n 3"]) -> dict[int, Matrix4]:
    """The poses of trees with these base points, by instance id, without their scale."""
    yaw_rad = np.array([tree.yaw_rad for tree in trees], dtype=float)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    poses = np.tile(np.eye(4), (len(trees), 1, 1))
    poses[:, 0, 0], poses[:, 0, 1], poses[:, 1, 0], poses[:, 1, 1] = c, -s, s, c
    poses[:, :3, 3] = trees_world
    return {instance_id("tree", number): pose for number, pose in enumerate(poses)}


def footprint(
    middle: Float[np.ndarray, "*t 2"], heading: Float[np.ndarray, "*t 2"], length_m: float, width_m: float
) -> Float[np.ndarray, "*t 4 2"]:
    """Corners of a rectangle on the ground, seen from above."""
    right = np.stack([heading[..., 1], -heading[..., 0]], axis=-1)
    along, across = heading * length_m / 2, right * width_m / 2
    corners = np.stack([along + across, along - across, -along - across, -along + across], axis=-2)
    return np.asarray(middle[..., None, :] + corners)


def host_footprint(world_from_road: Matrix4) -> Footprint:
    """The footprint of the host's own body, given the road frame at the host."""
    heading = world_from_road[:2, 1] / np.linalg.norm(world_from_road[:2, 1])
    return footprint(world_from_road[:2, 3], heading, *HOST_SIZE_M)


def overlaps_any(places: Float[np.ndarray, "*#n 4 2"], others: Float[np.ndarray, "*#n 4 2"]) -> bool:
    """Whether any rectangle overlaps its other (separating axis test); a single one is compared with all others."""
    separated = np.zeros(np.broadcast_shapes(places.shape, others.shape)[:-2], dtype=bool)
    for corners in (places, others):
        for first, second in ((0, 1), (1, 2)):
            side = (corners[..., second, :] - corners[..., first, :])[..., None, :]
            ours, theirs = (at[..., 0] * side[..., 0] + at[..., 1] * side[..., 1] for at in (places, others))
            separated |= (ours.max(axis=-1) < theirs.min(axis=-1)) | (theirs.max(axis=-1) < ours.min(axis=-1))
    return not separated.all()


def touches_any(own: Float[np.ndarray, "t 4 2"], others: Float[np.ndarray, "k _ 4 2"]) -> bool:
    """Whether a rectangle at instants overlaps any of others then. Only pairs whose circles meet are looked at."""
    others = np.broadcast_to(others, (len(others), *own.shape))
    middles, others_at = own.mean(axis=1), others.mean(axis=2)
    radius_m, radii_m = (
        np.linalg.norm(at[..., 0, :] - to, axis=-1) for at, to in ((own, middles), (others, others_at))
    )
    who, when = np.nonzero(np.linalg.norm(others_at - middles, axis=2) < radius_m + radii_m + SLACK_M)
    return len(who) > 0 and overlaps_any(own[when], others[who, when])


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
