"""What stands beside the road -> Blender: one material per semantic name, coloured face by face."""

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

from synth3dlanes.blender.polygons import polygons
from synth3dlanes.blender.shaders import ShaderGraph, coated, new_material, texture
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.world.solids import SURFACES, Body

# Dirt and stains vary the colours over this length.
DIRT_M = 6.0


def structure_materials() -> dict[str, bpy.types.Material]:
    """The materials of SURFACES: each face's colour with a little dirt, under a coat with its gloss."""
    return {name: _material(name) for name in SURFACES}


def _material(name: str) -> bpy.types.Material:
    material, graph = new_material(name, SEMANTIC_IDS[name])
    paint = graph.node("ShaderNodeAttribute", attribute_name="paint")
    coated(graph, _dirty(graph, paint.outputs["Color"]), 0.35, paint.outputs["Alpha"])
    return material


def _dirty(graph: ShaderGraph, color: object) -> object:
    """A colour that is 20 % darker or lighter in patches."""
    x, y, z = graph.node("ShaderNodeSeparateXYZ", {0: graph.node("ShaderNodeNewGeometry").outputs["Position"]}).outputs
    place = graph.node("ShaderNodeCombineXYZ", {0: graph.math("ADD", x, y), 1: graph.math("SUBTRACT", z, x)}).outputs[0]
    patches = texture(graph, "terrain_macro.jpg", graph.scale(place, 1 / DIRT_M), is_color=False)
    shade = graph.math("MULTIPLY_ADD", patches, 0.8, 0.6)
    return graph.scale(color, shade)


def structure_mesh(body: Body, materials: Sequence[bpy.types.Material]) -> bpy.types.Mesh:
    """A mesh of flat quads with the face colours as attribute `paint`."""
    corners = body.corners_world.reshape(-1, 3)
    data = polygons(body.kind, corners, np.arange(len(corners)).reshape(-1, 4))
    paint = data.attributes.new("paint", "FLOAT_COLOR", "CORNER")
    paint.data.foreach_set("color", np.repeat(body.colors, 4, axis=0).astype(np.float32).ravel())
    data.materials.append(materials[0])
    data.update(calc_edges=True)
    return data


def search_tree(bodies: list[Body]) -> BVHTree | None:
    """One search tree of all bodies; None without any."""
    corners = np.concatenate([np.zeros((0, 3)), *(body.corners_world.reshape(-1, 3) for body in bodies)])
    if not len(corners):
        return None
    return BVHTree.FromPolygons(corners.tolist(), np.arange(len(corners)).reshape(-1, 4).tolist())
