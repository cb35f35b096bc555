"""The projective transformation layer (paper, 3.3): sample image maps at the top-view cells. In float32.

Frames: top (the road frame of the pose used in the warp, possibly moved on its plane) -> camera -> image.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from .backbone import Lattice
from .config import Grid

MIN_DEPTH_M = 0.05
OUTSIDE = -4.0
"""A normalised coordinate well outside every map: samples there are zero."""


def road_from_cam(pose: Float[Tensor, "b 2"]) -> Float[Tensor, "b 4 4"]:
    """`curves.road_from_cam` of a batch, differentiable: rotate by pitch about x, then move up by the height."""
    pitch, height = pose.unbind(-1)
    cos, sin, zero, one = pitch.cos(), pitch.sin(), torch.zeros_like(pitch), torch.ones_like(pitch)
    rows = [one, zero, zero, zero, zero, cos, sin, zero, zero, -sin, cos, height, zero, zero, zero, one]
    return torch.stack(rows, dim=-1).reshape(*pitch.shape, 4, 4)


def invert_rigid(b_from_a: Float[Tensor, "b 4 4"]) -> Float[Tensor, "b 4 4"]:
    """Inverse of a rigid transform."""
    a_from_b = torch.zeros_like(b_from_a)
    rotation = b_from_a[..., :3, :3].transpose(-1, -2)
    a_from_b[..., :3, :3] = rotation
    a_from_b[..., :3, 3] = -(rotation @ b_from_a[..., :3, 3:])[..., 0]
    a_from_b[..., 3, 3] = 1
    return a_from_b


def top_from_road(yaw_rad: Float[Tensor, " b"], shift_m: Float[Tensor, " b"]) -> Float[Tensor, "b 4 4"]:
    """The top frame whose grid is turned left by yaw about the camera's foot and moved right by shift."""
    cos, sin, zero, one = yaw_rad.cos(), yaw_rad.sin(), torch.zeros_like(yaw_rad), torch.ones_like(yaw_rad)
    rows = [cos, sin, zero, -shift_m, -sin, cos, zero, zero, zero, zero, one, zero, zero, zero, zero, one]
    return torch.stack(rows, dim=-1).reshape(-1, 4, 4)


def cell_centres(grid: Grid, level: int) -> Float[Tensor, "rows columns 3"]:
    """Positions of the cells of the map pooled `level` times, far rows first; level -1 has twice the resolution."""
    scale = 2.0**level
    rows, columns = int(grid.rows / scale), int(grid.columns / scale)
    x_m = (torch.arange(columns) + 0.5) * (grid.cell_x_m * scale) - grid.columns * grid.cell_x_m / 2
    # Pools drop odd rows at the near end, which is the end of the array.
    y_m = grid.y_min_m + grid.rows * grid.cell_y_m - (torch.arange(rows) + 0.5) * (grid.cell_y_m * scale)
    centres = torch.zeros(rows, columns, 3)
    centres[..., 0], centres[..., 1] = x_m, y_m[:, None]
    return centres


def sampling_grid(
    points_top: Float[Tensor, "*b rows columns 3"],
    cam_from_top: Float[Tensor, "n 4 4"],
    intrinsics: Float[Tensor, "n 4"],
    lattice: Lattice,
    size: tuple[int, int],
) -> Float[Tensor, "n rows columns 2"]:
    """Coordinates for `grid_sample(align_corners=False)` on a map of `size` (rows, columns) with that lattice.

    Coordinates are normalised by the map's own size, not the image's: 360 rows at stride 16 give 22 rows, which cover
    352 pixels."""
    rotation, translation = cam_from_top[:, :3, :3], cam_from_top[:, :3, 3]
    points_cam = points_top @ rotation[:, None].transpose(-1, -2) + translation[:, None, None]
    fx, fy, cx, cy = (value[:, None, None] for value in intrinsics.unbind(-1))
    depth = points_cam[..., 1].clamp_min(MIN_DEPTH_M)
    u_px = cx + fx * points_cam[..., 0] / depth
    v_px = cy - fy * points_cam[..., 2] / depth
    index = torch.stack([u_px, v_px], dim=-1).sub(lattice.offset).div(lattice.stride)
    extent = torch.tensor([size[1], size[0]], dtype=index.dtype, device=index.device)
    grid = (2 * (index + 0.5) / extent - 1).clamp(OUTSIDE, -OUTSIDE)
    behind = points_cam[..., 1:2] < MIN_DEPTH_M
    return torch.where(behind, torch.full_like(grid, OUTSIDE), grid)


def pixel_rays(
    intrinsics: Float[Tensor, "b 4"], height: int, width: int
) -> tuple[Float[Tensor, "b h w"], Float[Tensor, "b h w"]]:
    """Tangents of each pixel's viewing ray, right and down."""
    fx, fy, cx, cy = (value[:, None, None] for value in intrinsics.unbind(-1))
    u = (torch.arange(width, device=intrinsics.device) + 0.5)[None, None, :]
    v = (torch.arange(height, device=intrinsics.device) + 0.5)[None, :, None]
    return ((u - cx) / fx).expand(-1, height, -1), ((v - cy) / fy).expand(-1, -1, width)


def sample(
    features: Float[Tensor, "n c h w"],
    points_top: Float[Tensor, "*b rows columns 3"],
    cam_from_top: Float[Tensor, "n 4 4"],
    intrinsics: Float[Tensor, "n 4"],
    lattice: Lattice,
) -> Float[Tensor, "n c rows columns"]:
    """A map of images at points, bilinearly; zero outside the image."""
    grid = sampling_grid(points_top, cam_from_top, intrinsics, lattice, (features.shape[2], features.shape[3]))
    return functional.grid_sample(features, grid, align_corners=False)


class ImageMaps(NamedTuple):
    """Maps of images, where their features are in the images, and the cameras that took these."""

    maps: Sequence[Float[Tensor, "..."]]
    lattices: Sequence[Lattice]
    cam_from_top: Float[Tensor, "b 4 4"]
    intrinsics: Float[Tensor, "b 4"]


class Projection(nn.Module):
    """One projective transformation: image map -> top-view map of the road plane.

    If the number of channels changes, a 1x1 convolution without bias comes first: as a linear map it gives the same
    result as after the sampling, with less work."""

    def __init__(self, channels_in: int, channels_out: int, grid: Grid, level: int) -> None:
        super().__init__()
        same = channels_in == channels_out
        self.reduce = nn.Identity() if same else nn.Conv2d(channels_in, channels_out, 1, bias=False)
        self.points_top: Tensor
        self.register_buffer("points_top", cell_centres(grid, level), persistent=False)

    def forward(
        self,
        features: Float[Tensor, "b c h w"],
        cam_from_top: Float[Tensor, "b 4 4"],
        intrinsics: Float[Tensor, "b 4"],
        lattice: Lattice,
    ) -> Float[Tensor, "b d rows columns"]:
        """Sample bilinearly; zero outside the image."""
        features = self.reduce(features)
        with torch.autocast(features.device.type, enabled=False):
            sampled = sample(features.float(), self.points_top, cam_from_top, intrinsics, lattice)
        return sampled.contiguous(memory_format=torch.channels_last)
