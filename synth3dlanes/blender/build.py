"""World and View -> Blender data: the world's surfaces, and instances of the assets. World frame."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import bpy
import mathutils
import numpy as np

from synth3dlanes.blender import drop_scratch
from synth3dlanes.blender.camera import set_camera
from synth3dlanes.blender.lens import make_lens, set_lens
from synth3dlanes.blender.light import STUDIO, add_haze, add_lights, make_world, set_light
from synth3dlanes.blender.load_assets import LoadedAssets, load_assets
from synth3dlanes.blender.materials import Materials, make_materials, set_materials, set_snow_caps, set_translucency
from synth3dlanes.blender.polygons import polygons
from synth3dlanes.blender.shaders import car_paint, new_material
from synth3dlanes.blender.structures import structure_mesh
from synth3dlanes.imaging.daylight import Daylight
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Library
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.schema import Color
from synth3dlanes.world import bonnet
from synth3dlanes.world.grass import Blades
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.meshes import Mesh
from synth3dlanes.world.paint import paint_color
from synth3dlanes.world.placement import PlacedObject
from synth3dlanes.world.solids import Body
from synth3dlanes.world.world import View, World

# The collections of a world's objects, in the order in which Cycles gets them, and those that depend on the view.
COLLECTIONS = ("ground", "paint", "structures", "objects", "trees", "host", "grass", "lens", "lights")
OF_VIEW = ("paint", "objects", "host", "grass", "lens", "lights")
# Shade of a blade of grass at both corners of its foot and at its tip.
FOOT_TO_TIP = np.array([0.5, 0.5, 1.0])
# Arrays of a mesh, its materials and its instance id.
BuiltMesh = tuple[Mesh | Body | Blades, Sequence[bpy.types.Material], int]


@dataclass(eq=False)
class Studio:
    """Data shared by all scenes of a process. `plain` is the cheapest material, for renders of geometry alone, `lens`
    the one through which a lens bends the camera's rays; `kept` names the meshes that must outlive a scene. The world
    that is built stands on `ground`."""

    assets: LoadedAssets
    materials: Materials
    bonnet: bpy.types.Mesh
    plain: bpy.types.Material
    lens: bpy.types.Material
    camera: bpy.types.Object
    kept: frozenset[str]
    ground: Ground | None = None


@dataclass(frozen=True, eq=False)
class MeshInstance:
    """An object with a box, a tree or the host's bonnet in the scene: its mesh, pose, scale and instance id; the colour
    and gloss of its body, and those of the paints of its parts."""

    mesh: bpy.types.Mesh
    world_from_object: Matrix4
    scale: float
    instance_id: int
    body: tuple[float, ...] | None = None
    paints: tuple[Color, ...] = ()


def open_studio(library: Library = BUILT_IN) -> Studio:
    """Reset Blender and load the assets, once per process."""
    # The module bpy begins with factory settings; read_factory_settings would load all add-ons again.
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    drop_scratch()
    bpy.context.preferences.edit.use_global_undo = False
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    for name in (STUDIO, *COLLECTIONS):
        bpy.context.scene.collection.children.link(bpy.data.collections.new(name))
        # Nobody looks at a viewport; Blender would bring it up to date before and after every render.
        bpy.data.collections[name].hide_viewport = True
    bpy.data.collections[STUDIO].objects.link(camera)
    bpy.context.scene.camera = camera
    make_world()
    assets = load_assets(library)
    materials = make_materials(assets.roads, assets.terrains)
    hood = new_mesh(bonnet.bonnet(), [_host_paint()])
    hood.name = bonnet.KIND.series
    add_haze()
    add_lights()
    kept = frozenset(mesh.name for mesh in bpy.data.meshes)
    return Studio(assets, materials, hood, _plain(), make_lens(), camera, kept)


def _host_paint() -> bpy.types.Material:
    material, graph = new_material(bonnet.KIND.name, bonnet.KIND.semantic_id)
    car_paint(graph)
    return material


def _plain() -> bpy.types.Material:
    """A material without a shader, for renders that need no light."""
    material = bpy.data.materials.new("plain")
    material.use_nodes = True
    material.node_tree.nodes.clear()
    material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    return material


@dataclass(frozen=True, eq=False)
class Prepared:
    """What a world and a view add to Blender, by collection. `is_built` says that the world is there, so that only what
    depends on the view is added."""

    surfaces: dict[str, list[BuiltMesh]]
    instances: dict[str, list[MeshInstance]]
    is_built: bool


def prepare(studio: Studio, world: World, view: View, labelled: Sequence[str] = ()) -> Prepared:
    """Compute what `build` adds, without Blender.

    Instance ids number the delimiters in `labelled` first, in that order, then those beyond the labels' range.
    """
    materials, is_built = studio.materials, studio.ground is world.ground
    road, shoulder, terrain = materials.ground(world.scene.surface)
    surfaces: dict[str, list[BuiltMesh]] = {}
    if not is_built:
        made = world.site.surfaces
        surfaces["ground"] = [(made.terrain, [terrain], 0)]
        surfaces["ground"] += [(mesh, [road, shoulder, terrain], 0) for mesh in made.pavement]
        surfaces["structures"] = _bodies(materials, world.site.bodies)
    surfaces["paint"] = [*_paint(materials, world, view, labelled)]
    grass = world.grass(view)
    surfaces["grass"] = [] if grass is None else [(grass, [materials.grass], 0)]
    surfaces["lights"] = _bodies(materials, world.site.lights(world.scene.shot.time_s))
    assets = studio.assets
    instances = {"objects": _objects(assets, view), "trees": _trees(assets, world), "host": _host(studio, view)}
    return Prepared(surfaces, instances, is_built)


def build(
    studio: Studio, world: World, view: View, light: Daylight, prepared: Prepared | None = None
) -> list[MeshInstance]:
    """Replace the previous world by this one; return its objects with boxes, in the view's order, its trees and the
    host's bonnet.

    Of the world that was built last, as another shot sees it (`World.seen_in`), only what depends on the view is built
    anew.
    """
    scene, materials = world.scene, studio.materials
    prepared = prepared or prepare(studio, world, view)
    # No world until the build succeeds: another view cannot be added to one that failed.
    studio.ground = None
    missing = OF_VIEW if prepared.is_built else COLLECTIONS
    _clear(missing, studio.kept)
    if not prepared.is_built:
        set_materials(materials, world)
        set_translucency(studio.assets.trees, scene.vegetation.translucency)
        set_snow_caps(scene.weather.snow)
    # In this order Blender itself gives most of them their names.
    for name in (name for name in COLLECTIONS if name in missing):
        for surface, its_materials, id_ in prepared.surfaces.get(name, []):
            _add_object(name, _blender_mesh(surface, its_materials), id_)
        _add_placed(name, prepared.instances.get(name, []))
    if not view.camera.lens.is_pinhole:
        set_lens(studio.lens, view, bpy.data.collections["lens"])
    studio.ground = world.ground
    set_camera(studio.camera, view.camera, view.world_from_cam)
    _name_in_order()
    set_light(scene, light, studio.assets.skies, view.world_from_host, world.site.street_lamps)
    return [*(item for items in prepared.instances.values() for item in items)]


def _clear(collections: Sequence[str], kept: frozenset[str]) -> None:
    """Remove the objects of some collections, and all unused meshes but `kept`; memory would grow otherwise."""
    bpy.data.batch_remove([item for name in collections for item in bpy.data.collections[name].objects])
    bpy.data.batch_remove([mesh for mesh in bpy.data.meshes if not mesh.users and mesh.name not in kept])


def _name_in_order() -> None:
    """Name all objects by their order, whenever they were made: Cycles' random number of an object, which tints leaves
    and bark, follows from its name."""
    items = [item for name in COLLECTIONS for item in bpy.data.collections[name].objects]
    names = ["item", *(f"item.{number:03d}" for number in range(1, len(items)))]
    renamed = [(item, name) for item, name in zip(items, names, strict=False) if item.name != name]
    for item, _ in renamed:
        item.name = "renamed"
    for item, name in renamed:
        item.name = name


def _paint(materials: Materials, world: World, view: View, labelled: Sequence[str]) -> Iterator[BuiltMesh]:
    """What lies on the road, moved a little so that it looks in place from the view."""
    seams = (
        (world.tar(view), materials.tar),
        (world.ghost_lines(view), materials.ghost),
        (world.removed_lines(view), materials.removed),
    )
    for seam, material in seams:
        if seam is not None:
            yield seam, [material], 0
    strips = world.paint(view, all_round=False)
    colors = {line.id: paint_color(line, world.scene.markings) for line in world.site.lines}
    for number, name in enumerate([*labelled, *(name for name in strips if name not in labelled)]):
        if name in strips and len(strips[name].faces):
            material = materials.yellow_marking if colors[name] == "yellow" else materials.marking
            yield strips[name], [material], instance_id("delimiter", number)
    for id_, mesh in zip(world.symbol_ids, world.symbols(view, all_round=False), strict=True):
        if len(mesh.faces):
            yield mesh, [materials.symbol], id_


def _objects(assets: LoadedAssets, view: View) -> list[MeshInstance]:
    return [_object(assets, item) for item in view.objects]


def _object(assets: LoadedAssets, item: PlacedObject) -> MeshInstance:
    place = item.world_from_object, item.scale, item.id
    if item.kind is None:
        return MeshInstance(assets.cars[item.model - 1], *place, body=(*item.colors[0], item.gloss))
    return MeshInstance(assets.things[item.kind][item.model - 1][item.pose], *place, paints=item.colors)


def _bodies(materials: Materials, bodies: dict[int, Body]) -> list[BuiltMesh]:
    return [(body, [materials.structures[body.surface]], id_) for id_, body in bodies.items()]


def _trees(assets: LoadedAssets, world: World) -> list[MeshInstance]:
    return [
        MeshInstance(assets.trees[tree.model - 1], pose, tree.scale, id_)
        for tree, (id_, pose) in zip(world.scene.trees, world.site.world_from_trees.items(), strict=True)
    ]


def _host(studio: Studio, view: View) -> list[MeshInstance]:
    pose, own = view.world_from_bonnet, view.scene.host
    body = (*[own.gray] * 3, own.gloss)
    return [] if pose is None else [MeshInstance(studio.bonnet, pose, 1.0, bonnet.ID, body)]


def _blender_mesh(surface: Mesh | Body | Blades, materials: Sequence[bpy.types.Material]) -> bpy.types.Mesh:
    if isinstance(surface, Body):
        return structure_mesh(surface, materials)
    if isinstance(surface, Blades):
        return _grass_mesh(surface, materials[0])
    return new_mesh(surface, materials)


def new_mesh(mesh: Mesh, materials: Sequence[bpy.types.Material]) -> bpy.types.Mesh:
    """A Blender mesh of smooth quads with its UV layer in metres."""
    data = polygons("surface", mesh.vertices_world, mesh.faces, mesh.uv_m)
    data.attributes.new("material_index", "INT", "FACE").data.foreach_set("value", mesh.material.astype(np.int32))
    for material in materials:
        data.materials.append(material)
    data.update(calc_edges=True)
    return data


def _grass_mesh(grass: Blades, material: bpy.types.Material) -> bpy.types.Mesh:
    """Blades as triangles with their shade, which is darker at the foot, and their dryness."""
    n_blades = len(grass.shade)
    data = polygons("grass", grass.corners_world.reshape(-1, 3), np.arange(3 * n_blades).reshape(-1, 3))
    for name, values in (("shade", np.outer(0.8 + 0.7 * grass.shade, FOOT_TO_TIP)), ("dryness", grass.dryness)):
        per_corner = np.broadcast_to(values.reshape(n_blades, -1), (n_blades, 3)).astype(np.float32)
        data.attributes.new(name, "FLOAT", "POINT").data.foreach_set("value", per_corner.ravel())
    data.materials.append(material)
    data.update()
    return data


def _add_placed(collection: str, items: Sequence[MeshInstance]) -> None:
    for item in items:
        scaled = item.world_from_object * [item.scale, item.scale, item.scale, 1.0]
        added = _add_object(collection, item.mesh, item.instance_id)
        added.matrix_world = mathutils.Matrix(scaled.tolist())
        if item.body is not None:
            added.color = item.body
        for number, paint in enumerate(item.paints):
            added[f"paint{number}"] = paint


def _add_object(collection: str, mesh: bpy.types.Mesh, instance_id: int) -> bpy.types.Object:
    item = bpy.data.objects.new("item", mesh)
    item.pass_index = instance_id
    bpy.data.collections[collection].objects.link(item)
    return item
