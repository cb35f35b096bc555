"""Bodies of things by kind: boxes that they fill or may fill, lines of sight through these, and outlines in the image.

An object, as a car, fills its model's box, a tree that of trunk and crown, a structure a flat box about each of its
faces. Frame of the world, metres.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.scene.instance_ids import thing_of
from synth3dlanes.system.arrays import Points2, Points3
from synth3dlanes.world.bonnet import bonnet
from synth3dlanes.world.objects import PlacedObject
from synth3dlanes.world.world import World

# Mirrors and twigs may extend beyond the boxes of models; a face may be this far from what is seen of it.
ROOM, FACE_ROOM_M = 1.15, 0.12
# Bodies of models sink into slopes by this share of their height; trunks go on underground.
SUNK, ROOTS_M = 0.05, 1.0
# Every car is solid in this part of its box: above the open space below a truck, below the windows, behind the gap at a
# truck's cab, and between the arches of the wheels, through which one sees above the tyres.
CORE_SIDES, CORE_HEIGHT = ((-0.7, -0.35), (0.7, 0.2)), (0.38, 0.5)
# Below its highest point the host's bonnet fills the first box and is inside the second.
BONNET_CORE = ((-0.6, 0.35, -0.3), (0.6, 1.3, -0.16))
BONNET = ((-0.78, 0.02, -0.4), (0.78, 1.6, 0.02))
# Bodies are cut off at this depth, so that a car beside the camera can be projected.
CUT_DEPTH_M = 0.3
# Lower limit of the sun's elevation, and upper limit of a shadow's length.
LOWEST_SUN_RAD, MAX_SHADOW_M = 0.05, 15.0
# Margin for soft shadow edges and for mirrors.
ROOM_PX = 3.0
# Least number of a body's corners in the field of a lens; places along a line that the lens bends.
MIN_CORNERS, BENDS = 3, 9
# Boxes of a thing that are looked at together where one around them is met; boxes times points at once.
RUN, TOGETHER = 32, 1_000_000

Corners = Float[np.ndarray, "k 3"]


class Boxes(NamedTuple):
    """Boxes from a low to a high corner, each in its own frame, and the number of the thing that each belongs to."""

    world_from_boxes: Float[np.ndarray, "k 4 4"]
    low: Corners
    high: Corners
    owners: Int[np.ndarray, " k"]

    def at(self, which: Bool[np.ndarray, " k"] | slice) -> "Boxes":
        """Some of the boxes."""
        return Boxes(*(values[which] for values in self))

    def and_one(
        self, pose: Float[np.ndarray, "4 4"] | None, low: tuple[float, ...], high: tuple[float, ...]
    ) -> "Boxes":
        """The same with one more box of no thing, if it has a pose."""
        if pose is None:
            return self
        return Boxes(*(np.concatenate([part, [own]]) for part, own in zip(self, (pose, low, high, -1), strict=True)))

    def groups(self) -> tuple["Boxes", list[slice]]:
        """Upright boxes around runs of a thing's boxes, and these runs."""
        n = len(self.owners)
        if not n:
            return self, []
        begins = np.append(True, self.owners[1:] != self.owners[:-1])
        in_run = np.arange(n) - np.maximum.accumulate(np.where(begins, np.arange(n), 0))
        starts = np.flatnonzero(in_run % RUN == 0)
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


def objects(series: str, world: World) -> Boxes:
    """The box of each object of a series of instance ids."""
    placed = [item for item in world.view.objects if thing_of(item.id)[0] == series]
    sizes = np.array([item.size_m for item in placed]).reshape(-1, 3) * [0.5, 0.5, 1]
    return _of_models(sizes, np.array([item.world_from_object for item in placed]).reshape(-1, 4, 4))


def trees(world: World) -> Boxes:
    """The box of each tree's trunk and crown, roots included."""
    models = [world.scene.assets.tree_models[tree.model - 1] for tree in world.scene.trees]
    sizes = np.array([(model.crown_radius_m, model.crown_radius_m, model.height_m) for model in models]).reshape(-1, 3)
    sizes *= np.array([tree.scale for tree in world.scene.trees]).reshape(-1, 1)
    poses = np.tile(np.eye(4), (len(sizes), 1, 1))
    poses[:, :3, 3] = world.site.trees_world
    return _of_models(sizes, poses, ROOTS_M)


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


# The series of instance ids whose things have bodies.
BODIES: dict[str, Callable[[World], Boxes]] = {
    "car": partial(objects, "car"),
    "thing": partial(objects, "thing"),
    "tree": trees,
    "structure": structures,
}


def grown(boxes: Boxes) -> Boxes:
    """The same with room for mirrors and twigs."""
    return boxes._replace(low=ROOM * boxes.low, high=ROOM * boxes.high)


def cores(world: World) -> Boxes:
    """The opaque core of each car and of the bonnet."""
    boxes = objects("car", world)
    half, up = boxes.high * [1, 1, 0], boxes.high * [0, 0, 1]
    low, high = (half * [*side, 0] + height * up for side, height in zip(CORE_SIDES, CORE_HEIGHT, strict=True))
    return boxes._replace(low=low, high=high).and_one(world.view.world_from_bonnet, *BONNET_CORE)


def outlines(world: World) -> Boxes:
    """The box that each object, each tree and the bonnet may fill."""
    grown_ = [grown(boxes(world)) for series, boxes in BODIES.items() if series != "structure"]
    return Boxes(*(np.concatenate(parts) for parts in zip(*grown_, strict=True))).and_one(
        world.view.world_from_bonnet, *BONNET
    )


def inside(boxes: Boxes, points_world: Points3, owners: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
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


def meet(
    boxes: Boxes, eye_world: Float[np.ndarray, "3"], points_world: Points3, room_m: float = 0.0
) -> Bool[np.ndarray, " n"]:
    """Which straight lines from the eye to the points meet any of the boxes, or room about them."""
    found = np.zeros(len(points_world), dtype=bool)
    around, runs = boxes.groups()
    for first in range(0, len(runs), step := max(1, TOGETHER // max(len(points_world), 1))):
        some = slice(first, first + step)
        near = _meet(around.at(some), eye_world, points_world, room_m)
        for run, of_run in zip(runs[some], near, strict=True):
            at = np.flatnonzero(of_run & ~found)
            found[at] = _meet(boxes.at(run), eye_world, points_world[at], room_m).any(axis=0)
    return found


def _meet(
    boxes: Boxes, eye_world: Float[np.ndarray, "3"], points_world: Points3, room_m: float
) -> Bool[np.ndarray, "k n"]:
    """Which lines meet which box."""
    turn, origin = boxes.world_from_boxes[:, :3, :3], boxes.world_from_boxes[:, None, :3, 3]
    eyes, ends = (eye_world - origin) @ turn, (points_world - origin) @ turn
    low, high = boxes.low[:, None] - room_m, boxes.high[:, None] + room_m
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (low - eyes) / (ends - eyes), (high - eyes) / (ends - eyes)
    # 0 / 0 along an axis perpendicular to a line is NaN, which fmax and fmin ignore.
    enters = np.fmax.reduce(np.minimum(first, second), axis=2, initial=0)
    leaves = np.fmin.reduce(np.maximum(first, second), axis=2, initial=1)
    return np.asarray(enters <= leaves)


def corners_world(item: PlacedObject, room: float = 1.0) -> Float[np.ndarray, "8 3"]:
    """The corners of an object's bounding box, grown about its place on the road."""
    high = item.size_m * [0.5, 0.5, 1]
    corners = np.stack(np.meshgrid(*np.stack([high * [-1, -1, 0], high], axis=1)), axis=-1).reshape(-1, 3)
    return transform(item.world_from_object, room * corners)


def may_show_objects(world: World, camera: CameraLabel, uv: Points2, within_m: float) -> Bool[np.ndarray, " n"]:
    """Which pixels an object with a box or its shadow may cover, counting only those that begin within `within_m`
    ahead, or the host's bonnet."""
    hulls = []
    for item in world.view.objects:
        corners = corners_world(item)
        hulls.append(np.concatenate([corners, _shadow(world, item, corners)]))
    if world.view.world_from_bonnet is not None:
        hulls.append(transform(world.view.world_from_bonnet, bonnet().vertices_world))
    hidden = np.zeros(len(uv), dtype=bool)
    for points in hulls:
        points_cam = transform(invert(camera.world_from_cam), points)
        if points_cam[:, 1].min() <= within_m:
            hidden[~hidden] = covers(outline(camera, points_cam), uv[~hidden], ROOM_PX)
    return hidden


def _shadow(world: World, item: PlacedObject, corners: Float[np.ndarray, "8 3"]) -> Float[np.ndarray, "8 3"]:
    """The corners' shadows on level ground."""
    light, foot_m = world.scene.light, item.world_from_object[2, 3]
    rise = np.tan(max(np.pi / 2 - light.sun_zenith_rad, LOWEST_SUN_RAD))
    length_m = np.minimum((corners[:, 2] - foot_m) / rise, MAX_SHADOW_M)
    away = -np.array([np.cos(light.sun_azimuth_rad), np.sin(light.sun_azimuth_rad)])
    return np.column_stack([corners[:, :2] + length_m[:, None] * away, np.full(len(corners), foot_m)])


def outline(camera: CameraLabel, points_cam: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "_ 2"]:
    """Places in the image whose convex hull contains what the camera sees of the convex hull of points. A lens bends
    the lines between these, and may see some of them behind the camera."""
    if camera.lens.is_pinhole:
        return camera.project(ahead(points_cam))
    sides = ConvexHull(points_cam).simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    one, other = np.unique(np.sort(sides, axis=1), axis=0).T
    share = np.linspace(0, 1, BENDS)[:, None, None]
    uv = camera.project((points_cam[one] + share * (points_cam[other] - points_cam[one])).reshape(-1, 3))
    return uv[np.isfinite(uv).all(axis=1)]


def ahead(points_cam: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Points whose convex hull is the part of that of the given points that is ahead of the camera."""
    y_m = points_cam[:, 1]
    front, back = points_cam[y_m >= CUT_DEPTH_M], points_cam[y_m < CUT_DEPTH_M]
    share = (front[:, None, 1:2] - CUT_DEPTH_M) / (front[:, None, 1:2] - back[None, :, 1:2])
    return np.concatenate([front, (front[:, None] + share * (back - front[:, None])).reshape(-1, 3)])


def covers(corners: Float[np.ndarray, "k 2"], uv: Points2, room_px: float) -> Bool[np.ndarray, " n"]:
    """Which pixels are inside the convex hull of corners, or within a margin of it; none without an area."""
    covered = np.zeros(len(uv), dtype=bool)
    corners = corners[np.isfinite(corners).all(axis=1)]
    if len(corners) < MIN_CORNERS or not np.ptp(corners, axis=0).all():
        return covered
    near = ((uv > corners.min(axis=0) - room_px) & (uv < corners.max(axis=0) + room_px)).all(axis=1)
    if near.any():
        sides = ConvexHull(corners).equations
        covered[near] = (uv[near] @ sides[:, :2].T + sides[:, 2] < room_px).all(axis=1)
    return covered
