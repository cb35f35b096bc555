"""Eq. 1 of the paper, plus a term for our additional output. Per image, so that errors can name the sample."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from .anchors import Targets
from .config import LaneType, LossConfig
from .lane_head import Lanes
from .model import Output


def loss(
    output: Output,
    targets: Targets,
    target_pose: Float[Tensor, "b 2"],
    types: tuple[LaneType, ...],
    config: LossConfig,
) -> dict[str, Float[Tensor, " b"]]:
    """Loss terms of each image; `total` is their weighted sum.

    As in Eq. 1, geometry is summed over anchors and valid knots, in metres, without dividing by their number; hidden
    knots contribute 0. The pose term is in degrees and metres.
    """
    labelled = [("delimiter" if name == "d" else "centerline") in config.kinds for name in types]
    of_kind = torch.tensor(labelled, device=output.logit.device)[:, None]
    stages: list[Lanes | Output] = [*output.earlier, output]
    by_stage = [_of_lanes(lanes, targets, of_kind, config) for lanes in stages]
    terms = {name: torch.stack([of_stage[name] for of_stage in by_stage]).sum(0) for name in by_stage[0]}
    error = (output.pose - target_pose).abs()
    terms["pose"] = torch.rad2deg(error[:, 0]) + error[:, 1]
    terms["total"] = torch.stack([getattr(config, name) * value for name, value in terms.items()]).sum(0)
    return terms


def _of_lanes(
    lanes: Lanes | Output, targets: Targets, of_kind: Bool[Tensor, "t 1"], config: LossConfig
) -> dict[str, Float[Tensor, " b"]]:
    """The terms that lanes have, those of the head and those of each refinement."""
    entropy = functional.binary_cross_entropy_with_logits(lanes.logit, targets.assigned.float(), reduction="none")
    terms = {
        "detection": (entropy * (targets.scored & of_kind)).sum((1, 2)),
        "geometry": _geometry(lanes, targets, of_kind, config),
    }
    if lanes.visible_logit is not None:
        known = (targets.assigned & of_kind)[..., None]
        entropy = functional.binary_cross_entropy_with_logits(
            lanes.visible_logit, targets.visible.float(), reduction="none"
        )
        terms["visibility"] = (entropy * known).sum((1, 2, 3))
    return terms


def _geometry(
    lanes: Lanes | Output, targets: Targets, of_kind: Bool[Tensor, "t 1"], config: LossConfig
) -> Float[Tensor, " b"]:
    known = targets.in_range if config.supervise_occluded else targets.visible
    known = known & (targets.assigned & of_kind)[..., None]
    error_m = (lanes.x_m - targets.x_m).abs() + (lanes.z_m - targets.z_m).abs()
    if config.knot_sigma_m is not None:
        error_m = error_m / torch.tensor(config.knot_sigma_m, device=error_m.device)
    # `where` instead of a product, so that infinities at hidden knots do not become NaN.
    return torch.where(known, error_m, torch.zeros_like(error_m)).sum((1, 2, 3))
