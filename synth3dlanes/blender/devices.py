"""The device that this process renders on, through the preferences of the Cycles add-on."""

from typing import Any

import bpy

from synth3dlanes.scene.settings import Device, choose_device


def found_devices() -> tuple[Device, ...]:
    """All devices that Cycles finds on this machine; GPUs appear only after a refresh."""
    preferences = _preferences()
    preferences.refresh_devices()
    return tuple(Device(device.type.lower(), device.name) for device in preferences.devices)


def use_device(asked: str) -> None:
    """Render on all visible devices of this kind; raise InputError if there is none."""
    kind = "cpu" if asked == "cpu" else choose_device(asked, found_devices())
    preferences, options = _preferences(), bpy.context.scene.cycles
    options.device = "CPU" if kind == "cpu" else "GPU"
    options.denoising_use_gpu = kind != "cpu"
    if kind != "cpu":
        preferences.compute_device_type = kind.upper()
        for device in preferences.devices:
            device.use = device.type == kind.upper()


def _preferences() -> Any:
    return bpy.context.preferences.addons["cycles"].preferences
