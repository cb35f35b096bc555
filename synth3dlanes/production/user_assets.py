"""A user's folder of assets, checked and measured once before a run, in a process of its own that loads Blender."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from synth3dlanes.production.recipe import require_blender
from synth3dlanes.production.workers import Limits, call
from synth3dlanes.scene.assets.catalogue import Library
from synth3dlanes.scene.assets.folder import FolderCheck
from synth3dlanes.system.errors import InputError

PATIENCE = Limits(seconds=1800.0, rss_bytes=16 << 30)


def open_library(folder: Path) -> tuple[Library, tuple[str, ...]]:
    """The assets in a folder, and the warnings about them. Raises InputError with every problem."""
    checked = check_assets(folder)
    if checked.problems:
        raise InputError(*(f"assets {folder}: {problem}" for problem in checked.problems))
    return Library(str(folder.resolve()), checked.assets), checked.warnings


def check_assets(folder: Path) -> FolderCheck:
    """Check a folder. Raises InputError if it does not exist, WorkerError if Blender crashes on its files."""
    if not folder.is_dir():
        raise InputError(f"assets {folder}: expected a folder, found none")
    checked: FolderCheck = _in_blender(_check, folder)
    return checked


def write_example(folder: Path) -> None:
    """Write an example of such a folder. Raises InputError if something is there already."""
    if folder.exists():
        raise InputError(f"{folder}: already exists")
    _in_blender(_example, folder)


def _in_blender(function: Callable[[Path], Any], folder: Path) -> Any:
    require_blender()
    return call(PATIENCE, function, folder).result(f"assets {folder}")


# The worker loads Blender's modules; this process does not.


def _check(folder: Path) -> FolderCheck:
    from synth3dlanes.blender.check_assets import check_folder

    return check_folder(folder)


def _example(folder: Path) -> None:
    from synth3dlanes.blender.example_assets import make_example

    make_example(folder)
