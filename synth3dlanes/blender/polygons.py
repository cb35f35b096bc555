"""Arrays -> Blender meshes."""

import bpy
import numpy as np
from jaxtyping import Float, Int


def polygons(name: str, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f k"]) -> bpy.types.Mesh:
    """A new mesh of these faces, each of k vertices; the caller adds attributes and materials, then updates it."""
    n_faces, n_corners = faces.shape
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(vertices))
    data.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    data.loops.add(faces.size)
    data.polygons.add(n_faces)
    data.polygons.foreach_set("loop_start", np.arange(0, faces.size, n_corners, dtype=np.int32))
    # As attributes: loops and polygons would need to be set one by one.
    data.attributes[".corner_vert"].data.foreach_set("value", faces.astype(np.int32).ravel())
    return data
