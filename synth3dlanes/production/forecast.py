"""The time and the disk space that samples take: measured in the last run of a split, estimated before a run starts;
and the room on the disk while it works.

Whether there is room again is tested by writing: free bytes are of no use if the number of files, or a user's quota,
is at its limit.
"""

import json
import os
import shutil
import statistics
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synth3dlanes.dataset.folder import PROBE
from synth3dlanes.production.events import duration
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.workers import DISK_FULL
from synth3dlanes.system.errors import DiskFullError, Synth3dlanesError
from synth3dlanes.system.files import Folder, read_bounded
from synth3dlanes.system.words import counted, sized

# Measured on scenes of Appendix I at 480x360: core-seconds an image, bytes a pixel, bytes of text.
SECONDS_PER_PIXEL_SAMPLE, SECONDS_PER_PIXEL, SECONDS_PER_SCENE = 2.3e-6, 1.6e-6, 0.25
BYTES_PER_PIXEL = {"jpg": 0.45, "png": 1.6}
BYTES_PER_PIXEL_OF_PASS = {"depth": 2.4, "normal": 3.0, "semantic": 0.2, "instance": 0.4, "height": 0.3}
BYTES_OF_TEXT = 80_000
# The same for a lidar sweep.
SECONDS_PER_RAY, BYTES_PER_RAY = 7e-6, 2.5
# Seconds until a worker has loaded Blender and its first scene.
SECONDS_TO_START = 3.0
# Multiple of the expected seconds after which a sample is given up: slow machines and large cameras need more.
PATIENCE, LEAST_PATIENCE_S = 60.0, 120.0
# More core-seconds than a scene takes to draw and label.
TRY_S = 2.0
# While a shard is joined, it is on the disk twice.
SHARD_SAMPLES = 1000


@dataclass(frozen=True)
class Measured:
    """Seconds that a worker took for a sample, and bytes of it, as medians."""

    seconds: float
    bytes: float


@dataclass(frozen=True)
class Forecast:
    """The time and the disk space that the missing samples will take; `is_measured` if it follows from the samples that
    this machine made before."""

    samples: int
    workers: int
    seconds: float
    bytes_kept: int
    bytes_needed: int
    is_measured: bool = False

    def text(self) -> str:
        """The forecast as one line of text."""
        return (
            f"{counted(self.samples, 'sample')} to make with {counted(self.workers, 'worker')}: "
            f"about {duration(self.seconds)} and {sized(self.bytes_kept)}"
            f"{', as the samples before took' * self.is_measured}"
        )

    def require_room(self, folder: Path, reserve: int = 0) -> None:
        """Raise DiskFullError unless the disk of a folder (or of the folder where it will be made) has room for all
        samples and a reserve."""
        there = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        free, needed = shutil.disk_usage(there).free, self.bytes_needed + reserve
        if self.samples and free < needed:
            raise DiskFullError(
                f"{folder}: {counted(self.samples, 'sample')} need {sized(needed, 3)}, "
                f"but only {sized(free, 3)} are free"
            )


def seconds_per_sample(recipe: Recipe) -> float:
    """Core-seconds of a sample, from the measured costs of a pixel."""
    pixels = _pixels(recipe)
    seconds = SECONDS_PER_SCENE + pixels * (SECONDS_PER_PIXEL + SECONDS_PER_PIXEL_SAMPLE * recipe.settings.samples)
    return seconds + _rays(recipe) * SECONDS_PER_RAY


def forecast(recipe: Recipe, samples: int, workers: int, found: Measured | None = None) -> Forecast:
    """Time and size of `samples` more: as those before took, where that is known, else from the costs of a pixel."""
    per_pixel = BYTES_PER_PIXEL[recipe.image_format] + sum(
        BYTES_PER_PIXEL_OF_PASS.get(name, 0.0) for name in recipe.settings.passes
    )
    size = BYTES_OF_TEXT + int(_pixels(recipe) * per_pixel + _rays(recipe) * BYTES_PER_RAY)
    size = size if found is None else int(found.bytes)
    needed = (samples + min(samples, SHARD_SAMPLES)) * size
    start = SECONDS_TO_START if samples else 0.0
    seconds = start + samples * (seconds_per_sample(recipe) if found is None else found.seconds) / workers
    return Forecast(samples, workers, seconds, samples * size, needed, found is not None)


def patience_s(recipe: Recipe) -> float:
    """The core-seconds that a sample may take before it is given up."""
    drawing_s = TRY_S * recipe.where.tries if recipe.where else 0.0
    return max(LEAST_PATIENCE_S, PATIENCE * seconds_per_sample(recipe)) + drawing_s


def _pixels(recipe: Recipe) -> float:
    """The mean number of pixels of an image."""
    cameras = recipe.cameras
    return sum(camera.width_px.draw(0.5) * camera.height_px.draw(0.5) for camera in cameras) / len(cameras)


def _rays(recipe: Recipe) -> int:
    """The number of rays of a lidar sweep."""
    lidar = recipe.scenes.shots.lidar
    return len(lidar.elevations_deg) * lidar.azimuths if lidar else 0


# Least number of samples that say something, and the number of the last ones that are used.
LEAST_SAMPLES, MOST_SAMPLES = 5, 500
MAX_LOG_BYTES = 1 << 28


def measured(root: Path, split: str) -> Measured | None:
    """What the last run with enough samples has measured in a data set here; None where there is none."""
    for path in sorted((root / "logs").glob(f"{split}-*.jsonl"), reverse=True):
        samples = list(_samples(path))[-MOST_SAMPLES:]
        if len(samples) >= LEAST_SAMPLES:
            return Measured(*(statistics.median(sample[name] for sample in samples) for name in ("seconds", "bytes")))
    return None


def _samples(path: Path) -> Iterator[dict[str, Any]]:
    """The details of the samples in a log; a line that a killed run has left unfinished is none."""
    try:
        lines = read_bounded(path, MAX_LOG_BYTES).splitlines()
    except (OSError, Synth3dlanesError):
        return
    for line in lines:
        try:
            event = json.loads(line)
            details = event["details"] if event["kind"] == "sample" else {}
        except (ValueError, LookupError, TypeError):
            continue
        if all(isinstance(details.get(name), int | float) for name in ("seconds", "bytes")):
            yield details


FREE_MARK_SHARE, FREE_MARK_BYTES = 0.01, 1 << 30
# Seconds between two tries: the first value, doubled up to the second.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 16.0
CHUNK_BYTES = 1 << 20


def is_full(error: BaseException | None) -> bool:
    """Whether an error says that a disk or a user's quota is full."""
    return isinstance(error, OSError) and error.errno in DISK_FULL


class Room:
    """The free space in the folder of a data set. It is too low once a write fails or few bytes are free; then it is
    waited for until there is enough for the next step (`n_files` files and some bytes). A run stops writing at `mark`
    free bytes, so that the disk is never quite full, and continues at twice as many."""

    def __init__(self, root: Path, n_files: int) -> None:
        self.root, self.mark = root, min(FREE_MARK_BYTES, int(shutil.disk_usage(root).total * FREE_MARK_SHARE))
        self._n_files, self._n_bytes, self._is_low = n_files, 0, False
        self._try_at, self._pause_s = 0.0, FIRST_PAUSE_S
        self.is_waiting = False

    @property
    def is_low(self) -> bool:
        """Whether few bytes are free."""
        return self.free < self.mark

    @property
    def free(self) -> int:
        """The free bytes, according to the file system."""
        return shutil.disk_usage(self.root).free

    def wait(self, n_bytes: int) -> None:
        """Start waiting until `n_bytes` can be written."""
        if not self.is_waiting:
            self._n_bytes = 0
        self.is_waiting, self._n_bytes, self._is_low = True, max(n_bytes, self._n_bytes), self.is_low
        self._try_at = time.monotonic() + self._pause_s

    def is_back(self) -> bool:
        """Whether there is space again, while waiting. Tests this now and then, and returns False in between."""
        if time.monotonic() < self._try_at:
            return False
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)
        self._try_at = time.monotonic() + self._pause_s
        if (self._is_low and self.free < 2 * self.mark) or not self._can_write():
            return False
        self.is_waiting = False
        return True

    def has_been_of_use(self) -> None:
        """Record that something was written, so that the next wait begins with a short pause."""
        self._pause_s = FIRST_PAUSE_S

    def _can_write(self) -> bool:
        folder = Folder(self.root)
        try:
            with ExitStack() as stack:
                first, *_ = [stack.enter_context(folder.draft(PROBE)) for _ in range(self._n_files)]
                for done in range(0, self._n_bytes, CHUNK_BYTES):
                    # Not zeros, which some file systems store without using space.
                    first.stream.write(os.urandom(min(CHUNK_BYTES, self._n_bytes - done)))
                first.sync()
        except OSError as error:
            if is_full(error):
                return False
            raise
        return True
