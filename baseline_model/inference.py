"""Detect lanes in images with a trained network."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from synth3dlanes.errors import InputError

from .data import Samples, intrinsics_of, resize
from .lanes import AnchorLayout, Prediction, decode
from .model import LaneNet, Output
from .poses import Pose

Intrinsics = tuple[float, float, float, float]


def choose_device(name: str) -> torch.device:
    """The torch device; `auto` is the first GPU if there is one, else the CPU."""
    n_gpus = torch.cuda.device_count()
    if name == "auto":
        name = "cuda" if n_gpus else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError(f"device: expected auto, cpu or cuda[:n], got {name!r}") from None
    if device.type == "cuda" and (device.index or 0) >= n_gpus:
        raise InputError(f"device: expected one of the {n_gpus} GPUs that PyTorch sees here, got {name!r}")
    return device


def mixed_precision(device: torch.device, precision: str = "auto") -> AbstractContextManager[object]:
    """Autocast to bfloat16 if requested, or with `auto` if the hardware supports it (`TrainConfig.precision`)."""
    is_fast = device.type == "cuda" or torch.cpu.get_capabilities().get("avx512_bf16", False)
    if precision == "bfloat16" or (precision == "auto" and is_fast):
        return torch.autocast(device.type, dtype=torch.bfloat16)
    return nullcontext()


def layout_of(model: LaneNet) -> AnchorLayout:
    """The layout of the network's output."""
    config = model.config
    anchors_m = model.anchors_m.cpu().numpy().astype(float)
    return AnchorLayout(config.types, anchors_m, np.array(config.knots_y_m), config.spline)


def predictions_of(keys: Sequence[str], output: Output, layout: AnchorLayout) -> Iterator[Prediction]:
    """Decode a batch."""
    x_m, z_m, poses = (value.double().cpu().numpy() for value in (output.x_m, output.z_m, output.pose))
    scores = output.logit.double().sigmoid().cpu().numpy()
    logit = output.visible_logit
    seen = [None] * len(keys) if logit is None else logit.double().sigmoid().cpu().numpy()
    for i, key in enumerate(keys):
        pose = Pose(float(poses[i, 0]), float(poses[i, 1]))
        yield Prediction(key, decode(x_m[i], z_m[i], scores[i], pose, layout, seen[i]), pose)


@torch.inference_mode()
def run(model: LaneNet, images: Float[Tensor, "b 3 h w"], intrinsics: Float[Tensor, "b 4"]) -> Output:
    """One forward pass without gradients; in float32 on CPUs, so that all CPUs give the same lanes."""
    with mixed_precision(images.device, "auto" if images.device.type == "cuda" else "float32"):
        output: Output = model(images, intrinsics)
    return output


def predict_images(
    model: LaneNet, images: Iterable[tuple[str, UInt8[np.ndarray, "h w 3"], Intrinsics]], batch: int = 16
) -> Iterator[Prediction]:
    """Detect lanes in images of any size with known intrinsics (fx, fy, cx, cy in pixels)."""
    size_px = (model.config.image_height_px, model.config.image_width_px)
    device, layout = model.anchors_m.device, layout_of(model)
    waiting: list[tuple[str, UInt8[np.ndarray, "h w 3"], Intrinsics]] = []

    def flush() -> Iterator[Prediction]:
        if waiting:
            pixels = torch.from_numpy(np.stack([image for _, image, _ in waiting])).to(device)
            rgb = pixels.permute(0, 3, 1, 2).float().div(255).contiguous(memory_format=torch.channels_last)
            intrinsics = torch.tensor([values for _, _, values in waiting], device=device)
            yield from predictions_of([key for key, _, _ in waiting], run(model, rgb, intrinsics), layout)
            waiting.clear()

    for key, image, intrinsics in images:
        small, scaled = resize(image, intrinsics, size_px)
        waiting.append((key, small, scaled))
        if len(waiting) == batch:
            yield from flush()
    yield from flush()


def predict_samples(model: LaneNet, samples: Samples, batch: int = 16) -> Iterator[Prediction]:
    """Detect lanes in labelled images; only the intrinsics of the labels are used."""
    chosen = (samples[index] for index in range(len(samples)))
    return predict_images(model, ((s.key, np.array(s.image), intrinsics_of(s.labels)) for s in chosen), batch)
