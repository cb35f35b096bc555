"""Weights of a network as the start of one with more channels, more residual pairs or a close look.

The larger network computes the same at first (Chen, Goodfellow and Shlens, Net2Net, 2016): nothing of the old part
reads new channels yet, and a new pair adds nothing to its input.
"""

import re

import torch
from torch import Tensor

from .config import ModelConfig
from .model import LaneNet

SIZES = {
    "name",
    "image_channels",
    "image_blocks",
    "projected_channels",
    "top_channels",
    "head_channels",
    "pose_channels",
    "has_close_look",
}
"""In what a network may differ from a smaller one."""
NEW_PAIR = re.compile(r"(image\.stages\.\d+\.\d+\.)(first|second)\.")
LAST_NORM = ("second.1.weight", "second.1.bias")
JOINED = re.compile(r"top\.[12]\.1\.0\.weight|head\.reduce\.0\.0\.weight")
"""Convolutions of the top view's map of a level beside the projected map of the image."""


def grown(weights: dict[str, Tensor], small: ModelConfig, network: LaneNet) -> dict[str, Tensor]:
    """The weights of `network` that compute what those of the `small` one do. Where the two differ in more than in
    size, the weights given stay as they are, which `load_weights` refuses."""
    own, large = network.state_dict(), network.config
    is_alike = small.model_dump(exclude=SIZES) == large.model_dump(exclude=SIZES)
    may_grow = is_alike and large.backbone == "residual" and large.batch_norm
    found = dict(weights)
    for name, value in own.items():
        if name in weights:
            if may_grow:
                found[name] = _within(value, weights[name], _inputs(name, weights[name], small, large))
        elif name.startswith("close_look."):
            found[name] = value
        elif may_grow and (pair := NEW_PAIR.match(name)) and f"{pair[1]}shortcut.weight" not in own:
            found[name] = torch.zeros_like(value) if name.endswith(LAST_NORM) else value
    return found


def _within(large: Tensor, small: Tensor, inputs: list[int]) -> Tensor:
    """The large tensor with the small one in it, whose input channels go to `inputs`; the small one where it does not
    fit."""
    pairs = list(zip(small.shape, large.shape, strict=False))
    is_smaller = small.ndim == large.ndim and all(a <= b for a, b in pairs) and all(a == b for a, b in pairs[2:])
    if not is_smaller or small.shape == large.shape:
        return small
    whole = large.to(small.dtype, copy=True)
    if small.ndim < 2:
        whole[: len(small)] = small
        return whole
    whole[: len(small)] = 0
    whole[: len(small), inputs] = small
    return whole


def _inputs(name: str, weight: Tensor, small: ModelConfig, large: ModelConfig) -> list[int]:
    """Where the larger network has the input channels of a layer of the small one."""
    inputs = list(range(weight.shape[1])) if weight.ndim > 1 else []
    if large.variant == "full" and JOINED.fullmatch(name):
        level = int(name[4]) if name.startswith("top") else 3
        of_top, wider = small.top_channels[level - 1], large.top_channels[level - 1]
        return [i if i < of_top else i - of_top + wider for i in inputs]
    return inputs
