"""Detect lanes in a split, in image files or in folders of images; write predictions and pictures."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from synth3dlanes.errors import InputError
from synth3dlanes.formats.reading import read_image
from synth3dlanes.labels import Labels

from . import checkpoint as checkpoints
from .data import intrinsics_of
from .inference import Intrinsics, choose_device, predict_images
from .lanes import Prediction, write_predictions
from .overlay import save_overlay
from .sources import open_split

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".webp")


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
) -> Path:
    """Write `predictions.jsonl` and the first `n_overlays` pictures to `out_dir`; return the predictions' path.

    `source` is a split of a dataset, an image, or a folder of images; images need their `intrinsics` (fx, fy, cx, cy
    in pixels of these images)."""
    model = checkpoints.build(checkpoints.load(Path(checkpoint)), choose_device(device))
    pictures = _pictures(source, intrinsics)
    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    shown: list[_Picture] = []

    def images() -> Iterator[tuple[str, UInt8[np.ndarray, "h w 3"], Intrinsics]]:
        for picture in pictures:
            if len(shown) < n_overlays:
                shown.append(picture)
            yield picture.key, picture.image, picture.intrinsics

    def kept() -> Iterator[Prediction]:
        for number, prediction in enumerate(predict_images(model, images())):
            if number < n_overlays:
                picture = shown[number]
                name = picture.key.replace("/", "_").rsplit(".", 1)[0]
                matrix = img_from_cam(picture.intrinsics)
                save_overlay(out / f"{name}.png", picture.image, matrix, prediction, picture.labels)
            yield prediction

    path = out / "predictions.jsonl"
    write_predictions(path, kept())
    return path


def img_from_cam(intrinsics: Intrinsics) -> Float[np.ndarray, "3 3"]:
    """The labels' matrix for these intrinsics."""
    fx, fy, cx, cy = intrinsics
    return np.array([[fx, cx, 0.0], [0.0, cy, -fy], [0.0, 1.0, 0.0]])


def _pictures(source: str | Path, intrinsics: Intrinsics | None) -> Iterator[_Picture]:
    """The source's images; the source is opened at once, images are read on iteration."""
    files = _image_files(Path(source)) if "://" not in str(source) else []
    if files:
        if intrinsics is None:
            raise InputError("intrinsics: expected fx,fy,cx,cy in pixels for image files, got none")
        return (_Picture(file.name, read_image(file), intrinsics, None) for file in files)
    samples = open_split(source)
    chosen = (samples[index] for index in range(len(samples)))
    return (_Picture(s.key, np.array(s.image), intrinsics_of(s.labels), s.labels) for s in chosen)


def _image_files(source: Path) -> list[Path]:
    if source.is_file() and source.suffix.lower() in IMAGE_SUFFIXES:
        return [source]
    if source.is_dir():
        return sorted(path for path in source.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    return []
