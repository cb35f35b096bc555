"""Arrays -> Blender meshes."""

import bpy
import numpy as np
from jaxtyping import Float, Int


def polygons(name: str, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f k"]) -> bpy.types.Mesh:
    """A new mesh of these faces, each of k vertices; the caller adds attributes and materials, then updates it."""
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(vertices))
    data.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    corners = corners_of(faces)
    n_corners = (faces != np.roll(faces, 1, axis=1)).sum(axis=1)
    data.loops.add(len(corners))
    data.polygons.add(len(faces))
    data.polygons.foreach_set("loop_start", (np.cumsum(n_corners) - n_corners).astype(np.int32))
    # As attributes: loops and polygons would need to be set one by one.
    data.attributes[".corner_vert"].data.foreach_set("value", corners.astype(np.int32))
    return data


def corners_of(faces: Int[np.ndarray, "f k"]) -> Int[np.ndarray, " c"]:
    """The vertices of the corners of all faces; of two equal ones that follow each other one."""
    return faces[faces != np.roll(faces, 1, axis=1)]
