"""What cars and trees hide: rays against their true meshes. World frame; no rendering.

Each asset's mesh gets one search tree per process; a ray is brought into an object's own frame.
"""

from functools import cache

import bpy
import numpy as np
from jaxtyping import Bool, Float
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from synth3dlanes.blender.build import Placed
from synth3dlanes.geometry.transforms import invert, transform

# A point on the road is not hidden by what touches it from beyond this distance.
END_M = 0.02


def hidden_by_objects(
    placed: list[Placed], eye_world: Float[np.ndarray, "3"], points_world: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """True where a car or a tree stands on the straight line from the eye to the point."""
    hidden = np.zeros(len(points_world), dtype=bool)
    near = _rays_near(placed, eye_world, points_world)
    for item, candidates in zip(placed, near, strict=True):
        rays = np.flatnonzero(candidates & ~hidden)
        if not rays.size:
            continue
        tree = _search_tree(item.mesh.name)
        object_from_world = invert(item.world_from_object)
        eye = transform(object_from_world, eye_world) / item.scale
        to = transform(object_from_world, points_world[rays]) / item.scale - eye
        reach = np.linalg.norm(to, axis=1)
        origin = Vector(eye)
        for ray, direction, distance in zip(rays, to / reach[:, None], reach - END_M / item.scale, strict=True):
            hidden[ray] = tree.ray_cast(origin, Vector(direction), distance)[0] is not None
    return hidden


def _rays_near(
    placed: list[Placed], eye_world: Float[np.ndarray, "3"], points_world: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "o n"]:
    """Which rays pass through which object's bounding sphere before they end."""
    spheres = [_bounding_sphere(item.mesh.name) for item in placed]
    centers = np.array(
        [transform(item.world_from_object, item.scale * center) for item, (center, _) in zip(placed, spheres, strict=True)]
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
