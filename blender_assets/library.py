"""assets.blend: one mesh a car and a tree, with their materials.

A material's `pass_index` is its semantic id. Body paint reads `obj.color = (r, g, b, gloss)`.
"""

from pathlib import Path

import bpy
import numpy as np
from car_body import LIVERY
from cars import build_all
from jaxtyping import Float, Int
from things import MATERIALS, build_things
from trees import Tree, fit, grow_all

from synth3dlanes.blender.shaders import car_paint, coated, new_material, thing_paint
from synth3dlanes.scene.things import SEMANTIC_IDS, ThingKind

CAR_ID, TREE_ID = SEMANTIC_IDS["car"], SEMANTIC_IDS["tree"]
FOLIAGE = {  # linear reflectance at either end of the random range
    "broadleaf": ((0.075, 0.115, 0.028), (0.135, 0.150, 0.042)),
    "conifer": ((0.040, 0.072, 0.036), (0.068, 0.095, 0.045)),
    "poplar": ((0.080, 0.125, 0.034), (0.150, 0.165, 0.050)),
    "bush": ((0.075, 0.105, 0.034), (0.150, 0.140, 0.052)),
    "dead": ((0.1, 0.1, 0.1), (0.1, 0.1, 0.1)),
    "young": ((0.090, 0.140, 0.034), (0.170, 0.180, 0.055)),
}
# Share and linear reflectance of the colours of liveries.
LIVERIES = (
    (0.42, (0.62, 0.62, 0.60)),
    (0.14, (0.30, 0.31, 0.32)),
    (0.12, (0.020, 0.060, 0.230)),
    (0.10, (0.36, 0.016, 0.016)),
    (0.08, (0.50, 0.33, 0.02)),
    (0.08, (0.018, 0.130, 0.050)),
    (0.06, (0.42, 0.10, 0.012)),
)
# Light through a leaf as shares of what it reflects: yellower, and about as much.
TRANSMITTED = (1.15, 1.3, 0.5)
PASSED = (0.9, 1.0, 0.5)
BARKS = {"conifer": (0.085, 0.055, 0.038), "dead": (0.16, 0.145, 0.125), "poplar": (0.15, 0.14, 0.115)}


def paint() -> bpy.types.Material:
    """Body paint, whose colour and gloss are the object's."""
    material, graph = new_material("car_paint", CAR_ID)
    car_paint(graph)
    return material


def plain(
    name: str, color: tuple[float, float, float], roughness: float, ior: float, amount: float
) -> bpy.types.Material:
    """A coated material of one colour."""
    material, graph = new_material(name, CAR_ID)
    coated(graph, color, roughness, amount, ior)
    return material


def car_materials() -> list[bpy.types.Material]:
    """The slots of every car, in the order of `car_body`."""
    return [
        paint(),
        plain("car_glass", (0.012, 0.014, 0.015), 0.02, 1.55, 1.0),
        plain("car_tyre", (0.022, 0.022, 0.023), 0.6, 1.3, 0.5),
        plain("car_rim", (0.30, 0.30, 0.31), 0.25, 2.6, 1.0),
        plain("car_trim", (0.024, 0.024, 0.025), 0.45, 1.4, 0.6),
        plain("car_head", (0.55, 0.56, 0.58), 0.06, 1.7, 1.0),
        plain("car_tail", (0.36, 0.008, 0.010), 0.08, 1.5, 1.0),
        plain("car_plate", (0.68, 0.68, 0.62), 0.4, 1.4, 0.5),
    ]


def livery() -> bpy.types.Material:
    """A second colour for a truck's box or a bus's band, by the object's random number: mostly white."""
    material, graph = new_material("car_livery", CAR_ID)
    ramp = graph.node("ShaderNodeValToRGB", {"Fac": graph.node("ShaderNodeObjectInfo").outputs["Random"]})
    ramp.color_ramp.interpolation = "CONSTANT"
    for number, (_, color) in enumerate(LIVERIES):
        start = sum(share for share, _ in LIVERIES[:number])
        element = ramp.color_ramp.elements[0] if number == 0 else ramp.color_ramp.elements.new(start)
        element.color = (*color, 1.0)
    ramp.color_ramp.elements.remove(ramp.color_ramp.elements[-1])
    coated(graph, ramp.outputs["Color"], 0.3, 0.6)
    return material


def bark(name: str) -> bpy.types.Material:
    """Matt wood."""
    material, graph = new_material(f"{name}_bark", TREE_ID)
    graph.surface(graph.node("ShaderNodeBsdfDiffuse", {"Color": (*BARKS.get(name, (0.11, 0.085, 0.062)), 1)}))
    return material


def leaf(name: str) -> bpy.types.Material:
    """Leaves: a colour by the tree's own random number, times the leaf's shade. `translucency` lets light through."""
    material, graph = new_material(f"{name}_leaf", TREE_ID)
    info = graph.node("ShaderNodeObjectInfo")
    shade = graph.node("ShaderNodeAttribute", {}, attribute_name="shade")
    hue = graph.mix_color(*FOLIAGE[name], info.outputs["Random"])
    color = graph.node("ShaderNodeVectorMath", {0: hue, 1: shade.outputs["Vector"]}, operation="MULTIPLY")
    geometry = graph.node("ShaderNodeNewGeometry")  # keep the normal out of the crown on a leaf's back, too
    side = graph.math("MULTIPLY_ADD", geometry.outputs["Backfacing"], -2.0, 1.0)
    normal = graph.scale(geometry.outputs["Normal"], side)
    opaque = graph.node("ShaderNodeBsdfDiffuse", {"Color": color.outputs[0], "Normal": normal}).outputs[0]
    through = graph.vector("MULTIPLY", color.outputs[0], TRANSMITTED)
    back = graph.node("ShaderNodeBsdfTranslucent", {"Color": through, "Normal": normal}).outputs[0]
    lit = graph.node("ShaderNodeAddShader", {0: opaque, 1: back}).outputs[0]
    share = graph.value("translucency")
    leaf = graph.node("ShaderNodeMixShader", {0: share, 1: opaque, 2: lit}).outputs[0]
    # Light goes on through leaves to others. Without translucency, Cycles drops all but the opaque leaf.
    is_shadow = graph.node("ShaderNodeLightPath").outputs["Is Shadow Ray"]
    passed = graph.node("ShaderNodeBsdfTransparent", {"Color": PASSED}).outputs[0]
    unshaded = graph.math("MULTIPLY", is_shadow, graph.math("MULTIPLY", share, 0.5))
    graph.surface(graph.node("ShaderNodeMixShader", {0: unshaded, 1: leaf, 2: passed}))
    return material


def cloth(name: str, paint: int, semantic_id: int) -> bpy.types.Material:
    """Matt cloth, skin or hair, whose colour (a display value) is a property of the object."""
    material, graph = new_material(name, semantic_id)
    thing_paint(graph, paint)
    return material


def thing_slots(kind: ThingKind) -> list[bpy.types.Material]:
    """The slots of people, riders and road works of a kind, in the order of `things`."""
    slots = []
    for name, look in MATERIALS:
        if isinstance(look, int):
            slots.append(cloth(f"{kind}_{name}", look, SEMANTIC_IDS[kind]))
        else:
            material, graph = new_material(f"{kind}_{name}", SEMANTIC_IDS[kind])
            coated(graph, *look)
            slots.append(material)
    return slots


def to_mesh(
    name: str,
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 4"],
    materials: Int[np.ndarray, " f"],
    slots: list[bpy.types.Material],
) -> bpy.types.Mesh:
    """A Blender mesh kept with a fake user; a face's last corner is -1 where it is a triangle."""
    mesh = bpy.data.meshes.new(name)
    counts = np.where(faces[:, 3] < 0, 3, 4)
    corners = faces[faces >= 0]
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    mesh.loops.add(len(corners))
    mesh.loops.foreach_set("vertex_index", corners.astype(np.int32))
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int32))
    mesh.polygons.foreach_set("material_index", materials.astype(np.int32))
    for slot in slots:
        mesh.materials.append(slot)
    mesh.update(calc_edges=True)
    mesh.use_fake_user = True
    return mesh


def cars() -> set[bpy.types.ID]:
    """The cars, smooth but for edges sharper than 40 degrees."""
    slots, livered = car_materials(), livery()
    meshes = set()
    for model, shape in build_all():
        vertices, faces, materials = shape.arrays()
        mesh = to_mesh(model.name, vertices, faces, materials, slots + [livered] * int(LIVERY in materials))
        mesh.set_sharp_from_angle(angle=np.deg2rad(40))
        meshes.add(mesh)
    return meshes


def tree_mesh(name: str, tree: Tree, vertices: Float[np.ndarray, "v 3"]) -> bpy.types.Mesh:
    """One tree with its shades and shading normals."""
    _, faces, materials = tree.shape.arrays()
    mesh = to_mesh(name, vertices, faces, materials, [bark(name), leaf(name)])
    shade = mesh.attributes.new("shade", "FLOAT", "POINT")
    shade.data.foreach_set("value", np.concatenate(tree.shades).astype(np.float32))
    own = np.zeros(3 * len(vertices), np.float32)
    mesh.vertices.foreach_get("normal", own)
    normals = np.concatenate(tree.normals)
    given = np.any(normals, axis=1, keepdims=True)
    mesh.normals_split_custom_set_from_vertices(np.where(given, normals, own.reshape(-1, 3)).tolist())
    return mesh


def things() -> set[bpy.types.ID]:
    """People, riders and road works in all of their poses, smooth but for edges sharper than 60 degrees."""
    meshes = set()
    for kind, shapes in build_things().items():
        slots = thing_slots(kind)
        for name, shape in shapes:
            vertices, faces, materials = shape.arrays()
            used, own = np.unique(materials, return_inverse=True)
            # Fewer digits make a smaller file.
            mesh = to_mesh(name, np.round(vertices * 2048) / 2048, faces, own, [slots[number] for number in used])
            mesh.set_sharp_from_angle(angle=np.deg2rad(60))
            meshes.add(mesh)
    return meshes


def make_library(path: Path) -> None:
    """Write all meshes with their materials."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    meshes = cars() | things()
    for model, tree in grow_all():
        meshes.add(tree_mesh(model.name, tree, fit(tree, model)))
    bpy.data.libraries.write(str(path), meshes, fake_user=True, compress=True)
