"""Bodies of cars, trees and the host's bonnet: boxes that they fill or may fill, and pixels that they may cover."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.system.arrays import Points2
from synth3dlanes.validate.boxes import Boxes, Corners
from synth3dlanes.world.bonnet import bonnet
from synth3dlanes.world.world import World

# Bodies are cut off at this depth, so that a car beside the camera can be projected.
CUT_DEPTH_M = 0.3
# Lower limit of the sun's elevation, and upper limit of a shadow's length.
LOWEST_SUN_RAD, MAX_SHADOW_M = 0.05, 15.0
# Margin for soft shadow edges and for mirrors.
ROOM_PX = 3.0

# Least number of a body's corners in the field of a lens; places along a line that the lens bends.
MIN_CORNERS, BENDS = 3, 9
# Mirrors and twigs may extend beyond the nominal boxes.
ROOM = 1.15
# Trunks go on underground, where they hide points behind a hill.
ROOTS_M = 1.0
# Every car is solid in this part of its box: above the open space below a truck, below the windows, behind the gap at a
# truck's cab, and between the arches of the wheels, through which one sees above the tyres.
CORE_SIDES, CORE_HEIGHT = ((-0.7, -0.35), (0.7, 0.2)), (0.38, 0.5)
# Below its highest point the host's bonnet fills the first box and is inside the second.
BONNET_CORE = ((-0.6, 0.35, -0.3), (0.6, 1.3, -0.16))
BONNET = ((-0.78, 0.02, -0.4), (0.78, 1.6, 0.02))


def corners_world(world: World, car: int) -> Float[np.ndarray, "8 3"]:
    """The corners of a car's bounding box."""
    item = world.scene.cars[car]
    model = world.scene.assets.car_models[item.model - 1]
    half = np.array([model.width_m, model.length_m]) / 2
    low, high = np.array([*-half, 0.0]), np.array([*half, model.height_m])
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)
    return transform(world.view.world_from_cars[car], corners * item.scale)


def may_show_cars(world: World, camera: CameraLabel, uv: Points2, within_m: float) -> Bool[np.ndarray, " n"]:
    """Which pixels a car or its shadow may cover, counting only those that begin within `within_m` ahead, or the host's
    bonnet."""
    hidden = np.zeros(len(uv), dtype=bool)
    for points in _bodies(world):
        points_cam = transform(invert(camera.world_from_cam), points)
        if points_cam[:, 1].min() <= within_m:
            hidden[~hidden] = covers(outline(camera, points_cam), uv[~hidden], ROOM_PX)
    return hidden


def outline(camera: CameraLabel, points_cam: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "_ 2"]:
    """Places in the image whose convex hull contains what the camera sees of the convex hull of points. A lens bends
    the lines between these, and may see some of them behind the camera."""
    if camera.lens.is_pinhole:
        return camera.project(ahead(points_cam))
    one, other = np.triu_indices(len(points_cam))
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


def _bodies(world: World) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Points whose convex hulls contain each car with its shadow, and the bonnet."""
    for car in range(len(world.scene.cars)):
        corners = corners_world(world, car)
        yield np.concatenate([corners, _shadow(world, car, corners)])
    if world.view.world_from_bonnet is not None:
        yield transform(world.view.world_from_bonnet, bonnet().vertices_world)


def _shadow(world: World, car: int, corners: Float[np.ndarray, "8 3"]) -> Float[np.ndarray, "8 3"]:
    """The corners' shadows on level ground."""
    light, foot_m = world.scene.light, world.view.world_from_cars[car][2, 3]
    rise = np.tan(max(np.pi / 2 - light.sun_zenith_rad, LOWEST_SUN_RAD))
    length_m = np.minimum((corners[:, 2] - foot_m) / rise, MAX_SHADOW_M)
    away = -np.array([np.cos(light.sun_azimuth_rad), np.sin(light.sun_azimuth_rad)])
    return np.column_stack([corners[:, :2] + length_m[:, None] * away, np.full(len(corners), foot_m)])


def cores(world: World) -> Boxes:
    """The opaque core of each car and of the bonnet."""
    half, up, poses = _cars(world)
    low, high = (half * [*side, 0] + height * up for side, height in zip(CORE_SIDES, CORE_HEIGHT, strict=True))
    return _with_bonnet(world, Boxes(poses, low, high), BONNET_CORE)


def outlines(world: World) -> Boxes:
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
