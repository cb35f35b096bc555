"""Read files of PyTorch: tensors and plain values only, no code."""

from pathlib import Path
from typing import Any

import torch
from torch import nn

from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import open_regular


def read_tensors(path: Path, what: str) -> Any:
    """What `torch.save` wrote, on the CPU; raise FormatError where it is not `what`, as in "a state dict"."""
    try:
        with open_regular(path) as stream:
            return torch.load(stream, map_location="cpu", weights_only=True)
    except (FormatError, MemoryError):
        raise
    except OSError as error:
        raise FormatError(f"{path}: expected {what}, got {error.strerror or error}") from None
    except Exception:  # noqa: BLE001 - the unpickler raises whatever damaged bytes lead to
        raise FormatError(f"{path}: expected {what}, got other or damaged bytes") from None


def load_weights(network: nn.Module, weights: dict[str, torch.Tensor], where: str, source: str | Path) -> None:
    """Load the weights of this very network; raise InputError, which begins with `where`, if they are another's."""
    # Earlier versions kept parts of timm's networks that nothing used. A user's modules may have any other attributes.
    former = tuple(
        f"{name}.{part}" for name, module in network.named_modules() for part in getattr(module, "former_weights", ())
    )
    weights = {name: value for name, value in weights.items() if not name.startswith(former)}
    own = network.state_dict()
    expected = {name: tuple(value.shape) for name, value in own.items()}
    given = {name: tuple(value.shape) for name, value in weights.items()}
    wrong = sorted(name for name in expected | given if expected.get(name) != given.get(name))
    if wrong:
        name = wrong[0]
        raise InputError(
            f"{where}: expected weights of this network, got {len(wrong)} others in {source}, "
            f"first {name}: {given.get(name, 'none')} for {expected.get(name, 'none')}"
        )
    network.load_state_dict(weights)


def state_dict(found: Any, path: Path) -> dict[str, torch.Tensor]:
    """The checked tensors of a state dict by name. Raises FormatError for anything else."""
    if not isinstance(found, dict):
        raise FormatError(f"{path}: expected a state dict, got {type(found).__name__}")
    for name, value in found.items():
        if not (isinstance(name, str) and isinstance(value, torch.Tensor)):
            raise FormatError(f"{path}: expected a tensor at {name!s:.60}, got {type(value).__name__}")
    return found
