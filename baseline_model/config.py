"""All hyper-parameters of the baseline, and the named models. Pure data; checkpoints store them as JSON."""

from collections.abc import Iterable, Sequence
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, model_validator
from pydantic_core import ErrorDetails

from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import MAX_PX, problem_line, unknown_key
from synth3dlanes.system.yaml_text import read_yaml

from .curves import HALF_WIDTH_M

Variant = Literal["full", "image_view", "top_view", "early_ipm", "late_ipm"]
PoseTarget = Literal["plane", "horizon", "fixed"]
LaneType = Literal["c1", "c2", "d"]
PositiveNumber = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Size = Annotated[int, Field(ge=1, le=MAX_PX)]
Few = Annotated[int, Field(ge=0, le=100)]

PAPER_KNOTS_M = (5.0, 20.0, 40.0, 60.0, 80.0, 100.0)
TEN_KNOTS_M = (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0)
TIMM = "timm:"
FIRST_KNOT_M, LAST_KNOT_M = 5.0, 110.0
"""Nearer road is below the image; labels end at 110 m."""


class Strict(BaseModel):
    """Frozen; unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


Config = TypeVar("Config", bound=Strict)


class Grid(Strict):
    """The cells of the first of four top-view maps, centred on x = 0, with y from `y_min_m`. Each further map has half
    the size; the columns of the last one are the anchors (paper: cells of 16 cm x 38.4 cm, anchors every 1.28 m)."""

    rows: Size = 208
    columns: Size = 128
    cell_x_m: PositiveNumber = 0.16
    cell_y_m: PositiveNumber = 0.384
    y_min_m: float = 0.0


class ModelConfig(Strict):
    """One network. Widths are per stage at image strides 2, 4, 8, 16; `vgg16` has 64 channels before the first."""

    name: str
    backbone: Annotated[str, Field(pattern=rf"^(vgg16|residual|{TIMM}\w+(\.\w+)?)$")]
    """`timm:NAME` is a network of the package timm, whose own channels, blocks and norms replace those given here. The
    names of hubs and folders, from which timm would load more, are not taken."""
    image_channels: tuple[Size, Size, Size, Size]
    image_blocks: tuple[Few, Few, Few, Few]
    projected_channels: tuple[Size, Size, Size, Size]
    top_channels: tuple[Size, Size, Size]
    head_channels: Size
    pose_channels: Annotated[tuple[Size, ...], Field(max_length=100)]
    pose_convolutions: Annotated[Few, Field(ge=1)]
    variant: Variant = "full"
    grid: Grid = Grid()
    image_height_px: Size = 360
    image_width_px: Size = 480
    reference_intrinsics: tuple[float, float, float, float] = (415.7, 415.7, 240.0, 180.0)
    """fx, fy, cx, cy of the training images; only the anchors of `image_view` depend on them."""
    image_view_anchors: Size | None = None
    """Anchors of `image_view`, evenly over the image's columns. None: one per column of the last map (paper: 30)."""
    types: tuple[LaneType, ...] = ("c1", "c2", "d")
    has_elevation: bool = True
    knots_y_m: tuple[float, ...] = PAPER_KNOTS_M
    spline: Literal["natural", "pchip"] = "natural"
    pose_target: PoseTarget = "plane"
    fixed_pitch_deg: float = 2.5
    fixed_height_m: PositiveNumber = 1.65
    grid_gradient: bool = False
    """Whether the lane loss is backpropagated to the pose through the sampling grid; the paper supervises the pose."""
    batch_norm: bool = True
    """Batch norm after every convolution but the head's last two. The paper does not mention any; `paper` has it."""
    has_visibility: bool = False
    """Our addition: a logit per knot for its visibility."""
    refinements: Few = 0
    """Our addition: how often lanes are corrected by the maps of the image around their points."""
    has_close_look: bool = False
    """Our addition: at last, points of lanes are corrected by what the image shows within pixels of them."""

    @property
    def size_px(self) -> tuple[int, int]:
        """Height and width of the images."""
        return (self.image_height_px, self.image_width_px)

    @property
    def is_refined(self) -> bool:
        """Whether lanes are corrected by the maps of the image."""
        return self.refinements > 0 or self.has_close_look

    @model_validator(mode="after")
    def _fits(self) -> "ModelConfig":
        grid, knots = self.grid, self.knots_y_m
        width_m = grid.columns * grid.cell_x_m
        if grid.columns % 8 or abs(width_m - 2 * HALF_WIDTH_M) > 1e-6:
            raise ValueError(
                f"grid: expected a multiple of 8 columns, together {2 * HALF_WIDTH_M:g} m wide as the metric's region, "
                f"got {grid.columns} columns of {grid.cell_x_m:g} m"
            )
        if grid.rows < 8:
            raise ValueError(f"grid.rows: expected at least 8, which three pools reduce to 1, got {grid.rows}")
        if min(self.size_px) < 16:
            size = f"{self.image_width_px} x {self.image_height_px}"
            raise ValueError(f"image: expected at least 16 x 16 px, one cell of the last map, got {size}")
        if len(knots) < 2 or list(knots) != sorted(set(knots)) or knots[0] < FIRST_KNOT_M or knots[-1] > LAST_KNOT_M:
            raise ValueError(
                f"knots_y_m: expected two or more increasing distances from {FIRST_KNOT_M:g} to {LAST_KNOT_M:g} m, "
                f"got {list(knots)}"
            )
        if not self.types or len(set(self.types)) < len(self.types):
            raise ValueError(f"types: expected at least one, each once, got {list(self.types)}")
        if self.backbone.startswith(TIMM) and self.variant in ("image_view", "top_view"):
            raise ValueError(
                f"backbone: expected vgg16 or residual for {self.variant}, whose maps are centred on cells, "
                f"got {self.backbone}"
            )
        return self


class CustomModel(Strict):
    """A user's network: what `build` (`module:function`) returns for these arguments, on images of this size."""

    build: Annotated[str, Field(pattern=r"^[\w.]+:\w+$")]
    arguments: dict[str, Any] = {}
    image_height_px: Size = 360
    image_width_px: Size = 480

    @property
    def size_px(self) -> tuple[int, int]:
        """Height and width of the images."""
        return (self.image_height_px, self.image_width_px)

    @property
    def pose_target(self) -> PoseTarget:
        """The pose that batches carry."""
        return "plane"


def _which_model(value: Any) -> str:
    is_custom = isinstance(value, CustomModel) or (isinstance(value, dict) and "build" in value)
    return "custom" if is_custom else "network"


AnyModel = Annotated[
    Annotated[ModelConfig, Tag("network")] | Annotated[CustomModel, Tag("custom")], Discriminator(_which_model)
]


class Augmentation(Strict):
    """Augmentations that change image and labels consistently, applied on the device; zero disables each."""

    flip: Annotated[float, Field(ge=0, le=1)] = 0.5
    brightness: Annotated[float, Field(ge=0)] = 0.2
    contrast: Annotated[float, Field(ge=0)] = 0.2
    noise: Annotated[float, Field(ge=0)] = 0.02
    tint: Annotated[float, Field(ge=0, lt=1)] = 0.0
    saturation: Annotated[float, Field(ge=0, le=1)] = 0.0
    sharpness: Annotated[float, Field(ge=0, le=1)] = 0.0
    """What cameras differ in: the gain of each colour, the distance of colours from gray, and that of pixels from the
    mean of their neighbours, each changed by at most this share."""
    pitch_deg: Annotated[float, Field(ge=0)] = 0.0
    yaw_deg: Annotated[float, Field(ge=0)] = 0.0
    """Virtual rotations of the camera: the image is warped by K R K^-1, exact for the whole 3D scene."""
    top_shift_m: Annotated[float, Field(ge=0)] = 0.0
    top_yaw_deg: Annotated[float, Field(ge=0)] = 0.0
    """Shift and rotation of the top-view grid and the targets; the image is unchanged."""


class LossConfig(Strict):
    """Weights of Eq. 1 (all 1 in the paper). Lengths are in metres. The paper does not state the pitch's unit; we use
    degrees, since one degree is one metre of elevation at 57 m, while radians would make the term negligible."""

    detection: float = 1.0
    geometry: float = 1.0
    pose: float = 1.0
    knot_sigma_m: tuple[PositiveNumber, ...] | None = None
    """Divisor of each knot's error (our addition; favours near points). None: the paper's L1 in metres."""
    supervise_occluded: bool = False
    visibility: float = 0.2
    """Applies if the network has this output."""
    image: float = 0.0
    """Our addition: the error of each knot as the camera sees it, per milliradian, mainly across the line."""
    kinds: tuple[Literal["centerline", "delimiter"], ...] = ("centerline", "delimiter")
    """Kinds of lanes labelled in the data; the others enter no term."""


class TrainConfig(Strict):
    """One run. `steps` counts optimiser steps over all GPUs; `batch` is the batch of all GPUs together."""

    model: AnyModel
    loss: LossConfig = LossConfig()
    augmentation: Augmentation = Augmentation()
    seed: int = 0
    batch: Count = 16
    epochs: PositiveNumber = 20.0
    optimizer: Literal["adamw", "adam"] = "adamw"
    schedule: Literal["cosine", "cyclic"] = "cosine"
    learning_rate: PositiveNumber = 1e-3
    min_learning_rate: PositiveNumber = 1e-6
    warmup_fraction: Annotated[float, Field(ge=0, lt=1)] = 0.04
    cycle_epochs: PositiveNumber = 2.0
    weight_decay: Annotated[float, Field(ge=0)] = 0.02
    clip_norm: PositiveNumber = 10.0
    ema_decay: Annotated[float, Field(ge=0, lt=1)] = 0.999
    label_pose_fraction: Annotated[float, Field(ge=0, le=1)] = 0.1
    """Share of the first steps that warp by the label's pose with noise, as in the paper; later steps use the predicted
    pose."""
    label_pose_noise_deg: Annotated[float, Field(ge=0)] = 0.15
    label_pose_noise_m: Annotated[float, Field(ge=0)] = 0.04
    target_frame: Literal["label", "grid"] = "label"
    """Frame of the lane targets: the road frame of the label's pose (paper), or of the pose used in the warp."""
    fov_mask: bool = False
    validate_every_epochs: PositiveNumber = 1.0
    train_split: str = "train"
    val_split: str = "val"
    max_images: Count | None = None
    """The most images of each data set; None: all."""
    device: str = "auto"
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """`auto`: bfloat16 on GPUs and on CPUs with AVX512-BF16, else float32. Pose, warp, head output and loss are always
    in float32."""
    compile: bool = True
    pretrained: str | None = None
    init: str | None = None
    """A checkpoint whose weights training starts from, or `nano` for the ones in the package."""
    workers: Annotated[int, Field(ge=0)] | None = None
    """Processes that decode images for each training process; None: all cores that training leaves."""
    keep_decoded: bool | None = None
    """Whether decoded images are kept in memory; None: if they take less than half of what is free."""

    @model_validator(mode="after")
    def _fits(self) -> "TrainConfig":
        if isinstance(self.model, CustomModel):
            return self
        sigmas, knots = self.loss.knot_sigma_m, self.model.knots_y_m
        if sigmas is not None and len(sigmas) != len(knots):
            raise ValueError(
                f"loss.knot_sigma_m: expected {len(knots)} lengths, one for each of model.knots_y_m, got {len(sigmas)}"
            )
        moved = {name: getattr(self.augmentation, name) for name in ("top_shift_m", "top_yaw_deg")}
        if self.model.variant == "image_view" and any(moved.values()):
            raise ValueError(f"augmentation: expected no moves of the top view, which image_view lacks, got {moved}")
        return self


PAPER = ModelConfig(
    name="paper",
    backbone="vgg16",
    image_channels=(128, 256, 512, 512),
    image_blocks=(2, 3, 3, 3),
    projected_channels=(128, 128, 256, 256),
    top_channels=(128, 256, 256),
    head_channels=64,
    pose_channels=(256, 128, 64),
    pose_convolutions=3,
)
COMPACT = ModelConfig(
    name="compact",
    backbone="residual",
    image_channels=(32, 64, 128, 192),
    image_blocks=(1, 2, 2, 2),
    projected_channels=(32, 32, 48, 64),
    top_channels=(48, 96, 128),
    head_channels=48,
    pose_channels=(64, 48, 32),
    pose_convolutions=1,
)
SMALL = COMPACT.model_copy(
    update={
        "name": "small",
        "image_channels": (24, 48, 96, 128),
        "image_blocks": (1, 2, 2, 1),
        "projected_channels": (24, 24, 32, 48),
        "top_channels": (32, 64, 96),
        "head_channels": 40,
    }
)
NANO = COMPACT.model_copy(
    update={
        "name": "nano",
        "image_channels": (16, 24, 48, 64),
        "image_blocks": (0, 1, 1, 1),
        "projected_channels": (16, 16, 24, 32),
        "top_channels": (24, 32, 48),
        "head_channels": 32,
        "pose_channels": (48, 32, 24),
    }
)
TINY = NANO.model_copy(
    update={
        "name": "tiny",
        "image_height_px": 120,
        "image_width_px": 160,
        "reference_intrinsics": (138.6, 138.6, 80.0, 60.0),
        "image_view_anchors": 30,
        "grid": Grid(rows=104, cell_y_m=0.768),
    }
)


def improved(model: ModelConfig) -> ModelConfig:
    """The model with our changes, trained with `IMPROVED_LOSS`: ten knots, a visibility per knot, a refinement and a
    close look."""
    ours = {"knots_y_m": TEN_KNOTS_M, "has_visibility": True, "refinements": 1, "has_close_look": True}
    return model.model_copy(update={"name": "improved", **ours})


OUR_AUGMENTATION = Augmentation(pitch_deg=1.0, yaw_deg=2.0, top_shift_m=0.64, top_yaw_deg=3.0)
OUR_LOSS = LossConfig(detection=20.0, pose=20.0)
"""The errors of far knots outweigh the other terms of Eq. 1 a hundredfold: training on six images took over 200 steps
to AP 0.9 with equal weights, and 50 steps to AP 1 with a detection weight of 20. `paper` keeps the equal weights."""
IMPROVED_LOSS = OUR_LOSS.model_copy(
    update={
        "knot_sigma_m": (0.08, 0.09, 0.095, 0.10, 0.14, 0.18, 0.25, 0.32, 0.55, 0.9),
        "geometry": 0.25,
        "image": 0.1,
        "supervise_occluded": True,
    }
)
"""`knot_sigma_m` has the knot errors that would give the paper's near accuracy; it favours near over far points."""
TUSIMPLE: dict[str, Any] = {
    "types": ("d",),
    "has_elevation": False,
    "pose_target": "fixed",
    "fixed_pitch_deg": 9.0,
    "fixed_height_m": 1.6,
    "reference_intrinsics": (375.0, 562.5, 240.0, 180.0),
}
"""The image-only variant (paper, 4.4) on 1280x720 images without their top 80 rows. Pitch and height replace the
paper's hand-picked homography, which makes straight lanes parallel."""

IMAGE_ONLY = PAPER.model_copy(update={"name": "tusimple", **TUSIMPLE})
MODELS = {model.name: model for model in (PAPER, COMPACT, SMALL, NANO, TINY, improved(COMPACT), IMAGE_ONLY)}

ABLATIONS: dict[str, dict[str, Any]] = {
    "full": {},
    "image_view": {
        "model.variant": "image_view",
        "target_frame": "label",
        "augmentation.top_shift_m": 0.0,
        "augmentation.top_yaw_deg": 0.0,
    },
    "top_view": {"model.variant": "top_view"},
    "early_ipm": {"model.variant": "early_ipm"},
    "late_ipm": {"model.variant": "late_ipm"},
    "horizon": {"model.pose_target": "horizon"},
    "fixed_position": {"model.pose_target": "fixed"},
    "no_supervision": {"model.grid_gradient": True, "label_pose_fraction": 0.0, "loss.pose": 0.0},
    "improved": {},
}
"""The settings that each row of the paper's Table 1 changes; `image_view` has no top view to augment or to use as
target frame. `flat_ground` is an evaluation of `full`. The paper mentions `no_supervision` ("failed to produce
satisfying results"); `improved` has our changes."""


def train_config(model: str, overrides: dict[str, Any] | None = None, ablation: str = "full") -> TrainConfig:
    """The default configuration of the named model, or of a network of the user's own (`module:function`), with
    overrides by dotted keys: {"model.grid.rows": 104, "batch": 8}."""
    if ":" in model:
        if ablation != "full":
            raise InputError(f"ablation: expected full for a network of your own, got {ablation!r}")
        return _overridden({"model": {"build": model}}, overrides or {})
    for what, name, known in (("model", model, MODELS), ("ablation", ablation, ABLATIONS)):
        if name not in known:
            raise InputError(f"{what}: expected one of {', '.join(known)}, got {name!r}")
    document = _defaults(model, is_improved="improved" in (model, ablation))
    if ablation == "improved" and model != "improved":
        document["model"] = improved(MODELS[model]).model_dump()
    return _overridden(document, ABLATIONS[ablation] | (overrides or {}))


def changed(config: TrainConfig, overrides: dict[str, Any]) -> TrainConfig:
    """The configuration with overrides by dotted keys."""
    return _overridden(config.model_dump(), overrides)


def _overridden(document: dict[str, Any], overrides: dict[str, Any]) -> TrainConfig:
    for key, value in overrides.items():
        *above, name = key.split(".")
        part = document
        for step in above:
            part = part.setdefault(step, {})
        part[name] = value
    return parse(TrainConfig, document, "train")


def parse(kind: type[Config], document: dict[str, Any] | str, where: str) -> Config:
    """Validate a document; raise one InputError with all problems."""
    try:
        return kind.model_validate_json(document) if isinstance(document, str) else kind.model_validate(document)
    except ValidationError as error:
        raise InputError(*(_line(problem, where) for problem in error.errors())) from None


def _line(problem: ErrorDetails, where: str) -> str:
    # pydantic names the kind of model that it took, which is no key of the document.
    loc = tuple(part for part in problem["loc"] if part not in ("network", "custom"))
    if problem["type"] == "value_error":  # from `_fits`: names the setting itself
        return ".".join(map(str, (where, *loc, problem["ctx"]["error"])))
    problem["loc"] = (where, *loc)
    if problem["type"] == "extra_forbidden":
        return f"{'.'.join(map(str, problem['loc']))}: {unknown_key(str(loc[-1]), _known(loc[:-1]))}"
    return problem_line(problem)


def _known(path: tuple[int | str, ...]) -> Iterable[str]:
    """The settings of a part of the configuration."""
    part: Any = _defaults("compact", is_improved=False) if path else TrainConfig.model_fields
    for step in path:
        part = part.get(step, {}) if isinstance(part, dict) else {}
    return list(part)


def _defaults(model: str, *, is_improved: bool) -> dict[str, Any]:
    """Default training of the named model: `paper` and `tusimple` follow the paper as far as it says, the others use
    what worked best for them."""
    document: dict[str, Any] = {"model": MODELS[model].model_dump(), "loss": OUR_LOSS.model_dump()}
    document |= {"augmentation": OUR_AUGMENTATION.model_dump(), "target_frame": "grid"}
    if model in ("nano", "tiny"):
        document["learning_rate"] = 2e-3
    if model in ("paper", "tusimple"):
        document |= {"optimizer": "adam", "schedule": "cyclic", "learning_rate": 5e-4, "weight_decay": 0.0, "batch": 64}
    if is_improved:
        document["loss"] = IMPROVED_LOSS.model_dump()
    elif model in ("paper", "tusimple"):
        kinds = ("delimiter",) if model == "tusimple" else ("centerline", "delimiter")
        document |= {"loss": LossConfig(kinds=kinds).model_dump(), "target_frame": "label"}
        document["augmentation"] = Augmentation().model_dump()
    return document


def overrides_from(texts: Sequence[str]) -> dict[str, Any]:
    """Parse `KEY=VALUE` texts with dotted keys; values are YAML, as those of every `--set`."""
    overrides: dict[str, Any] = {}
    problems: list[str] = []
    for text in texts:
        key, equals, value = text.partition("=")
        if not (key and equals):
            raise InputError(f"overrides: expected KEY=VALUE, got {text!r}")
        overrides[key], wrong = read_yaml(value, f"overrides {key}")
        problems += wrong
    if problems:
        raise InputError(*problems)
    return overrides
