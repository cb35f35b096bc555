"""Detect lanes in a split, in image files or in folders of images; write predictions and pictures."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from synth3dlanes.formats.reading import read_image
from synth3dlanes.labels import Labels

from . import checkpoint as checkpoints
from .data import Intrinsics, intrinsics_of, size_of
from .inference import choose_device
from .lanes import Prediction, write_predictions
from .overlay import save_overlay
from .sources import open_split

ASSUMED_FOV_DEG = 60.0
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".webp")


@dataclass(eq=False)
class Summary:
    """What was found, and where it is written; `n_lanes` counts lanes of at least the threshold's confidence."""

    path: Path
    threshold: float
    is_assumed: bool = False
    n_images: int = 0
    n_lanes: int = 0
    best_score: float = 0.0

    def text(self) -> str:
        """It in words."""
        if self.n_lanes:
            found = f"{self.path}: {self.n_lanes} lanes in {self.n_images} images"
        else:
            found = (
                f"{self.path}: no lane of confidence {self.threshold:g} in {self.n_images} images; the best has "
                f"{self.best_score:.2f}, --threshold shows it"
            )
        assumed = f"; a field of view of {ASSUMED_FOV_DEG:g} degrees was assumed, --intrinsics says otherwise"
        return found + assumed * self.is_assumed


@dataclass(frozen=True, eq=False)
class _Picture:
    key: str
    image: UInt8[np.ndarray, "h w 3"]
    intrinsics: Intrinsics
    labels: Labels | None


def predict(
    checkpoint: str | Path,
    source: str | Path,
    out_dir: str | Path,
    intrinsics: Intrinsics | None = None,
    n_overlays: int = 16,
    device: str = "auto",
    own_model: str | None = None,
    threshold: float = 0.5,
) -> Summary:
    """Write `predictions.jsonl` and the first `n_overlays` pictures, with lanes of at least this confidence, to
    `out_dir`.

    `source` is a split of a dataset, an image, or a folder of images. `intrinsics` are those of images (fx, fy, cx, cy
    in their pixels); None: a camera with a field of view of 60 degrees, as that of the paper, is assumed."""
    detector = checkpoints.detector(checkpoint, choose_device(device), own_model)
    pictures = _pictures(source, intrinsics)
    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    summary = Summary(out / "predictions.jsonl", threshold)
    summary.is_assumed = intrinsics is None and bool(_image_files(source))
    shown: list[_Picture] = []

    def images() -> Iterator[tuple[str, UInt8[np.ndarray, "h w 3"], Intrinsics]]:
        for picture in pictures:
            if len(shown) < n_overlays:
                shown.append(picture)
            yield picture.key, picture.image, picture.intrinsics

    def kept() -> Iterator[Prediction]:
        for number, prediction in enumerate(detector.in_images(images())):
            if number < n_overlays:
                picture = shown[number]
                name = picture.key.replace("/", "_").rsplit(".", 1)[0]
                matrix = img_from_cam(picture.intrinsics)
                save_overlay(out / f"{name}.png", picture.image, matrix, prediction, picture.labels, threshold)
            summary.n_images += 1
            summary.n_lanes += sum(lane.score >= threshold for lane in prediction.lanes)
            summary.best_score = max([summary.best_score, *(lane.score for lane in prediction.lanes)])
            yield prediction

    write_predictions(summary.path, kept())
    return summary


def img_from_cam(intrinsics: Intrinsics) -> Float[np.ndarray, "3 3"]:
    """The labels' matrix for these intrinsics."""
    fx, fy, cx, cy = intrinsics
    return np.array([[fx, cx, 0.0], [0.0, cy, -fy], [0.0, 1.0, 0.0]])


def _pictures(source: str | Path, intrinsics: Intrinsics | None) -> Iterator[_Picture]:
    """The source's images; the source is opened at once, images are read on iteration."""
    files = _image_files(source)
    if files:
        return (_of_file(file, intrinsics) for file in files)
    samples = open_split(source)
    chosen = (samples[index] for index in range(len(samples)))
    return (_Picture(s.key, np.array(s.image), intrinsics_of(s.labels), s.labels) for s in chosen)


def _of_file(file: Path, intrinsics: Intrinsics | None) -> _Picture:
    image = read_image(file)
    return _Picture(file.name, image, intrinsics or assumed_intrinsics(size_of(image)), None)


def assumed_intrinsics(size_px: tuple[int, int]) -> Intrinsics:
    """Those of a camera with square pixels and a horizontal field of view of 60 degrees."""
    height, width = size_px
    focal_px = width / 2 / math.tan(math.radians(ASSUMED_FOV_DEG / 2))
    return (focal_px, focal_px, width / 2, height / 2)


def _image_files(source: str | Path) -> list[Path]:
    if "://" in str(source):
        return []
    source = Path(source)
    if source.is_file() and source.suffix.lower() in IMAGE_SUFFIXES:
        return [source]
    if source.is_dir():
        return sorted(path for path in source.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    return []
