"""Materials of ground, road and paint: made once per process, tuned per scene through node values.

Every mesh carries a UV layer "UVMap" in metres: terrain (world x, world y), road and shoulder (right of the road's
middle, along it), paint (across, along). A material's `pass_index` is its semantic id.
"""

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from synth3dlanes.blender.assets import assets_dir
from synth3dlanes.blender.shaders import Graph, coated, new_material
from synth3dlanes.scene import Scene
from synth3dlanes.settings import SEMANTIC_IDS

# A texture scale is the number of tiles in 100 m: road tiles of 3 to 10 m, terrain tiles of 7 to 20 m.
SCALE_LENGTH_M = 100.0
WEAR_LENGTH_M = 48.0  # the wear maps show two lanes by this length
SHOULDER_TILES = 30.0  # as a texture scale
N_ROADS, N_TERRAINS = 3, 2
# Cycles has no mipmaps: far terrain fades to its texture's mean (linear), or the grain would alias at few samples.
BLUR_DISTANCE_M = 160.0
TERRAIN_MEANS = {"terrain_1": (0.108, 0.12, 0.042), "terrain_2": (0.249, 0.179, 0.11)}


@dataclass(frozen=True, eq=False)
class Materials:
    """Road and terrain materials by texture type, counted from 0 here."""

    roads: tuple[bpy.types.Material, ...]
    shoulder: bpy.types.Material
    terrains: tuple[bpy.types.Material, ...]
    marking: bpy.types.Material


def make_materials() -> Materials:
    """Build all of them with their textures; call once per process."""
    return Materials(
        tuple(_road(f"road_{k + 1}") for k in range(N_ROADS)),
        _shoulder(),
        tuple(_terrain(f"terrain_{k + 1}") for k in range(N_TERRAINS)),
        _marking(),
    )


def set_materials(materials: Materials, scene: Scene) -> None:
    """Turn the knobs for one scene: texture scale and direction, gloss, lane width, paint."""
    surface, angle_rad = scene.surface, scene.surface.texture_orientation_rad
    lane_width_m, parity = scene.road.lane_width_m, scene.road.n_lanes % 2
    for road in materials.roads:
        _orient(road, surface.road_texture_scale, angle_rad)
        wear = road.node_tree.nodes["wear_uv"].inputs
        wear["Scale"].default_value = (0.5 / lane_width_m, 1 / WEAR_LENGTH_M, 1)
        wear["Location"].default_value = (0.25 * parity, 0, 0)
        _set(road, "gloss", surface.road_gloss)
    for terrain in materials.terrains:
        _orient(terrain, surface.terrain_texture_scale, angle_rad)
    _orient(materials.shoulder, SHOULDER_TILES, angle_rad)
    _set(materials.marking, "grayscale", scene.markings.grayscale)
    _set(materials.marking, "gloss", scene.markings.gloss)


def _set(material: bpy.types.Material, name: str, value: float) -> None:
    material.node_tree.nodes[name].outputs[0].default_value = value


def _orient(material: bpy.types.Material, texture_scale: float, angle_rad: float) -> None:
    """Scale and turn the texture, and turn the bumps of its normal map back into the world."""
    tiles_per_m = texture_scale / SCALE_LENGTH_M
    uv, tilt = (material.node_tree.nodes[name].inputs for name in ("tile_uv", "tilt"))
    uv["Scale"].default_value = (tiles_per_m, tiles_per_m, 1)
    uv["Rotation"].default_value = (0, 0, angle_rad)
    strength = tilt["Scale"].default_value[0] / 2
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    tilt["Rotation"].default_value = (0, 0, -angle_rad)
    tilt["Location"].default_value = (-strength * (c + s), -strength * (c - s), 0)


def _image(graph: Graph, file: str, vector: Any, is_color: bool) -> Any:
    """A repeating texture's colour output."""
    image = bpy.data.images.load(str(assets_dir() / "textures" / file), check_existing=True)
    image.colorspace_settings.name = "sRGB" if is_color else "Non-Color"
    return graph.node("ShaderNodeTexImage", {"Vector": vector}, image=image).outputs["Color"]


def _metres(graph: Graph) -> Any:
    return graph.node("ShaderNodeUVMap", uv_map="UVMap").outputs[0]


def _bumpy_normal(graph: Graph, name: str, uv: Any, strength: float) -> Any:
    """The surface normal tilted by a normal map.

    The tilt is added in world x and y: the ground is nearly level, and this needs no tangents on the meshes.
    """
    texel = _image(graph, f"{name}_normal.jpg", uv, is_color=False)
    tilt = graph.node("ShaderNodeMapping", {"Vector": texel, "Scale": (2 * strength, 2 * strength, 0)}, name="tilt")
    normal = graph.node("ShaderNodeNewGeometry").outputs["Normal"]
    return graph.vector("NORMALIZE", graph.vector("ADD", normal, tilt.outputs[0]))


def _tile_uv(graph: Graph) -> Any:
    return graph.node("ShaderNodeMapping", {"Vector": _metres(graph)}, name="tile_uv").outputs[0]


def _road(name: str) -> bpy.types.Material:
    """Fine texture times the lane-aligned wear map; a rough coat that `gloss` polishes."""
    material, graph = new_material(name, SEMANTIC_IDS["road"])
    uv = _tile_uv(graph)
    wear_uv = graph.node("ShaderNodeMapping", {"Vector": _metres(graph)}, name="wear_uv").outputs[0]
    fine = _image(graph, f"{name}_albedo.jpg", uv, is_color=True)
    wear = _image(graph, f"{name}_wear.jpg", wear_uv, is_color=False)
    color = graph.vector("MULTIPLY", graph.scale(fine, 2.0), wear)
    gloss = graph.value("gloss")
    roughness = graph.math("MULTIPLY_ADD", gloss, -1.5, _image(graph, f"{name}_roughness.jpg", uv, is_color=False))
    amount = graph.math("MULTIPLY_ADD", gloss, 1.2, 0.15)
    coated(graph, color, roughness, amount, normal=_bumpy_normal(graph, name, uv, 0.4))
    return material


def _shoulder() -> bpy.types.Material:
    """Gravel, matt."""
    material, graph = new_material("shoulder", SEMANTIC_IDS["shoulder"])
    uv = _tile_uv(graph)
    macro_uv = graph.scale(_metres(graph), 1 / 17.0)
    macro = graph.math("MULTIPLY", _image(graph, "terrain_macro.jpg", macro_uv, is_color=False), 2.0)
    color = graph.scale(_image(graph, "shoulder_albedo.jpg", uv, is_color=True), macro)
    normal = _bumpy_normal(graph, "shoulder", uv, 0.6)
    graph.surface(graph.node("ShaderNodeBsdfDiffuse", {"Color": color, "Normal": normal}))
    return material


def _terrain(name: str) -> bpy.types.Material:
    """Fine texture times two scales of a map of growth and dryness, so that no hill looks like a carpet."""
    material, graph = new_material(name, SEMANTIC_IDS["terrain"])
    uv, metres = _tile_uv(graph), _metres(graph)
    fine = _image(graph, f"{name}_albedo.jpg", uv, is_color=True)
    distance_m = graph.node("ShaderNodeCameraData").outputs["View Distance"]
    blur = graph.math("MINIMUM", graph.math("DIVIDE", distance_m, BLUR_DISTANCE_M), 0.9)
    color = graph.mix_color(fine, TERRAIN_MEANS[name], blur)
    for length_m in (41.0, 233.0):
        macro = _image(graph, "terrain_macro.jpg", graph.scale(metres, 1 / length_m), is_color=False)
        color = graph.vector("MULTIPLY", color, graph.scale(macro, 2.0))
    normal = _bumpy_normal(graph, name, uv, 0.8)
    graph.surface(graph.node("ShaderNodeBsdfDiffuse", {"Color": color, "Normal": normal}))
    return material


def _marking() -> bpy.types.Material:
    """Paint of the sampled grayscale and gloss, rubbed thin in places."""
    material, graph = new_material("marking", SEMANTIC_IDS["marking"])
    cover = _image(graph, "marking_cover.jpg", graph.scale(_metres(graph), 1 / 5.0), is_color=False)
    shade = graph.math("MULTIPLY", graph.math("MULTIPLY", graph.value("grayscale"), 0.85), cover)
    gloss = graph.value("gloss")
    roughness = graph.math("MULTIPLY_ADD", gloss, -0.4, 0.75)
    coated(graph, graph.node("ShaderNodeCombineColor", {0: shade, 1: shade, 2: shade}).outputs[0], roughness, gloss)
    return material
