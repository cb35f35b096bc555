"""The device that this machine renders on. A process of its own asks Blender for it before a run begins."""

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from synth3dlanes.production.recipe import Recipe, require_blender
from synth3dlanes.production.workers import Limits, call
from synth3dlanes.scene.settings import Device, choose_device
from synth3dlanes.system.machine import renderers_here

# A process sees only the GPUs that this variable names. Apple's machines have one.
MASK = {
    "optix": "CUDA_VISIBLE_DEVICES",
    "cuda": "CUDA_VISIBLE_DEVICES",
    "hip": "HIP_VISIBLE_DEVICES",
    "oneapi": "ZE_AFFINITY_MASK",
}
# Device files of GPUs on Linux: NVIDIA's, those in Windows (WSL), AMD's, and all others'.
GPU_FILES = ("nvidia*", "dxg", "kfd", "dri/render*")
# At a few rays a pixel a GPU waits for the scene to be built most of the time.
WORKERS_PER_GPU = 4


@dataclass(frozen=True)
class WorkerSlots:
    """The workers that this machine has room for: an environment mask for each GPU (see `masks`), and the number of
    workers."""

    masks: tuple[dict[str, str], ...] = ({},)
    workers: int = 1
    names: tuple[str, ...] = ()


def resolve_device(recipe: Recipe) -> tuple[Recipe, WorkerSlots]:
    """The recipe with the device that it will be rendered on, and this machine's slots for workers. Raises InputError
    if the device is not there.

    Pixels differ a little between devices, so the device is part of the recipe: `dataset.json` records it, and samples
    of two devices do not mix.
    """
    require_blender()
    asked = recipe.settings.device
    found = () if asked == "cpu" or (asked == "auto" and not may_have_gpu()) else _ask(asked)
    kind = choose_device(asked, found)
    each = masks(kind, found, os.environ)
    names = tuple(device.name for device in found if device.kind == kind)
    slots = WorkerSlots(tuple(each), default_workers(kind, len(each), renderers_here()), names)
    return replace(recipe, settings=replace(recipe.settings, device=kind)), slots


def may_have_gpu(system: str = sys.platform, folder: Path = Path("/dev")) -> bool:
    """Whether it is worth the second that asking Blender takes: on Linux, only if there is the device file of a GPU."""
    return system != "linux" or any(any(folder.glob(pattern)) for pattern in GPU_FILES)


def masks(kind: str, found: Sequence[Device], environment: Mapping[str, str]) -> list[dict[str, str]]:
    """The environment variables that show a process one GPU alone, for each GPU of this kind; for the CPU, one empty
    mapping. A mask that is set already, as by a scheduler, is divided and never widened."""
    count = sum(device.kind == kind for device in found)
    variable = MASK.get(kind)
    if variable is None:
        return [{}]
    names = environment[variable].split(",") if environment.get(variable) else [str(i) for i in range(count)]
    return [{variable: name} for name in names[:count]]


def default_workers(kind: str, n_gpus: int, most: int) -> int:
    """The default number of workers: the most there is room for; on GPUs, as many as keep them busy."""
    return most if kind == "cpu" else min(most, WORKERS_PER_GPU * n_gpus)


def list_devices() -> tuple[Device, ...]:
    """The devices that Cycles finds. Loads Blender into this process."""
    from synth3dlanes.blender.devices import found_devices

    return found_devices()


def _ask(asked: str) -> tuple[Device, ...]:
    devices: tuple[Device, ...] = call(Limits(), list_devices).result(f"device {asked}: Blender cannot list devices")
    return devices
