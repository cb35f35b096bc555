"""Which device to render on, decided from what was found; and how each worker is shown one GPU alone. No bpy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from synth3dlanes.errors import InputError

BEST_FIRST = ("optix", "cuda", "hip", "oneapi", "metal", "cpu")
# A process sees only the GPUs that this variable names. Apple's machines have one.
MASK = {
    "optix": "CUDA_VISIBLE_DEVICES",
    "cuda": "CUDA_VISIBLE_DEVICES",
    "hip": "HIP_VISIBLE_DEVICES",
    "oneapi": "ZE_AFFINITY_MASK",
}
# At a few rays a pixel a GPU waits for the scene to be built most of the time.
WORKERS_PER_GPU = 4


@dataclass(frozen=True)
class Device:
    """Something that Cycles can render on; `kind` is one of `settings.DEVICES` but auto."""

    kind: str
    name: str


def choose(asked: str, found: Sequence[Device]) -> str:
    """The kind asked for, or for `auto` the best there is; raise InputError where it is absent."""
    kinds = {device.kind for device in found} | {"cpu"}
    if asked != "auto" and asked not in kinds:
        names = ", ".join(f"{device.kind} ({device.name})" for device in found) or "nothing"
        raise InputError(f"device: expected {asked} on this machine, found {names}")
    return asked if asked != "auto" else next(kind for kind in BEST_FIRST if kind in kinds)


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
