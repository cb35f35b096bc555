"""Bodies of things by kind: boxes that they fill or may fill, and straight lines that meet these.

An object, as a car, fills its model's box, a tree that of trunk and crown, a structure a flat box about each of its
faces. Frame of the world, metres.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.scene.instance_ids import thing_of
from synth3dlanes.system.arrays import Points3
from synth3dlanes.world.bonnet import FROM_M, HALF_WIDTH_M, TO_M, surface_m
from synth3dlanes.world.placement import PlacedObject
from synth3dlanes.world.world import World

# Twigs and mirrors are within boxes that are larger by this factor; objects are seen within OBJECT_ROOM_M of their
# boxes, structures within FACE_ROOM_M of their faces.
ROOM, OBJECT_ROOM_M, FACE_ROOM_M = 1.15, 0.02, 0.03
# Bodies of models sink into slopes by this share of their height; trunks go on underground.
SUNK, ROOTS_M = 0.05, 1.0
# Every car is solid in this part of its box: above the open space below a truck, below the windows, behind the gap at a
# truck's cab, and between the arches of the wheels, through which one sees above the tyres.
CORE_SIDES, CORE_HEIGHT = ((-0.7, -0.35), (0.7, 0.2)), (0.38, 0.5)
# Depth of the host's bonnet, and the number of boxes along it.
DEEP_M, BONNET_PARTS = 0.4, 10
# Lower limit of the sun's elevation, and upper limit of a shadow's length on level ground.
LOWEST_SUN_RAD, MAX_SHADOW_M = 0.05, 15.0
# Room for soft edges of shadows.
SHADE_ROOM_M = 0.08
# A thing's boxes are tested in runs of BOXES_PER_RUN, where the box around the run is met; PAIRS_AT_ONCE pairs of a box
# and a point are tested at once.
BOXES_PER_RUN, PAIRS_AT_ONCE = 32, 1_000_000

# A distance beyond everything in a scene.
FAR_M = 5_000.0
# The series of objects.
OBJECTS = ("car", "thing")

Corners = Float[np.ndarray, "k 3"]
Hits = Bool[np.ndarray, " n"]


class Boxes(NamedTuple):
    """Boxes from a low to a high corner, each in its own frame, and the number of the thing that each belongs to."""

    world_from_boxes: Float[np.ndarray, "k 4 4"]
    low: Corners
    high: Corners
    owners: Int[np.ndarray, " k"]

    def at(self, which: Bool[np.ndarray, " k"] | slice) -> "Boxes":
        """Some of the boxes."""
        return Boxes(*(values[which] for values in self))

    def groups(self) -> tuple["Boxes", list[slice]]:
        """Upright boxes around runs of a thing's boxes, and these runs."""
        n = len(self.owners)
        if not n:
            return self, []
        begins = np.append(True, self.owners[1:] != self.owners[:-1])
        in_run = np.arange(n) - np.maximum.accumulate(np.where(begins, np.arange(n), 0))
        starts = np.flatnonzero(in_run % BOXES_PER_RUN == 0)
        corners = np.stack([np.where(at, self.high, self.low) for at in np.ndindex(2, 2, 2)], axis=1)
        turn, origin = self.world_from_boxes[:, :3, :3], self.world_from_boxes[:, None, :3, 3]
        world = corners @ turn.swapaxes(1, 2) + origin
        low = np.minimum.reduceat(world.min(axis=1), starts)
        high = np.maximum.reduceat(world.max(axis=1), starts)
        around = Boxes(np.tile(np.eye(4), (len(starts), 1, 1)), low, high, self.owners[starts])
        return around, [slice(*ends) for ends in zip(starts, [*starts[1:], n], strict=True)]


def _of_models(sizes_m: Float[np.ndarray, "k 3"], poses: Float[np.ndarray, "k 4 4"], below_m: float = 0.0) -> Boxes:
    """Boxes of half width, half length and height over places on the ground."""
    low = sizes_m * [-1, -1, -SUNK] - [0, 0, below_m]
    return Boxes(poses, low, sizes_m, np.arange(len(sizes_m)))


def boxes_of(items: Sequence[PlacedObject]) -> Boxes:
    """The box of each of these objects."""
    sizes = np.array([item.size_m for item in items]).reshape(-1, 3) * [0.5, 0.5, 1]
    return _of_models(sizes, np.array([item.world_from_object for item in items]).reshape(-1, 4, 4))


def objects(series: str, world: World) -> Boxes:
    """The box of each object of a series of instance ids."""
    return boxes_of([item for item in world.view.objects if thing_of(item.id)[0] == series])


def trees(world: World) -> Boxes:
    """The box of each tree's trunk, crown and roots, with room for twigs."""
    models = [world.scene.assets.tree_models[tree.model - 1] for tree in world.scene.trees]
    sizes = np.array([(model.crown_radius_m, model.crown_radius_m, model.height_m) for model in models]).reshape(-1, 3)
    sizes *= np.array([tree.scale for tree in world.scene.trees]).reshape(-1, 1)
    poses = np.tile(np.eye(4), (len(sizes), 1, 1))
    poses[:, :3, 3] = world.site.trees_world
    return grown(_of_models(sizes, poses, ROOTS_M))


def structures(world: World) -> Boxes:
    """A box about each face of each structure."""
    bodies = world.site.structures
    corners = np.concatenate([np.zeros((0, 4, 3)), *(body.corners_world for body in bodies)])
    first, second = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    # A triangle has two corners in one place.
    first = np.where(np.linalg.norm(first, axis=1, keepdims=True) < 1e-6, corners[:, 2] - corners[:, 0], first)
    second = np.where(np.linalg.norm(second, axis=1, keepdims=True) < 1e-6, corners[:, 2] - corners[:, 0], second)
    with np.errstate(invalid="ignore"):
        x = first / np.linalg.norm(first, axis=1, keepdims=True)
        z = np.cross(x, second)
        z /= np.linalg.norm(z, axis=1, keepdims=True)
    turn = np.stack([x, np.cross(z, x), z], axis=-1)
    turn[~np.isfinite(turn).all(axis=(1, 2))] = np.eye(3)
    poses = np.tile(np.eye(4), (len(corners), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turn, corners[:, 0]
    local = (corners - corners[:, :1]) @ turn
    owners = np.repeat(np.arange(len(bodies)), [len(body.corners_world) for body in bodies])
    return Boxes(poses, local.min(axis=1) - FACE_ROOM_M, local.max(axis=1) + FACE_ROOM_M, owners)


def with_room(boxes: Boxes, room_m: float) -> Boxes:
    """The same with room on every side."""
    return boxes._replace(low=boxes.low - room_m, high=boxes.high + room_m)


def grown(boxes: Boxes) -> Boxes:
    """The same with room for mirrors and twigs."""
    return boxes._replace(low=ROOM * boxes.low, high=ROOM * boxes.high)


# Where things of the series of instance ids that have bodies are seen.
BODIES: dict[str, Callable[[World], Boxes]] = {
    "car": lambda world: with_room(objects("car", world), OBJECT_ROOM_M),
    "thing": lambda world: with_room(objects("thing", world), OBJECT_ROOM_M),
    "tree": trees,
    "structure": structures,
}


def cores(world: World) -> Boxes:
    """The opaque core of each car."""
    boxes = objects("car", world)
    half, up = boxes.high * [1, 1, 0], boxes.high * [0, 0, 1]
    low, high = (half * [*side, 0] + height * up for side, height in zip(CORE_SIDES, CORE_HEIGHT, strict=True))
    return boxes._replace(low=low, high=high)


def bonnet(world: World) -> Boxes:
    """Boxes of no thing about parts of the host's bonnet, which falls towards its nose; none without a bonnet."""
    pose = world.view.world_from_bonnet
    y_m = np.linspace(FROM_M, TO_M, 1 if pose is None else BONNET_PARTS + 1)
    top_m = surface_m(np.linspace(-HALF_WIDTH_M, HALF_WIDTH_M, 20), y_m[:-1, None]).max(axis=1)
    side_m = np.full(len(top_m), HALF_WIDTH_M)
    low, high = (-side_m, y_m[:-1], top_m - DEEP_M), (side_m, y_m[1:], top_m)
    poses = np.tile(np.eye(4) if pose is None else pose, (len(top_m), 1, 1))
    return Boxes(poses, np.stack(low, axis=1), np.stack(high, axis=1), np.full(len(top_m), -1))


def inside(boxes: Boxes, points_world: Points3, owners: Int[np.ndarray, " n"]) -> Hits:
    """Which points are in a box of their thing; those of -1 in one of any."""
    found = np.zeros(len(points_world), dtype=bool)
    around, runs = boxes.groups()
    asked = np.isin(around.owners, owners) | (owners < 0).any()
    for i in np.flatnonzero(asked).tolist():
        near = ((points_world > around.low[i]) & (points_world < around.high[i])).all(axis=1) & ~found
        at = np.flatnonzero(near & ((owners == around.owners[i]) | (owners < 0)))
        pose, low, high, _ = boxes.at(runs[i])
        local = (points_world[at] - pose[:, None, :3, 3]) @ pose[:, :3, :3]
        found[at] = ((local > low[:, None]) & (local < high[:, None])).all(axis=2).any(axis=0)
    return found


def meet(boxes: Boxes, eyes_world: Float[np.ndarray, "*m 3"], points_world: Points3, room_m: float = 0.0) -> Hits:
    """Which straight lines from one eye, or from an eye each, to the points meet any of the boxes, or room about
    them."""
    found, eyes = np.zeros(len(points_world), dtype=bool), eyes_world.reshape(-1, 3)
    around, runs = boxes.groups()
    for first in range(0, len(runs), step := max(1, PAIRS_AT_ONCE // max(len(points_world), 1))):
        some = slice(first, first + step)
        near = _meet(around.at(some), eyes, points_world, room_m)
        for run, of_run in zip(runs[some], near, strict=True):
            at = np.flatnonzero(of_run & ~found)
            of_these = eyes if len(eyes) == 1 else eyes[at]
            found[at] = _meet(boxes.at(run), of_these, points_world[at], room_m).any(axis=0)
    return found


def _meet(
    boxes: Boxes, eyes_world: Float[np.ndarray, "m 3"], points_world: Points3, room_m: float
) -> Bool[np.ndarray, "k n"]:
    """Which lines meet which box."""
    turn, origin = boxes.world_from_boxes[:, :3, :3], boxes.world_from_boxes[:, None, :3, 3]
    eyes, ends = (eyes_world - origin) @ turn, (points_world - origin) @ turn
    low, high = boxes.low[:, None] - room_m, boxes.high[:, None] + room_m
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (low - eyes) / (ends - eyes), (high - eyes) / (ends - eyes)
    # 0 / 0 along an axis perpendicular to a line is NaN, which fmax and fmin ignore.
    enters = np.fmax.reduce(np.minimum(first, second), axis=2, initial=0)
    leaves = np.fmin.reduce(np.maximum(first, second), axis=2, initial=1)
    return np.asarray(enters <= leaves)


def before_or_shading(world: World, points_world: Points3) -> Hits:
    """Before which points an object or the bonnet is, as the camera sees them, and which may lie in the shadow of
    one."""
    light = world.scene.light
    parts = (with_room(boxes_of(world.view.objects), SHADE_ROOM_M), bonnet(world))
    bodies = Boxes(*(np.concatenate(of) for of in zip(*parts, strict=True)))
    up = np.tan(max(np.pi / 2 - light.sun_zenith_rad, LOWEST_SUN_RAD))
    to_sun = MAX_SHADOW_M * np.array([np.cos(light.sun_azimuth_rad), np.sin(light.sun_azimuth_rad), up])
    return meet(bodies, world.view.eye_world, points_world) | meet(bodies, points_world, points_world + to_sun)
