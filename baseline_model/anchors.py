"""Encode curves as anchor targets of the network (paper, sections 3.3.2 and 3.4). Batched torch.

Frame: `top`, the road frame of the targets' pose, possibly moved and turned on its plane.
"""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from .config import ModelConfig
from .curves import HALF_WIDTH_M, NEAR_KNOTS_M, Y_REF_M

CENTERLINE, DELIMITER = 1, 2
"""Kinds in `CurveBatch.kind`; 0 is padding."""
ABSENT, KEPT, IGNORED, DROPPED = 0, 1, 2, 3
"""Status of a curve: `IGNORED` ones do not count anywhere, `DROPPED` ones found no free slot on their anchor."""
TIE_M = 0.2
MASK_AROUND_IGNORED_M = 0.64
# Standard deviation of targets over the paper's parameter ranges (Appendix I). The network's outputs are multiplied by
# these, which conditions the optimisation and keeps the loss in metres.
SPREAD_Y_M = (5.0, 20.0, 40.0, 60.0, 80.0, 100.0)
SPREAD_X_M = (0.59, 0.37, 1.7, 4.7, 8.8, 13.4)
SPREAD_Z_M = (0.07, 0.88, 3.4, 7.6, 12.7, 18.0)


class CurveBatch(NamedTuple):
    """Curves of a batch of images, near to far, padded with repeats of the last point."""

    xyz_cam: Float[Tensor, "b l n 3"]
    visible: Bool[Tensor, "b l n"]
    kind: Int[Tensor, "b l"]


class Targets(NamedTuple):
    """Targets per lane type and anchor, types as in `ModelConfig.types`. x is relative to the anchor."""

    x_m: Float[Tensor, "b t a k"]
    z_m: Float[Tensor, "b t a k"]
    in_range: Bool[Tensor, "b t a k"]
    visible: Bool[Tensor, "b t a k"]
    assigned: Bool[Tensor, "b t a"]
    scored: Bool[Tensor, "b t a"]
    """False next to an ignored lane, where confidence is not trained."""


def anchor_positions_m(config: ModelConfig) -> tuple[float, ...]:
    """x of each anchor: the centres of the last top-view map's columns; for `image_view`, the points where the centres
    of equal columns of the image meet the road at Y_ref under the fixed pose."""
    grid = config.grid
    if config.variant != "image_view":
        pitch_m = 8 * grid.cell_x_m
        n_anchors = grid.columns // 8
        return tuple((i - (n_anchors - 1) / 2) * pitch_m for i in range(n_anchors))
    fx, _, cx, _ = config.reference_intrinsics
    pitch_rad = torch.deg2rad(torch.tensor(config.fixed_pitch_deg, dtype=torch.float64))
    depth_m = float(Y_REF_M * torch.cos(pitch_rad) + config.fixed_height_m * torch.sin(pitch_rad))
    n_columns = config.image_width_px // 16
    n_anchors = config.image_view_anchors or n_columns
    return tuple((16 * n_columns / n_anchors * (i + 0.5) - cx) / fx * depth_m for i in range(n_anchors))


def spread_m(config: ModelConfig) -> tuple[Float[Tensor, " k"], Float[Tensor, " k"]]:
    """Standard deviation of the x and z targets at each knot."""
    knots = torch.tensor(config.knots_y_m)
    return _interpolate_table(knots, SPREAD_X_M), _interpolate_table(knots, SPREAD_Z_M)


def encode(
    curves: CurveBatch, top_from_cam: Float[Tensor, "b 4 4"], config: ModelConfig
) -> tuple[Targets, Int[Tensor, "b l"]]:
    """Assign every curve to the nearest anchor at Y_ref; return the targets and the status of each curve."""
    device = curves.xyz_cam.device
    knots = torch.tensor(config.knots_y_m, device=device)
    anchors = torch.tensor(anchor_positions_m(config), device=device)
    y_query = torch.cat([knots, torch.tensor([Y_REF_M, *NEAR_KNOTS_M], device=device)])
    xyz_top = transform_points(top_from_cam, curves.xyz_cam)
    x_m, z_m, in_range, visible = sample_curves(xyz_top, curves.visible, y_query)
    n_knots = len(knots)
    x_ref_m = x_m[..., n_knots]
    crosses = (curves.kind > 0) & in_range[..., n_knots]
    usable = crosses & (x_ref_m.abs() <= HALF_WIDTH_M) & (visible[..., n_knots + 1 :].sum(-1) >= 2)
    # argmin takes the first of equal minima: a curve midway between two anchors goes left.
    anchor = (x_ref_m[..., None] - anchors).abs().argmin(-1)
    at_knots = (x_m[..., :n_knots], z_m[..., :n_knots], in_range[..., :n_knots], visible[..., :n_knots])
    rank = _rank_from_left(at_knots[0], at_knots[3], x_ref_m, usable, anchor, curves.kind)
    slot = _slots(rank, usable, curves.kind, config)
    targets = _scatter(at_knots, slot, anchor, anchors, len(config.types))
    scored = targets.assigned | ~_near_ignored(x_ref_m, crosses & ~usable, curves.kind, anchors, config)
    status = torch.where(slot >= 0, KEPT, torch.where(usable, DROPPED, IGNORED))
    return targets._replace(scored=scored), torch.where(curves.kind > 0, status, ABSENT)


def transform_points(b_from_a: Float[Tensor, "b 4 4"], points_a: Float[Tensor, "b l n 3"]) -> Float[Tensor, "b l n 3"]:
    """Apply each image's rigid transform to its curves."""
    return torch.einsum("bij,blnj->blni", b_from_a[:, :3, :3], points_a) + b_from_a[:, None, None, :3, 3]


def sample_curves(
    xyz: Float[Tensor, "b l n 3"], visible: Bool[Tensor, "b l n"], y_m: Float[Tensor, " y"]
) -> tuple[Float[Tensor, "b l y"], Float[Tensor, "b l y"], Bool[Tensor, "b l y"], Bool[Tensor, "b l y"]]:
    """x, z, whether the curve reaches y, and whether it is visible there; linear between samples, clamped outside."""
    # A strong virtual yaw can fold a curve's far end; the search needs y sorted.
    y_curve = xyz[..., 1].cummax(-1).values
    query = y_m.expand(*y_curve.shape[:2], -1).contiguous()
    after = torch.searchsorted(y_curve, query).clamp(1, y_curve.shape[-1] - 1)
    below, above = (torch.gather(xyz, 2, i[..., None].expand(-1, -1, -1, 3)) for i in (after - 1, after))
    step = (above[..., 1] - below[..., 1]).clamp_min(1e-6)
    share = ((query - below[..., 1]) / step).clamp(0, 1)
    point = below + share[..., None] * (above - below)
    in_range = (query >= y_curve[..., :1]) & (query <= y_curve.amax(-1, keepdim=True))
    seen = torch.gather(visible, 2, after - 1) & torch.gather(visible, 2, after)
    return point[..., 0], point[..., 2], in_range, in_range & seen


def _rank_from_left(
    x_m: Float[Tensor, "b l k"],
    valid: Bool[Tensor, "b l k"],
    x_ref_m: Float[Tensor, "b l"],
    usable: Bool[Tensor, "b l"],
    anchor: Int[Tensor, "b l"],
    kind: Int[Tensor, "b l"],
) -> Int[Tensor, "b l"]:
    """Rank from the left of each curve among those of its kind on its anchor. Curves that coincide at Y_ref (a split or
    merge) are ordered by where they differ; a mirrored scene gives the mirrored order."""
    apart_ref = x_ref_m[:, :, None] - x_ref_m[:, None, :]
    both = valid[:, :, None] & valid[:, None, :]
    apart_elsewhere = ((x_m[:, :, None] - x_m[:, None, :]) * both).sum(-1)
    tied = (apart_ref.abs() < TIE_M) & (apart_elsewhere.abs() > 1e-3)
    apart = torch.where(tied, apart_elsewhere, apart_ref)
    rivals = usable[:, :, None] & usable[:, None, :]
    rivals &= (anchor[:, :, None] == anchor[:, None, :]) & (kind[:, :, None] == kind[:, None, :])
    # Counting wins and breaking equal counts by index gives distinct ranks even where "left of" is not transitive.
    wins = (rivals & (apart < 0)).sum(-1)
    index = torch.arange(kind.shape[1], device=kind.device)
    better = (wins[:, None, :] > wins[:, :, None]) | (
        (wins[:, None, :] == wins[:, :, None]) & (index[None, None, :] < index[None, :, None])
    )
    return (rivals & better).sum(-1)


def _slots(
    rank: Int[Tensor, "b l"], usable: Bool[Tensor, "b l"], kind: Int[Tensor, "b l"], config: ModelConfig
) -> Int[Tensor, "b l"]:
    """Index into `types` for each curve, -1 for none: c1 and c2 get the first two centre lines from the left, d the
    first delimiter."""
    slot = torch.full_like(rank, -1)
    wanted = {"c1": (CENTERLINE, 0), "c2": (CENTERLINE, 1), "d": (DELIMITER, 0)}
    for index, name in enumerate(config.types):
        lane_kind, place = wanted[name]
        slot = torch.where(usable & (kind == lane_kind) & (rank == place), index, slot)
    return slot


def _scatter(
    at_knots: tuple[Tensor, Tensor, Tensor, Tensor],
    slot: Int[Tensor, "b l"],
    anchor: Int[Tensor, "b l"],
    anchors: Float[Tensor, " a"],
    n_types: int,
) -> Targets:
    """Write curves into (type, anchor) cells; curves without a slot go to an extra cell, which is removed."""
    batch, _, n_knots = at_knots[0].shape
    n_cells = n_types * len(anchors)
    cell = torch.where(slot >= 0, slot * len(anchors) + anchor, n_cells)
    values = (at_knots[0] - anchors[anchor][..., None], *at_knots[1:])

    def place(value: Tensor) -> Tensor:
        filled = torch.zeros(batch, n_cells + 1, n_knots, dtype=value.dtype, device=value.device)
        filled = filled.scatter(1, cell[..., None].expand_as(value), value)
        return filled[:, :n_cells].reshape(batch, n_types, len(anchors), n_knots)

    assigned = torch.zeros(batch, n_cells + 1, dtype=torch.bool, device=cell.device)
    assigned = assigned.scatter(1, cell, True)[:, :n_cells].reshape(batch, n_types, len(anchors))
    x_m, z_m, in_range, visible = (place(value) for value in values)
    return Targets(x_m, z_m, in_range, visible, assigned, torch.ones_like(assigned))


def _near_ignored(
    x_ref_m: Float[Tensor, "b l"],
    ignored: Bool[Tensor, "b l"],
    kind: Int[Tensor, "b l"],
    anchors: Float[Tensor, " a"],
    config: ModelConfig,
) -> Bool[Tensor, "b t a"]:
    near = ignored[..., None] & ((x_ref_m[..., None] - anchors).abs() <= MASK_AROUND_IGNORED_M)
    by_kind = [(near & (kind == k)[..., None]).any(1) for k in (CENTERLINE, DELIMITER)]
    return torch.stack([by_kind[1] if name == "d" else by_kind[0] for name in config.types], dim=1)


def _interpolate_table(y_m: Float[Tensor, " k"], values: tuple[float, ...]) -> Float[Tensor, " k"]:
    table_y, table = torch.tensor(SPREAD_Y_M), torch.tensor(values)
    after = torch.searchsorted(table_y, y_m).clamp(1, len(table_y) - 1)
    share = (y_m - table_y[after - 1]) / (table_y[after] - table_y[after - 1])
    return table[after - 1] + share * (table[after] - table[after - 1])
