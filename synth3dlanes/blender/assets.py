"""Load meshes from `blender_assets/assets.blend`."""

from collections.abc import Sequence

import bpy

from synth3dlanes.scene.assets.built_in import assets_dir
from synth3dlanes.system.errors import FormatError


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
