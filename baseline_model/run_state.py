"""The state of a training run: processes, model, optimiser, `last.pt`."""

import ctypes
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from synth3dlanes.errors import InputError

from . import checkpoint as checkpoints
from .config import TrainConfig
from .data import ResidentData
from .inference import choose_device
from .model import LaneNet
from .optim import RunningAverage, Schedule, optimizer_for
from .pretrained import load_vgg16

MEMORY_SHARE = 0.5
"""Data are moved to the GPU if they take less than this share of its free memory."""

M_MMAP_MAX, M_TRIM_THRESHOLD = -4, -1
"""Constants from malloc.h."""


@dataclass(frozen=True)
class Process:
    """This process among those started by torchrun; rank 0 of 1 without torchrun."""

    rank: int
    world: int
    device: torch.device


@dataclass(eq=False)
class Run:
    """The configuration and mutable state of a training run."""

    config: TrainConfig
    process: Process
    model: LaneNet
    average: RunningAverage
    optimizer: torch.optim.Optimizer
    schedule: Schedule = field(default_factory=Schedule)
    step: int = 0
    best: float = -1.0
    history: list[dict[str, Any]] = field(default_factory=list)


def start_process(config: TrainConfig) -> Process:
    """Choose the device, and join the other processes if torchrun started several."""
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
        _keep_freed_memory()
    return Process(rank, world, device)


def _keep_freed_memory() -> None:
    """Let malloc reuse the memory of large tensors. By default each is mapped and unmapped at every step, and page
    faults take a quarter of the CPU time. glibc only; others have no `mallopt`."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        for option, value in ((M_MMAP_MAX, 0), (M_TRIM_THRESHOLD, 2**31 - 1)):
            mallopt(option, value)


def fits(data: ResidentData, device: torch.device) -> bool:
    """Whether the data fit into the GPU's memory."""
    parts = [data.image, data.intrinsics, *data.curves, *([] if data.chroma is None else [data.chroma])]
    free, _ = torch.cuda.mem_get_info(device)
    return sum(part.numel() * part.element_size() for part in parts) < MEMORY_SHARE * free


def save(trainee: Run, out_dir: Path, about: dict[str, Any]) -> None:
    if trainee.process.rank != 0:
        return
    resume = {
        "model": trainee.model.state_dict(),
        "optimizer": trainee.optimizer.state_dict(),
        "schedule": trainee.schedule.state(),
        "step": trainee.step,
        "best": trainee.best,
        "history": trainee.history,
    }
    weights = trainee.average.model.state_dict()
    checkpoints.save(out_dir / "last.pt", checkpoints.Checkpoint(trainee.config, about, weights, resume))


def prepare(config: TrainConfig, process: Process, out_dir: Path, about: dict[str, Any]) -> Run:
    """Start a new run, or resume the one in `out_dir`."""
    torch.manual_seed(config.seed)
    model = LaneNet(config.model)
    if config.pretrained is not None:
        about["pretrained"] = load_vgg16(model, config.pretrained)
    model = model.to(process.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    trainee = Run(
        config,
        process,
        model,
        RunningAverage(model, config.ema_decay),
        optimizer_for(model, config, process.device),
    )
    last = out_dir / "last.pt"
    if last.exists():
        found = checkpoints.load(last)
        if found.config != config:
            raise InputError(f"{out_dir}: holds a run with other settings ({_difference(found.config, config)})")
        assert found.resume is not None
        trainee.model.load_state_dict(found.resume["model"])
        trainee.average.model.load_state_dict(found.model)
        trainee.optimizer.load_state_dict(found.resume["optimizer"])
        trainee.schedule = Schedule(**found.resume["schedule"])
        trainee.step, trainee.best = found.resume["step"], found.resume["best"]
        trainee.history = found.resume["history"]
    out_dir.mkdir(parents=True, exist_ok=True)
    return trainee


def _difference(found: TrainConfig, wanted: TrainConfig) -> str:
    names = [name for name in TrainConfig.model_fields if getattr(found, name) != getattr(wanted, name)]
    return ", ".join(names)
