"""Score a detector on photographs of a known camera by labels in the image: tuSimple's lines, KITTI's lane areas."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.formats.reading import read_image, read_text
from synth3dlanes.formats.tusimple import TusimpleSplit, find_labels
from synth3dlanes.system.arrays import RgbImage
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.words import counted

from .data import CameraImage, Intrinsics, checked_intrinsics, img_from_cam
from .inference import Detector
from .lanes import Detection, Prediction, read_by_key
from .predict import image_files
from .tusimple import asked_for, columns_of, delimiters, right_of_host_m, tusimple_score
from .workers import ImageProgress, told


@dataclass(frozen=True)
class ImageReport:
    """The figures of a benchmark, and the number of images and lines that they cover; NaN where nothing was found."""

    benchmark: str
    figures: Mapping[str, float]
    n_images: int
    n_lines: int
    threshold: float

    def document(self) -> dict[str, Any]:
        """The report as JSON values, with names in lower case and null for NaN."""
        figures = {name.lower(): None if np.isnan(value) else value for name, value in self.figures.items()}
        settings = {"n_images": self.n_images, "n_lines": self.n_lines, "threshold": self.threshold}
        return {self.benchmark.lower(): figures, "settings": settings}

    def text(self) -> str:
        """The report as one line of text."""
        figures = ", ".join(f"{name} {value:.4f}" for name, value in self.figures.items())
        lines = f"{self.n_lines} lines of confidence {self.threshold:g} or more"
        return f"{self.benchmark}: {figures} ({counted(self.n_images, 'image')}, {lines})"


@dataclass(frozen=True, eq=False)
class TusimpleImages:
    """The images of a tuSimple label file, scored by its benchmark."""

    split: TusimpleSplit

    def keys(self) -> Sequence[str]:
        """Each frame's `raw_file`."""
        return [self.split.frame(index).raw_file for index in range(len(self.split))]

    def image(self, index: int) -> RgbImage:
        """The frame's picture."""
        return self.split.image(index)

    def lines_px(self, index: int) -> list[Float[np.ndarray, "_ 2"]]:
        """The labelled lines as points of the image."""
        frame = self.split.frame(index)
        return [np.stack([u_px, frame.rows_px], axis=1)[u_px >= 0] for u_px in frame.lanes_u_px]

    def report(self, found: Sequence[Prediction], intrinsics: Intrinsics, threshold: float) -> ImageReport:
        """The official accuracy, and rates of false positives and negatives."""
        score = tusimple_score(found, self.split, img_from_cam(intrinsics), threshold)
        figures = {"accuracy": score.accuracy, "FP": score.false_positive, "FN": score.false_negative}
        n_lines = sum(len(asked_for(prediction, threshold)) for prediction in found)
        return ImageReport("tuSimple", figures, len(self.split), n_lines, threshold)


@dataclass(frozen=True, eq=False)
class LaneAreas:
    """KITTI's images with masks of the host's lane (`um_lane_000000.png` for the image `um_000000`): red where a pixel
    counts, blue in the lane."""

    images: Sequence[Path]
    masks: Sequence[Path]

    def keys(self) -> Sequence[str]:
        """The names of the image files."""
        return [path.name for path in self.images]

    def image(self, index: int) -> RgbImage:
        """The pixels of an image."""
        return read_image(self.images[index])

    def report(self, found: Sequence[Prediction], intrinsics: Intrinsics, threshold: float) -> ImageReport:
        """Precision, recall and intersection over union of the pixels between the nearest delimiters to the left and
        right of the host, over all images together; `found` is the share of images with both delimiters."""
        both = true = claimed = n_found = n_lines = 0
        for path, prediction in zip(self.masks, found, strict=True):
            counts, is_lane = np.moveaxis(read_image(path)[..., [0, 2]] > 127, -1, 0)
            lines = delimiters(prediction, threshold)
            sides = beside_host(lines)
            area = _between(sides, img_from_cam(intrinsics), counts.shape) & counts
            both += np.count_nonzero(area & is_lane)
            true += np.count_nonzero(is_lane & counts)
            claimed += np.count_nonzero(area)
            n_found += bool(sides)
            n_lines += len(lines)
        figures = {
            "precision": _ratio(both, claimed),
            "recall": _ratio(both, true),
            "IoU": _ratio(both, true + claimed - both),
            "found": _ratio(n_found, len(found)),
        }
        return ImageReport("KITTI", figures, len(self.masks), n_lines, threshold)


Photographs = TusimpleImages | LaneAreas


def evaluate_detector(
    detector: Detector,
    photographs: Photographs,
    intrinsics: Intrinsics,
    threshold: float = 0.5,
    progress: ImageProgress | None = None,
) -> ImageReport:
    """Run a network over photographs and score it; `progress` gets the images that are done, and all."""
    keys = photographs.keys()
    images = (CameraImage(key, photographs.image(i), intrinsics) for i, key in enumerate(keys))
    found = (prediction for _, prediction in told(detector.in_images(images), len(keys), progress))
    return _score(found, photographs, intrinsics, threshold)


def evaluate_predictions(
    file: str | Path, photographs: Photographs, intrinsics: Intrinsics, threshold: float = 0.5
) -> ImageReport:
    """Score predictions in JSON lines (docs/baseline.md); images without a line count as images without detections."""
    return _score(read_by_key(Path(file), photographs.keys()), photographs, intrinsics, threshold)


def open_photographs(source: str | Path, masks: Path | None = None) -> Photographs:
    """Photographs with labels: those of `open_tusimple`, or a folder of images whose masks are in another."""
    if masks is None:
        found = open_tusimple(source)
        if found is None:
            raise InputError(f"{source}: expected a label file of tuSimple or a folder with one, or --lane-masks")
        return found
    files, mask_files = image_files(source), sorted(masks.glob("*_lane_*.png"))
    if not mask_files:
        raise FormatError(f"{masks}: expected masks of lanes, such as um_lane_000000.png, got none")
    images = []
    for mask in mask_files:
        name = mask.stem.replace("_lane_", "_")
        fitting = [path for path in files if path.stem == name or path.stem.endswith(f"_{name}")]
        if len(fitting) != 1:
            raise FormatError(f"{source}: expected one image {name} for the mask {mask.name}, got {len(fitting)}")
        images += fitting
    return LaneAreas(images, mask_files)


def open_tusimple(source: str | Path) -> TusimpleImages | None:
    """The images of a tuSimple label file or of a folder with one; None if the source is neither."""
    labels = None if "://" in str(source) else find_labels(Path(source))
    return None if labels is None else TusimpleImages(TusimpleSplit(labels))


def read_intrinsics(path: Path) -> Intrinsics:
    """fx, fy, cx, cy of the left colour camera, `P2` in a calibration file of KITTI."""
    rows = [line.split()[1:] for line in read_text(path).splitlines() if line.startswith("P2:")]
    try:
        ((fx, _, cx, _, _, fy, cy, _, _, _, _, _),) = (map(float, row) for row in rows)
    except ValueError:
        raise FormatError(f"{path}: expected one line `P2:` of 12 numbers, as KITTI's calibration has it") from None
    return checked_intrinsics((fx, fy, cx, cy), str(path))


def beside_host(lanes: Sequence[Detection]) -> list[Detection]:
    """The nearest lane to the left of the host and the nearest to its right; none if one is missing."""
    x_m = [right_of_host_m(lane) for lane in lanes]
    left = max((i for i, x in enumerate(x_m) if x < 0), key=lambda i: x_m[i], default=None)
    right = min((i for i, x in enumerate(x_m) if x >= 0), key=lambda i: x_m[i], default=None)
    return [] if left is None or right is None else [lanes[left], lanes[right]]


def _score(
    found: Iterable[Prediction], photographs: Photographs, intrinsics: Intrinsics, threshold: float
) -> ImageReport:
    predictions = list(found)
    kinds = {lane.kind for prediction in predictions for lane in prediction.lanes}
    if kinds == {"centerline"}:
        raise InputError("predictions: expected delimiters, which the labels of images show, got centre lines only")
    return photographs.report(predictions, intrinsics, threshold)


def _between(
    sides: Sequence[Detection], matrix: Float[np.ndarray, "3 3"], size_px: tuple[int, ...]
) -> Bool[np.ndarray, "h w"]:
    height, width = size_px
    if not sides:
        return np.zeros((height, width), dtype=bool)
    left_px, right_px = (columns_of(lane, matrix, np.arange(height) + 0.5)[:, None] for lane in sides)
    centres_px = np.arange(width) + 0.5
    return (left_px <= centres_px) & (centres_px < right_px)


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
