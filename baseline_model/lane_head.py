"""The lane head (paper, 3.3.2): the lanes of all anchors from a top-view map."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from .anchors import spread_m
from .config import ModelConfig
from .layers import convolution

PRIOR_LOGIT = -2.9
"""Initial confidence of 0.05, about the share of anchors with a lane."""


class Lanes(NamedTuple):
    """The lane of each type and anchor at the knots, x relative to the anchor."""

    x_m: Float[Tensor, "b t a k"]
    z_m: Float[Tensor, "b t a k"]
    logit: Float[Tensor, "b t a"]
    visible_logit: Float[Tensor, "b t a k"] | None


class LaneHead(nn.Module):
    """Convolutions without padding along y reduce the map to one row; each of its columns is an anchor.

    Channels per anchor: for each type K offsets x, K heights z (unless the data are flat), a logit, and K visibility
    logits if configured."""

    def __init__(self, channels: int, rows: int, config: ModelConfig) -> None:
        super().__init__()
        width, batch_norm = config.head_channels, config.batch_norm
        layers: list[nn.Module] = []
        for kernel, at_most in ((3, 3), (5, rows)):
            while rows - (kernel - 1) >= 4 and sum(_kernel(layer) == kernel for layer in layers) < at_most:
                layers.append(convolution(channels, width, kernel, batch_norm=batch_norm, valid_rows=True))
                channels, rows = width, rows - (kernel - 1)
        self.reduce = nn.Sequential(*layers)
        self.fold = nn.Sequential(nn.Conv2d(channels, 2 * width, (rows, 5), padding=(0, 2)), nn.ReLU(inplace=True))
        self.parts = [len(config.knots_y_m)] * (1 + config.has_elevation) + [1]
        self.parts += [len(config.knots_y_m)] * config.has_visibility
        self.n_types, self.has_elevation = len(config.types), config.has_elevation
        self.out = nn.Conv2d(2 * width, self.n_types * sum(self.parts), (1, 5), padding=(0, 2))
        nn.init.normal_(self.out.weight, std=0.01)
        nn.init.zeros_(self.out.bias)  # type: ignore[arg-type]
        self.x_spread_m: Tensor
        self.z_spread_m: Tensor
        for name, values in zip(("x_spread_m", "z_spread_m"), spread_m(config), strict=True):
            self.register_buffer(name, values, persistent=False)

    def forward(self, features: Float[Tensor, "b c h w"]) -> Lanes:
        """The lanes."""
        raw = self.out(self.fold(self.reduce(features)))[:, :, 0].float()
        values = raw.unflatten(1, (self.n_types, -1)).transpose(2, 3)
        parts = list(values.split(self.parts, dim=-1))
        x_m = parts.pop(0) * self.x_spread_m
        z_m = parts.pop(0) * self.z_spread_m if self.has_elevation else torch.zeros_like(x_m)
        logit = parts.pop(0)[..., 0] + PRIOR_LOGIT
        return Lanes(x_m, z_m, logit, parts.pop(0) if parts else None)


def _kernel(layer: nn.Module) -> int:
    first = layer[0] if isinstance(layer, nn.Sequential) else layer
    return int(first.kernel_size[0]) if isinstance(first, nn.Conv2d) else 0
