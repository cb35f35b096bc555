"""A user's own network in the place of ours: what it has to offer, and how it is found by name (docs/baseline.md)."""

import importlib
import os
import sys
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor, nn

from synth3dlanes.system.errors import InputError

from .config import CustomModel
from .data import Batch
from .lanes import Detection


@runtime_checkable
class LaneDetector(Protocol):
    """What training, validation and prediction ask of an `nn.Module`."""

    def loss(self, batch: Batch) -> dict[str, Float[Tensor, " b"]]:
        """The terms of the loss of each image; `total` is what training lowers, the others are logged."""
        ...

    def detect(self, image: Float[Tensor, "b 3 h w"], intrinsics: Float[Tensor, "b 4"]) -> Sequence[list[Detection]]:
        """The lanes of each image, in camera coordinates. `image` is RGB in 0..1, `intrinsics` fx, fy, cx, cy in
        pixels; called in evaluation mode and without gradients."""
        ...


def build(config: CustomModel) -> nn.Module:
    """Call the function that `module:function` names; modules in the current folder are found too."""
    module_name, _, function_name = config.build.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        function = getattr(importlib.import_module(module_name), function_name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"model: expected a function {config.build}, got {error}") from None
    network = function(**config.arguments)
    if not (isinstance(network, nn.Module) and isinstance(network, LaneDetector)):
        what = type(network).__name__
        raise InputError(f"model: expected {config.build} to return an nn.Module with loss() and detect(), got {what}")
    return network
