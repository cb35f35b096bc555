"""Render scene.json to image, labels and passes as files, with the same bytes that a data set has for the scene."""

import math
from collections.abc import Sequence
from pathlib import Path

from synth3dlanes.dataset.format import SCENE
from synth3dlanes.dataset.scenes import find_scene
from synth3dlanes.draw.sample import with_lidar
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.production.recipe import make_image, require_blender
from synth3dlanes.production.workers import Limits, Pool, ask, call
from synth3dlanes.scene.assets.catalogue import Library
from synth3dlanes.scene.assets.folder import require_assets
from synth3dlanes.scene.change import change_scene
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import write
from synth3dlanes.world.world import resolve

# A scene may be as large as its file says.
PATIENCE = Limits(seconds=math.inf, rss_bytes=1 << 50)


def render_file(
    source: str,
    image_path: Path | None,
    changes: Sequence[str],
    settings: RenderSettings,
    library: Library,
    lidar: LidarSpec | None = None,
) -> list[Path]:
    """Render the scene of a file or of a sample (`DIR/SPLIT:KEY`), with some values changed or with another lidar.
    Returns the files written, the image first.

    The files are named like the members of a sample. The scene is written only if it was changed.
    """
    require_blender()
    name, scene = find_scene(source)
    scene = with_lidar(change_scene(scene, changes), lidar)
    is_changed = bool(changes or lidar)
    require_assets(scene.assets, library, source)
    image_path = image_path or Path(f"{name}.png")
    image_format = image_path.suffix.removeprefix(".")
    if image_format not in ("png", "jpg"):
        raise InputError(f"out {image_path}: expected a name that ends in .png or .jpg")
    if is_changed and image_path.with_suffix(f".{SCENE}").resolve() == Path(source).resolve():
        raise InputError(f"out {image_path}: would overwrite {source} with the changed scene; name another")
    # Pinned to one core like all workers: with another number of cores, Cycles rounds some sums differently.
    members = render_members(scene, settings, image_format, library, source)
    files = {image_path.with_suffix(f".{name}"): data for name, data in members.items() if is_changed or name != SCENE}
    for path, data in files.items():
        write(path, data)
    return list(files)


def render_members(
    scene: Scene,
    settings: RenderSettings,
    image_format: str,
    library: Library,
    where: str,
    pool: Pool | None = None,
) -> dict[str, bytes]:
    """The members of a sample of the scene, made in a worker process: a new process, or the pool's.

    Raises MissingPackageError without Blender, InputError for a device that is not there, WorkerError if Blender fails;
    the message begins with `where`.
    """
    require_blender()
    task = (_make, scene, settings, image_format, library)
    outcome = call(PATIENCE, *task, pinned=True) if pool is None else ask(pool, *task)
    members: dict[str, bytes] | InputError = outcome.result(where)
    if isinstance(members, InputError):
        raise members
    return members


def _make(scene: Scene, settings: RenderSettings, image_format: str, library: Library) -> dict[str, bytes] | InputError:
    try:
        return make_image(resolve(scene), settings, image_format, library).members
    except InputError as error:
        return error
