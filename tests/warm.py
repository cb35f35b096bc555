"""Workers that outlive their pool: the next pool of this process goes on with them, Blender and assets loaded.

A start of Blender takes some three seconds, and the tests ask for dozens. That bytes do not depend on what a worker has
made before is a promise of its own (tests/blender/test_clips.py). Tests of the processes themselves have fresh ones.
"""

import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

from synth3dlanes import renderer
from synth3dlanes.production import bench, local, twins, workers
from synth3dlanes.production.workers import Limits, Pool, Worker
from synth3dlanes.validate import made_again

# The checks of types look up once what "Pool" means in its own annotations: now, while it is the program's.
with Pool(0, Limits(), pinned=False):
    pass

USERS = (bench, local, made_again, renderer, workers)
# What differs between tests and does not matter to a worker.
NOT_ASKED = ("PYTEST_CURRENT_TEST", "COLUMNS", "LINES")
# Those that are kept, the last used last: as many as most pools have.
MOST = 2
_kept: list[tuple[dict[str, str], Worker]] = []
# Folders of the workers, each of its own; some tests have other temporary folders.
HOME = Path(tempfile.mkdtemp(prefix="synth3dlanes-warm-"))


def use(is_warm: bool) -> None:
    """Have the program's pools be warm ones from now on, or its own."""
    for module in USERS:
        module.Pool = Warm if is_warm else Pool  # type: ignore[misc]


def stop() -> None:
    """Kill what is left, and remove the folders."""
    while _kept:
        _end(_kept.pop()[1])
    shutil.rmtree(HOME, ignore_errors=True)


def _end(worker: Worker) -> None:
    worker.process.kill()
    worker.process.wait()
    worker.pipe.close()


class Warm(Pool):
    """A pool that begins with workers of earlier ones, if their environment was the same, and leaves its own to the
    next."""

    def __enter__(self) -> Pool:
        # A core of its own would be another pool's at other times.
        self.pinned = False
        return super().__enter__()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for slot, worker in enumerate(self._workers):
            if worker and worker.task is None and worker.process.poll() is None and not any(self.masks):
                _kept.append((_environment(), worker))
                self._workers[slot] = None
        while len(_kept) > MOST:
            _end(_kept.pop(0)[1])
        super().__exit__(kind, error, trace)

    def start(self, task: Any, function: Callable[..., Any], *args: Any, slot: int | None = None) -> None:
        """As any pool, in the folder that this process is in by now."""
        super().start(task, _in_folder, os.getcwd(), function, *args, slot=slot)

    def _launch(self, slot: int) -> Worker:
        for place, (environment, worker) in enumerate(_kept):
            if environment == _environment() and worker.process.poll() is None and not any(self.masks):
                del _kept[place]
                return worker
        # What it prints must stay when this pool's own folder goes.
        self._scratch, scratch = Path(tempfile.mkdtemp(dir=HOME)), self._scratch
        worker = super()._launch(slot)
        self._scratch = scratch
        return worker


def _environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name not in NOT_ASKED} | {"path": str(sys.path)}


def _in_folder(folder: str, function: Callable[..., Any], *args: Any) -> Any:
    os.chdir(folder)
    # Another test's data set may lie at the same address.
    twins._reader.cache_clear()
    return function(*args)
