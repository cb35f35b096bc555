"""Where a run stands: rate and time left, the forecast before it starts, the log."""

import io
import os
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from synth3dlanes.production.events import Event, duration
from synth3dlanes.production.recipe import Recipe

# Measured on scenes of Appendix I at 480x360: core-seconds an image, bytes a pixel, bytes of text.
SECONDS_PER_PIXEL_SAMPLE, SECONDS_PER_PIXEL, SECONDS_PER_SCENE = 2.3e-6, 1.6e-6, 0.25
BYTES_PER_PIXEL = {"jpg": 0.45, "png": 1.6}
BYTES_PER_PIXEL_OF_PASS = {"depth": 2.4, "normal": 3.0, "semantic": 0.2, "instance": 0.4, "height": 0.3}
BYTES_OF_TEXT = 80_000
# A joined shard lies there twice for a moment.
SHARD_SAMPLES = 1000


@dataclass
class Meter:
    """Counts samples and tells the rate since the first one was done, so that starting up does not count."""

    asked: int
    missing: int
    made: int = 0
    set_aside: list[int] = field(default_factory=list)
    began: float = field(default_factory=time.monotonic)
    first: float = 0.0

    @property
    def done(self) -> int:
        """How many of the samples asked for are there."""
        return self.asked - self.missing

    @property
    def seconds(self) -> float:
        """Since the run began."""
        return time.monotonic() - self.began

    def sample(self) -> None:
        """One more is there."""
        self.first = self.first or time.monotonic()
        self.made += 1
        self.missing -= 1

    def lose(self, count: int) -> None:
        """Some that were there turned out broken."""
        self.missing += count

    def event(self, kind: str, message: str, details: dict[str, Any]) -> Event:
        """What happened, with where the run stands."""
        rate = (self.made - 1) / (time.monotonic() - self.first) if self.made > 1 else None
        left = self.missing - len(self.set_aside)
        eta_s = left / rate if rate else None
        return Event(
            kind, message, self.done, self.asked, len(self.set_aside), round(self.seconds, 3), rate, eta_s, details
        )


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


def forecast(recipe: Recipe, samples: int, workers: int) -> Forecast:
    """Time and size of `samples` more, from the measured costs of a pixel."""
    camera, settings = recipe.params.camera, recipe.settings
    pixels = camera.width_px.draw(0.5) * camera.height_px.draw(0.5)
    seconds = SECONDS_PER_SCENE + pixels * (SECONDS_PER_PIXEL + SECONDS_PER_PIXEL_SAMPLE * settings.samples)
    per_pixel = BYTES_PER_PIXEL[recipe.image_format] + sum(BYTES_PER_PIXEL_OF_PASS[name] for name in settings.passes)
    size = BYTES_OF_TEXT + int(pixels * per_pixel)
    return Forecast(
        samples, workers, samples * seconds / workers, samples * size, (samples + min(samples, SHARD_SAMPLES)) * size
    )


def open_log(folder: Path, split: str) -> io.FileIO:
    """A new log for JSON lines, each written out at once."""
    folder.mkdir(exist_ok=True)
    name = f"{split}-{datetime.now(UTC):%Y%m%dT%H%M%S}-{os.uname().nodename}-{os.getpid()}.jsonl"
    return io.FileIO(folder / name, "a")
