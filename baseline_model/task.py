"""A network and its loss as one module, as DistributedDataParallel wants it: ours, or a user's."""

import math
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from synth3dlanes.system.errors import InputError

from . import custom
from .anchors import encode
from .augment import AugmentedBatch
from .config import CustomModel, ModelConfig, TrainConfig
from .custom import LaneDetector
from .inference import mixed_precision
from .loss import loss
from .model import LaneNet, Output
from .projection import invert_rigid, road_from_cam

Terms = dict[str, Float[Tensor, " b"]]


def network_of(model: ModelConfig | CustomModel) -> nn.Module:
    """The untrained network."""
    return custom.build(model) if isinstance(model, CustomModel) else LaneNet(model)


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
        return self._terms(output, augmented)

    def _terms(self, output: Output, augmented: AugmentedBatch) -> Terms:
        """Against targets in the frame given by `target_frame`."""
        batch, network, config = augmented.batch, self.network, self.config
        pose = output.pose if network.pose is None else batch.target_pose
        if config.target_frame == "grid":
            top_from_cam = invert_rigid(output.cam_from_top.detach())
        else:
            top_from_cam = augmented.top_from_road @ road_from_cam(pose)
        targets, _ = encode(batch.curves, top_from_cam, network.config)
        return loss(output, targets, pose, invert_rigid(top_from_cam), network.config, config.loss)


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
