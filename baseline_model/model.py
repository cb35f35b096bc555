"""3D-LaneNet (paper, section 3): dual pathway, road projection branch, lane head. One module for all variants."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from .anchors import anchor_positions_m
from .backbone import PIXELS, ImagePathway, convolutions
from .config import TIMM, ModelConfig
from .curves import MEAN_HEIGHT_M, MEAN_PITCH_RAD
from .heads import CloseLook, LaneHead, Lanes, Refinement
from .projection import ImageMaps, Projection, cell_centres, invert_rigid, pixel_rays, road_from_cam, sample
from .timm_trunk import TimmPathway

PITCH_SPREAD_RAD, HEIGHT_SPREAD_M = 0.0251, 0.144
"""Standard deviation of the paper's uniform ranges (0..5 deg, 1.4..1.9 m)."""


class Output(NamedTuple):
    """The network's output per anchor, as in `Lanes`, and what they refer to."""

    x_m: Float[Tensor, "b t a k"]
    z_m: Float[Tensor, "b t a k"]
    logit: Float[Tensor, "b t a"]
    visible_logit: Float[Tensor, "b t a k"] | None
    pose: Float[Tensor, "b 2"]
    """(pitch_rad, height_m), predicted or fixed."""
    cam_from_top: Float[Tensor, "b 4 4"]
    """The transform used in the warp."""
    earlier: tuple[Lanes, ...] = ()
    """The lanes before each refinement, and before the close look."""


class PoseBranch(nn.Module):
    """Road projection branch: residuals on the mean pose, initially zero. No dropout, which would perturb the warp."""

    def __init__(self, channels: int, size: tuple[int, int], config: ModelConfig) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        rows, columns = size
        for width in config.pose_channels:
            if min(rows, columns) >= 4:
                layers.append(nn.MaxPool2d(2))
                rows, columns = rows // 2, columns // 2
            layers += convolutions(channels, width, config.pose_convolutions, batch_norm=config.batch_norm)
            channels = width
        self.features = nn.Sequential(*layers, nn.Flatten(), nn.Linear(channels * rows * columns, 64), nn.ReLU())
        self.residual = nn.Linear(64, 2)
        nn.init.zeros_(self.residual.weight)
        nn.init.zeros_(self.residual.bias)

    def forward(self, features: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 2"]:
        """(pitch_rad, height_m)."""
        hidden = self.features(features)
        with torch.autocast(features.device.type, enabled=False):
            pitch, height = self.residual(hidden.float()).unbind(-1)
            return torch.stack(
                [MEAN_PITCH_RAD + PITCH_SPREAD_RAD * pitch, MEAN_HEIGHT_M + HEIGHT_SPREAD_M * height], dim=-1
            )


class LaneNet(nn.Module):
    """The network. `config.variant` selects its projections and the input of the head."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        grid, variant = config.grid, config.variant
        is_pose_learned = config.pose_target != "fixed"
        needs_all = is_pose_learned or config.is_refined or variant in ("full", "late_ipm", "image_view")
        pathway = TimmPathway if config.backbone.startswith(TIMM) else ImagePathway
        self.image = pathway(config, n_stages=4 if needs_all else 1) if self._needs_image(config) else None
        channels = self.image.channels if self.image is not None else ()
        size = self.image.sizes(*config.size_px)[-1] if self.image is not None else (0, 0)
        self.pose = PoseBranch(channels[3], size, config) if is_pose_learned else None
        levels = {"full": (0, 1, 2, 3), "early_ipm": (0,), "late_ipm": (3,)}.get(variant, ())
        self.projections = nn.ModuleDict(
            {str(level): Projection(channels[level], config.projected_channels[level], grid, level) for level in levels}
        )
        self.stem = ImagePathway(config, n_stages=1) if variant == "top_view" else None
        if self.stem is not None:
            self.stem_points: Tensor
            self.register_buffer("stem_points", cell_centres(grid, -1), persistent=False)
        self.top, head_channels = self._top_pathway(config)
        rows = size[0] if variant == "image_view" else grid.rows // 8
        self.head = LaneHead(head_channels, rows, config)
        self.refinements = nn.ModuleList(Refinement(channels, config) for _ in range(config.refinements))
        self.close_look = CloseLook(channels, config) if config.has_close_look else None
        fixed = torch.tensor([config.fixed_pitch_deg * torch.pi / 180, config.fixed_height_m])
        self.fixed_pose: Tensor
        self.register_buffer("fixed_pose", fixed, persistent=False)
        self.anchors_m: Tensor
        self.register_buffer("anchors_m", torch.tensor(anchor_positions_m(config)), persistent=False)

    @staticmethod
    def _needs_image(config: ModelConfig) -> bool:
        return config.variant != "top_view" or config.pose_target != "fixed" or config.is_refined

    def _projected_width(self, level: int) -> int:
        return self.config.projected_channels[level] if str(level) in self.projections else 0

    def _top_pathway(self, config: ModelConfig) -> tuple[nn.ModuleList, int]:
        if config.variant == "image_view":
            return nn.ModuleList(), config.image_channels[3]
        if config.variant == "late_ipm":
            return nn.ModuleList(), self._projected_width(3)
        channels = config.image_channels[0] if self.stem is not None else self._projected_width(0)
        stages = []
        for level, width in enumerate(config.top_channels, start=1):
            block = convolutions(channels, width, 3, batch_norm=config.batch_norm)
            stages.append(nn.Sequential(nn.MaxPool2d(2), *block))
            channels = width + self._projected_width(level)
        return nn.ModuleList(stages), channels

    def forward(
        self,
        image: Float[Tensor, "b 3 h w"],
        intrinsics: Float[Tensor, "b 4"],
        warp_pose: Float[Tensor, "b 2"] | None = None,
        top_from_road: Float[Tensor, "b 4 4"] | None = None,
    ) -> Output:
        """`image` is RGB in 0..1, `intrinsics` fx, fy, cx, cy in pixels. `warp_pose` replaces the predicted pose in
        the warp (training); `top_from_road` moves the top-view grid on its plane (augmentation)."""
        maps = self.image(image, self._rays(image, intrinsics)) if self.image is not None else []
        # In an export, `len` would be a constant.
        pose = self.pose(maps[3]) if self.pose is not None else self.fixed_pose.expand(image.shape[0], 2)
        driving = pose if self.config.grid_gradient else pose.detach()
        if warp_pose is not None and self.pose is not None:
            driving = warp_pose
        with torch.autocast(image.device.type, enabled=False):
            cam_from_top = invert_rigid(road_from_cam(driving))
            if top_from_road is not None:
                cam_from_top = cam_from_top @ invert_rigid(top_from_road)
        lattices = self.image.lattices if self.image is not None else []
        seen = ImageMaps(maps, lattices, cam_from_top, intrinsics)
        stages: list[Lanes] = [self.head(self._top_features(image, seen))]
        for correct in (*self.refinements, *([] if self.close_look is None else [self.close_look])):
            stages.append(correct(stages[-1], self.anchors_m, seen))
        return Output(*stages[-1], pose, cam_from_top, tuple(stages[:-1]))

    def _top_features(self, image: Float[Tensor, "b 3 h w"], seen: ImageMaps) -> Float[Tensor, "b c rows columns"]:
        """The input of the head."""
        maps, lattices, cam_from_top, intrinsics = seen
        if self.config.variant == "image_view":
            size = (maps[3].shape[2], len(self.anchors_m))
            return functional.interpolate(maps[3], size, mode="bilinear")
        projected = {
            level: projection(maps[int(level)], cam_from_top, intrinsics, lattices[int(level)])
            for level, projection in self.projections.items()
        }
        if self.config.variant == "late_ipm":
            return projected["3"]
        features = self._stem_features(image, seen) if self.stem is not None else projected["0"]
        for level, stage in enumerate(self.top, start=1):
            features = stage(features)
            if str(level) in projected:
                features = torch.cat([features, projected[str(level)].to(features.dtype)], dim=1)
        return features

    def _stem_features(self, image: Float[Tensor, "b 3 h w"], seen: ImageMaps) -> Float[Tensor, "b c rows columns"]:
        """`top_view`: the image itself is warped, at twice the first map's resolution, and then convolved."""
        assert self.stem is not None
        with torch.autocast(image.device.type, enabled=False):
            channels = torch.cat([image.float(), self._rays(image, seen.intrinsics)], dim=1)
            warped = sample(channels, self.stem_points, seen.cam_from_top, seen.intrinsics, PIXELS)
        return self.stem(warped[:, :3], warped[:, 3:])[0]

    @staticmethod
    def _rays(image: Float[Tensor, "b 3 h w"], intrinsics: Float[Tensor, "b 4"]) -> Float[Tensor, "b 2 h w"]:
        return torch.stack(pixel_rays(intrinsics, image.shape[2], image.shape[3]), dim=1)
