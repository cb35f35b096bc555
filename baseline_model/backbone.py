"""The image-view pathway: VGG16, or residual pairs of given widths. Four maps at strides 2, 4, 8, 16, and the positions
of their features in the image (lattices).
"""

from collections.abc import Iterable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from .config import ModelConfig

# Mean and standard deviation of ImageNet, RGB in 0..1, as published VGG16 weights expect.
IMAGE_MEAN = (0.485, 0.456, 0.406)
IMAGE_STD = (0.229, 0.224, 0.225)


class Lattice(NamedTuple):
    """Feature i is at `offset + stride * i` of the input, in continuous pixels (the first pixel spans 0 to 1)."""

    stride: int
    offset: float


PIXELS = Lattice(1, 0.5)


def lattice_after(layers: Iterable[nn.Module], before: Lattice) -> Lattice:
    """The lattice after convolutions and pools: offset += stride * ((kernel - 1) / 2 - padding), stride *= step."""
    stride, offset = before
    for layer in layers:
        if isinstance(layer, nn.Conv2d | nn.MaxPool2d):
            assert not isinstance(layer.padding, str)
            kernel, step, padding = (_single(value) for value in (layer.kernel_size, layer.stride, layer.padding))
            offset += stride * ((kernel - 1) / 2 - padding)
            stride *= step
    return Lattice(stride, offset)


def convolution(
    channels_in: int, channels_out: int, kernel: int = 3, *, batch_norm: bool, valid_rows: bool = False, step: int = 1
) -> nn.Sequential:
    """Convolution, optional batch norm, ReLU. `valid_rows`: no padding along y, so the map loses rows."""
    padding = kernel // 2 if step == 1 else (kernel - step) // 2
    layer = nn.Conv2d(
        channels_in,
        channels_out,
        kernel,
        stride=step,
        padding=(0 if valid_rows else padding, padding),
        bias=not batch_norm,
    )
    nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
    norm: list[nn.Module] = [nn.BatchNorm2d(channels_out)] if batch_norm else []
    return nn.Sequential(layer, *norm, nn.ReLU(inplace=True))


def convolutions(channels_in: int, channels_out: int, n: int, *, batch_norm: bool) -> list[nn.Module]:
    """n 3x3 convolutions in a row, as in VGG."""
    return [convolution(channels_in if i == 0 else channels_out, channels_out, batch_norm=batch_norm) for i in range(n)]


class ResidualPair(nn.Module):
    """Two 3x3 convolutions with a shortcut connection; keeps the lattice."""

    def __init__(self, channels_in: int, channels_out: int, *, batch_norm: bool) -> None:
        super().__init__()
        self.first = convolution(channels_in, channels_out, batch_norm=batch_norm)
        self.second = convolution(channels_out, channels_out, batch_norm=batch_norm)[:-1]
        self.shortcut = nn.Identity() if channels_in == channels_out else nn.Conv2d(channels_in, channels_out, 1)
        self.relu = nn.ReLU(inplace=True)

    def forward(self, features: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d h w"]:
        """The pair's output."""
        out: Tensor = self.relu(self.second(self.first(features)) + self.shortcut(features))
        return out


def _single(value: int | tuple[int, ...]) -> int:
    return value if isinstance(value, int) else value[-1]


class Normalised(nn.Module):
    """A pathway that is given RGB in 0..1."""

    def __init__(self) -> None:
        super().__init__()
        self.mean: Tensor
        self.std: Tensor
        self.register_buffer("mean", torch.tensor(IMAGE_MEAN)[:, None, None], persistent=False)
        self.register_buffer("std", torch.tensor(IMAGE_STD)[:, None, None], persistent=False)


class ImagePathway(Normalised):
    """Normalises RGB in 0..1 and returns the map of each stage; `lattices` has the positions of their features."""

    def __init__(self, config: ModelConfig, n_stages: int = 4) -> None:
        super().__init__()
        self.has_rays = config.backbone == "residual"
        stages = _vgg_stages(config) if config.backbone == "vgg16" else _residual_stages(config)
        self.stages = nn.ModuleList(stages[:n_stages])
        self.channels: tuple[int, ...] = config.image_channels[:n_stages]
        self.lattices: list[Lattice] = []
        for stage in self.stages:
            self.lattices.append(lattice_after(_main_path(stage), self.lattices[-1] if self.lattices else PIXELS))

    def forward(
        self, image: Float[Tensor, "b 3 h w"], rays: Float[Tensor, "b 2 h w"] | None = None
    ) -> list[Float[Tensor, "..."]]:
        """One map per stage. `rays` are two more channels, the tangents of each pixel's viewing ray, from which a
        shallow network can infer the pitch."""
        features = torch.addcmul(-self.mean / self.std, image, 1 / self.std)
        if self.has_rays:
            assert rays is not None
            features = torch.cat([features, rays], dim=1)
        maps = []
        for stage in self.stages:
            features = stage(features)
            maps.append(features)
        return maps

    def sizes(self, height_px: int, width_px: int) -> list[tuple[int, int]]:
        """Rows and columns of each map: every stage halves, rounding down."""
        return [(height_px // 2 ** (i + 1), width_px // 2 ** (i + 1)) for i in range(len(self.stages))]


def _main_path(module: nn.Module) -> list[nn.Module]:
    """Layers in forward order, without the shortcuts of residual pairs, whose lattice is the same."""
    if isinstance(module, ResidualPair):
        return [*_main_path(module.first), *_main_path(module.second)]
    if isinstance(module, nn.Sequential):
        return [layer for child in module for layer in _main_path(child)]
    return [module]


def _vgg_stages(config: ModelConfig) -> list[nn.Module]:
    batch_norm = config.batch_norm
    first = convolutions(3, 64, 2, batch_norm=batch_norm)
    stages: list[nn.Module] = []
    channels = 64
    for index, (width, n) in enumerate(zip(config.image_channels, config.image_blocks, strict=True)):
        layers = [nn.MaxPool2d(2), *convolutions(channels, width, n, batch_norm=batch_norm)]
        stages.append(nn.Sequential(*first, *layers) if index == 0 else nn.Sequential(*layers))
        channels = width
    return stages


def _residual_stages(config: ModelConfig) -> list[nn.Module]:
    # The 4x4 step-2 convolution and the 2x2 pools keep features centred on their cells (offset = stride / 2).
    batch_norm = config.batch_norm
    stages: list[nn.Module] = []
    channels = config.image_channels[0]
    for index, (width, n) in enumerate(zip(config.image_channels, config.image_blocks, strict=True)):
        down = convolution(5, width, 4, batch_norm=batch_norm, step=2) if index == 0 else nn.MaxPool2d(2)
        pairs = [ResidualPair(channels if i == 0 else width, width, batch_norm=batch_norm) for i in range(n)]
        stages.append(nn.Sequential(down, *pairs))
        channels = width
    return stages
