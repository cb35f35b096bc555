"""Arrays -> Blender meshes."""

import bpy
import numpy as np
from jaxtyping import Float, Int


def polygons(
    name: str,
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f k"],
    uv: Float[np.ndarray, "v 2"] | None = None,
) -> bpy.types.Mesh:
    """A new mesh of these faces, each of k vertices, of which equal ones that follow each other count once; with a UV
    layer. The caller adds attributes and materials, then updates it."""
    is_corner = np.zeros(faces.shape, dtype=bool)
    np.not_equal(faces[:, 1:], faces[:, :-1], out=is_corner[:, 1:])
    np.not_equal(faces[:, 0], faces[:, -1], out=is_corner[:, 0])
    corners, n_corners = faces.astype(np.int32)[is_corner], is_corner.sum(axis=1, dtype=np.int32)
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(vertices))
    data.loops.add(len(corners))
    data.polygons.add(len(faces))
    data.polygons.foreach_set("loop_start", np.cumsum(n_corners, dtype=np.int32) - n_corners)
    # As attributes: vertices and loops would be set one by one.
    data.attributes["position"].data.foreach_set("vector", vertices.astype(np.float32).ravel())
    data.attributes[".corner_vert"].data.foreach_set("value", corners)
    if uv is not None:
        data.uv_layers.new(name="UVMap").uv.foreach_set("vector", uv.astype(np.float32)[corners].ravel())
    return data
