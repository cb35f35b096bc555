"""Render settings: everything about the pictures that is not in the scene itself. No bpy."""

from collections.abc import Sequence
from dataclasses import dataclass

from synth3dlanes.system.errors import InputError

# Passes with the image's pixels, and all passes: these and the height map over the road plane.
PIXEL_PASSES = ("depth", "normal", "semantic", "instance")
PASSES = (*PIXEL_PASSES, "height")
# JPEG quality, 1 to 100, of scenes that do not set one.
JPEG_QUALITY = 95
# Legal names of splits, and the most samples of a split and of a shard: keys have eight digits.
MAX_SEED = 2**128
SPLIT_NAME, MAX_SAMPLES, MAX_SHARD_SIZE = "[A-Za-z0-9_-]+", 100_000_000, 1_000_000
# The most views of a world.
MAX_VIEWS = 64
# The scenes of a split that may be drawn for one sample until one fits a condition; the numbers of all scenes.
SCENES_OF_ONE = 100_000
# How many of those are drawn before a sample is given up, by default.
TRIES = 1000
N_SCENE_NUMBERS = MAX_SAMPLES * SCENES_OF_ONE
DEVICES = ("auto", "cpu", "cuda", "optix", "hip", "oneapi", "metal")
BEST_DEVICE_FIRST = ("optix", "cuda", "hip", "oneapi", "metal", "cpu")
QUALITY_SAMPLES = {"train": 1, "draft": 2, "standard": 4, "high": 8}


@dataclass(frozen=True)
class RenderSettings:
    """Samples per pixel, the passes to render in addition to the image, and the Cycles device. `lidar` counts as a pass
    if scenes have a lidar."""

    samples: int = QUALITY_SAMPLES["standard"]
    passes: tuple[str, ...] = ()
    device: str = "cpu"


@dataclass(frozen=True)
class Device:
    """A device that Cycles can render on; `kind` is one of DEVICES except auto."""

    kind: str
    name: str


def choose_device(asked: str, found: Sequence[Device]) -> str:
    """The requested kind, or the best one found for `auto`; raise InputError if it was not found."""
    kinds = {device.kind for device in found} | {"cpu"}
    if asked != "auto" and asked not in kinds:
        names = ", ".join(f"{device.kind} ({device.name})" for device in found) or "nothing"
        raise InputError(f"device: expected {asked} on this machine, found {names}")
    return asked if asked != "auto" else next(kind for kind in BEST_DEVICE_FIRST if kind in kinds)


# Depth of a pixel that hits nothing.
NO_HIT_DEPTH_M = float("inf")

# Environment variable with the path of a folder that a run's workers share; it is removed when the run ends.
SCRATCH = "SYNTH3DLANES_SCRATCH"
