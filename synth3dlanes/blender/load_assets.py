"""Load the meshes, textures and skies of a process: the built-in ones, or a user's own. Done once per process."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from jaxtyping import Float

from synth3dlanes.blender.user_models import ModelKind, import_model
from synth3dlanes.imaging.user_sky import UserSky, prepare_sky, resized
from synth3dlanes.scene.assets.built_in import assets_dir
from synth3dlanes.scene.assets.catalogue import (
    BUILT_IN,
    CARS,
    THING_FOLDERS,
    THINGS,
    TREES,
    AssetKind,
    Assets,
    CarModel,
    Library,
    Texture,
    TreeModel,
)
from synth3dlanes.scene.assets.folder import (
    ROLES,
    AssetFiles,
    TextureFiles,
    digest,
    pose_files,
    scan,
    texture_digest,
    verified,
)
from synth3dlanes.scene.things import ThingKind
from synth3dlanes.system.errors import FormatError

NOTHING = AssetFiles({}, {}, (), ())


@dataclass(frozen=True, eq=False)
class LoadedAssets:
    """One mesh per model and one set of files per texture, in the order of their numbers; of people, riders and road
    works one mesh per pose. A car's object must set `color = (r, g, b, gloss)`, that of a thing a property `paint0`,
    `paint1`, ... for each of its model's paints, as (r, g, b)."""

    cars: tuple[bpy.types.Mesh, ...]
    trees: tuple[bpy.types.Mesh, ...]
    roads: tuple[TextureFiles, ...]
    terrains: tuple[TextureFiles, ...]
    skies: tuple[UserSky, ...]
    things: dict[ThingKind, tuple[tuple[bpy.types.Mesh, ...], ...]]


def load_assets(library: Library = BUILT_IN) -> LoadedAssets:
    """Load all assets; raise FormatError if a file has changed since it was checked."""
    folder = scan(Path(library.folder)) if library.folder else NOTHING
    own = library.assets
    loaded = LoadedAssets(
        _own_meshes(folder, "cars", own.cars) or load_meshes([car.name for car in CARS]),
        _own_meshes(folder, "trees", own.trees) or load_meshes([tree.name for tree in TREES]),
        _own_textures(folder, "roads", own.roads) or tuple(our_texture(f"road_{k}") for k in (1, 2, 3)),
        _own_textures(folder, "terrains", own.terrains) or tuple(our_texture(f"terrain_{k}") for k in (1, 2)),
        tuple(
            prepare_sky(read_sky(verified(_path(folder, "skies", sky.name), sky.sha256)), sky.sun_azimuth_rad)
            for sky in own.skies
        ),
        {kind: _things(folder, own, name, kind) for name, kind in THING_FOLDERS.items()},
    )
    things = (pose for models in loaded.things.values() for poses in models for pose in poses)
    for mesh in (*loaded.cars, *loaded.trees, *things):
        _fix_normals(mesh)
    return loaded


def load_meshes(names: Sequence[str]) -> tuple[bpy.types.Mesh, ...]:
    """Append meshes with their materials; each gets a fake user, so that it outlives any scene."""
    path = assets_dir() / "assets.blend"
    if not path.is_file():
        raise FormatError(f"{path}: expected the asset library, found no file; `make assets` builds it")
    with bpy.data.libraries.load(str(path)) as (library, wanted):
        missing = sorted(set(names) - set(library.meshes))
        if missing:
            raise FormatError(f"{path}: expected meshes named like the catalogue, found no {', '.join(missing)}")
        wanted.meshes = list(names)
    for mesh in wanted.meshes:
        mesh.use_fake_user = True
    return tuple(wanted.meshes)


def read_sky(path: Path) -> Float[np.ndarray, "3 h w"]:
    """The picture's upper half at the size of the built-in dome; raise FormatError if it is not a sky picture."""
    image = bpy.data.images.load(str(path))
    try:
        width, height = image.size
        if width == 0:
            raise FormatError(f"{path.name}: cannot read the picture")
        if width != 2 * height:
            raise FormatError(
                f"{path.name}: expected a picture twice as wide as high (equirectangular), got {width}x{height}"
            )
        pixels = np.zeros(width * height * image.channels, dtype=np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    upper = pixels.reshape(height, width, -1)[height // 2 :, :, :3]
    if not np.isfinite(upper).all() or upper.min() < 0 or upper.max() <= 0:
        raise FormatError(f"{path.name}: expected light above the horizon, got black, negative or infinite values")
    return resized(np.moveaxis(upper, -1, 0))


def _fix_normals(mesh: bpy.types.Mesh) -> None:
    """Split a mesh along its sharp edges and store its normals, as Cycles would for every picture anew."""
    if mesh.normals_domain != "CORNER":
        return
    mesh.split_faces()
    normals = np.zeros(3 * len(mesh.loops), dtype=np.float32)
    mesh.corner_normals.foreach_get("vector", normals)
    # What the normals were computed from; custom ones are stored in another form.
    for name in ("sharp_edge", "sharp_face", "custom_normal"):
        if name in mesh.attributes:
            mesh.attributes.remove(mesh.attributes[name])
    mesh.attributes.new("custom_normal", "FLOAT_VECTOR", "CORNER").data.foreach_set("vector", normals)


def _things(
    folder: AssetFiles, own: Assets, name: AssetKind, kind: ThingKind
) -> tuple[tuple[bpy.types.Mesh, ...], ...]:
    """The meshes of a kind of things, those of a user or ours, by model and pose."""
    if not own.own(name):
        names = [f"{model.name}.{pose}" for model in THINGS[kind] for pose in model.poses]
        meshes = dict(zip(names, load_meshes(names), strict=True))
        return tuple(tuple(meshes[f"{model.name}.{pose}"] for pose in model.poses) for model in THINGS[kind])
    files, found = pose_files(folder.models[name])[0], []
    for model in own.thing_models(kind):
        paths = files.get(model.name, [])
        if not paths or digest(*paths) != model.sha256:
            raise FormatError(f"{name}/{model.name}: its files have changed since they were checked")
        poses = (import_model(path, kind, f"{path.stem}-{model.sha256[:12]}") for path in paths)
        found.append(tuple(pose.mesh for pose in poses if pose is not None))
    return tuple(found)


def our_texture(name: str) -> TextureFiles:
    """A built-in texture; paths are relative to the textures folder."""
    return TextureFiles(*(Path(f"{name}_{role}.jpg") for role in ROLES))


def _own_meshes(
    folder: AssetFiles, kind: AssetKind, models: tuple[CarModel, ...] | tuple[TreeModel, ...]
) -> tuple[bpy.types.Mesh, ...]:
    singular: ModelKind = "car" if kind == "cars" else "tree"
    meshes = []
    for model in models:
        path = verified(_path(folder, kind, model.name), model.sha256)
        # `occlusion` caches search trees by mesh name, so the name must be unique to this file.
        imported = import_model(path, singular, f"{model.name}-{model.sha256[:12]}")
        assert imported is not None, "check_folder rejects files without a surface"
        meshes.append(imported.mesh)
    return tuple(meshes)


def _own_textures(folder: AssetFiles, kind: AssetKind, textures: tuple[Texture, ...]) -> tuple[TextureFiles, ...]:
    found = []
    for texture in textures:
        files = folder.textures[kind].get(texture.name)
        if files is None or texture_digest(files) != texture.sha256:
            raise FormatError(f"{kind}/{texture.name}: its files have changed since they were checked")
        found.append(files)
    return tuple(found)


def _path(folder: AssetFiles, kind: AssetKind, name: str) -> Path:
    if name not in folder.models[kind]:
        raise FormatError(f"{kind}/{name}: the file has been removed since it was checked")
    return folder.models[kind][name]
