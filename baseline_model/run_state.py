"""The state of a training run: processes, model, optimiser, `last.pt`."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from synth3dlanes.dataset.locks import locks
from synth3dlanes.system.errors import ClaimedError, FormatError, InputError
from synth3dlanes.system.files import Folder

from . import checkpoint as checkpoints
from .config import CustomModel, TrainConfig
from .growth import grown
from .inference import choose_device
from .loading import Process
from .malloc import keep_freed_memory
from .model import LaneNet
from .optim import RunningAverage, Schedule, optimizer_for
from .pretrained import load_pretrained
from .task import network_of
from .tensors import load_weights

CHANGEABLE = frozenset(
    ("device", "epochs", "batch", "validate_every_epochs", "precision", "compile", "workers", "keep_decoded")
)
"""Settings that may differ when a run is resumed; a longer `epochs` extends a finished one."""


@dataclass(eq=False)
class TrainingRun:
    """The configuration and mutable state of a training run."""

    config: TrainConfig
    process: Process
    model: nn.Module
    average: RunningAverage
    optimizer: torch.optim.Optimizer
    schedule: Schedule = field(default_factory=Schedule)
    step: int = 0
    best: float = -1.0
    history: list[dict[str, Any]] = field(default_factory=list)
    saved_step: int = 0
    saved_batch: int = 0
    """The step of `last.pt`, and the batch of the steps before it."""


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
        keep_freed_memory()
    return Process(rank, world, device, int(os.environ.get("LOCAL_WORLD_SIZE", "1")))


def save(trainee: TrainingRun, out_dir: Path, about: dict[str, Any]) -> None:
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


def last_saved(out_dir: Path) -> tuple[int, int] | None:
    """What tells whether another process has written `last.pt` since; None where there is none."""
    try:
        found = os.lstat(out_dir / "last.pt")
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_mtime_ns


@contextmanager
def claimed(out_dir: Path, process: Process, read: tuple[int, int] | None) -> Iterator[None]:
    """The folder of a run, made if missing, while no other training writes it; `read` is what `last_saved` was when the
    state of the run was read. Raises ClaimedError."""
    folder = Folder(out_dir)
    folder.make()
    if process.rank != 0:
        yield
        return
    with locks(folder, ".") as held:
        if not held.take(0):
            raise ClaimedError(
                f"out {out_dir}: expected no other training at work here, got one; wait until it is done"
            )
        if last_saved(out_dir) != read:
            raise ClaimedError(f"out {out_dir}: another training has just been at work here; run it again to resume")
        yield


def prepare(config: TrainConfig, process: Process, out_dir: Path, about: dict[str, Any]) -> TrainingRun:
    """Start a new run, or resume the one in `out_dir`."""
    torch.manual_seed(config.seed)
    model = network_of(config.model)
    last = out_dir / "last.pt"
    is_resumed = os.path.lexists(last)
    if not is_resumed:
        about |= _start(model, config)
    model = model.to(process.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    trainee = TrainingRun(
        config,
        process,
        model,
        RunningAverage(model, config.ema_decay),
        optimizer_for(model, config, process.device),
    )
    if is_resumed:
        found = checkpoints.load(last, config.model.build if isinstance(config.model, CustomModel) else None)
        _resume(trainee, found, out_dir)
        about |= {name: found.about[name] for name in ("pretrained", "init") if name in found.about}
    return trainee


def _start(model: nn.Module, config: TrainConfig) -> dict[str, str]:
    """Load the weights that a new run starts from; return descriptions of them."""
    about = {}
    if config.pretrained is not None:
        if not isinstance(model, LaneNet):
            raise InputError("pretrained: expected a named model with a vgg16 trunk (paper), got a network of your own")
        about["pretrained"] = load_pretrained(model, config.pretrained)
    if config.init is not None:
        about["init"] = _start_from(model, config.init)
    return about


def _resume(trainee: TrainingRun, found: checkpoints.Checkpoint, out_dir: Path) -> None:
    """Continue from `last.pt`. With another batch, the run continues after as many images, in whole batches."""
    config = trainee.config
    wrong = [
        name
        for name in TrainConfig.model_fields
        if name not in CHANGEABLE and getattr(found.config, name) != getattr(config, name)
    ]
    if wrong:
        raise InputError(f"{out_dir}: holds a run with other settings ({', '.join(wrong)})")
    state = found.resume or {}
    try:
        trainee.model.load_state_dict(state["model"])
        trainee.average.model.load_state_dict(found.model)
        trainee.optimizer.load_state_dict(state["optimizer"])
        trainee.schedule = Schedule(**state["schedule"])
        trainee.saved_step, trainee.saved_batch = int(state["step"]), found.config.batch
        trainee.step = trainee.saved_step * found.config.batch // config.batch
        trainee.best, trainee.history = float(state["best"]), list(state["history"])
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error).partition("\n")[0]
        raise FormatError(f"{out_dir / 'last.pt'}: expected the state of a run, got damaged: {reason:.100}") from None


def _start_from(model: nn.Module, source: str) -> str:
    """Load another run's weights, which may be of a smaller network; return a description of them."""
    weights, small, about = checkpoints.load_start(checkpoints.place(source))
    if isinstance(model, LaneNet) and small is not None:
        weights = grown(weights, small, model)
    load_weights(model, weights, "init", source)
    return f"{source}, trained on {about.get('train', {}).get('n_images', '?')} images"
