"""Labelled images as training examples: pixels of the network's size, lanes as curves in camera coordinates.

`NetworkLabels` is what a network learns from the labels of one image, `Batch` several of them with their pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from PIL import Image
from torch import Tensor

from synth3dlanes.labels.labels import Labels
from synth3dlanes.system.arrays import Polyline2, RgbImage
from synth3dlanes.system.errors import FormatError, InputError

from .anchors import CENTERLINE, DELIMITER, CurveBatch
from .curves import Pose, plane_pose, road_curves, target_pose

Intrinsics = tuple[float, float, float, float]
MOST_ENLARGED = 20.0
"""An image of nearly 180 degrees would be, to look as in training."""
FOCAL_TOLERANCE = 1.05
"""Focal lengths that differ by less count as equal."""


class FocalLengths(NamedTuple):
    """The focal lengths of the images that a network was trained on, in pixels of its input: the range of fx, and fy /
    fx."""

    least_px: float
    most_px: float
    fy_by_fx: float

    def nearest(self, fx: float, fy: float) -> tuple[float, float]:
        """The fx and fy seen in training that are nearest to these; these themselves if they are within that range."""
        nearest_px = min(max(fx, self.least_px), self.most_px)
        pairs = ((fx, nearest_px), (fy, fx * self.fy_by_fx))
        if all(max(a, b) <= min(a, b) * FOCAL_TOLERANCE for a, b in pairs):
            return fx, fy
        return nearest_px, nearest_px * self.fy_by_fx


@runtime_checkable
class LabelledImage(Protocol):
    """A sample of a reader (`synth3dlanes.dataset.read.Sample`, `synth3dlanes.formats.reading.ForeignSample`)."""

    @property
    def key(self) -> str: ...
    @property
    def image(self) -> RgbImage: ...
    @property
    def labels(self) -> Labels: ...


@runtime_checkable
class Samples(Protocol):
    """Random access to labelled images by index from 0."""

    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> LabelledImage: ...


@dataclass(frozen=True, eq=False)
class CameraImage:
    """An image of any size, the intrinsics of its camera (fx, fy, cx, cy in its pixels), its labels or labelled lines
    in the image, if it has some, and its time in a clip or a video."""

    key: str
    image: RgbImage
    intrinsics: Intrinsics
    truth: Labels | Sequence[Polyline2] = ()
    time_s: float | None = None


class Batch(NamedTuple):
    """Images (uint8 as read, 0..1 once on the device), intrinsics (fx, fy, cx, cy) in pixels of these images, curves,
    and the poses (pitch_rad, height_m) of the labels and of the target."""

    image: Float[Tensor, "b 3 h w"] | UInt8[Tensor, "b 3 h w"]
    intrinsics: Float[Tensor, "b 4"]
    curves: CurveBatch
    plane_pose: Float[Tensor, "b 2"]
    target_pose: Float[Tensor, "b 2"]
    keys: tuple[str, ...]

    def to(self, device: torch.device) -> "Batch":
        """The batch on the device, with images in 0..1."""
        tensors = (part.to(device, non_blocking=True) for part in (self.intrinsics, self.plane_pose, self.target_pose))
        intrinsics, plane_pose, target_pose = tensors
        curves = CurveBatch(*(part.to(device, non_blocking=True) for part in self.curves))
        return Batch(pixels_on(device, self.image), intrinsics, curves, plane_pose, target_pose, self.keys)


@dataclass(frozen=True, eq=False)
class NetworkLabels:
    """What a network learns from the sample with this key. `intrinsics` are in pixels of the network's image.

    Curves have no repeats. Short ones are padded with their last point, so that y stays sorted; the padding is not
    visible.
    """

    key: str
    intrinsics: Intrinsics
    plane: Pose
    target: Pose
    xyz_cam: Float[np.ndarray, "l n 3"]
    visible: Bool[np.ndarray, "l n"]
    kind: Int[np.ndarray, " l"]


def annotation_of(
    key: str, labels: Labels, size_px: tuple[int, int], pose_mode: str, *, in_image_only: bool = False
) -> NetworkLabels:
    """The annotation that labels give for images of `size_px` (height, width); raise FormatError, naming the sample,
    where they hold no finite numbers."""
    if not all(np.isfinite(lane.xyz_cam).all() for lane in labels.lanes):
        raise FormatError(f"sample {key}: expected finite lane points, got NaN or infinity")
    all_curves = road_curves(labels, in_image_only=in_image_only)
    curves = [curve for curve in all_curves if not curve.is_repeat]
    n_points = max([1, *(len(curve.visible) for curve in curves)])
    xyz_cam = np.zeros((len(curves), n_points, 3), dtype=np.float32)
    visible = np.zeros((len(curves), n_points), dtype=bool)
    for i, curve in enumerate(curves):
        n = len(curve.visible)
        xyz_cam[i, :n], xyz_cam[i, n:], visible[i, :n] = curve.xyz_cam, curve.xyz_cam[-1], curve.visible
    kind = np.array([CENTERLINE if curve.kind == "centerline" else DELIMITER for curve in curves], dtype=np.int64)
    intrinsics = scale(intrinsics_of(labels), (labels.camera.height_px, labels.camera.width_px), size_px)
    plane, target = plane_pose(labels), target_pose(labels, pose_mode)
    return NetworkLabels(key, intrinsics, plane, target, xyz_cam, visible, kind)


def pack(annotations: Sequence[NetworkLabels]) -> CurveBatch:
    """The curves of several images in one padded block."""
    n_lanes = max([1, *(len(one.kind) for one in annotations)])
    n_points = max([1, *(one.visible.shape[1] for one in annotations)])
    xyz_cam = np.zeros((len(annotations), n_lanes, n_points, 3), dtype=np.float32)
    visible = np.zeros((len(annotations), n_lanes, n_points), dtype=bool)
    kind = np.zeros((len(annotations), n_lanes), dtype=np.int64)
    for i, one in enumerate(annotations):
        lanes, points = one.visible.shape
        xyz_cam[i, :lanes, :points], xyz_cam[i, :lanes, points:] = one.xyz_cam, one.xyz_cam[:, -1:]
        visible[i, :lanes, :points] = one.visible
        kind[i, :lanes] = one.kind
    return CurveBatch(torch.from_numpy(xyz_cam), torch.from_numpy(visible), torch.from_numpy(kind))


def pixels_on(device: torch.device, image: UInt8[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
    """Images in 0..1 on the device, in the layout that convolutions like best."""
    moved = image.to(device, non_blocking=True)
    return moved.float().div_(255).contiguous(memory_format=torch.channels_last)


def intrinsics_of(labels: Labels) -> Intrinsics:
    """fx, fy, cx, cy from `img_from_cam` = [[fx, cx, 0], [0, cy, -fy], [0, 1, 0]]."""
    matrix = labels.camera.img_from_cam
    return (float(matrix[0, 0]), float(-matrix[1, 2]), float(matrix[0, 1]), float(matrix[1, 1]))


def checked_intrinsics(intrinsics: Intrinsics, where: str) -> Intrinsics:
    """Intrinsics given by a user. Raises InputError if no camera can have them."""
    fx, fy, cx, cy = intrinsics
    if not (all(1 <= f_px <= 1e6 for f_px in (fx, fy)) and all(abs(c_px) <= 1e6 for c_px in (cx, cy))):
        given = ",".join(f"{value:g}" for value in intrinsics)
        raise InputError(f"{where}: expected focal lengths from 1 to 1000000 px and a centre, got {given}")
    return intrinsics


def img_from_cam(intrinsics: Intrinsics) -> Float[np.ndarray, "3 3"]:
    """The projection matrix, as labels have it, of these intrinsics."""
    fx, fy, cx, cy = intrinsics
    return np.array([[fx, cx, 0.0], [0.0, cy, -fy], [0.0, 1.0, 0.0]])


def size_of(image: RgbImage) -> tuple[int, int]:
    """Height and width."""
    return (image.shape[0], image.shape[1])


def resize(image: RgbImage, size_px: tuple[int, int]) -> UInt8[np.ndarray, "h2 w2 3"]:
    """Resize to (height, width), ignoring the aspect ratio."""
    height, width = size_px
    if image.shape[:2] == (height, width):
        return image
    method = Image.Resampling.BOX if width < image.shape[1] else Image.Resampling.BILINEAR
    return np.array(Image.fromarray(image).resize((width, height), method))


def fit(
    image: RgbImage, intrinsics: Intrinsics, size_px: tuple[int, int], trained: FocalLengths | None = None
) -> tuple[UInt8[np.ndarray, "h2 w2 3"], Intrinsics]:
    """The image of `size_px` (height, width) that a network takes, and its intrinsics.

    The image is resized. If that gives focal lengths that training did not have, it is resized to the nearest that
    training had, and cropped or extended by its border pixels, so that lanes appear as wide and as long as in training.
    """
    (height, width), from_px = size_px, size_of(image)
    if not 0 < intrinsics[2] < from_px[1]:
        told = f"an image of {from_px[1]}x{from_px[0]} px, got {intrinsics[2]:g}: are they those of another size?"
        raise InputError(f"intrinsics: expected a centre between the left and the right edge of {told}")
    fx, fy, cx, cy = scale(intrinsics, from_px, size_px)
    new_fx, new_fy = (fx, fy) if trained is None else trained.nearest(fx, fy)
    enlarged = max(new_fx / fx, new_fy / fy)
    if enlarged > MOST_ENLARGED:
        least = ", ".join(f"{f_px * enlarged / MOST_ENLARGED:.4g}" for f_px in intrinsics[:2])
        raise InputError(
            f"intrinsics: expected focal lengths of at least {least} px for an image of {from_px[1]}x{from_px[0]} px, "
            f"got {intrinsics[0]:.4g}, {intrinsics[1]:.4g}"
        )
    small_px = (max(1, round(height * new_fy / fy)), max(1, round(width * new_fx / fx)))
    small = resize(image, small_px)
    fx, fy, small_cx, small_cy = scale(intrinsics, from_px, small_px)
    left, top = round(cx - small_cx), round(cy - small_cy)
    rows = np.clip(np.arange(height) - top, 0, small_px[0] - 1)
    columns = np.clip(np.arange(width) - left, 0, small_px[1] - 1)
    return small[rows][:, columns], (fx, fy, small_cx + left, small_cy + top)


def scale(intrinsics: Intrinsics, from_px: tuple[int, int], to_px: tuple[int, int]) -> Intrinsics:
    """The intrinsics of a resized image; sizes are (height, width)."""
    fx, fy, cx, cy = intrinsics
    sy, sx = to_px[0] / from_px[0], to_px[1] / from_px[1]
    return (fx * sx, fy * sy, cx * sx, cy * sy)
