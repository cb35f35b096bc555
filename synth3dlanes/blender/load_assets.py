"""What every scene of a process is put together from: ours, or a user's own in its place. One load a process."""

from dataclasses import dataclass
from pathlib import Path

import bpy

from synth3dlanes.assets.catalogue import BUILT_IN, CARS, TREES, AssetKind, CarModel, Library, Texture, TreeModel
from synth3dlanes.assets.folder import ROLES, Folder, TextureFiles, scan, texture_digest, verified
from synth3dlanes.blender.assets import load_meshes
from synth3dlanes.blender.sky_file import read_sky
from synth3dlanes.blender.user_models import ModelKind, import_model
from synth3dlanes.errors import FormatError
from synth3dlanes.imaging.user_sky import UserSky, prepare_sky

NOTHING = Folder({}, {}, (), ())


@dataclass(frozen=True, eq=False)
class LoadedAssets:
    """One mesh a model and one set of files a texture, in the order of their numbers; a car's object sets
    `color = (r, g, b, gloss)`."""

    cars: tuple[bpy.types.Mesh, ...]
    trees: tuple[bpy.types.Mesh, ...]
    roads: tuple[TextureFiles, ...]
    terrains: tuple[TextureFiles, ...]
    skies: tuple[UserSky, ...]


def load_assets(library: Library = BUILT_IN) -> LoadedAssets:
    """Load all models; raise FormatError where a file is no longer the one that was checked."""
    folder = scan(Path(library.folder)) if library.folder else NOTHING
    own = library.assets
    return LoadedAssets(
        _own_meshes(folder, "cars", own.cars) or load_meshes([car.name for car in CARS]),
        _own_meshes(folder, "trees", own.trees) or load_meshes([tree.name for tree in TREES]),
        _own_textures(folder, "roads", own.roads) or tuple(our_texture(f"road_{k}") for k in (1, 2, 3)),
        _own_textures(folder, "terrains", own.terrains) or tuple(our_texture(f"terrain_{k}") for k in (1, 2)),
        tuple(
            prepare_sky(read_sky(verified(_path(folder, "skies", sky.name), sky.sha256)), sky.sun_azimuth_rad)
            for sky in own.skies
        ),
    )


def our_texture(name: str) -> TextureFiles:
    """A texture of ours, in the folder of textures."""
    return TextureFiles(*(Path(f"{name}_{role}.jpg") for role in ROLES))


def _own_meshes(
    folder: Folder, kind: AssetKind, models: tuple[CarModel, ...] | tuple[TreeModel, ...]
) -> tuple[bpy.types.Mesh, ...]:
    singular: ModelKind = "car" if kind == "cars" else "tree"
    meshes = []
    for model in models:
        path = verified(_path(folder, kind, model.name), model.sha256)
        # Search trees are kept by the mesh's name, so it must tell this file from any other.
        imported = import_model(path, singular, f"{model.name}-{model.sha256[:12]}")
        assert imported is not None, "the check refuses files without a surface"
        meshes.append(imported.mesh)
    return tuple(meshes)


def _own_textures(folder: Folder, kind: AssetKind, textures: tuple[Texture, ...]) -> tuple[TextureFiles, ...]:
    found = []
    for texture in textures:
        files = folder.textures[kind].get(texture.name)
        if files is None or texture_digest(files) != texture.sha256:
            raise FormatError(f"{kind}/{texture.name}: expected the files that were checked before the run, got others")
        found.append(files)
    return tuple(found)


def _path(folder: Folder, kind: AssetKind, name: str) -> Path:
    if name not in folder.models[kind]:
        raise FormatError(f"{kind}/{name}: expected the file that was checked before the run, found none")
    return folder.models[kind][name]
