"""Occlusion by cars, trees and structures: rays against their rendered meshes. World frame; no rendering.

Each asset's mesh gets one search tree per process; rays are transformed into the object's frame. All structures of a
scene share one tree.
"""

from collections.abc import Callable
from functools import cache

import bpy
import numpy as np
from jaxtyping import Bool, Float
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from synth3dlanes.blender.build import Placed
from synth3dlanes.frames import invert, transform
from synth3dlanes.labels import Labels

# Rays end this far before the point, so that surfaces touching the point do not hide it.
END_M = 0.02
# Rays per side of the grid over a car's bounding sphere. About 60 of them hit the car, so shares are accurate to a few
# per cent.
SILHOUETTE_RAYS = 16
# Seen from behind, a car larger than this fills too little of its sphere: its grid is twice as fine.
LARGE_M = 5.0


def hidden_by_objects(
    placed: list[Placed],
    structures: BVHTree | None,
    eye_world: Float[np.ndarray, "3"],
    points_world: Float[np.ndarray, "n 3"],
) -> Bool[np.ndarray, " n"]:
    """True where a car, a tree or a structure is on the straight line from the eye to the point."""
    hidden = np.zeros(len(points_world), dtype=bool)
    if structures is not None:
        hidden = _meets(structures, eye_world, points_world, END_M)
    near = _rays_near(placed, eye_world, points_world)
    for item, candidates in zip(placed, near, strict=True):
        rays = np.flatnonzero(candidates & ~hidden)
        if not rays.size:
            continue
        object_from_world = invert(item.world_from_object)
        eye = transform(object_from_world, eye_world) / item.scale
        points = transform(object_from_world, points_world[rays]) / item.scale
        hidden[rays] = _meets(_search_tree(item.mesh.name), eye, points, END_M / item.scale)
    return hidden


def _meets(
    tree: BVHTree, eye: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 3"], end: float
) -> Bool[np.ndarray, " n"]:
    """Which straight lines from the eye meet a mesh before they come this close to their points."""
    to = points - eye
    reach, origin = np.linalg.norm(to, axis=1), Vector(eye)
    hits = (
        tree.ray_cast(origin, Vector(direction), distance)[0] is not None
        for direction, distance in zip(to / reach[:, None], reach - end, strict=True)
    )
    return np.fromiter(hits, dtype=bool, count=len(to))


def seen_fractions(
    cars: list[Placed],
    placed: list[Placed],
    structures: BVHTree | None,
    labels: Labels,
    seen_over_ground: Callable[[Float[np.ndarray, "n 3"]], Bool[np.ndarray, " n"]],
) -> tuple[float, ...]:
    """For each car, the share of its silhouette that is inside the image and not hidden by ground or objects."""
    camera = labels.camera
    eye = camera.world_from_cam[:3, 3]
    nothing = np.zeros((0, 3))
    surfaces = [_silhouette(car, eye) if _reaches_image(car, labels) else nothing for car in cars]
    points = np.concatenate([*surfaces, nothing])
    seen = camera.shows(transform(invert(camera.world_from_cam), points))
    seen[seen] = seen_over_ground(points[seen])
    seen[seen] = ~hidden_by_objects(placed, structures, eye, points[seen])
    shares = np.split(seen, np.cumsum([len(surface) for surface in surfaces]))[:-1]
    return tuple(round(float(share.mean()), 3) if share.size else 0.0 for share in shares)


def _reaches_image(car: Placed, labels: Labels) -> bool:
    """Whether the car's bounding sphere reaches into the view frustum; for lenses, every car may."""
    if not labels.camera.lens.is_pinhole:
        return True
    center, radius = _bounding_sphere(car.mesh.name)
    camera = labels.camera
    center_cam = transform(invert(camera.world_from_cam), transform(car.world_from_object, center * car.scale))
    u, v, y = camera.img_from_cam
    sides = np.array([u, v, camera.width_px * y - u, camera.height_px * y - v])
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    return bool((sides @ center_cam > -radius * car.scale).all())


def _silhouette(car: Placed, eye_world: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n 3"]:
    """World points on the car's surface where a regular grid of rays from the eye hits it."""
    center, radius = _bounding_sphere(car.mesh.name)
    eye = transform(invert(car.world_from_object), eye_world) / car.scale
    forward = center - eye
    distance = np.linalg.norm(forward)
    forward /= distance
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    n_rays = SILHOUETTE_RAYS * (2 if radius > LARGE_M else 1)
    grid = (np.arange(n_rays) + 0.5) / n_rays * 2 - 1
    across, up = (axis.reshape(-1, 1) for axis in np.meshgrid(grid, grid))
    rays = center + radius * (across * right + up * np.cross(right, forward)) - eye
    tree = _search_tree(car.mesh.name)
    hits = (tree.ray_cast(Vector(eye), Vector(ray))[0] for ray in rays / np.linalg.norm(rays, axis=1)[:, None])
    points = np.array([hit for hit in hits if hit is not None]).reshape(-1, 3)
    return transform(car.world_from_object, points * car.scale)


def _rays_near(
    placed: list[Placed], eye_world: Float[np.ndarray, "3"], points_world: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "o n"]:
    """Which rays pass through each object's bounding sphere before they end."""
    spheres = [_bounding_sphere(item.mesh.name) for item in placed]
    centers = np.array(
        [
            transform(item.world_from_object, item.scale * center)
            for item, (center, _) in zip(placed, spheres, strict=True)
        ]
    ).reshape(-1, 3)
    radii = np.array([item.scale * radius for item, (_, radius) in zip(placed, spheres, strict=True)])
    to = points_world - eye_world
    reach = np.linalg.norm(to, axis=1)
    offset = centers - eye_world
    along = np.clip(offset @ (to / reach[:, None]).T, 0, reach)
    squared = (offset**2).sum(axis=1)[:, None] - 2 * along * (offset @ (to / reach[:, None]).T) + along**2
    return np.asarray(squared < (radii**2)[:, None])


@cache
def _search_tree(mesh_name: str) -> BVHTree:
    mesh = bpy.data.meshes[mesh_name]
    return BVHTree.FromPolygons([v.co for v in mesh.vertices], [list(p.vertices) for p in mesh.polygons])


@cache
def _bounding_sphere(mesh_name: str) -> tuple[Float[np.ndarray, "3"], float]:
    mesh = bpy.data.meshes[mesh_name]
    points = np.zeros(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", points)
    points = points.reshape(-1, 3).astype(float)
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    return center, float(np.linalg.norm(points - center, axis=1).max())
