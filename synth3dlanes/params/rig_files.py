"""Files of rigs: several cameras on one host, by name, each as in a camera file (docs/camera.md).

Reading a file is the only side effect.
"""

import re
from pathlib import Path
from typing import Any

from synth3dlanes.params.camera_files import load_camera, read_camera, read_document
from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.params import find_preset
from synth3dlanes.scene.host import MAX_CAMERAS
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import MAX_PROBLEMS, shown

NAME = re.compile(r"[\w.-]{1,64}")


def load_rig(source: str) -> tuple[CameraSpec, ...]:
    """Read a ready rig (by name) or a file, in the file's order; raise InputError with a line for every problem."""
    path, where = find_preset(source, "rigs")
    document = read_document(path, where)
    if not isinstance(document, dict) or not 0 < len(document) <= MAX_CAMERAS:
        raise InputError(f"{where}: expected 1 to {MAX_CAMERAS} cameras by name, got {shown(document)}")
    cameras: list[CameraSpec] = []
    problems: list[str] = []
    for name, camera in document.items():
        try:
            cameras.append(_camera(name, camera, where, path.parent))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(*problems[:MAX_PROBLEMS])
    return tuple(cameras)


def _camera(name: Any, camera: Any, where: str, folder: Path) -> CameraSpec:
    """A camera of a rig: its keys, or the name or file of a camera."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise InputError(f"{where}: expected a camera's name of letters, digits, _ . and -, got {shown(name)}")
    if not isinstance(camera, str):
        return read_camera(camera, f"{where}: {name}", folder).model_copy(update={"name": name})
    try:
        spec = load_camera(str(folder / camera) if camera.endswith((".yaml", ".yml")) else camera)
    except InputError as error:
        raise InputError(*(f"{where}: {name}: {problem}" for problem in error.problems)) from None
    return spec.model_copy(update={"name": name})
