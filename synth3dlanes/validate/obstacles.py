"""Check `object_visible` against boxes of cars, trees, structures and the bonnet; works without passes and Blender.

A point can only be hidden by an object if its line of sight meets a box of the object, and it must be hidden if
the line goes through the core of a car.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from synth3dlanes.frames import transform
from synth3dlanes.labels import Labels
from synth3dlanes.validate.boxes import Boxes, Corners, meet, structure_boxes
from synth3dlanes.validate.findings import Finding
from synth3dlanes.world import World

# Mirrors and twigs may extend beyond the nominal boxes.
ROOM = 1.15
# Trunks go on underground, where they hide points behind a hill.
ROOTS_M = 1.0
# Every car is solid in this part of its box: above the open space below a truck, below the windows, and behind the gap
# at a truck's cab.
CORE_SIDES, CORE_HEIGHT = ((-0.7, -0.7), (0.7, 0.2)), (0.38, 0.5)
# The host's bonnet fills this box below its highest point, and lies in that one.
BONNET_CORE = ((-0.6, 0.35, -0.3), (0.6, 1.3, -0.16))
BONNET = ((-0.78, 0.02, -0.4), (0.78, 1.6, 0.02))
# Number of lines of sight that may graze the core's edges.
MAX_WRONG = 1
# Largest number of points of a line behind twigs outside their boxes in 1,350 scenes.
MAX_TWIGS = 2


def check_objects(world: World, labels: Labels) -> Iterator[Finding]:
    """Findings about lanes and symbols with points marked hidden without an object in the way, or visible behind a
    car."""
    items = {lane.id: lane for lane in labels.lanes} | {f"symbol {i}": item for i, item in enumerate(labels.symbols)}
    points_world = transform(labels.camera.world_from_cam, np.concatenate([item.xyz_cam for item in items.values()]))
    seen = np.concatenate([np.asarray(item.object_visible) for item in items.values()])
    eye_world = labels.camera.world_from_cam[:3, 3]
    ends = np.cumsum([len(item.xyz_cam) for item in items.values()])[:-1]
    through, unhidden = seen.copy(), ~seen
    through[seen] = meet(_cores(world), eye_world, points_world[seen])
    unhidden[~seen] = ~meet(_outlines(world), eye_world, points_world[~seen])
    unhidden[unhidden] = ~meet(structure_boxes(world).boxes, eye_world, points_world[unhidden])
    for id_, of_through, of_unhidden in zip(items, np.split(through, ends), np.split(unhidden, ends), strict=True):
        if of_through.sum() > MAX_WRONG:
            reason = f"object_visible: expected points behind cars as hidden, got {of_through.sum()} as seen"
            yield Finding(id_, reason)
        if of_unhidden.sum() > MAX_TWIGS:
            reason = f"object_visible: got {of_unhidden.sum()} points as hidden where nothing is in the way"
            yield Finding(id_, reason)


def _cores(world: World) -> Boxes:
    """The opaque core of each car and of the bonnet."""
    half, up, poses = _cars(world)
    low, high = (half * [*side, 0] + height * up for side, height in zip(CORE_SIDES, CORE_HEIGHT, strict=True))
    return _with_bonnet(world, Boxes(poses, low, high), BONNET_CORE)


def _outlines(world: World) -> Boxes:
    """The box that each car, each tree and the bonnet may fill."""
    half, up, cars = _cars(world)
    models = [world.scene.assets.tree_models[tree.model - 1] for tree in world.scene.trees]
    sizes = np.array([(model.crown_radius_m, model.crown_radius_m, model.height_m) for model in models]).reshape(-1, 3)
    sizes *= np.array([tree.scale for tree in world.scene.trees]).reshape(-1, 1)
    trees = np.tile(np.eye(4), (len(sizes), 1, 1))
    trees[:, :3, 3] = world.site.trees_world
    crown, height = sizes * [1, 1, 0], sizes * [0, 0, 1]
    low, high = np.concatenate([-half, -crown - [0, 0, ROOTS_M]]), np.concatenate([half + up, crown + height])
    return _with_bonnet(world, Boxes(np.concatenate([cars, trees]), ROOM * low, ROOM * high), BONNET)


def _with_bonnet(world: World, boxes: Boxes, bonnet: tuple[tuple[float, ...], ...]) -> Boxes:
    pose = world.view.world_from_bonnet
    if pose is None:
        return boxes
    return Boxes(*(np.concatenate([part, [own]]) for part, own in zip(boxes, (pose, *bonnet), strict=True)))


def _cars(world: World) -> tuple[Corners, Corners, Float[np.ndarray, "k 4 4"]]:
    """Half the width and length of every car, its height, and its pose."""
    models = [world.scene.assets.car_models[car.model - 1] for car in world.scene.cars]
    sizes = np.array([(model.width_m / 2, model.length_m / 2, model.height_m) for model in models]).reshape(-1, 3)
    sizes *= np.array([car.scale for car in world.scene.cars]).reshape(-1, 1)
    return sizes * [1, 1, 0], sizes * [0, 0, 1], np.array(world.view.world_from_cars).reshape(-1, 4, 4)
