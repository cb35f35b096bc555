"""What a network runs on: the device and its precision, the processes of a run, cores, memory."""

import ctypes
import os
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import psutil
import torch

from synth3dlanes.system.errors import InputError
from synth3dlanes.system.machine import workers_here

from .config import TrainConfig

MAX_WORKERS = 16
# Constants from glibc's malloc.h.
M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4


@dataclass(frozen=True)
class Process:
    """This process among those started by torchrun; rank 0 of 1 without torchrun. `neighbours` run on one machine."""

    rank: int
    world: int
    device: torch.device
    neighbours: int = 1


def choose_device(name: str) -> torch.device:
    """The torch device; `auto` is the first GPU if there is one, else the CPU."""
    n_gpus = torch.cuda.device_count()
    if name == "auto":
        name = "cuda" if n_gpus else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError(f"device: expected auto, cpu or cuda[:n], got {name!r}") from None
    if device.type == "cuda" and (device.index or 0) >= n_gpus:
        raise InputError(f"device: expected one of the {n_gpus} GPUs that PyTorch sees here, got {name!r}")
    return device


def mixed_precision(device: torch.device, precision: str = "auto") -> AbstractContextManager[object]:
    """Autocast to bfloat16 if requested, or with `auto` if the hardware supports it (`TrainConfig.precision`)."""
    is_fast = device.type == "cuda" or torch.cpu.get_capabilities().get("avx512_bf16", False)
    if precision == "bfloat16" or (precision == "auto" and is_fast):
        return torch.autocast(device.type, dtype=torch.bfloat16)
    return nullcontext()


def start_process(config: TrainConfig) -> Process:
    """Choose the device of a training, and join the other processes if torchrun started several."""
    world, rank = int(os.environ.get("WORLD_SIZE", "1")), int(os.environ.get("RANK", "0"))
    device = choose_device(config.device)
    if config.batch % world:
        raise InputError(f"train.batch: expected a multiple of {world} processes, got {config.batch}")
    if world > 1:
        if device.type == "cuda":
            device = torch.device("cuda", int(os.environ["LOCAL_RANK"]))
            torch.cuda.set_device(device)
        torch.distributed.init_process_group("nccl" if device.type == "cuda" else "gloo")
    if device.type == "cuda":
        torch.backends.cudnn.benchmark = True
        torch.set_float32_matmul_precision("high")
    else:
        keep_freed_memory()
    return Process(rank, world, device, int(os.environ.get("LOCAL_WORLD_SIZE", "1")))


def spare_cores(neighbours: int = 1) -> int:
    """How many processes may decode for one of several neighbours: its share of the cores, less one for itself."""
    return min(MAX_WORKERS, max(1, workers_here() // neighbours - 1))


def free_gpu_bytes(device: torch.device) -> int:
    """The free memory of a GPU; 0 for the CPU."""
    return int(torch.cuda.mem_get_info(device)[0]) if device.type == "cuda" else 0


def free_memory_bytes() -> int:
    """The memory that can be had now: the machine's, or what is left of the limit of a container."""
    free: int = psutil.virtual_memory().available
    try:
        limit, used = (Path("/sys/fs/cgroup", name).read_text() for name in ("memory.max", "memory.current"))
        return min(free, int(limit) - int(used))
    except (OSError, ValueError):
        return free


def keep_freed_memory() -> None:
    """Let glibc's malloc reuse the memory of large tensors. By default each is mapped and unmapped at every step, and
    page faults take a quarter of the CPU time."""
    if hasattr(libc := ctypes.CDLL(None), "mallopt"):
        libc.mallopt(M_MMAP_MAX, 0)
        libc.mallopt(M_TRIM_THRESHOLD, 2**31 - 1)


def return_freed_memory() -> None:
    """Give back what is free. Threads have heaps of their own, in which a large picture leaves 200 MB."""
    if hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
        libc.malloc_trim(0)
