"""scene.json -> image, labels and passes as files. Imports bpy."""

import ctypes
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from synth3dlanes.asset_folder import require_assets
from synth3dlanes.blender.render import render
from synth3dlanes.catalogue import Library
from synth3dlanes.change import change_scene
from synth3dlanes.dataset.format import SCENE, encode
from synth3dlanes.errors import ParamsError
from synth3dlanes.ground_truth import ground_truth
from synth3dlanes.look_up import load_scene, scene_name
from synth3dlanes.scene import to_json
from synth3dlanes.settings import RenderSettings


def render_file(
    scene_path: Path, image_path: Path | None, changes: Sequence[str], settings: RenderSettings, library: Library
) -> list[Path]:
    """Render exactly the scene of a file, some factors changed; return the files written, the image first.

    They are named as the members of a sample. The scene is among them only where it was changed.
    """
    scene = change_scene(load_scene(scene_path), changes)
    require_assets(scene.assets, library, str(scene_path))
    image_path = image_path or Path(f"{scene_name(scene_path)}.png")
    image_format = image_path.suffix.removeprefix(".")
    if image_format not in ("png", "jpg"):
        raise ParamsError(f"--out {image_path}: expected a name that ends in .png or .jpg")
    if changes and image_path.with_suffix(f".{SCENE}").resolve() == scene_path.resolve():
        raise ParamsError(f"--out {image_path}: would overwrite {scene_path} with the changed scene; name another")
    image_path.parent.mkdir(parents=True, exist_ok=True)
    with _blender_silent():
        rendering = render(scene, ground_truth(scene), settings, library)
    members = encode(rendering.image, rendering.labels, to_json(scene), rendering.passes, image_format)
    files = {image_path.with_suffix(f".{name}"): data for name, data in members.items() if changes or name != SCENE}
    for path, data in files.items():
        path.write_bytes(data)
    return list(files)


@contextmanager
def _blender_silent() -> Iterator[None]:
    """Blender writes every step of a render to stdout, past Python, where our own result is to stand alone."""
    sys.stdout.flush()
    stdout, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        ctypes.CDLL(None).fflush(None)
        os.dup2(stdout, 1)
        os.close(stdout)
        os.close(nowhere)
