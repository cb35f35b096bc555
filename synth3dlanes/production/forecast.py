"""What samples will cost in time and room, before a run starts."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from synth3dlanes.errors import DiskFullError
from synth3dlanes.production.events import duration
from synth3dlanes.production.recipe import Recipe

# Measured on scenes of Appendix I at 480x360: core-seconds an image, bytes a pixel, bytes of text.
SECONDS_PER_PIXEL_SAMPLE, SECONDS_PER_PIXEL, SECONDS_PER_SCENE = 2.3e-6, 1.6e-6, 0.25
BYTES_PER_PIXEL = {"jpg": 0.45, "png": 1.6}
BYTES_PER_PIXEL_OF_PASS = {"depth": 2.4, "normal": 3.0, "semantic": 0.2, "instance": 0.4, "height": 0.3}
BYTES_OF_TEXT = 80_000
# Of a lidar.
SECONDS_PER_RAY, BYTES_PER_RAY = 7e-6, 2.5
# Until a worker has loaded Blender and its first scene.
SECONDS_TO_START = 3.0
# A joined shard lies there twice for a moment.
SHARD_SAMPLES = 1000


@dataclass(frozen=True)
class Forecast:
    """What the missing samples will take."""

    samples: int
    workers: int
    seconds: float
    bytes_kept: int
    bytes_needed: int

    def text(self) -> str:
        """The forecast in a line."""
        return (
            f"{self.samples} samples to make with {self.workers} workers: about {duration(self.seconds)} "
            f"and {self.bytes_kept / 1e9:.2g} GB"
        )

    def require_room(self, folder: Path, reserve: int = 0) -> None:
        """Raise DiskFullError unless the disk of a folder (or of the folder it will be made in) has room for all and
        the reserve."""
        there = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
        free, needed = shutil.disk_usage(there).free, self.bytes_needed + reserve
        if self.samples and free < needed:
            raise DiskFullError(
                f"{folder}: {self.samples} samples need {needed / 1e9:.3g} GB, but only {free / 1e9:.3g} GB are free"
            )


def forecast(recipe: Recipe, samples: int, workers: int) -> Forecast:
    """Time and size of `samples` more, from the measured costs of a pixel."""
    settings, cameras = recipe.settings, recipe.cameras
    pixels = sum(camera.width_px.draw(0.5) * camera.height_px.draw(0.5) for camera in cameras) / len(cameras)
    seconds = SECONDS_PER_SCENE + pixels * (SECONDS_PER_PIXEL + SECONDS_PER_PIXEL_SAMPLE * settings.samples)
    per_pixel = BYTES_PER_PIXEL[recipe.image_format] + sum(
        BYTES_PER_PIXEL_OF_PASS.get(name, 0.0) for name in settings.passes
    )
    lidar = recipe.shots.lidar
    rays = len(lidar.elevations_deg) * lidar.azimuths if lidar else 0
    seconds += rays * SECONDS_PER_RAY
    size = BYTES_OF_TEXT + int(pixels * per_pixel + rays * BYTES_PER_RAY)
    needed = (samples + min(samples, SHARD_SAMPLES)) * size
    start = SECONDS_TO_START if samples else 0.0
    return Forecast(samples, workers, start + samples * seconds / workers, samples * size, needed)
