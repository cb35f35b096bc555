"""The lanes of all anchors from a top-view map (paper, 3.3.2), and our addition: their correction by maps of the image.

The top view shows the plane of the road alone, and what is far by few pixels. The 3D points of a predicted lane tell
where in the image to look again: metres around each knot first, then pixels around the line.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from .anchors import spread_m
from .backbone import convolution
from .config import ModelConfig
from .projection import ImageMaps, sample

PRIOR_LOGIT = -2.9
"""Initial confidence of 0.05, about the share of anchors with a lane."""
WIDTH, HIDDEN = 16, 64
LEVELS = (0, 1, 2)
"""Maps that a refinement samples: image strides 2, 4 and 8."""
ASIDE_M = (-0.8, -0.4, 0.0, 0.4, 0.8)
"""Where it samples them, right of each point."""
CORRECTION_SCALE = 0.2
"""Scale of its correction, in spreads of the targets."""
CLOSE_LEVELS = (0, 1)
ASIDE_PX = (-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 15.0)
"""Where a close look samples its maps, right of each point, in pixels of the network's input."""
PER_KNOT = 3
"""Points from a knot to the next, without the next."""
STEP_PX = 10.0
"""Scale of its correction."""
CLOSE_HIDDEN = 48


class Lanes(NamedTuple):
    """The lane of each type and anchor at the knots, x relative to the anchor."""

    x_m: Float[Tensor, "b t a k"]
    z_m: Float[Tensor, "b t a k"]
    logit: Float[Tensor, "b t a"]
    visible_logit: Float[Tensor, "b t a k"] | None


class LaneHead(nn.Module):
    """Convolutions without padding along y reduce the map to one row; each of its columns is an anchor.

    Channels per anchor: for each type K offsets x, K heights z (unless the data are flat), a logit, and K visibility
    logits if configured."""

    def __init__(self, channels: int, rows: int, config: ModelConfig) -> None:
        super().__init__()
        width, batch_norm = config.head_channels, config.batch_norm
        layers: list[nn.Module] = []
        for kernel, at_most in ((3, 3), (5, rows)):
            while rows - (kernel - 1) >= 4 and sum(_kernel(layer) == kernel for layer in layers) < at_most:
                layers.append(convolution(channels, width, kernel, batch_norm=batch_norm, valid_rows=True))
                channels, rows = width, rows - (kernel - 1)
        self.reduce = nn.Sequential(*layers)
        self.fold = nn.Sequential(nn.Conv2d(channels, 2 * width, (rows, 5), padding=(0, 2)), nn.ReLU(inplace=True))
        self.parts = [len(config.knots_y_m)] * (1 + config.has_elevation) + [1]
        self.parts += [len(config.knots_y_m)] * config.has_visibility
        self.n_types, self.has_elevation = len(config.types), config.has_elevation
        self.out = nn.Conv2d(2 * width, self.n_types * sum(self.parts), (1, 5), padding=(0, 2))
        nn.init.normal_(self.out.weight, std=0.01)
        nn.init.zeros_(self.out.bias)  # type: ignore[arg-type]
        self.x_spread_m: Tensor
        self.z_spread_m: Tensor
        for name, values in zip(("x_spread_m", "z_spread_m"), spread_m(config), strict=True):
            self.register_buffer(name, values, persistent=False)

    def forward(self, features: Float[Tensor, "b c h w"]) -> Lanes:
        """The lanes."""
        raw = self.out(self.fold(self.reduce(features)))[:, :, 0].float()
        values = raw.unflatten(1, (self.n_types, -1)).transpose(2, 3)
        parts = list(values.split(self.parts, dim=-1))
        x_m = parts.pop(0) * self.x_spread_m
        z_m = parts.pop(0) * self.z_spread_m if self.has_elevation else torch.zeros_like(x_m)
        logit = parts.pop(0)[..., 0] + PRIOR_LOGIT
        return Lanes(x_m, z_m, logit, parts.pop(0) if parts else None)


def _kernel(layer: nn.Module) -> int:
    first = layer[0] if isinstance(layer, nn.Sequential) else layer
    return int(first.kernel_size[0]) if isinstance(first, nn.Conv2d) else 0


class _Look(nn.Module):
    """Samples a few channels of maps of the image, at points and beside them."""

    def __init__(
        self, channels: Sequence[int], levels: Sequence[int], aside: Sequence[float], config: ModelConfig
    ) -> None:
        super().__init__()
        self.levels, self.has_elevation = levels, config.has_elevation
        self.reduce = nn.ModuleList(nn.Conv2d(channels[level], WIDTH, 1) for level in levels)
        self.knots_y_m: Tensor
        self.register_buffer("knots_y_m", torch.tensor(config.knots_y_m), persistent=False)
        self.aside: Tensor
        self.register_buffer("aside", torch.tensor(aside), persistent=False)

    def seen_along(
        self,
        x_m: Float[Tensor, "b t a p s"],
        y_m: Float[Tensor, " p"],
        z_m: Float[Tensor, "b t a p"],
        image: ImageMaps,
    ) -> Float[Tensor, "m d p"]:
        """What maps have at points of the top frame, as channels along each lane of each image; x is given for the
        point and for places beside it. No gradient passes to where maps are sampled."""
        b, t, a, p, s = x_m.shape
        points_top = torch.stack([x_m, y_m[:, None].expand_as(x_m), z_m[..., None].expand_as(x_m)], dim=-1)
        points_top, cam_from_top = points_top.reshape(b, t * a * p, s, 3), image.cam_from_top.detach()
        seen = [
            sample(reduce(image.maps[i].float()), points_top, cam_from_top, image.intrinsics, image.lattices[i])
            for reduce, i in zip(self.reduce, self.levels, strict=True)
        ]
        points = torch.cat(seen, dim=1).reshape(b, -1, t * a, p, s)
        return points.permute(0, 2, 1, 4, 3).reshape(b * t * a, -1, p)


class Refinement(_Look):
    """Samples around the points of a lane, and convolutions along it, give a correction of its points and logits."""

    def __init__(self, channels: Sequence[int], config: ModelConfig) -> None:
        super().__init__(channels, LEVELS, ASIDE_M, config)
        self.x_spread_m: Tensor
        self.z_spread_m: Tensor
        for name, values in zip(("x_spread_m", "z_spread_m"), spread_m(config), strict=True):
            self.register_buffer(name, values, persistent=False)
        self.mix = nn.Conv1d(len(LEVELS) * len(ASIDE_M) * WIDTH + 3, HIDDEN, 1)
        self.place = nn.Parameter(torch.zeros(len(config.types), HIDDEN, len(config.knots_y_m)))
        along = [nn.Conv1d(HIDDEN, HIDDEN, 3, padding=1) for _ in range(2)]
        self.along = nn.Sequential(nn.ReLU(), along[0], nn.ReLU(), along[1], nn.ReLU())
        self.points, self.lane = nn.Conv1d(HIDDEN, 3, 1), nn.Linear(HIDDEN, 1)
        for value in (*self.points.parameters(), *self.lane.parameters()):
            nn.init.zeros_(value)

    def forward(self, lanes: Lanes, anchors_m: Float[Tensor, " a"], image: ImageMaps) -> Lanes:
        """The corrected lanes. No gradient passes to the lanes given, nor to where maps are sampled."""
        x_m, z_m, logit = lanes.x_m.detach(), lanes.z_m.detach(), lanes.logit.detach()
        b, t, a, k = x_m.shape
        with torch.autocast(x_m.device.type, enabled=False):
            around_m = (x_m + anchors_m[:, None])[..., None] + self.aside
            knots = self.seen_along(around_m, self.knots_y_m, z_m, image)
            scaled = [x_m / self.x_spread_m, z_m / self.z_spread_m, 0.2 * logit[..., None].expand_as(x_m)]
            own = torch.stack(scaled, dim=3).reshape(b * t * a, 3, k)
            hidden = self.mix(torch.cat([knots, own], dim=1)).reshape(b, t, a, HIDDEN, k) + self.place[:, None]
            hidden = self.along(hidden.reshape(b * t * a, HIDDEN, k))
            dx, dz, dvisible = self.points(hidden).reshape(b, t, a, 3, k).unbind(3)
            return Lanes(
                x_m + CORRECTION_SCALE * self.x_spread_m * dx,
                z_m + CORRECTION_SCALE * self.z_spread_m * dz if self.has_elevation else z_m,
                logit + self.lane(hidden.mean(-1)).reshape(b, t, a),
                None if lanes.visible_logit is None else lanes.visible_logit.detach() + dvisible,
            )


class CloseLook(_Look):
    """Samples across the line as the camera sees it, at and between the knots, and convolutions along it, give a
    correction of its points in pixels."""

    def __init__(self, channels: Sequence[int], config: ModelConfig) -> None:
        super().__init__(channels, CLOSE_LEVELS, ASIDE_PX, config)
        n_knots = len(config.knots_y_m)
        place = torch.arange(PER_KNOT * (n_knots - 1) + 1) / PER_KNOT
        self.at_points: Tensor
        """Matrix from values at knots to linear interpolations at points."""
        between = (1 - (place - torch.arange(n_knots)[:, None]).abs()).clamp_min(0)
        self.register_buffer("at_points", between, persistent=False)
        self.mix = nn.Conv1d(len(CLOSE_LEVELS) * len(ASIDE_PX) * WIDTH, CLOSE_HIDDEN, 1)
        self.place = nn.Parameter(torch.zeros(len(config.types), CLOSE_HIDDEN, len(place)))
        self.along = nn.Sequential(
            nn.ReLU(),
            nn.Conv1d(CLOSE_HIDDEN, CLOSE_HIDDEN, 5, padding=2),
            nn.ReLU(),
            nn.Conv1d(CLOSE_HIDDEN, CLOSE_HIDDEN, 5, padding=2, stride=PER_KNOT),
            nn.ReLU(),
            nn.Conv1d(CLOSE_HIDDEN, CLOSE_HIDDEN, 3, padding=1),
            nn.ReLU(),
        )
        self.points = nn.Conv1d(CLOSE_HIDDEN, 2, 1)
        for value in self.points.parameters():
            nn.init.zeros_(value)

    def forward(self, lanes: Lanes, anchors_m: Float[Tensor, " a"], image: ImageMaps) -> Lanes:
        """The lanes with corrected points. No gradient passes to the lanes given, nor to where maps are sampled."""
        x_m, z_m = lanes.x_m.detach(), lanes.z_m.detach()
        b, t, a, k = x_m.shape
        with torch.autocast(x_m.device.type, enabled=False):
            # A pixel's width in metres, at a distance of one metre.
            pixel = 1 / image.intrinsics[:, 0, None, None, None, None]
            y_m = self.knots_y_m @ self.at_points
            across_m = ((x_m + anchors_m[:, None]) @ self.at_points)[..., None] + pixel * y_m[:, None] * self.aside
            seen = self.seen_along(across_m, y_m, z_m @ self.at_points, image)
            hidden = self.mix(seen).reshape(b, t, a, CLOSE_HIDDEN, -1) + self.place[:, None]
            hidden = self.along(hidden.reshape(b * t * a, CLOSE_HIDDEN, -1))
            dx_px, dz_px = (STEP_PX * self.points(hidden)).reshape(b, t, a, 2, k).unbind(3)
            pixel_m = pixel[..., 0] * self.knots_y_m
            return Lanes(
                x_m + pixel_m * dx_px,
                z_m + pixel_m * dz_px if self.has_elevation else z_m,
                lanes.logit.detach(),
                None if lanes.visible_logit is None else lanes.visible_logit.detach(),
            )
