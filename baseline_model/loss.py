"""Eq. 1 of the paper, and our additions. Per image, so that errors can name the sample."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from .anchors import Targets, anchor_positions_m
from .config import LossConfig, ModelConfig
from .lane_head import Lanes
from .model import Output

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
) -> dict[str, Float[Tensor, " b"]]:
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
) -> dict[str, Float[Tensor, " b"]]:
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
