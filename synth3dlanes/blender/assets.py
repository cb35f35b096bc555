"""Cars and trees out of `blender_assets/assets.blend`, and where that folder is. One load per process."""

from dataclasses import dataclass
from pathlib import Path

import bpy

from synth3dlanes.catalogue import CARS, TREES
from synth3dlanes.errors import FormatError


@dataclass(frozen=True, eq=False)
class Assets:
    """One mesh a model, in the catalogue's order; a car's object sets `color = (r, g, b, gloss)`."""

    cars: tuple[bpy.types.Mesh, ...]
    trees: tuple[bpy.types.Mesh, ...]


def assets_dir() -> Path:
    """The folder of built assets: inside an installed wheel, beside the package in a checkout."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "_assets"
    return installed if installed.is_dir() else package.parent / "blender_assets"


def load_assets() -> Assets:
    """Append every catalogue mesh with its materials; all keep a fake user and so outlive any scene."""
    path = assets_dir() / "assets.blend"
    names = [model.name for model in CARS + TREES]
    if not path.is_file():
        raise FormatError(f"{path}: expected the asset library, found no file; `make assets` builds it")
    with bpy.data.libraries.load(str(path)) as (library, wanted):
        missing = sorted(set(names) - set(library.meshes))
        if missing:
            raise FormatError(f"{path}: expected meshes named like the catalogue, found no {', '.join(missing)}")
        wanted.meshes = list(names)
    meshes = tuple(wanted.meshes)
    for mesh in meshes:
        mesh.use_fake_user = True
    return Assets(meshes[: len(CARS)], meshes[len(CARS) :])
