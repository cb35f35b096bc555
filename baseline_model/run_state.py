"""The state of a training run: model, optimiser, learning rate, running average of weights, `last.pt`."""

import copy
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from synth3dlanes.dataset.locks import locks
from synth3dlanes.system.errors import ClaimedError, FormatError, InputError
from synth3dlanes.system.files import Folder

from . import checkpoint as checkpoints
from .config import CustomModel, TrainConfig
from .devices import Process
from .loss import network_of
from .model import LaneNet
from .pretrained import grown, load_pretrained, load_weights

EMA_START = 10
"""The decay starts at (1 + step) / (10 + step), so that early weights are soon forgotten."""
CHANGEABLE = frozenset(
    ("device", "epochs", "batch", "validate_every_epochs", "precision", "compile", "workers", "keep_decoded")
)
"""Settings that may differ when a run is resumed; a longer `epochs` extends a finished one."""


@dataclass
class Schedule:
    """Learning rate at each step. `cyclic` is our interpretation of the paper's "variation on the cyclic learning rate
    regime": cosine cycles from the peak to 1e-6; the peak is halved after a cycle that did not improve validation."""

    peak_factor: float = 1.0
    best_of_past_cycles: float = -1.0
    best_of_this_cycle: float = -1.0
    cycle: int = 0

    def rate(self, step: int, n_steps: int, steps_per_epoch: int, config: TrainConfig) -> float:
        """Learning rate of this step."""
        if config.schedule == "cyclic":
            period = max(1, round(config.cycle_epochs * steps_per_epoch))
            share, peak = (step % period) / period, config.learning_rate * self.peak_factor
        else:
            n_warmup = round(config.warmup_fraction * n_steps)
            if step < n_warmup:
                return config.learning_rate * (step + 1) / n_warmup
            share, peak = (step - n_warmup) / max(1, n_steps - n_warmup), config.learning_rate
        low = min(config.min_learning_rate, peak)
        return low + (peak - low) * (1 + math.cos(math.pi * share)) / 2

    def validated(self, score: float, step: int, steps_per_epoch: int, config: TrainConfig) -> None:
        """Record a validation's score; at the end of a cycle, set the next peak."""
        self.best_of_this_cycle = max(self.best_of_this_cycle, score)
        period = max(1, round(config.cycle_epochs * steps_per_epoch))
        if step // period > self.cycle:
            if self.best_of_this_cycle <= self.best_of_past_cycles:
                self.peak_factor /= 2
            self.best_of_past_cycles = max(self.best_of_past_cycles, self.best_of_this_cycle)
            self.best_of_this_cycle, self.cycle = -1.0, step // period


def optimizer_for(model: nn.Module, config: TrainConfig, device: torch.device) -> torch.optim.Optimizer:
    """Adam, or AdamW with weight decay on convolution and matrix weights only."""
    is_fused = device.type == "cuda"
    if config.optimizer == "adam":
        return torch.optim.Adam(model.parameters(), lr=config.learning_rate, fused=is_fused)
    matrices = [p for p in model.parameters() if p.ndim > 1]
    vectors = [p for p in model.parameters() if p.ndim <= 1]
    groups = [{"params": matrices, "weight_decay": config.weight_decay}, {"params": vectors, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, lr=config.learning_rate, fused=is_fused)


class RunningAverage:
    """Exponential average of weights and batch-norm statistics; evaluation and `best.pt` use it. torch's AveragedModel
    counts the updates itself, so a checkpoint would have to hold that count beside the step."""

    def __init__(self, model: nn.Module, decay: float) -> None:
        self.model = copy.deepcopy(model)
        self.model.eval().requires_grad_(False)
        self.decay = decay

    @torch.no_grad()
    def update(self, model: nn.Module, step: int) -> None:
        """Update the average with the model's weights."""
        weight = 1 - min(self.decay, (1 + step) / (EMA_START + step))
        pairs = list(zip(self.model.state_dict().values(), model.state_dict().values(), strict=True))
        averages, currents = zip(*(pair for pair in pairs if pair[0].is_floating_point()), strict=True)
        # All in one call: a GPU needs longer to start one than to do it.
        torch._foreach_lerp_(averages, currents, weight)
        for average, current in pairs:
            if not average.is_floating_point():
                average.copy_(current)


@dataclass(eq=False)
class TrainingRun:
    """The configuration, folder and mutable state of a training run; `about` is told of it in its checkpoints."""

    config: TrainConfig
    process: Process
    out_dir: Path
    about: dict[str, Any]
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


def save(trainee: TrainingRun, about: dict[str, Any]) -> None:
    """Write `last.pt`, from which the run can go on."""
    if trainee.process.rank != 0:
        return
    resume = {
        "model": trainee.model.state_dict(),
        "optimizer": trainee.optimizer.state_dict(),
        "schedule": asdict(trainee.schedule),
        "step": trainee.step,
        "best": trainee.best,
        "history": trainee.history,
    }
    weights = trainee.average.model.state_dict()
    checkpoints.save(trainee.out_dir / "last.pt", checkpoints.Checkpoint(trainee.config, about, weights, resume))


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
    is_resumed = os.path.lexists(out_dir / "last.pt")
    if not is_resumed:
        about = about | _start(model, config)
    model = model.to(process.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    average, optimizer = RunningAverage(model, config.ema_decay), optimizer_for(model, config, process.device)
    trainee = TrainingRun(config, process, out_dir, about, model, average, optimizer)
    if is_resumed:
        _resume(trainee)
    return trainee


def _start(model: nn.Module, config: TrainConfig) -> dict[str, str]:
    """Load the weights that a new run starts from, a package's or another run's, which may be of a smaller network;
    return descriptions of them."""
    about = {}
    if config.pretrained is not None:
        if not isinstance(model, LaneNet):
            raise InputError("pretrained: expected a named model with a vgg16 trunk (paper), got a network of your own")
        about["pretrained"] = load_pretrained(model, config.pretrained)
    if config.init is not None:
        weights, small, of_init = checkpoints.load_start(checkpoints.place(config.init))
        if isinstance(model, LaneNet) and small is not None:
            weights = grown(weights, small, model)
        load_weights(model, weights, "init", config.init)
        about["init"] = f"{config.init}, trained on {of_init.get('train', {}).get('n_images', '?')} images"
    return about


def _resume(trainee: TrainingRun) -> None:
    """Continue from `last.pt`. With another batch, the run continues after as many images, in whole batches."""
    config, last = trainee.config, trainee.out_dir / "last.pt"
    found = checkpoints.load(last, config.model.build if isinstance(config.model, CustomModel) else None)
    wrong = [
        name
        for name in TrainConfig.model_fields
        if name not in CHANGEABLE and getattr(found.config, name) != getattr(config, name)
    ]
    if wrong:
        raise InputError(f"{trainee.out_dir}: holds a run with other settings ({', '.join(wrong)})")
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
        raise FormatError(f"{last}: expected the state of a run, got damaged: {reason:.100}") from None
    trainee.about |= {name: found.about[name] for name in ("pretrained", "init") if name in found.about}
