"""Materials of ground, road and paint: made once per process, adjusted per scene through node values.

Every mesh carries a UV layer "UVMap" in metres: terrain (world x, world y), road and shoulder (right of the road's
middle, along it), paint (across, along). A material's `pass_index` is its semantic id.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from PIL import Image

from synth3dlanes.blender.shaders import ShaderGraph, coated, new_material, set_value, texture
from synth3dlanes.blender.structures import structure_materials
from synth3dlanes.blender.weathering import (
    CAP,
    SNOW,
    Look,
    cap_level,
    rub_level,
    rubbed,
    snow_cap,
    snowed,
    thrown_back,
    wet,
    wheel_tracks,
)
from synth3dlanes.scene.assets.catalogue import ROAD_MEANS
from synth3dlanes.scene.assets.folder import TextureFiles
from synth3dlanes.scene.scene import Surface
from synth3dlanes.scene.things import KINDS, SEMANTIC_IDS
from synth3dlanes.world.seams import ghost_shade, joint
from synth3dlanes.world.world import World

# A texture scale is the number of tiles in 100 m: road tiles of 3 to 10 m, terrain tiles of 7 to 20 m.
SCALE_LENGTH_M = 100.0
TILED = "tiled"  # label of the texture nodes with this scale
WEAR_LENGTH_M = 48.0  # the wear maps show two lanes by this length
SHOULDER_TILES = 30.0  # as a texture scale
ROAD_TILE_M, ROAD_ROUGHNESS = 5.0, 0.8  # of the road that shows through rubbed paint
# Cycles has no mipmaps: far ground fades to its textures' means (linear), because fine texture aliases at few samples.
BLUR_DISTANCE_M = 160.0
MACRO_TILES = 20.0  # the large-scale maps fade out over this many tiles, before their repetition is visible
# How well rough pavement and beads in paint throw headlights back (about 10 and 150 mcd/m2/lx at 30 m), and the most
# they gain over a matt surface; under water a fifth of it is left.
ROAD_BACK, PAINT_BACK, LEFT_WET = (0.12, 4.0), (0.4, 12.0), 0.2
TAR, TAR_ROUGHNESS, TAR_COAT = (0.012, 0.012, 0.012), 0.35, 0.3
# Colours of traffic paint as shares of its grayscale, linear.
WHITE, YELLOW = (1.0, 1.0, 1.0), (1.0, 0.56, 0.06)
DRY_GRASS = (0.24, 0.19, 0.10)
# Twice the variance of the slopes of a road's normal map, at the strength with which it is used.
BUMPS = 0.012
TERRAIN_MEANS = {"terrain_1": (0.103, 0.109, 0.052), "terrain_2": (0.249, 0.179, 0.11)}
# Woods on far terrain (linear): patches of hundreds of metres that fade in from this distance to twice it.
WOODS, WOODS_LENGTH_M, WOODS_FROM_M = (0.035, 0.045, 0.025), 2900.0, 220.0
# What snow lies on, beside the ground.
CAPPED = {kind.semantic_id for kind in KINDS if kind.is_capped}
CLEARED = {kind.semantic_id for kind in KINDS if kind.is_cleared}


@dataclass(frozen=True, eq=False)
class Materials:
    """Road, shoulder and terrain materials by texture number minus 1, the paints, and those of structures by name."""

    roads: tuple[bpy.types.Material, ...]
    shoulders: tuple[bpy.types.Material, ...]
    terrains: tuple[bpy.types.Material, ...]
    marking: bpy.types.Material
    yellow_marking: bpy.types.Material
    symbol: bpy.types.Material
    tar: bpy.types.Material
    ghost: bpy.types.Material
    removed: bpy.types.Material
    grass: bpy.types.Material
    structures: Mapping[str, bpy.types.Material]

    @property
    def paints(self) -> tuple[bpy.types.Material, ...]:
        """All materials of paint."""
        return self.marking, self.yellow_marking, self.symbol

    def ground(self, surface: Surface) -> tuple[bpy.types.Material, bpy.types.Material, bpy.types.Material]:
        """The materials of a scene's road, shoulder and terrain."""
        return (
            self.roads[surface.road_texture - 1],
            self.shoulders[surface.shoulder_texture - 1],
            self.terrains[surface.terrain_texture - 1],
        )


def make_materials(roads: Sequence[TextureFiles], terrains: Sequence[TextureFiles]) -> Materials:
    """Build all materials with their textures; call once per process."""
    return Materials(
        tuple(_road(f"road_{k + 1}", files) for k, files in enumerate(roads)),
        (_gravel_shoulder(), _paved_shoulder()),
        tuple(_terrain(f"terrain_{k + 1}", files) for k, files in enumerate(terrains)),
        _paint("marking", "marking", WHITE),
        _paint("yellow_marking", "marking", YELLOW),
        _paint("symbol", "symbol", WHITE),
        _tar(),
        _ghost("ghost"),
        _ghost("removed"),
        _grass(),
        structure_materials(),
    )


def set_materials(materials: Materials, world: World) -> None:
    """Set the values of one scene: texture scale and direction, gloss, lane width, paint, wetness."""
    scene, network = world.scene, world.network
    surface, weather, angle_rad = scene.surface, scene.weather, scene.surface.texture_orientation_rad
    lanes = network.across
    lane_width_m, parity, median_m = lanes.width_m, lanes.parity, lanes.median_m
    road, shoulder, terrain = materials.ground(surface)
    paved_shoulder = materials.shoulders[1]
    _orient(road, surface.road_texture_scale, angle_rad)
    _orient(shoulder, surface.road_texture_scale if shoulder is paved_shoulder else SHOULDER_TILES, angle_rad)
    _orient(terrain, surface.terrain_texture_scale, angle_rad)
    wear = road.node_tree.nodes["wear"].texture_mapping
    wear.scale = (0.5 / lane_width_m, 1 / WEAR_LENGTH_M, 1)
    wear.translation = (0.25 * parity, 0, 0)
    set_value(road, "median_at_m", lanes.median_at_m)
    set_value(road, "median_m", median_m)
    joint_m, darker = joint(network, surface.joint, scene.stream)
    set_value(road, "gloss", surface.road_gloss)
    set_value(road, "joint_m", joint_m)
    set_value(road, "darker", darker if surface.joint else 0.0)
    set_value(road, "lane_width_m", lane_width_m)
    set_value(road, "lane_shift", 0.5 * parity)
    for paint in materials.paints:
        set_value(paint, "grayscale", scene.markings.grayscale)
        set_value(paint, "gloss", scene.markings.gloss)
        set_value(paint, "rub_level", rub_level(scene.markings.wear))
        set_value(paint, "is_rubbed", float(scene.markings.wear > 0))
        set_value(paint, "road_gloss", surface.road_gloss)
    ghosts = materials.ghost, materials.removed
    for like_road in (paved_shoulder, *ghosts, *materials.paints):
        like_road.node_tree.nodes["albedo"].image = road.node_tree.nodes["albedo"].image
    works = scene.roads.works
    contrasts = surface.ghost_lines, works.removed if works is not None else 0.0
    for ghost, contrast in zip(ghosts, contrasts, strict=True):
        set_value(ghost, "shade", ghost_shade(contrast, scene.stream))
    for paved in (road, shoulder, *ghosts, *materials.paints):
        set_value(paved, "wetness", surface.wetness)
        set_value(paved, "retro", weather.headlights * (1 - (1 - LEFT_WET) * surface.wetness))
    for paved in (road, materials.tar, *ghosts, *materials.paints):
        _set_snow(paved, weather.snow_on_road)
    for bare in (shoulder, terrain):
        _set_snow(bare, weather.snow)
    mean = terrain.node_tree.nodes["mean"].outputs[0].default_value
    under_snow = [(1 - weather.snow) * earth + weather.snow * white for earth, white in zip(mean, SNOW, strict=False)]
    materials.grass.node_tree.nodes["mean"].outputs[0].default_value = (*under_snow, 1.0)


def _set_snow(material: bpy.types.Material, share: float) -> None:
    set_value(material, "snow", share)
    set_value(material, "snow_level", rub_level(share))
    set_value(material, "is_snowy", float(share > 0))


def set_translucency(trees: Sequence[bpy.types.Mesh], share: float) -> None:
    """Set how much light the leaves of the built-in trees let through."""
    for material in (material for mesh in trees for material in mesh.materials):
        if material is not None and material.node_tree is not None and "translucency" in material.node_tree.nodes:
            set_value(material, "translucency", share)


def set_snow_caps(share: float) -> None:
    """Put snow on trees, cars and structures, as much as on the ground, or take it away."""
    for material in bpy.data.materials:
        output = material.node_tree.get_output_node("CYCLES") if material.pass_index in CAPPED else None
        if output is None or not output.inputs["Surface"].links:
            continue
        tree, surface = material.node_tree, output.inputs["Surface"]
        top, is_cleared = surface.links[0].from_node, material.pass_index in CLEARED
        if share and top.name != CAP:
            cap = tree.nodes.get(CAP) or snow_cap(ShaderGraph(tree), surface.links[0].from_socket, is_cleared)
            tree.links.new(cap.outputs[0], surface)
        if share:
            set_value(material, "cap_level", cap_level(share, is_cleared))
        elif top.name == CAP:
            tree.links.new(top.inputs[1].links[0].from_socket, surface)


def _orient(material: bpy.types.Material, texture_scale: float, angle_rad: float) -> None:
    """Scale and rotate the tiles, and rotate the tilt from their normal map back to world axes."""
    tiles_per_m = texture_scale / SCALE_LENGTH_M
    for node in material.node_tree.nodes:
        if node.label == TILED:
            node.texture_mapping.scale = (tiles_per_m, tiles_per_m, 1)
            node.texture_mapping.rotation = (0, 0, angle_rad)
    material.node_tree.nodes["tilt"].inputs["Angle"].default_value = -angle_rad


def _metres(graph: ShaderGraph) -> Any:
    return graph.node("ShaderNodeUVMap", uv_map="UVMap").outputs[0]


def _tiled(graph: ShaderGraph, file: Path | str, metres: Any, is_color: bool) -> Any:
    """A texture that `_orient` scales and rotates. Its own mapping is a matrix; a Mapping node would make one of sines
    and cosines at every hit."""
    texel = texture(graph, file, metres, is_color)
    texel.node.label = TILED
    return texel


def _blur(graph: ShaderGraph) -> Any:
    """How far fine texture has faded to its mean."""
    distance_m = graph.node("ShaderNodeCameraData").outputs["View Distance"]
    return graph.math("MINIMUM", graph.math("DIVIDE", distance_m, BLUR_DISTANCE_M), 0.9)


def _rougher(graph: ShaderGraph, roughness: Any, blur: Any) -> Any:
    """The roughness with the bumps that have faded: they widen reflections as they did before (LEAN mapping)."""
    fourth = graph.math("POWER", graph.math("MAXIMUM", roughness, 0.0), 4.0)
    return graph.math("POWER", graph.math("MULTIPLY_ADD", blur, BUMPS, fourth), 0.25)


def _bumpy_normal(graph: ShaderGraph, file: Path | str, metres: Any, strength: float, blur: Any) -> Any:
    """The surface normal tilted by a normal map, not of unit length.

    The tilt is added in world x and y: the ground is nearly level, and this needs no tangents on the meshes.
    """
    texel = graph.vector(
        "MULTIPLY_ADD", _tiled(graph, file, metres, is_color=False), (2.0, 2.0, 0.0), (-1.0, -1.0, 0.0)
    )
    tilt = graph.node("ShaderNodeVectorRotate", {"Vector": texel}, rotation_type="Z_AXIS", name="tilt").outputs[0]
    tilt = graph.scale(tilt, graph.math("MULTIPLY_ADD", blur, -strength, strength))
    return graph.vector("ADD", graph.node("ShaderNodeNewGeometry").outputs["Normal"], tilt)


def _road(name: str, files: TextureFiles) -> bpy.types.Material:
    """Fine texture times a lane-aligned wear map (for a user's texture, that of fresh asphalt), right of a joint
    darker, under a coat whose smoothness is `gloss`."""
    material, graph = new_material(name, SEMANTIC_IDS["road"])
    metres = _metres(graph)
    blur = _blur(graph)
    is_own = files.albedo.is_absolute()
    mean, mean_roughness = (mean_color(files.albedo), mean_gray(files.roughness)) if is_own else ROAD_MEANS[name]
    fine = graph.mix_color(_albedo(_tiled(graph, files.albedo, metres, is_color=True)), mean, blur)
    wear_file = "road_1_wear.jpg" if is_own else f"{name}_wear.jpg"
    right_m = graph.node("ShaderNodeSeparateXYZ", {0: metres}).outputs[0]
    # Wear and tracks lie as if there were no median: so they are in the lanes beyond it too.
    is_oncoming = graph.math("LESS_THAN", right_m, graph.value("median_at_m"))
    closing_m = graph.math("MULTIPLY", is_oncoming, graph.value("median_m"))
    closed = graph.vector("ADD", metres, graph.node("ShaderNodeCombineXYZ", {0: closing_m}).outputs[0])
    wear = texture(graph, wear_file, closed, is_color=False)
    wear.node.name = "wear"
    is_right = graph.math("GREATER_THAN", right_m, graph.value("joint_m"))
    shade = graph.math("SUBTRACT", 1.0, graph.math("MULTIPLY", graph.value("darker"), is_right))
    color = graph.scale(graph.vector("MULTIPLY", graph.scale(fine, 2.0), wear), shade)
    gloss = graph.value("gloss")
    roughness = graph.mix(_tiled(graph, files.roughness, metres, is_color=False), mean_roughness, blur)
    roughness = _rougher(graph, graph.math("MULTIPLY_ADD", gloss, -1.5, roughness), blur)
    amount = graph.math("MULTIPLY_ADD", gloss, 1.2, 0.15)
    tracks = wheel_tracks(graph, graph.node("ShaderNodeSeparateXYZ", {0: closed}).outputs[0])
    look = wet(graph, Look(color, roughness, amount, _bumpy_normal(graph, files.normal, metres, 0.4, blur)), tracks)
    look = thrown_back(graph, snowed(graph, look, tracks), *ROAD_BACK)
    coated(graph, look.color, look.roughness, look.amount, normal=look.normal)
    return material


def _albedo(color: Any) -> Any:
    """A road's fine texture, on the node `albedo`."""
    color.node.name = "albedo"
    return color


def _gravel_shoulder() -> bpy.types.Material:
    """Gravel, matte when dry."""
    material, graph = new_material("shoulder", SEMANTIC_IDS["shoulder"])
    metres = _metres(graph)
    macro_uv = graph.scale(metres, 1 / 17.0)
    macro = graph.math("MULTIPLY", texture(graph, "terrain_macro.jpg", macro_uv, is_color=False), 2.0)
    color = graph.scale(_tiled(graph, "shoulder_albedo.jpg", metres, is_color=True), macro)
    normal = _bumpy_normal(graph, "shoulder_normal.jpg", metres, 0.6, _blur(graph))
    look = thrown_back(graph, snowed(graph, wet(graph, Look(color, 0.8, 0.0, normal))), *ROAD_BACK)
    coated(graph, look.color, look.roughness, look.amount, normal=look.normal)
    return material


def _paved_shoulder() -> bpy.types.Material:
    """The road's own pavement without wear: no wheel paths, patches of dust."""
    material, graph = new_material("paved_shoulder", SEMANTIC_IDS["shoulder"])
    metres = _metres(graph)
    dust = texture(graph, "terrain_macro.jpg", graph.scale(metres, 1 / 23.0), is_color=False)
    fine = _albedo(_tiled(graph, "road_1_albedo.jpg", metres, is_color=True))
    color = graph.vector("MULTIPLY", graph.scale(fine, 2.0), dust)
    normal = _bumpy_normal(graph, "road_1_normal.jpg", metres, 0.4, _blur(graph))
    look = wet(graph, Look(color, ROAD_ROUGHNESS, 0.15, normal))
    look = thrown_back(graph, snowed(graph, look), *ROAD_BACK)
    coated(graph, look.color, look.roughness, look.amount, normal=look.normal)
    return material


def _terrain(name: str, files: TextureFiles) -> bpy.types.Material:
    """Fine texture times a map of growth and dryness at two scales, so that hills do not look uniform."""
    material, graph = new_material(name, SEMANTIC_IDS["terrain"])
    metres = _metres(graph)
    fine = _tiled(graph, files.albedo, metres, is_color=True)
    distance_m, blur = graph.node("ShaderNodeCameraData").outputs["View Distance"], _blur(graph)
    mean = graph.node("ShaderNodeRGB", name="mean").outputs[0]
    known = mean_color(files.albedo) if files.albedo.is_absolute() else TERRAIN_MEANS[name]
    mean.default_value = (*known, 1.0)
    color = graph.mix_color(fine, mean, blur)
    for length_m in (41.0, 233.0):
        macro = texture(graph, "terrain_macro.jpg", graph.scale(metres, 1 / length_m), is_color=False)
        fade = graph.clamp(graph.math("DIVIDE", distance_m, MACRO_TILES * length_m))
        color = graph.vector("MULTIPLY", color, graph.mix_color(graph.scale(macro, 2.0), (1.0, 1.0, 1.0), fade))
    color = graph.mix_color(color, WOODS, _far_woods(graph, metres, distance_m))
    normal = _bumpy_normal(graph, files.normal, metres, 0.8, blur)
    look = snowed(graph, Look(color, 1.0, 0.0, normal), blur=blur)
    graph.surface(graph.node("ShaderNodeBsdfDiffuse", {"Color": look.color, "Normal": look.normal}))
    return material


def _grass() -> bpy.types.Material:
    """Blades in the terrain's mean colour, some of them dry, lit from both sides."""
    material, graph = new_material("grass", SEMANTIC_IDS["terrain"])
    shade, dryness = (
        graph.node("ShaderNodeAttribute", attribute_name=name).outputs["Fac"] for name in ("shade", "dryness")
    )
    mean = graph.node("ShaderNodeRGB", name="mean").outputs[0]
    color = graph.scale(graph.mix_color(mean, DRY_GRASS, dryness), shade)
    facing = graph.node("ShaderNodeNewGeometry").outputs["Normal"]
    normal = graph.vector("NORMALIZE", graph.vector("ADD", facing, (0.0, 0.0, 0.9)))
    front = graph.node("ShaderNodeBsdfDiffuse", {"Color": color, "Normal": normal})
    back = graph.node("ShaderNodeBsdfTranslucent", {"Color": color})
    graph.surface(graph.node("ShaderNodeAddShader", {0: front.outputs[0], 1: back.outputs[0]}))
    return material


def _far_woods(graph: ShaderGraph, metres: Any, distance_m: Any) -> Any:
    """Share 0..1 of dark woods or scrub on far terrain; a plain would look uniform to the horizon without it."""
    patches = texture(graph, "terrain_macro.jpg", graph.scale(metres, 1 / WOODS_LENGTH_M), is_color=False)
    begun = graph.clamp(graph.math("MULTIPLY_ADD", distance_m, 1 / WOODS_FROM_M, -1.0))
    return graph.math("MULTIPLY", begun, graph.clamp(graph.math("MULTIPLY_ADD", patches, -9.0, 4.7)))


def mean_gray(file: Path) -> float:
    """The mean of a map of numbers, 0..1."""
    with Image.open(file) as picture:
        return float(np.asarray(picture.convert("L"), np.float32).mean() / 255)


def mean_color(file: Path) -> tuple[float, float, float]:
    """The mean linear reflectance of an albedo map."""
    with Image.open(file) as picture:
        srgb = np.asarray(picture.convert("RGB"), np.float32) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    red, green, blue = linear.mean(axis=(0, 1)).tolist()
    return red, green, blue


def _paint(name: str, kind: str, tint: tuple[float, float, float]) -> bpy.types.Material:
    """Paint with the scene's grayscale and gloss, thin in places, and bare road where it is rubbed off."""
    material, graph = new_material(name, SEMANTIC_IDS[kind])
    cover = texture(graph, "marking_cover.jpg", graph.scale(_metres(graph), 1 / 5.0), is_color=False)
    shade = graph.math("MULTIPLY", graph.math("MULTIPLY", graph.value("grayscale"), 0.85), cover)
    painted = graph.node("ShaderNodeCombineColor", {k: graph.math("MULTIPLY", shade, tint[k]) for k in range(3)})
    bare, gloss = rubbed(graph), graph.value("gloss")
    position = graph.node("ShaderNodeNewGeometry").outputs["Position"]
    road = _albedo(texture(graph, "road_1_albedo.jpg", graph.scale(position, 1 / ROAD_TILE_M), is_color=True))
    color = graph.mix_color(painted.outputs[0], road, bare)
    roughness = graph.mix(graph.math("MULTIPLY_ADD", gloss, -0.4, 0.75), ROAD_ROUGHNESS, bare)
    amount = graph.mix(gloss, graph.math("MULTIPLY_ADD", graph.value("road_gloss"), 1.2, 0.15), bare)
    normal = graph.node("ShaderNodeNewGeometry").outputs["Normal"]
    look = thrown_back(graph, snowed(graph, wet(graph, Look(color, roughness, amount, normal))), *PAINT_BACK)
    coated(graph, look.color, look.roughness, look.amount, normal=look.normal)
    return material


def _tar() -> bpy.types.Material:
    """Bitumen: black and shiny, wet or dry."""
    material, graph = new_material("tar", SEMANTIC_IDS["road"])
    normal = graph.node("ShaderNodeNewGeometry").outputs["Normal"]
    look = snowed(graph, Look(TAR, TAR_ROUGHNESS, TAR_COAT, normal))
    coated(graph, look.color, look.roughness, look.amount, normal=look.normal)
    return material


def _ghost(name: str) -> bpy.types.Material:
    """The gray of the road's pavement, lighter or darker by `shade`."""
    material, graph = new_material(name, SEMANTIC_IDS["road"])
    position = graph.node("ShaderNodeNewGeometry").outputs["Position"]
    road = _albedo(texture(graph, "road_1_albedo.jpg", graph.scale(position, 1 / ROAD_TILE_M), is_color=True))
    gray = graph.node("ShaderNodeRGBToBW", {0: road}).outputs[0]
    color = graph.scale((1.0, 1.0, 1.0), graph.math("MULTIPLY", gray, graph.value("shade")))
    normal = graph.node("ShaderNodeNewGeometry").outputs["Normal"]
    look = thrown_back(graph, snowed(graph, wet(graph, Look(color, ROAD_ROUGHNESS, 0.15, normal))), *ROAD_BACK)
    coated(graph, look.color, look.roughness, look.amount, normal=look.normal)
    return material
