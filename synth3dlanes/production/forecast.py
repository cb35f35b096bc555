"""The time and the disk space that samples will take, estimated before a run starts."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from synth3dlanes.production.events import duration
from synth3dlanes.production.measured import Measured
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.system.errors import DiskFullError
from synth3dlanes.system.words import counted

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
            f"about {duration(self.seconds)} and {self.bytes_kept / 1e9:.2g} GB"
            f"{', as the samples before took' * self.is_measured}"
        )

    def require_room(self, folder: Path, reserve: int = 0) -> None:
        """Raise DiskFullError unless the disk of a folder (or of the folder where it will be made) has room for all
        samples and a reserve."""
        there = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        free, needed = shutil.disk_usage(there).free, self.bytes_needed + reserve
        if self.samples and free < needed:
            raise DiskFullError(
                f"{folder}: {counted(self.samples, 'sample')} need {needed / 1e9:.3g} GB, "
                f"but only {free / 1e9:.3g} GB are free"
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
