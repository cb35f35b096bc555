"""What this machine renders on: asks Blender, in a process of its own, before anything else is begun."""

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from synth3dlanes.production.recipe import Recipe, require_blender
from synth3dlanes.production.workers import Limits, call
from synth3dlanes.settings import Device, choose_device

# A process sees only the GPUs that this variable names. Apple's machines have one.
MASK = {
    "optix": "CUDA_VISIBLE_DEVICES",
    "cuda": "CUDA_VISIBLE_DEVICES",
    "hip": "HIP_VISIBLE_DEVICES",
    "oneapi": "ZE_AFFINITY_MASK",
}
# On Linux, where every GPU has one: NVIDIA's, in Windows (WSL), AMD's, and all others'.
GPU_FILES = ("nvidia*", "dxg", "kfd", "dri/render*")
# At a few rays a pixel a GPU waits for the scene to be built most of the time.
WORKERS_PER_GPU = 4


@dataclass(frozen=True)
class WorkerSlots:
    """The places for workers on this machine: a mask for each GPU (see `masks`), and how many workers fill it."""

    masks: tuple[dict[str, str], ...] = ({},)
    workers: int = 1
    names: tuple[str, ...] = ()


def resolve_device(recipe: Recipe) -> tuple[Recipe, WorkerSlots]:
    """The recipe with the device that it will be made on, and the slots there; raise InputError without that device.

    Pixels differ a little between devices, so the device found is part of the recipe: `dataset.json` records it, and
    samples of two devices do not mix.
    """
    require_blender()
    asked = recipe.settings.device
    found = () if asked == "cpu" or (asked == "auto" and not may_have_gpu()) else _ask(asked)
    kind = choose_device(asked, found)
    each = masks(kind, found, os.environ)
    names = tuple(device.name for device in found if device.kind == kind)
    slots = WorkerSlots(tuple(each), default_workers(kind, len(each), n_cores()), names)
    return replace(recipe, settings=replace(recipe.settings, device=kind)), slots


def may_have_gpu(system: str = sys.platform, folder: Path = Path("/dev")) -> bool:
    """Whether to ask Blender, which takes a second: not on Linux without a device file of a GPU."""
    return system != "linux" or any(any(folder.glob(pattern)) for pattern in GPU_FILES)


def masks(kind: str, found: Sequence[Device], environment: Mapping[str, str]) -> list[dict[str, str]]:
    """For each GPU of this kind the environment of a process that is to see it alone; of the CPU, one empty one.

    A mask that is there already, as schedulers set them, is divided and never widened.
    """
    count = sum(device.kind == kind for device in found)
    variable = MASK.get(kind)
    if variable is None:
        return [{}]
    names = environment[variable].split(",") if environment.get(variable) else [str(i) for i in range(count)]
    return [{variable: name} for name in names[:count]]


def default_workers(kind: str, n_gpus: int, n_cores: int) -> int:
    """One a core; on GPUs so many that they do not wait."""
    return n_cores if kind == "cpu" else min(n_cores, WORKERS_PER_GPU * n_gpus)


def n_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def list_devices() -> tuple[Device, ...]:
    """What Cycles finds; for a process that may carry Blender."""
    from synth3dlanes.blender.devices import found_devices

    return found_devices()


def _ask(asked: str) -> tuple[Device, ...]:
    devices: tuple[Device, ...] = call(Limits(), list_devices).result(f"device {asked}: Blender cannot list devices")
    return devices
