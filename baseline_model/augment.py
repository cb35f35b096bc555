"""Augmentation on the device, exact for 3D labels: mirroring, virtual camera rotation, moved top view, colours."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from .config import Augmentation
from .data import Batch
from .projection import pixel_rays, road_from_cam, top_from_road


class AugmentedBatch(NamedTuple):
    """The changed batch, how the top-view grid was moved on its plane, and standard normal noise for the pose that
    drives the warp."""

    batch: Batch
    top_from_road: Float[Tensor, "b 4 4"]
    pose_noise: Float[Tensor, "b 2"]


def generator_for(seed: int, step: int, rank: int, device: torch.device) -> torch.Generator:
    """The random generator of one step on one process; a resumed run repeats it without stored state."""
    mixed = (seed * 1_000_003 + step) * 1_009 + rank
    return torch.Generator(device).manual_seed(mixed & (2**63 - 1))


def augment(batch: Batch, config: Augmentation, generator: torch.Generator) -> AugmentedBatch:
    """Apply all enabled augmentations."""
    device, n = batch.image.device, len(batch.image)

    def uniform(limit: float) -> Float[Tensor, " b"]:
        return (torch.rand(n, generator=generator, device=device) * 2 - 1) * limit

    batch = flip(batch, torch.rand(n, generator=generator, device=device) < config.flip)
    pitch_rad, yaw_rad = uniform(math.radians(config.pitch_deg)), uniform(math.radians(config.yaw_deg))
    if config.pitch_deg or config.yaw_deg:
        batch = rotate(batch, pitch_rad, yaw_rad)
    if config.sharpness:
        batch = batch._replace(image=sharpen(batch.image, uniform(config.sharpness)))
    if config.saturation:
        batch = batch._replace(image=saturate(batch.image, uniform(config.saturation)))
    gain, offset = 1 + uniform(config.contrast), uniform(config.brightness)
    # One noise field for the batch, with strength and sign per image: a field per image took longer on a CPU than the
    # first convolution.
    noise = torch.randn(batch.image.shape[1:], generator=generator, device=device)
    offset = offset + (1 - gain) / 2
    gain, offset, strength = (v[:, None, None, None] for v in (gain, offset, uniform(config.noise)))
    if config.tint:
        tint = 1 + torch.stack([uniform(config.tint) for _ in range(3)], dim=1)[..., None, None]
        gain, offset = gain * tint, offset * tint
    image = torch.addcmul(offset, batch.image, gain).addcmul_(noise, strength).clamp_(0, 1)
    moved = top_from_road(uniform(math.radians(config.top_yaw_deg)), uniform(config.top_shift_m))
    pose_noise = torch.randn((n, 2), generator=generator, device=device)
    return AugmentedBatch(batch._replace(image=image), moved, pose_noise)


def sharpen(image: Float[Tensor, "b 3 h w"], amount: Float[Tensor, " b"]) -> Float[Tensor, "b 3 h w"]:
    """Move each pixel away from the mean of its four neighbours by this share of the difference; below 0 towards it,
    which blurs. Those of the border stay."""
    inner = image[..., 1:-1, 1:-1]
    above, below, left, right = image[..., :-2, 1:-1], image[..., 2:, 1:-1], image[..., 1:-1, :-2], image[..., 1:-1, 2:]
    mean = (above + below).add_(left).add_(right).mul_(0.25)
    sharp = image.clone()
    sharp[..., 1:-1, 1:-1] = inner.lerp(mean, -amount[:, None, None, None])
    return sharp


def saturate(image: Float[Tensor, "b 3 h w"], amount: Float[Tensor, " b"]) -> Float[Tensor, "b 3 h w"]:
    """Move each pixel away from its mean gray by this share of the difference; below 0 towards it: -1 leaves gray."""
    return image.lerp(image.mean(1, keepdim=True).expand_as(image), -amount[:, None, None, None])


def flip(batch: Batch, chosen: Bool[Tensor, " b"]) -> Batch:
    """Mirror left and right: x -> -x, cx -> W - cx. Anchors are assigned afterwards, from the mirrored order."""
    width = batch.image.shape[-1]
    image = batch.image.clone()
    image[chosen] = batch.image[chosen].flip(-1)
    intrinsics = batch.intrinsics.clone()
    intrinsics[:, 2] = torch.where(chosen, width - intrinsics[:, 2], intrinsics[:, 2])
    xyz = batch.curves.xyz_cam.clone()
    xyz[..., 0] = torch.where(chosen[:, None, None], -xyz[..., 0], xyz[..., 0])
    return batch._replace(image=image, intrinsics=intrinsics, curves=batch.curves._replace(xyz_cam=xyz))


def rotate(batch: Batch, pitch_rad: Float[Tensor, " b"], yaw_rad: Float[Tensor, " b"]) -> Batch:
    """Rotate the camera: pitch it down, and turn it right about the road's normal. For a pure rotation, the warp by
    K R K^-1 is exact for the whole scene. Yaw turns the lanes in the road frame; the pose's height is unchanged and its
    pitch increases by `pitch_rad`."""
    zero = torch.zeros_like(pitch_rad)
    road_from_old = road_from_cam(torch.stack([batch.plane_pose[:, 0], zero], dim=-1))[:, :3, :3]
    road_from_new = road_from_cam(torch.stack([batch.plane_pose[:, 0] + pitch_rad, zero], dim=-1))[:, :3, :3]
    # The heading turns right by yaw, so the world turns left (counter-clockwise from above) around the camera.
    turned = top_from_road(-yaw_rad, zero)[:, :3, :3]
    new_from_old = road_from_new.transpose(-1, -2) @ turned @ road_from_old
    curves = batch.curves._replace(xyz_cam=torch.einsum("bij,blnj->blni", new_from_old, batch.curves.xyz_cam))
    added = torch.stack([pitch_rad, zero], dim=-1)
    return batch._replace(
        image=_warp(batch.image, batch.intrinsics, new_from_old.transpose(-1, -2)),
        curves=curves,
        plane_pose=batch.plane_pose + added,
        target_pose=batch.target_pose + added,
    )


def _warp(
    image: Float[Tensor, "b 3 h w"], intrinsics: Float[Tensor, "b 4"], old_from_new: Float[Tensor, "b 3 3"]
) -> Float[Tensor, "b 3 h w"]:
    """The image of the rotated camera; pixels outside the original repeat its border."""
    height, width = image.shape[2], image.shape[3]
    fx, fy, cx, cy = (value[:, None, None] for value in intrinsics.unbind(-1))
    right, down = pixel_rays(intrinsics, height, width)
    rays_new = torch.stack([right, torch.ones_like(right), -down], dim=-1)
    rays_old = torch.einsum("bij,bhwj->bhwi", old_from_new, rays_new)
    u_old = cx + fx * rays_old[..., 0] / rays_old[..., 1]
    v_old = cy - fy * rays_old[..., 2] / rays_old[..., 1]
    grid = torch.stack([2 * u_old / width - 1, 2 * v_old / height - 1], dim=-1)
    return functional.grid_sample(image, grid, padding_mode="border", align_corners=False)
