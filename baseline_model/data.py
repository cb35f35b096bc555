"""A split held in memory: images as uint8 (RGB, or planar YUV 4:2:0 when large), labels as padded curves.

Everything is decoded once; batches are gathered by index on the training device. Order and augmentation depend on
(seed, epoch, step) alone, not on the number of readers. Curves are in camera coordinates.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from PIL import Image
from torch import Tensor
from torch.nn import functional

from synth3dlanes.errors import FormatError
from synth3dlanes.labels import Labels

from .anchors import CENTERLINE, DELIMITER, CurveBatch
from .curves import Curve, road_curves, target_pose
from .poses import Pose

RGB_LIMIT_BYTES = 8 * 2**30
"""Above this size, `auto` stores YUV 4:2:0, which takes half the bytes; JPEG has no finer chroma anyway."""
N_POINTS = 112
N_DECODERS = 8


@runtime_checkable
class LabelledImage(Protocol):
    """A sample of a reader (`synth3dlanes.dataset.read.Sample`, `synth3dlanes.formats.reading.ForeignSample`)."""

    @property
    def key(self) -> str: ...
    @property
    def image(self) -> UInt8[np.ndarray, "h w 3"]: ...
    @property
    def labels(self) -> Labels: ...


@runtime_checkable
class Samples(Protocol):
    """Random access to labelled images by index from 0."""

    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> LabelledImage: ...


class Batch(NamedTuple):
    """Images in 0..1, intrinsics (fx, fy, cx, cy) in pixels of these images, curves, and poses (pitch, height)."""

    image: Float[Tensor, "b 3 h w"]
    intrinsics: Float[Tensor, "b 4"]
    curves: CurveBatch
    plane_pose: Float[Tensor, "b 2"]
    target_pose: Float[Tensor, "b 2"]
    places: Int[Tensor, " b"]


@dataclass(frozen=True, eq=False)
class ResidentData:
    """A whole split. `chroma` is None for RGB storage; otherwise `image` is luma only."""

    keys: tuple[str, ...]
    image: UInt8[Tensor, "n c h w"]
    chroma: UInt8[Tensor, "n 2 h2 w2"] | None
    intrinsics: Float[Tensor, "n 4"]
    curves: CurveBatch
    plane_pose: Float[Tensor, "n 2"]
    target_pose: Float[Tensor, "n 2"]

    def __len__(self) -> int:
        return len(self.keys)

    def to(self, device: torch.device) -> "ResidentData":
        """Copy all tensors to the device."""
        return ResidentData(
            self.keys,
            self.image.to(device),
            None if self.chroma is None else self.chroma.to(device),
            self.intrinsics.to(device),
            CurveBatch(*(part.to(device) for part in self.curves)),
            self.plane_pose.to(device),
            self.target_pose.to(device),
        )

    def batch(self, index: Int[Tensor, " b"], device: torch.device) -> Batch:
        """Images and labels of these samples."""
        index = index.to(self.image.device)
        image = self.image[index].to(device).float() / 255
        if self.chroma is not None:
            image = rgb_from_yuv(image, self.chroma[index].to(device).float() / 255)
        return Batch(
            image.contiguous(memory_format=torch.channels_last),
            self.intrinsics[index].to(device),
            CurveBatch(*(part[index].to(device) for part in self.curves)),
            self.plane_pose[index].to(device),
            self.target_pose[index].to(device),
            index,
        )


class _Record(NamedTuple):
    key: str
    image: UInt8[np.ndarray, "h w 3"]
    intrinsics: tuple[float, float, float, float]
    curves: tuple[Curve, ...]
    plane: Pose
    target: Pose


def load(
    samples: Samples,
    size_px: tuple[int, int],
    pose_mode: str,
    storage: Literal["auto", "rgb", "yuv420"] = "auto",
    *,
    fov_mask: bool = False,
    on_progress: Callable[[int, int], None] | None = None,
) -> ResidentData:
    """Decode every sample once, resized to `size_px` (height, width) with its intrinsics."""
    height, width = size_px
    n = len(samples)
    if n == 0:
        raise FormatError("training data: expected at least one sample, got none")
    is_yuv = storage == "yuv420" or (storage == "auto" and n * height * width * 3 > RGB_LIMIT_BYTES)
    image = torch.zeros(n, 1 if is_yuv else 3, height, width, dtype=torch.uint8)
    chroma = torch.zeros(n, 2, height // 2, width // 2, dtype=torch.uint8) if is_yuv else None
    records: list[_Record] = []

    def read(index: int) -> _Record:
        return _record(samples[index], size_px, pose_mode, fov_mask)

    with ThreadPoolExecutor(N_DECODERS) as pool:
        for index, record in enumerate(pool.map(read, range(n))):
            pixels = torch.from_numpy(record.image).permute(2, 0, 1)
            if chroma is None:
                image[index] = pixels
            else:
                image[index], chroma[index] = yuv_from_rgb(pixels)
            records.append(record._replace(image=record.image[:0]))
            if on_progress is not None:
                on_progress(index + 1, n)
    return ResidentData(
        keys=tuple(record.key for record in records),
        image=image,
        chroma=chroma,
        intrinsics=torch.tensor([record.intrinsics for record in records]),
        curves=pack([record.curves for record in records]),
        plane_pose=torch.tensor([record.plane for record in records]),
        target_pose=torch.tensor([record.target for record in records]),
    )


def pack(curves: Sequence[tuple[Curve, ...]]) -> CurveBatch:
    """Curves of several images in one padded block, without repeats; padding repeats the last point, so y is sorted."""
    curves = [tuple(curve for curve in of_image if not curve.is_repeat) for of_image in curves]
    n_lanes = max([1, *(len(of_image) for of_image in curves)])
    n_points = max([N_POINTS, *(len(curve.visible) for of_image in curves for curve in of_image)])
    xyz = np.zeros((len(curves), n_lanes, n_points, 3), dtype=np.float32)
    visible = np.zeros((len(curves), n_lanes, n_points), dtype=bool)
    kind = np.zeros((len(curves), n_lanes), dtype=np.int64)
    for i, of_image in enumerate(curves):
        for j, curve in enumerate(of_image):
            n = len(curve.visible)
            xyz[i, j, :n], xyz[i, j, n:] = curve.xyz_cam, curve.xyz_cam[-1]
            visible[i, j, :n] = curve.visible
            kind[i, j] = CENTERLINE if curve.kind == "centerline" else DELIMITER
    return CurveBatch(torch.from_numpy(xyz), torch.from_numpy(visible), torch.from_numpy(kind))


def yuv_from_rgb(rgb: UInt8[Tensor, "3 h w"]) -> tuple[UInt8[Tensor, "1 h w"], UInt8[Tensor, "2 h2 w2"]]:
    """JPEG's (BT.601, full range) luma, and chroma averaged over 2x2 pixels."""
    r, g, b = rgb.float()
    luma = 0.299 * r + 0.587 * g + 0.114 * b
    chroma = torch.stack([(b - luma) * 0.564334 + 128, (r - luma) * 0.713267 + 128])
    half = functional.avg_pool2d(chroma, 2)
    return luma.round().clamp(0, 255).byte()[None], half.round().clamp(0, 255).byte()


def rgb_from_yuv(luma: Float[Tensor, "b 1 h w"], chroma: Float[Tensor, "b 2 h2 w2"]) -> Float[Tensor, "b 3 h w"]:
    """Inverse of `yuv_from_rgb` for values in 0..1; chroma is interpolated."""
    size = (luma.shape[2], luma.shape[3])
    colour = functional.interpolate(chroma, size, mode="bilinear") - 128 / 255
    blue, red = colour[:, :1], colour[:, 1:]
    rgb = [luma + 1.402 * red, luma - 0.344136 * blue - 0.714136 * red, luma + 1.772 * blue]
    return torch.cat(rgb, dim=1).clamp(0, 1)


def intrinsics_of(labels: Labels) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy from `img_from_cam` = [[fx, cx, 0], [0, cy, -fy], [0, 1, 0]]."""
    matrix = labels.camera.img_from_cam
    return (float(matrix[0, 0]), float(-matrix[1, 2]), float(matrix[0, 1]), float(matrix[1, 1]))


def resize(
    image: UInt8[np.ndarray, "h w 3"], intrinsics: tuple[float, float, float, float], size_px: tuple[int, int]
) -> tuple[UInt8[np.ndarray, "h2 w2 3"], tuple[float, float, float, float]]:
    """Resize to (height, width), ignoring the aspect ratio; the intrinsics scale with the image."""
    height, width = size_px
    if image.shape[:2] == (height, width):
        return image, intrinsics
    fx, fy, cx, cy = intrinsics
    sx, sy = width / image.shape[1], height / image.shape[0]
    small = Image.fromarray(image).resize(
        (width, height), Image.Resampling.BOX if sx < 1 else Image.Resampling.BILINEAR
    )
    return np.array(small), (fx * sx, fy * sy, cx * sx, cy * sy)


def _record(sample: LabelledImage, size_px: tuple[int, int], pose_mode: str, fov_mask: bool) -> _Record:
    labels = sample.labels
    if not all(np.isfinite(lane.xyz_cam).all() for lane in labels.lanes):
        raise FormatError(f"sample {sample.key}: expected finite lane points, got NaN or infinity")
    image, intrinsics = resize(np.array(sample.image), intrinsics_of(labels), size_px)
    curves = road_curves(labels, in_image_only=fov_mask)
    plane = Pose(labels.camera.pitch_rad, labels.camera.height_m)
    return _Record(sample.key, image, intrinsics, curves, plane, target_pose(labels, pose_mode))


def describe(data: ResidentData) -> dict[str, Any]:
    """The description of training data that checkpoints store."""
    return {
        "n_images": len(data),
        "intrinsics_mean": [round(float(v), 3) for v in data.intrinsics.mean(0)],
        "storage": "rgb" if data.chroma is None else "yuv420",
    }
