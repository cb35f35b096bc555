"""Building blocks, and the positions of features in the image (lattices)."""

from collections.abc import Iterable
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor, nn


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
