"""Checkpoints: tensors and plain values only, readable with `weights_only=True`.

`config` is the run's TrainConfig as JSON, so the network can be rebuilt from a checkpoint alone.
"""

import os
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from synth3dlanes.errors import FormatError

from .config import TrainConfig, parse
from .model import LaneNet

FORMAT = "synth3dlanes.baseline"
VERSION = 1


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Weights for inference (`model`, averaged over training steps) and, in `last.pt`, the state to resume from."""

    config: TrainConfig
    about: dict[str, Any]
    model: dict[str, Tensor]
    resume: dict[str, Any] | None


def save(path: Path, checkpoint: Checkpoint) -> None:
    """Write to a temporary file, flush, rename: a killed run leaves either the old or the new file."""
    document = {
        "format": FORMAT,
        "version": VERSION,
        "config": checkpoint.config.model_dump_json(),
        "about": checkpoint.about,
        "model": checkpoint.model,
        "resume": checkpoint.resume,
    }
    partial = path.with_name(path.name + ".tmp")
    with partial.open("wb") as file:
        torch.save(document, file)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


def load(path: Path) -> Checkpoint:
    """Load a checkpoint without executing code from it; raise FormatError if it is not a baseline checkpoint."""
    try:
        document = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FormatError(f"{path}: expected a baseline checkpoint, got {reason:.100}") from None
    found = (document.get("format"), document.get("version")) if isinstance(document, dict) else type(document)
    if found != (FORMAT, VERSION):
        raise FormatError(f"{path}: expected {FORMAT} version {VERSION}, got {found}")
    config = parse(TrainConfig, document["config"], f"{path}: config")
    return Checkpoint(config, document["about"], document["model"], document["resume"])


def build(checkpoint: Checkpoint, device: torch.device) -> LaneNet:
    """The network of a checkpoint, in evaluation mode."""
    model = LaneNet(checkpoint.config.model)
    model.load_state_dict(checkpoint.model)
    return model.to(device, memory_format=torch.channels_last).eval()  # type: ignore[call-overload]
