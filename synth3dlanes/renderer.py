"""Scenes as pictures in this process, rendered in another one: part of `import synth3dlanes` (docs/api.md)."""

import atexit
import os
from _thread import LockType
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import Lock

import numpy as np
from jaxtyping import Shaped, UInt8

from synth3dlanes.dataset.format import (
    HEIGHT,
    IMAGE_FORMATS,
    LABELS,
    LIDAR,
    PASSES,
    Picture,
    decode_image,
    encode,
    read_passes,
    read_sweep,
)
from synth3dlanes.draw.sample import with_lidar
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels import labels as labels_format
from synth3dlanes.labels.labels import Labels
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.production.render_file import PATIENCE, render_members
from synth3dlanes.production.workers import Pool
from synth3dlanes.scene import scene as scene_format
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Library
from synth3dlanes.scene.assets.folder import require_assets
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import DEVICES, QUALITY_SAMPLES, RenderSettings
from synth3dlanes.scene.settings import PASSES as PASS_NAMES
from synth3dlanes.system.arguments import checked
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import write

STANDARD = QUALITY_SAMPLES["standard"]


@dataclass(frozen=True, eq=False)
class Rendered:
    """A rendered scene. The image, labels, passes and lidar sweep equal those of the same scene in a data set of PNG
    images. `sweep` is None for a scene without a lidar."""

    scene: Scene
    image: UInt8[np.ndarray, "h w 3"]
    labels: Labels
    passes: dict[str, Shaped[np.ndarray, "..."]]
    sweep: Sweep | None = None

    @checked
    def save(self, path: str | Path) -> list[Path]:
        """Write the image (.png or .jpg), and beside it the labels, the scene and the passes. Returns the paths.

        For `scene.png` the other files are `scene.labels.json`, `scene.scene.json` and `scene.passes.exr`. Raises
        InputError for another suffix.
        """
        path = Path(path)
        image_format = one_of("path", path.suffix.removeprefix("."), IMAGE_FORMATS)
        text = scene_format.to_json(self.scene)
        members = encode(Picture(self.image, self.labels, self.passes, self.sweep), text, image_format)
        for name, data in members.items():
            write(path.with_suffix(f".{name}"), data)
        return [path.with_suffix(f".{name}") for name in members]


class Renderer:
    """Renders scenes one after the other in one process of its own, so that only the first waits for Blender to start.

    Use it as a context manager, or call `close`. It takes the arguments of `render`, raises the same errors and returns
    the same bytes.
    """

    @checked
    def __init__(
        self,
        *,
        samples: int = STANDARD,
        passes: str | Sequence[str] = (),
        device: str = "auto",
        assets: Library = BUILT_IN,
    ) -> None:
        self._settings, self._assets = render_settings(samples, passes, device), assets
        self._open: ExitStack | None = None
        self._pool, self._turn = Pool(1, PATIENCE), Lock()

    def __enter__(self) -> "Renderer":
        if self._open is None:
            self._open = ExitStack()
            self._open.enter_context(self._pool)
        return self

    def _with(self, pool: Pool, turn: LockType) -> "Renderer":
        """This renderer, with a process that others open and close, and the lock of who uses it."""
        self._pool, self._open, self._turn = pool, ExitStack(), turn
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process; the next call of `render` starts another."""
        if self._open is not None:
            self._open.close()
            self._open = None

    @checked
    def render(self, scene: Scene, *, lidar: str | Path | None = None) -> Rendered:
        """Render a scene; threads wait for each other."""
        require_assets(scene.assets, self._assets, "scene")
        scene = with_lidar(scene, None if lidar is None else load_lidar(str(lidar)))
        with self._turn:
            self.__enter__()
            members = render_members(scene, self._settings, "png", self._assets, "render", self._pool)
        found: dict[str, Shaped[np.ndarray, ...]] = {}
        for name in (PASSES, HEIGHT):
            if name in members:
                found |= read_passes(members[name], name)
        labels = labels_format.from_json(members[LABELS], LABELS)
        sweep = None if labels.lidar is None else read_sweep(members[LIDAR], LIDAR, labels.lidar)
        return Rendered(scene, decode_image(members["png"], "png"), labels, found, sweep)


@checked
def render(
    scene: Scene,
    *,
    samples: int = STANDARD,
    passes: str | Sequence[str] = (),
    lidar: str | Path | None = None,
    device: str = "auto",
    assets: Library = BUILT_IN,
) -> Rendered:
    """Render a scene with `samples` samples per pixel, in a process of its own, which stays until this one ends: only
    the first call waits for Blender to start. A `Renderer` ends its process when it is closed.

    `passes` are some of depth, normal, semantic, instance and height, or "all". `lidar` is a YAML file or the name of a
    ready lidar (docs/lidar.md); without it, the scene's own lidar is used, if it has one. Raises InputError for a wrong
    argument, or if `assets` are not those that the scene was drawn with; MissingPackageError without Blender;
    WorkerError if Blender fails.
    """
    renderer = Renderer(samples=samples, passes=passes, device=device, assets=assets)
    with _ONE_AT_A_TIME:
        kept = _kept(os.getpid())
    return renderer._with(*kept).render(scene, lidar=lidar)


_ONE_AT_A_TIME = Lock()


@cache
def _kept(pid: int) -> tuple[Pool, LockType]:
    """The pool of `render` in the process of this number, and the lock of who uses it. A fork neither uses nor ends the
    pool of its parent."""
    stack, pool = ExitStack(), Pool(1, PATIENCE)
    stack.enter_context(pool)
    atexit.register(lambda: stack.close() if os.getpid() == pid else None)
    return pool, Lock()


def render_settings(samples: int, passes: str | Sequence[str], device: str) -> RenderSettings:
    """The checked render settings, with the passes in the order of `PASSES`."""
    if samples < 1:
        raise InputError(f"samples: expected 1 or more, got {samples}")
    asked = PASS_NAMES if passes == "all" else [one_of("passes", name, PASS_NAMES) for name in several(passes)]
    ordered = tuple(name for name in PASS_NAMES if name in asked)
    return RenderSettings(samples, ordered, one_of("device", device, DEVICES))


def several(values: str | Sequence[str]) -> Sequence[str]:
    """The values as a sequence: a single text becomes a list with one item."""
    return [values] if isinstance(values, str) else values


def one_of(argument: str, value: str, known: Iterable[str]) -> str:
    """The value; raise InputError if it is none of the known ones."""
    if value not in known:
        raise InputError(f"{argument}: expected one of {', '.join(known)}, got {value!r}")
    return value
