"""Checkpoints: tensors and plain values only, readable with `weights_only=True`.

`config` is the run's TrainConfig as JSON, so the network can be rebuilt from a checkpoint alone.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from pydantic import ConfigDict, ValidationError
from torch import Tensor, nn

from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import Folder, encoded
from synth3dlanes.system.schema import Excerpt, Positive, did_you_mean, validation_problems

from .config import CustomModel, ModelConfig, TrainConfig, changed, parse
from .data import FocalLengths
from .inference import Detector
from .loss import network_of
from .model import LaneNet
from .pretrained import load_weights, read_tensors

FORMAT = "synth3dlanes.baseline"
VERSION = 1
# Settings of 0.1.0 and 0.2.0 that are gone, and the value with which they changed nothing; None for any.
FORMER: dict[str, Any] = {
    "storage": None,
    "loss.bev_masks": None,
    "model.has_bev_masks": False,
    "model.plane_heights_m": [0.0],
}
SHIPPED = Path(__file__).parent / "weights" / "nano.pt"
STREETS, COMPACT = SHIPPED.with_name("streets.pt"), SHIPPED.with_name("compact.pt")
"""Weights in the package: of small networks for the paper's scenes and for photographs, and of a larger one for the
paper's scenes; docs/models.md says what made them."""


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Weights for inference (`model`, averaged over training steps) and, in `last.pt`, the state to resume from."""

    config: TrainConfig
    about: dict[str, Any]
    model: dict[str, Tensor]
    resume: dict[str, Any] | None


class _Trained(Excerpt):
    focal_px: tuple[Positive, Positive, Positive] | None = None  # not in those of 0.1.0


class _About(Excerpt):
    train: _Trained = _Trained()


class _Stored(Excerpt):
    model_config = ConfigDict(arbitrary_types_allowed=True)

    config: str
    about: _About
    model: dict[str, Tensor]
    resume: dict[str, Any] | None


def save(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint. A killed process and a failed write leave the old file or the new one, whole; earlier
    unfinished files are removed."""
    document = {
        "format": FORMAT,
        "version": VERSION,
        "config": checkpoint.config.model_dump_json(),
        "about": checkpoint.about,
        "model": checkpoint.model,
        "resume": checkpoint.resume,
    }
    folder = Folder(path.parent)
    folder.remove_unfinished(path.name)
    folder.write(path.name, encoded(lambda stream: torch.save(document, stream)))


def load(path: Path, own_model: str | None = None) -> Checkpoint:
    """Load a checkpoint; raise FormatError if it is not one of the baseline.

    Nothing that the file says is imported or called: a user's network is code, and a checkpoint of one is refused
    (InputError) unless `own_model` names it as training did. All that builds a network from a file begins here.
    """
    found = _read(path)
    model = found.config.model
    if isinstance(model, CustomModel) and own_model != model.build:
        raise InputError(f"model: expected {model.build}, whose network {path} holds, got {own_model or 'none'}")
    if own_model is not None and not isinstance(model, CustomModel):
        raise InputError(f"model: expected none for a checkpoint of {model.name}, got {own_model}")
    return found


def load_start(path: Path) -> tuple[dict[str, Tensor], ModelConfig | None, dict[str, Any]]:
    """The weights of a checkpoint, the settings of its network if it is one of ours, and what is told of it: for
    networks that the user has named, whichever network the weights were trained in."""
    found = _read(path)
    model = found.config.model
    return found.model, None if isinstance(model, CustomModel) else model, found.about


def _read(path: Path) -> Checkpoint:
    document = read_tensors(path, "a baseline checkpoint")
    found = (document.get("format"), document.get("version")) if isinstance(document, dict) else type(document).__name__
    if found != (FORMAT, VERSION):
        raise FormatError(f"{path}: expected {FORMAT} version {VERSION}, got {found!s:.60}")
    try:
        _Stored.model_validate(document)
    except ValidationError as error:
        raise FormatError("\n".join(validation_problems(error, str(path)))) from None
    try:
        settings = dict(json.loads(document["config"]))
    except (TypeError, ValueError, RecursionError) as error:
        raise FormatError(f"{path}: config: expected JSON, got {error!s:.60}") from None
    config = parse(TrainConfig, _without_former(settings), f"{path}: config")
    return Checkpoint(config, document["about"], document["model"], document["resume"])


def _without_former(settings: dict[str, Any]) -> dict[str, Any]:
    """The configuration without settings that later versions dropped, if they had no effect; settings that had one
    stay, and are refused."""
    for path, idle in FORMER.items():
        *above, name = path.split(".")
        group: Any = settings
        for key in above:
            group = group.get(key) if isinstance(group, dict) else None
        if isinstance(group, dict) and (idle is None or group.get(name) == idle):
            group.pop(name, None)
    return settings


def place(source: str | Path) -> Path:
    """The file of a checkpoint, given by its path or by the name of weights in the package. Raises InputError where
    there is none."""
    shipped = {file.stem: file for file in (SHIPPED, COMPACT, STREETS)}
    found = shipped.get(str(source), Path(source))
    if not os.path.lexists(found):
        meant = did_you_mean(str(source), shipped)
        raise InputError(f"{source}: expected a checkpoint or one of {', '.join(shipped)}, got no such file{meant}")
    return found


def fine_tuning(source: str, overrides: dict[str, Any]) -> TrainConfig:
    """The settings of a checkpoint of one of our networks, changed by dotted keys, for a training that starts from its
    weights. What belongs to the data and the machine of the earlier training is not taken over."""
    of_earlier = dict.fromkeys(("pretrained", "max_images", "workers", "keep_decoded"))
    return changed(load(place(source)).config, {**of_earlier, **overrides, "init": source})


def build(checkpoint: Checkpoint, device: torch.device) -> nn.Module:
    """The network of a checkpoint, in evaluation mode."""
    network = network_of(checkpoint.config.model)
    load_weights(network, checkpoint.model, "checkpoint", "the file")
    moved: nn.Module = network.to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    return moved.eval()


def load_lane_net(source: str | Path, device: torch.device) -> tuple[Checkpoint, LaneNet]:
    """A checkpoint, given as for `place`, and its network; raise InputError for a user's network."""
    checkpoint = _read(place(source))
    if isinstance(checkpoint.config.model, CustomModel):
        raise InputError("checkpoint: expected a named model (docs/baseline.md), got a network of your own")
    network = build(checkpoint, device)
    assert isinstance(network, LaneNet)
    return checkpoint, network


def detector(source: str | Path, device: torch.device, own_model: str | None = None) -> Detector:
    """The network of a checkpoint, given as for `place`, ready to detect lanes."""
    checkpoint = load(place(source), own_model)
    return detector_of(checkpoint, build(checkpoint, device))


def detector_of(checkpoint: Checkpoint, network: nn.Module) -> Detector:
    """The detector with this network, built of the checkpoint."""
    found = checkpoint.about.get("train", {}).get("focal_px")  # not in those of 0.1.0
    trained = None if found is None else FocalLengths(*found)
    return Detector(network, checkpoint.config.model.size_px, trained)
