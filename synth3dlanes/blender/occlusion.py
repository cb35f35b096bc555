"""Occlusion by objects, trees and structures: rays against their rendered meshes. World frame; no rendering.

Each asset's mesh gets one search tree per process; rays are transformed into the object's frame. All structures of a
scene share one tree.
"""

from functools import cache

import bpy
import numpy as np
from jaxtyping import Bool, Float
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from synth3dlanes.blender.build import MeshInstance
from synth3dlanes.blender.user_models import points_of
from synth3dlanes.geometry.frames import invert, transform

# Rays end before the point, so that surfaces touching it do not hide it.
END_M = 0.02

Bounds = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]


def hidden_by_objects(
    placed: list[MeshInstance],
    structures: BVHTree | None,
    eye_world: Float[np.ndarray, "3"],
    points_world: Float[np.ndarray, "n 3"],
) -> Bool[np.ndarray, " n"]:
    """True where an object, a tree or a structure is on the straight line from the eye to the point."""
    hidden = np.zeros(len(points_world), dtype=bool)
    if structures is not None:
        hidden = _meets(structures, eye_world, points_world, END_M)
    near = _rays_near(placed, eye_world, points_world)
    for number in np.flatnonzero(near.any(axis=1)):
        item, rays = placed[number], np.flatnonzero(near[number] & ~hidden)
        if not rays.size:
            continue
        object_from_world = invert(item.world_from_object)
        eye = transform(object_from_world, eye_world) / item.scale
        points = transform(object_from_world, points_world[rays]) / item.scale
        hidden[rays] = _meets(search_tree(item.mesh.name), eye, points, END_M / item.scale)
    return hidden


def _meets(
    tree: BVHTree, eye: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 3"], end: float
) -> Bool[np.ndarray, " n"]:
    """Which straight lines from the eye hit a mesh before they are this near to their points."""
    to = points - eye
    reach, origin = np.linalg.norm(to, axis=1), Vector(eye)
    rays = zip((to / reach[:, None]).tolist(), (reach - end).tolist(), strict=True)
    hits = (tree.ray_cast(origin, direction, distance)[0] is not None for direction, distance in rays)
    return np.fromiter(hits, dtype=bool, count=len(to))


def _rays_near(
    placed: list[MeshInstance], eye_world: Float[np.ndarray, "3"], points_world: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, "o n"]:
    """Which rays pass through each object's bounding sphere before they end."""
    spheres = [bounding_sphere(item.mesh.name) for item in placed]
    poses = np.array([item.world_from_object for item in placed]).reshape(-1, 4, 4)
    scales, middles = np.array([item.scale for item in placed]), np.array([center for center, _ in spheres])
    offsets = poses[:, :3, :3] @ (scales[:, None] * middles.reshape(-1, 3))[..., None]
    centers = poses[:, :3, 3] + offsets[..., 0]
    radii = scales * np.array([radius for _, radius in spheres])
    to = points_world - eye_world
    reach = np.linalg.norm(to, axis=1)
    offset = centers - eye_world
    ahead = offset @ (to / reach[:, None]).T
    along = np.clip(ahead, 0, reach)
    squared = (offset**2).sum(axis=1)[:, None] - 2 * along * ahead + along**2
    return np.asarray(squared < (radii**2)[:, None])


@cache
def search_tree(mesh_name: str) -> BVHTree:
    """The search tree of a mesh in its own frame."""
    mesh = bpy.data.meshes[mesh_name]
    return BVHTree.FromPolygons([v.co for v in mesh.vertices], [list(p.vertices) for p in mesh.polygons])


@cache
def bounding_box(mesh_name: str) -> Bounds:
    """The least and the greatest coordinates of a mesh."""
    points = points_of(bpy.data.meshes[mesh_name])
    return points.min(axis=0), points.max(axis=0)


@cache
def bounding_sphere(mesh_name: str) -> tuple[Float[np.ndarray, "3"], float]:
    """Middle of a mesh's bounding box, and the distance of its farthest vertex from there."""
    center = np.mean(bounding_box(mesh_name), axis=0)
    return center, float(np.linalg.norm(points_of(bpy.data.meshes[mesh_name]) - center, axis=1).max())
