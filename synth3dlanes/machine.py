"""What this machine renders on: asks Blender, in a process of its own, before anything else is begun."""

import os
from dataclasses import dataclass, replace

from synth3dlanes.devices import Device, choose, default_workers, masks
from synth3dlanes.errors import InputError
from synth3dlanes.generate import Recipe, require_blender
from synth3dlanes.workers import Limits, call


@dataclass(frozen=True)
class Seats:
    """How workers sit on this machine: a mask for each GPU (see `devices.masks`), and how many workers fill it."""

    masks: tuple[dict[str, str], ...] = ({},)
    workers: int = 1
    names: tuple[str, ...] = ()


def settle(recipe: Recipe) -> tuple[Recipe, Seats]:
    """The recipe with the device that it will be made on, and the seats there; raise InputError without that device.

    Pixels differ a little between devices, so the device found is part of the recipe: `dataset.json` records it, and
    samples of two devices do not mix.
    """
    require_blender()
    asked = recipe.settings.device
    found = () if asked == "cpu" else _ask(asked)
    kind = choose(asked, found)
    each = masks(kind, found, os.environ)
    names = tuple(device.name for device in found if device.kind == kind)
    seats = Seats(tuple(each), default_workers(kind, len(each), n_cores()), names)
    return replace(recipe, settings=replace(recipe.settings, device=kind)), seats


def n_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def list_devices() -> tuple[Device, ...]:
    """What Cycles finds; for a process that may carry Blender."""
    from synth3dlanes.blender.devices import found_devices

    return found_devices()


def _ask(asked: str) -> tuple[Device, ...]:
    outcome = call(Limits(), list_devices)
    if outcome.status != "done":
        raise InputError(
            f"device {asked}: expected Blender to list this machine's devices, got {outcome.reason}"
            f"\n{outcome.stderr}".rstrip()
        )
    devices: tuple[Device, ...] = outcome.value
    return devices
