"""What training minimises: Eq. 1 of the paper and our additions, or the loss of a user's own network.

Losses are per image, so that errors can name the sample.
"""

import importlib
import math
import os
import sys
from collections.abc import Sequence
from typing import Protocol, cast, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from synth3dlanes.system.errors import InputError

from .anchors import Targets, anchor_positions_m, encode
from .augment import AugmentedBatch
from .config import CustomModel, LossConfig, ModelConfig, TrainConfig
from .data import Batch
from .devices import mixed_precision
from .heads import Lanes
from .lanes import Detection
from .model import LaneNet, Output
from .projection import invert_rigid, road_from_cam

Terms = dict[str, Float[Tensor, " b"]]

ALONG = 0.5
"""Weight of the image error along the line, where a wrong height of the camera moves every point, beside that across
it, which the image alone tells."""
MIN_DEPTH_M = 1.0
MRAD = 1e-3


def loss(
    output: Output,
    targets: Targets,
    target_pose: Float[Tensor, "b 2"],
    cam_from_top: Float[Tensor, "b 4 4"],
    model: ModelConfig,
    config: LossConfig,
) -> Terms:
    """Loss terms of each image; `total` is their weighted sum. `cam_from_top` is that of the targets' frame.

    As in Eq. 1, geometry is summed over anchors and valid knots, in metres, without dividing by their number; hidden
    knots contribute 0. The pose term is in degrees and metres, the image term in milliradians.
    """
    labelled = [("delimiter" if name == "d" else "centerline") in config.kinds for name in model.types]
    of_kind = torch.tensor(labelled, device=output.logit.device)[:, None]
    known = targets.in_range if config.supervise_occluded else targets.visible
    known = known & (targets.assigned & of_kind)[..., None]
    stages: list[Lanes | Output] = [*output.earlier, output]
    by_stage = [_of_lanes(lanes, targets, of_kind, known, config) for lanes in stages]
    if config.image:
        x_m, y_m = (
            torch.tensor(values, device=known.device) for values in (anchor_positions_m(model), model.knots_y_m)
        )
        true = _in_image(targets, x_m, y_m, cam_from_top)
        for lanes, of_stage in zip(stages, by_stage, strict=True):
            error = _image_error(_in_image(lanes, x_m, y_m, cam_from_top), true)
            of_stage["image"] = torch.where(known, error, torch.zeros_like(error)).sum((1, 2, 3)) / MRAD
    terms = {name: torch.stack([of_stage[name] for of_stage in by_stage]).sum(0) for name in by_stage[0]}
    error = (output.pose - target_pose).abs()
    terms["pose"] = torch.rad2deg(error[:, 0]) + error[:, 1]
    terms["total"] = torch.stack([getattr(config, name) * value for name, value in terms.items()]).sum(0)
    return terms


def _of_lanes(
    lanes: Lanes | Output,
    targets: Targets,
    of_kind: Bool[Tensor, "t 1"],
    known: Bool[Tensor, "b t a k"],
    config: LossConfig,
) -> Terms:
    """The terms that lanes have, those of the head and those of each refinement."""
    entropy = functional.binary_cross_entropy_with_logits(lanes.logit, targets.assigned.float(), reduction="none")
    terms = {
        "detection": (entropy * (targets.scored & of_kind)).sum((1, 2)),
        "geometry": _geometry(lanes, targets, known, config),
    }
    if lanes.visible_logit is not None:
        entropy = functional.binary_cross_entropy_with_logits(
            lanes.visible_logit, targets.visible.float(), reduction="none"
        )
        terms["visibility"] = (entropy * (targets.assigned & of_kind)[..., None]).sum((1, 2, 3))
    return terms


def _geometry(
    lanes: Lanes | Output, targets: Targets, known: Bool[Tensor, "b t a k"], config: LossConfig
) -> Float[Tensor, " b"]:
    error_m = (lanes.x_m - targets.x_m).abs() + (lanes.z_m - targets.z_m).abs()
    if config.knot_sigma_m is not None:
        error_m = error_m / torch.tensor(config.knot_sigma_m, device=error_m.device)
    # `where` instead of a product, so that infinities at hidden knots do not become NaN.
    return torch.where(known, error_m, torch.zeros_like(error_m)).sum((1, 2, 3))


def _in_image(
    lanes: Lanes | Output | Targets,
    anchors_m: Float[Tensor, " a"],
    knots_y_m: Float[Tensor, " k"],
    cam_from_top: Float[Tensor, "b 4 4"],
) -> Float[Tensor, "b t a k 2"]:
    """Tangents of the viewing rays of the knots, right and up."""
    points_top = torch.stack([lanes.x_m + anchors_m[:, None], knots_y_m.expand_as(lanes.x_m), lanes.z_m], dim=-1)
    rotation, translation = cam_from_top[:, None, None, :3, :3], cam_from_top[:, None, None, None, :3, 3]
    points_cam = points_top @ rotation.transpose(-1, -2) + translation
    return points_cam[..., [0, 2]] / points_cam[..., 1:2].clamp_min(MIN_DEPTH_M)


def _image_error(seen: Float[Tensor, "b t a k 2"], true: Float[Tensor, "b t a k 2"]) -> Float[Tensor, "b t a k"]:
    """Errors across the true line and, less, along it, as the camera sees them."""
    ends = torch.cat([true[..., :1, :], true, true[..., -1:, :]], dim=-2)
    right, up = functional.normalize(ends[..., 2:, :] - ends[..., :-2, :], dim=-1).unbind(-1)
    off_right, off_up = (seen - true).unbind(-1)
    return (off_right * up - off_up * right).abs() + ALONG * (off_right * right + off_up * up).abs()


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


def network_of(config: ModelConfig | CustomModel) -> nn.Module:
    """The untrained network: ours, or what the user's function returns. Modules in the current folder are found too."""
    if isinstance(config, ModelConfig):
        return LaneNet(config)
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


def task_of(network: nn.Module, config: TrainConfig) -> nn.Module:
    """The module whose forward pass, on an augmented batch and the share of training that is done, is the loss."""
    return LaneNetTask(network, config) if isinstance(network, LaneNet) else CustomTask(network)


class LaneNetTask(nn.Module):
    """Our network with Eq. 1 of the paper and our additions to it."""

    def __init__(self, network: LaneNet, config: TrainConfig) -> None:
        super().__init__()
        self.network, self.config = network, config

    def forward(self, augmented: AugmentedBatch, done: float) -> Terms:
        """The loss terms of each image."""
        batch, config = augmented.batch, self.config
        warp_pose = None
        if done < config.label_pose_fraction:
            sd = torch.tensor([math.radians(config.label_pose_noise_deg), config.label_pose_noise_m])
            warp_pose = batch.target_pose + sd.to(batch.target_pose.device) * augmented.pose_noise
        with mixed_precision(batch.image.device, config.precision):
            output: Output = self.network(batch.image, batch.intrinsics, warp_pose, augmented.top_from_road)
        pose = output.pose if self.network.pose is None else batch.target_pose
        if config.target_frame == "grid":
            top_from_cam = invert_rigid(output.cam_from_top.detach())
        else:
            top_from_cam = augmented.top_from_road @ road_from_cam(pose)
        model = self.network.config
        targets, _ = encode(batch.curves, top_from_cam, model)
        return loss(output, targets, pose, invert_rigid(top_from_cam), model, config.loss)


class CustomTask(nn.Module):
    """A user's network with the loss that it brings."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, augmented: AugmentedBatch, done: float) -> Terms:
        """The loss terms of each image."""
        batch = augmented.batch
        terms = cast(LaneDetector, self.network).loss(batch)
        total = terms.get("total") if isinstance(terms, dict) else None
        if not (isinstance(total, Tensor) and total.shape == (len(batch.image),)):
            got = f"shape {tuple(total.shape)}" if isinstance(total, Tensor) else "none"
            raise InputError(f"model: expected loss() to return a dict with a `total` per image, got {got}")
        return terms
