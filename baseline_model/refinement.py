"""Our addition: lanes are corrected by the maps of the image around their points.

The top view shows the plane of the road alone, and what is far by few pixels. The 3D points of a predicted lane tell
where in the image to look again.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from .anchors import spread_m
from .config import ModelConfig
from .lane_head import Lanes
from .layers import Lattice
from .projection import sampling_grid

LEVELS = (0, 1, 2)
"""Maps that are sampled: image strides 2, 4 and 8."""
ASIDE_M = (-0.8, -0.4, 0.0, 0.4, 0.8)
"""Where maps are sampled, right of each point."""
WIDTH, HIDDEN = 16, 64
STEP = 0.2
"""Scale of a correction, in spreads of the targets."""


class Refinement(nn.Module):
    """Samples around the points of a lane, and convolutions along it, give a correction of its points and logits."""

    def __init__(self, channels: Sequence[int], config: ModelConfig) -> None:
        super().__init__()
        for name, values in zip(("x_spread_m", "z_spread_m"), spread_m(config), strict=True):
            self.register_buffer(name, values, persistent=False)
        self.x_spread_m: Tensor
        self.z_spread_m: Tensor
        self.knots_y_m: Tensor
        self.register_buffer("knots_y_m", torch.tensor(config.knots_y_m), persistent=False)
        self.aside_m: Tensor
        self.register_buffer("aside_m", torch.tensor(ASIDE_M), persistent=False)
        self.has_elevation = config.has_elevation
        self.reduce = nn.ModuleList(nn.Conv2d(channels[level], WIDTH, 1) for level in LEVELS)
        self.mix = nn.Conv1d(len(LEVELS) * len(ASIDE_M) * WIDTH + 3, HIDDEN, 1)
        self.place = nn.Parameter(torch.zeros(len(config.types), HIDDEN, len(config.knots_y_m)))
        along = [nn.Conv1d(HIDDEN, HIDDEN, 3, padding=1) for _ in range(2)]
        self.along = nn.Sequential(nn.ReLU(), along[0], nn.ReLU(), along[1], nn.ReLU())
        self.points, self.lane = nn.Conv1d(HIDDEN, 3, 1), nn.Linear(HIDDEN, 1)
        for value in (*self.points.parameters(), *self.lane.parameters()):
            nn.init.zeros_(value)

    def forward(
        self,
        lanes: Lanes,
        anchors_m: Float[Tensor, " a"],
        maps: Sequence[Float[Tensor, "..."]],
        lattices: Sequence[Lattice],
        cam_from_top: Float[Tensor, "b 4 4"],
        intrinsics: Float[Tensor, "b 4"],
    ) -> Lanes:
        """The corrected lanes. No gradient passes to the lanes given, nor to where maps are sampled."""
        x_m, z_m, logit = lanes.x_m.detach(), lanes.z_m.detach(), lanes.logit.detach()
        b, t, a, k = x_m.shape
        with torch.autocast(x_m.device.type, enabled=False):
            x_top_m = (x_m + anchors_m[:, None])[..., None] + self.aside_m
            y_top_m, z_top_m = self.knots_y_m[:, None].expand_as(x_top_m), z_m[..., None].expand_as(x_top_m)
            points_top = torch.stack([x_top_m, y_top_m, z_top_m], dim=-1).reshape(b, t * a * k, len(ASIDE_M), 3)
            seen = []
            for reduce, level in zip(self.reduce, LEVELS, strict=True):
                features = reduce(maps[level].float())
                size = (features.shape[2], features.shape[3])
                grid = sampling_grid(points_top, cam_from_top.detach(), intrinsics, lattices[level], size)
                seen.append(functional.grid_sample(features, grid, align_corners=False))
            # A sequence of knots per lane, with what is seen there and beside it as channels.
            knots = torch.cat(seen, dim=1).reshape(b, -1, t * a, k, len(ASIDE_M))
            knots = knots.permute(0, 2, 1, 4, 3).reshape(b * t * a, -1, k)
            scaled = [x_m / self.x_spread_m, z_m / self.z_spread_m, 0.2 * logit[..., None].expand_as(x_m)]
            own = torch.stack(scaled, dim=3).reshape(b * t * a, 3, k)
            hidden = self.mix(torch.cat([knots, own], dim=1)).reshape(b, t, a, HIDDEN, k) + self.place[:, None]
            hidden = self.along(hidden.reshape(b * t * a, HIDDEN, k))
            dx, dz, dvisible = self.points(hidden).reshape(b, t, a, 3, k).unbind(3)
            return Lanes(
                x_m + STEP * self.x_spread_m * dx,
                z_m + STEP * self.z_spread_m * dz if self.has_elevation else z_m,
                logit + self.lane(hidden.mean(-1)).reshape(b, t, a),
                None if lanes.visible_logit is None else lanes.visible_logit.detach() + dvisible,
            )
