"""Meshes as vertex and face arrays, and how their faces are put together. World frame."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.system.arrays import Points2

# Slots of materials.
ROAD, SHOULDER, MEDIAN = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Mesh:
    """Quads, of which a triangle has its last corner twice. `uv_m` is (across, along) in metres, for terrain world (x,
    y); `material` is the material slot per face: ROAD, SHOULDER or MEDIAN of a pavement, else 0."""

    vertices_world: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 4"]
    uv_m: Float[np.ndarray, "v 2"]
    material: Int[np.ndarray, " f"]


def grid(vertices: Float[np.ndarray, "r c 3"], uv: Float[np.ndarray, "r c 2"], column_material: np.ndarray) -> Mesh:
    """Quads between rows and columns, facing up. `column_material` is one slot per column or, in 2D, per face."""
    rows, columns = vertices.shape[:2]
    i = np.arange(rows * columns).reshape(rows, columns)
    faces = np.stack([i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]], -1).reshape(-1, 4)
    across, along = vertices[:-1, 1:] - vertices[:-1, :-1], vertices[1:, :-1] - vertices[:-1, :-1]
    if (across[..., 0] * along[..., 1] - across[..., 1] * along[..., 0]).sum() < 0:
        faces = faces[:, ::-1]
    material = np.broadcast_to(column_material, (rows - 1, columns - 1)).reshape(-1)
    return Mesh(vertices.reshape(-1, 3), faces, uv.reshape(-1, 2), material)


def where(mesh: Mesh, holds: Callable[[Points2], Bool[np.ndarray, " v"]]) -> Mesh:
    """The mesh without the faces that have a corner at a place that does not hold."""
    kept = holds(mesh.vertices_world[:, :2])[mesh.faces].all(axis=1)
    return mesh if kept.all() else replace(mesh, faces=mesh.faces[kept], material=mesh.material[kept])


def with_crease(mesh: Mesh, apart: Bool[np.ndarray, " f"]) -> Mesh:
    """The mesh with some of its faces apart from the others: shading, which is smooth over vertices that faces share,
    ends between them."""
    used, numbers = np.unique(mesh.faces[apart], return_inverse=True)
    faces = mesh.faces.copy()
    faces[apart] = len(mesh.vertices_world) + numbers.reshape(-1, 4)
    vertices, uv = (np.concatenate([values, values[used]]) for values in (mesh.vertices_world, mesh.uv_m))
    return replace(mesh, vertices_world=vertices, uv_m=uv, faces=faces)


def facing_up(vertices_world: Float[np.ndarray, "v 3"], uv_m: Float[np.ndarray, "v 2"]) -> Mesh:
    """A mesh of separate quads, four vertices each, with their front sides up."""
    faces = np.arange(len(vertices_world)).reshape(-1, 4)
    mesh = Mesh(vertices_world, faces, uv_m, np.zeros(len(faces), dtype=int))
    up = is_facing_up(mesh)
    return Mesh(vertices_world, np.where(up[:, None], faces, faces[:, ::-1]), uv_m, mesh.material)


def is_facing_up(mesh: Mesh) -> Bool[np.ndarray, " f"]:
    """Which faces have their front side up."""
    a, b, c, d = (mesh.vertices_world[mesh.faces[:, i], :2] for i in range(4))
    across, along = c - a, d - b
    return np.asarray(across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0] >= 0)
