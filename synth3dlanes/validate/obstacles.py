"""`object_visible` against the sizes of cars and trees alone: works without passes and without Blender.

A point can only be hidden by an object whose bounding box its line of sight meets, and is hidden for certain where
that goes through the core of a car.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.frames import transform
from synth3dlanes.labels import Labels
from synth3dlanes.validate.findings import Finding
from synth3dlanes.world import World

# Meshes may stand out of their nominal boxes by mirrors and twigs.
ROOM = 1.15
# Every body is solid within this part of its box: between what is open below a truck and windows, and behind the
# gap that a truck has at its cab.
CORE_SIDES, CORE_HEIGHT = ((-0.7, -0.7), (0.7, 0.2)), (0.38, 0.5)
# A sight line may graze the core's edges.
MAX_WRONG = 1
# So many points of a line were behind twigs that reach out of their boxes, at most, in 1,350 scenes.
MAX_TWIGS = 2

Points = Float[np.ndarray, "n 3"]
Corners = Float[np.ndarray, "k 3"]


class Boxes(NamedTuple):
    """Boxes, each from its low corner to its high one in its own frame, metres."""

    world_from_boxes: Float[np.ndarray, "k 4 4"]
    low: Corners
    high: Corners


def check_objects(world: World, labels: Labels) -> Iterator[Finding]:
    """Lanes with points that are called hidden with nothing there to hide them, or seen through a car."""
    points_world = transform(labels.camera.world_from_cam, np.concatenate([lane.xyz_cam for lane in labels.lanes]))
    seen = np.concatenate([np.asarray(lane.object_visible) for lane in labels.lanes])
    eye_world, ends = labels.camera.world_from_cam[:3, 3], np.cumsum([len(lane.xyz_cam) for lane in labels.lanes])[:-1]
    through, unhidden = seen.copy(), ~seen
    through[seen] = _meet(_cores(world), eye_world, points_world[seen])
    unhidden[~seen] = ~_meet(_outlines(world), eye_world, points_world[~seen])
    for lane, of_through, of_unhidden in zip(
        labels.lanes, np.split(through, ends), np.split(unhidden, ends), strict=True
    ):
        if of_through.sum() > MAX_WRONG:
            reason = f"object_visible: expected points behind cars as hidden, got {of_through.sum()} as seen"
            yield Finding(lane.id, reason)
        if of_unhidden.sum() > MAX_TWIGS:
            reason = f"object_visible: got {of_unhidden.sum()} points as hidden where no car or tree is in the way"
            yield Finding(lane.id, reason)


def _cores(world: World) -> Boxes:
    """The part of each car that nobody sees through."""
    half, up, poses = _cars(world)
    low, high = (half * [*side, 0] + height * up for side, height in zip(CORE_SIDES, CORE_HEIGHT, strict=True))
    return Boxes(poses, low, high)


def _outlines(world: World) -> Boxes:
    """What each car and each tree may fill."""
    half, up, cars = _cars(world)
    models = [world.scene.assets.tree_models[tree.model - 1] for tree in world.scene.trees]
    sizes = np.array([(model.crown_radius_m, model.crown_radius_m, model.height_m) for model in models]).reshape(-1, 3)
    sizes *= np.array([tree.scale for tree in world.scene.trees]).reshape(-1, 1)
    trees = np.tile(np.eye(4), (len(sizes), 1, 1))
    trees[:, :3, 3] = world.trees_world
    crown, height = sizes * [1, 1, 0], sizes * [0, 0, 1]
    low, high = np.concatenate([-half, -crown]), np.concatenate([half + up, crown + height])
    return Boxes(np.concatenate([cars, trees]), ROOM * low, ROOM * high)


def _cars(world: World) -> tuple[Corners, Corners, Float[np.ndarray, "k 4 4"]]:
    """Half the width and length of every car, its height, and its pose."""
    models = [world.scene.assets.car_models[car.model - 1] for car in world.scene.cars]
    sizes = np.array([(model.width_m / 2, model.length_m / 2, model.height_m) for model in models]).reshape(-1, 3)
    sizes *= np.array([car.scale for car in world.scene.cars]).reshape(-1, 1)
    return sizes * [1, 1, 0], sizes * [0, 0, 1], np.array(world.view.world_from_cars).reshape(-1, 4, 4)


def _meet(boxes: Boxes, eye_world: Float[np.ndarray, "3"], points_world: Points) -> Bool[np.ndarray, " n"]:
    """Which straight lines from the eye to the points meet any of the boxes."""
    rotations, origins = boxes.world_from_boxes[:, :3, :3], boxes.world_from_boxes[:, None, :3, 3]
    eyes, ends = (eye_world - origins) @ rotations, (points_world - origins) @ rotations
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = ((corner[:, None] - eyes) / (ends - eyes) for corner in (boxes.low, boxes.high))
    # Along an axis that a line runs across, 0 / 0 says nothing.
    enters = np.fmax.reduce(np.minimum(first, second), axis=2, initial=0)
    leaves = np.fmin.reduce(np.maximum(first, second), axis=2, initial=1)
    return np.asarray((enters <= leaves).any(axis=0))
