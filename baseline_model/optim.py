"""Optimiser, learning-rate schedules and the running average of weights."""

import copy
import math
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import nn

from .config import TrainConfig

EMA_START = 10
"""The decay starts at (1 + step) / (10 + step), so that early weights are soon forgotten."""


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

    def state(self) -> dict[str, Any]:
        """Plain values for a checkpoint."""
        return asdict(self)


def optimizer_for(model: nn.Module, config: TrainConfig, device: torch.device) -> torch.optim.Optimizer:
    """Adam, or AdamW with weight decay on convolution and matrix weights only."""
    is_fused = device.type == "cuda"
    if config.optimizer == "adam":
        return torch.optim.Adam(model.parameters(), lr=config.learning_rate, fused=is_fused)
    matrices = [p for p in model.parameters() if p.ndim > 1]
    vectors = [p for p in model.parameters() if p.ndim <= 1]
    groups = [
        {"params": matrices, "weight_decay": config.weight_decay},
        {"params": vectors, "weight_decay": 0.0},
    ]
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
