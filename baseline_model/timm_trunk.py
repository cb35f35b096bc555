"""Trunks by name from timm (PyTorch Image Models), an optional package: `model.backbone=timm:resnet18`.

timm says neither where its features lie nor does it share a layout of layers, so their lattices are measured.
"""

import copy
from contextlib import suppress
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from synth3dlanes.system.errors import InputError, MissingPackageError

from .backbone import Lattice, Normalised
from .config import TIMM, ModelConfig

STRIDES = (2, 4, 8, 16)
PROBE_PX = 320
"""Size of the image in which lattices are measured: what a feature in its middle sees is hardly cut off."""


class UnevenError(ValueError):
    """The features of a map have no place in the image that is the same for all sizes."""


class TimmPathway(Normalised):
    """The maps of a timm network at strides 2, 4, 8, 16. Images are normalised as for most of timm's weights."""

    has_rays = False

    def __init__(self, config: ModelConfig, n_stages: int = 4) -> None:
        super().__init__()
        self.name = config.backbone.removeprefix(TIMM)
        self.indices = _indices(self.name)[:n_stages]
        self.trunk = create(self.name, out_indices=self.indices)
        self.former_weights = drop_unused(self.trunk)
        self.channels: tuple[int, ...] = tuple(self.trunk.feature_info.channels())
        try:
            self.lattices = measured_lattices(self.trunk, *config.size_px)
        except UnevenError as error:
            raise InputError(f"model.backbone: {_symmetric(self.name, *config.size_px) or error}") from None

    def forward(
        self, image: Float[Tensor, "b 3 h w"], rays: Float[Tensor, "b 2 h w"] | None = None
    ) -> list[Float[Tensor, "..."]]:
        """One map per stage, from RGB in 0..1; `rays` are not used."""
        maps: list[Tensor] = self.trunk((image - self.mean) / self.std)
        return maps

    def sizes(self, height_px: int, width_px: int) -> list[tuple[int, int]]:
        """Rows and columns of each map; most networks of timm round up."""
        trunk = copy.deepcopy(self.trunk).eval()
        with torch.no_grad():
            return [tuple(features.shape[2:]) for features in trunk(torch.zeros(1, 3, height_px, width_px))]


@torch.enable_grad()
def drop_unused(trunk: nn.Module) -> tuple[str, ...]:
    """Remove what no map depends on, as stages behind the last map; return the names of these parts. They would take
    time, and DistributedDataParallel waits for their gradients."""
    was_training = trunk.training
    maps = trunk.eval()(torch.zeros(1, 3, 64, 64))
    total = torch.stack([features.sum() for features in maps]).sum()
    weights = dict(trunk.named_parameters())
    gradients = torch.autograd.grad(total, list(weights.values()), allow_unused=True)
    used = {name for name, gradient in zip(weights, gradients, strict=True) if gradient is not None}
    dropped: list[str] = []
    for name, module in list(trunk.named_modules()):
        if isinstance(module, nn.Sequential | nn.ModuleList | nn.ModuleDict):
            continue  # a forward pass may go through its parts
        own = {f"{name}.{inner}" for inner, _ in module.named_parameters()}
        if name and own and not own & used and not name.startswith(tuple(f"{part}." for part in dropped)):
            trunk.set_submodule(name, nn.Identity())
            dropped.append(name)
    trunk.train(was_training)
    return tuple(f"trunk.{name}." for name in dropped)


@torch.enable_grad()
def measured_lattices(trunk: nn.Module, height_px: int, width_px: int) -> list[Lattice]:
    """Where the features of each map lie: the centres of what they see of the image, if all weights are equal.

    For two neighbours at centres a and b, which see equally much, the gradient g of their difference has the moments
    sum(g u) / sum(g u^2) = (a - b) / (a^2 - b^2) = 1 / (a + b). What both see, as by a mean over the image, cancels.
    """
    probe = copy.deepcopy(trunk).eval().requires_grad_(False)
    _make_averaging(probe)
    # Padding may depend on whether a map's size is even. Little light keeps activations that saturate at their slope.
    size = (1, 3, PROBE_PX + height_px % 32, PROBE_PX + width_px % 32)
    image = torch.full(size, 1e-3, requires_grad=True)
    lattices = []
    for stride, features in zip(STRIDES, probe(image), strict=False):
        seen = features.sum(1)[0]
        row, column = (n // 2 for n in seen.shape)
        # Neighbours in a row have the same profile over the rows, and cancel there.
        apart = 2 * seen[row, column] - seen[row + 1, column] - seen[row, column + 1]
        (gradient,) = torch.autograd.grad(apart, image, retain_graph=True)
        offsets = []
        for index, profile in ((row, gradient[0].sum((0, 2))), (column, gradient[0].sum((0, 1)))):
            # From the middle of the image, which keeps the squares small.
            u_px = torch.arange(len(profile)) + 0.5 - len(profile) / 2
            middle_px = float((profile * u_px**2).sum() / (profile * u_px).sum()) / 2 + len(profile) / 2
            offsets.append(middle_px - stride * (index + 0.5))
        offset = round(2 * offsets[0]) / 2
        if max(abs(found - offset) for found in offsets) > 0.1:
            raise UnevenError(f"expected features at whole or half pixels, got offsets {offsets}")
        lattices.append(Lattice(stride, offset))
    return lattices


def _make_averaging(module: nn.Module) -> None:
    """Replace weights by means, normalisations by nothing, and maxima by means."""
    for name, child in module.named_children():
        if isinstance(child, nn.Conv2d):
            nn.init.constant_(child.weight, 1 / child.weight[0].numel())
            if child.bias is not None:
                nn.init.zeros_(child.bias)
        elif isinstance(child, nn.BatchNorm2d | nn.GroupNorm | nn.LayerNorm):
            setattr(module, name, nn.Identity())
        elif isinstance(child, nn.MaxPool2d):
            pool = nn.AvgPool2d(child.kernel_size, child.stride, child.padding, child.ceil_mode)
            setattr(module, name, pool)
        else:
            _make_averaging(child)


def _indices(name: str) -> tuple[int, ...]:
    """The places, among timm's maps, of the last ones at our strides."""
    strides = create(name).feature_info.reduction()
    if not set(STRIDES) <= set(strides):
        raise InputError(
            f"model.backbone: expected a network with maps at strides 2, 4, 8, 16, got {strides} of {name}"
        )
    return tuple(max(i for i, found in enumerate(strides) if found == stride) for stride in STRIDES)


def _symmetric(name: str, height_px: int, width_px: int) -> str | None:
    """What to take in the place of a network that pads as TensorFlow does; None for others."""
    if not name.startswith("tf_"):
        return None
    same = name.removeprefix("tf_").partition(".")[0]
    instead = "; a network with symmetric padding is timm:efficientnet_lite0"
    with suppress(InputError, UnevenError):
        measured_lattices(create(same, out_indices=_indices(same)), height_px, width_px)
        instead = f"; the same with symmetric padding is timm:{same}"
    return f"expected a network with symmetric padding, got {name}, which pads as TensorFlow does{instead}"


def create(name: str, *, features_only: bool = True, pretrained: bool = False, **settings: Any) -> Any:
    try:
        import timm  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError:
        raise MissingPackageError(f"timm, which has {name}, is not installed: pip install timm") from None
    except RuntimeError as error:  # as of torchvision, which timm imports, beside another build of torch
        build = torch.__version__.partition("+")[2]
        index = f" --index-url https://download.pytorch.org/whl/{build}" if build else ""
        raise MissingPackageError(
            f"timm, which has {name}, cannot be imported ({error!s:.60}): torchvision is of another build than torch; "
            f"pip install --force-reinstall --no-deps torchvision{index}"
        ) from None
    try:
        return timm.create_model(name, pretrained=pretrained, features_only=features_only, **settings)
    except (RuntimeError, AttributeError) as error:
        raise InputError(f"model.backbone: expected a network of timm, got {name}: {error!s:.100}") from None
