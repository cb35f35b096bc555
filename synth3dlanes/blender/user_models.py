"""Import a user's .blend and .glb files, each as one mesh with its materials, like the built-in models.

Model frame: metres, x right, y forward, z up. A car is moved so that its middle is at x = y = 0 and its lowest point at
z = 0; trees and things are not moved.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import bpy
import numpy as np
from jaxtyping import Float
from mathutils import Matrix

from synth3dlanes.blender.shaders import ShaderGraph, car_paint, new_material, thing_paint
from synth3dlanes.scene.assets.catalogue import HOLDS, RIDER, THINGS
from synth3dlanes.scene.things import SEMANTIC_IDS, ThingKind

ModelKind = Literal["car", "tree", ThingKind]
PAINTED = ("paint", "body")
WHEEL = "wheel"


@dataclass(frozen=True, eq=False)
class ImportedMesh:
    """One mesh, the translation that was applied to it, the vertices of parts named wheel*, and the names of the paints
    of a thing."""

    mesh: bpy.types.Mesh
    moved: Float[np.ndarray, "3"]
    wheels: Float[np.ndarray, "n 3"]
    paints: tuple[str, ...]


def import_model(path: Path, kind: ModelKind, name: str) -> ImportedMesh | None:
    """All surfaces of a file as one mesh; None if it has none.

    Raises Blender's RuntimeError or OSError if the file cannot be read.
    """
    before = {group: set(getattr(bpy.data, group)) for group in ("objects", "meshes", "collections")}
    _append(path)
    parts = list(_parts())
    whole = _joined([mesh for mesh, _ in parts]) if parts else None
    for group, blocks in before.items():
        bpy.data.batch_remove([block for block in getattr(bpy.data, group) if block not in blocks and block != whole])
    if whole is None or not len(whole.polygons):
        return None
    whole.name, whole.use_fake_user = name, True
    paints = _set_materials(whole, kind)
    moved = np.zeros(3)
    if kind == "car":
        points = points_of(whole)
        low, high = points.min(axis=0), points.max(axis=0)
        moved = -np.array([*(low + high)[:2] / 2, low[2]])
        whole.transform(Matrix.Translation(moved.tolist()))
    wheels = np.concatenate([np.zeros((0, 3)), *(points for _, points in parts)]) + moved
    return ImportedMesh(whole, moved, wheels, paints)


def points_of(mesh: bpy.types.Mesh) -> Float[np.ndarray, "v 3"]:
    """The vertices of a mesh."""
    points = np.zeros(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", points)
    return points.reshape(-1, 3).astype(float)


def _append(path: Path) -> None:
    """Add a file's objects to the scene."""
    if path.suffix.lower() == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(path), loglevel=50)
        return
    with bpy.data.libraries.load(str(path)) as (library, wanted):
        wanted.objects = library.objects
    for item in wanted.objects:
        bpy.context.scene.collection.objects.link(item)


def _parts() -> Iterator[tuple[bpy.types.Mesh, Float[np.ndarray, "n 3"]]]:
    """Every visible surface of the scene, with modifiers applied, in the file's frame, and the vertices of its
    wheels."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    shown = [
        (instance.object.original, instance.matrix_world.copy())
        for instance in depsgraph.object_instances
        if instance.object.type == "MESH" and not instance.object.original.hide_render
    ]
    for item, world_from_object in shown:
        mesh = bpy.data.meshes.new_from_object(
            item.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph
        )
        mesh.transform(world_from_object)
        if world_from_object.is_negative:
            mesh.flip_normals()
        for number, layer in enumerate(mesh.uv_layers):
            layer.name = f"UV{number}"
        yield mesh, points_of(mesh)[_wheel_vertices(item, mesh)]


def _wheel_vertices(item: bpy.types.Object, mesh: bpy.types.Mesh) -> list[int]:
    """All vertices of an object if it or one of its parents is named wheel*; else those in vertex groups named
    wheel*."""
    above = item
    while above is not None:
        if above.name.lower().startswith(WHEEL):
            return list(range(len(mesh.vertices)))
        above = above.parent
    groups = {group.index for group in item.vertex_groups if group.name.lower().startswith(WHEEL)}
    return [v.index for v in mesh.vertices if any(entry.group in groups for entry in v.groups)] if groups else []


def _joined(meshes: list[bpy.types.Mesh]) -> bpy.types.Mesh:
    """Join all meshes into one; Blender keeps materials, normals and texture coordinates."""
    items = [bpy.data.objects.new("part", mesh) for mesh in meshes]
    for item in items:
        bpy.context.scene.collection.objects.link(item)
    if len(items) > 1:
        with bpy.context.temp_override(active_object=items[0], object=items[0], selected_editable_objects=items):
            bpy.ops.object.join()
    return items[0].data


def _set_materials(mesh: bpy.types.Mesh, kind: ModelKind) -> tuple[str, ...]:
    """Set the semantic id of every material, use the scene's colour for body paint and for what a thing's paints are
    named, and gray for parts without material; the names of these paints, in our order."""
    if not mesh.materials or None in list(mesh.materials):
        gray, graph = new_material("bare", SEMANTIC_IDS[kind])
        graph.surface(graph.node("ShaderNodeBsdfDiffuse", {"Color": (0.3, 0.3, 0.3)}))
        if not mesh.materials:
            mesh.materials.append(gray)
        for slot, material in enumerate(mesh.materials):
            mesh.materials[slot] = material or gray
    named = [material.name.lower().split(".")[0] for material in mesh.materials]
    # Nobody draws colours for road works.
    is_drawn = kind != "car" and kind != "tree" and any(model.paints for model in THINGS[kind])
    paints = tuple(name for name in dict.fromkeys((*HOLDS, *RIDER)) if is_drawn and name in named)
    for name, material in zip(named, mesh.materials, strict=True):
        material.pass_index = SEMANTIC_IDS[kind]
        material.use_nodes = True
        if kind == "car" and material.name.lower().startswith(PAINTED):
            material.node_tree.nodes.clear()
            car_paint(ShaderGraph(material.node_tree))
        elif name in paints:
            material.node_tree.nodes.clear()
            thing_paint(ShaderGraph(material.node_tree), paints.index(name))
    return paints
