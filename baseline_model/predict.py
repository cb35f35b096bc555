"""Detect lanes in a split, in image files or in folders of images; write predictions and pictures."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from synth3dlanes.arrays import Polyline2, RgbImage
from synth3dlanes.errors import InputError
from synth3dlanes.files import Folder
from synth3dlanes.formats.reading import read_image
from synth3dlanes.labels import Labels
from synth3dlanes.words import counted

from . import checkpoint as checkpoints
from .data import Intrinsics, LabelledImage, img_from_cam, intrinsics_of, size_of
from .inference import Detector, choose_device
from .lanes import Prediction, write_predictions
from .overlay import save_pictures
from .photographs import open_tusimple
from .sources import IMAGE_SUFFIXES, image_files, open_split
from .tusimple import check_plane

ASSUMED_FOV_DEG = 60.0


@dataclass(eq=False)
class PredictionSummary:
    """What was found, and where it is written; `n_lanes` counts lanes of at least the threshold's confidence."""

    path: Path
    threshold: float
    is_assumed: bool = False
    n_images: int = 0
    n_lanes: int = 0
    best_score: float = 0.0

    def text(self) -> str:
        """The summary as one line of text."""
        if self.n_lanes:
            found = f"{self.path}: {counted(self.n_lanes, 'lane')} in {counted(self.n_images, 'image')}"
        else:
            found = (
                f"{self.path}: no lane of confidence {self.threshold:g} in {counted(self.n_images, 'image')}; "
                f"the best has {self.best_score:.2f}, --threshold shows it"
            )
        assumed = f"; a field of view of {ASSUMED_FOV_DEG:g} degrees was assumed, --intrinsics says otherwise"
        return found + assumed * self.is_assumed


@dataclass(frozen=True, eq=False)
class _Picture:
    key: str
    image: RgbImage
    intrinsics: Intrinsics
    truth: Labels | Sequence[Polyline2] = ()


@dataclass(frozen=True, eq=False)
class _Pictures:
    """A source's images, each read when it is asked for: one may take 200 MB."""

    n: int
    read: Callable[[int], _Picture]


def detector_for(
    source: str | Path, checkpoint: str | Path | None = None, device: str = "auto", own_model: str | None = None
) -> Detector:
    """The detector of a checkpoint, or that of the weights in this package which suit the source: `nano` for a split,
    `streets` for photographs. `own_model` names a network of your own as `module:function`."""
    are_photographs = bool(image_files(source)) or open_tusimple(source) is not None
    weights = checkpoint or (checkpoints.STREETS if are_photographs else checkpoints.SHIPPED)
    return checkpoints.detector(weights, choose_device(device), own_model)


def predict(
    detector: Detector,
    source: str | Path,
    out_dir: str | Path,
    intrinsics: Intrinsics | None = None,
    n_overlays: int = 16,
    threshold: float = 0.5,
) -> PredictionSummary:
    """Write `predictions.jsonl` to `out_dir`, and of each of the first `n_overlays` images a figure and the image in
    full size with the lanes of at least this confidence (`overlay.save_pictures`).

    `source` is a split of a dataset, an image, a folder of images, or a label file of tuSimple or a folder with one.
    `intrinsics` (fx, fy, cx, cy, in pixels) are those of image files. Without them a horizontal field of view of 60
    degrees is assumed, that of the paper's camera; photographs of tuSimple then need a network of the variant on a
    fixed plane."""
    are_files, are_tusimples = bool(image_files(source)), open_tusimple(source) is not None
    pictures = _pictures(source, intrinsics)
    out = Path(out_dir)
    Folder(out).make()
    summary = PredictionSummary(out / "predictions.jsonl", threshold)
    summary.is_assumed = intrinsics is None and are_files
    needs_plane = intrinsics is None and not are_files and are_tusimples

    def seen(index: int) -> tuple[str, RgbImage, Intrinsics]:
        picture = pictures.read(index)
        return picture.key, picture.image, picture.intrinsics

    def kept() -> Iterator[Prediction]:
        for number, prediction in enumerate(detector.in_images(map(seen, range(pictures.n)))):
            if needs_plane:
                check_plane(prediction, source)
            if number < n_overlays:
                _save(out, pictures.read(number), prediction, threshold)
            summary.n_images += 1
            summary.n_lanes += sum(lane.score >= threshold for lane in prediction.lanes)
            summary.best_score = max([summary.best_score, *(lane.score for lane in prediction.lanes)])
            yield prediction

    write_predictions(summary.path, kept())
    return summary


def _save(out: Path, picture: _Picture, prediction: Prediction, threshold: float) -> None:
    name = picture.key.replace("/", "_").rsplit(".", 1)[0]
    matrix = img_from_cam(picture.intrinsics)
    save_pictures(out / f"{name}.png", Image.fromarray(picture.image), matrix, prediction, picture.truth, threshold)


def _pictures(source: str | Path, intrinsics: Intrinsics | None) -> _Pictures:
    """The source's images; the source is opened at once."""
    frames = None if intrinsics is None else open_tusimple(source)
    if intrinsics is not None and frames is not None:
        keys = frames.keys()
        return _Pictures(len(keys), lambda i: _Picture(keys[i], frames.image(i), intrinsics, frames.lines_px(i)))
    files = image_files(source)
    if files:
        return _Pictures(len(files), lambda i: _of_file(files[i], intrinsics))
    is_here = "://" not in str(source)
    if is_here and Path(source).suffix.lower() in IMAGE_SUFFIXES:
        raise InputError(f"{source}: expected an image, got no such file")
    samples = open_split(source)
    if intrinsics is not None:
        raise InputError(f"intrinsics: expected none for {source}, whose labels have them")
    return _Pictures(len(samples), lambda i: _of_sample(samples[i]))


def _of_file(file: Path, intrinsics: Intrinsics | None) -> _Picture:
    image = read_image(file)
    return _Picture(file.name, image, intrinsics or assumed_intrinsics(size_of(image)))


def _of_sample(sample: LabelledImage) -> _Picture:
    return _Picture(sample.key, np.asarray(sample.image), intrinsics_of(sample.labels), sample.labels)


def assumed_intrinsics(size_px: tuple[int, int]) -> Intrinsics:
    """Those of a camera with square pixels and a horizontal field of view of 60 degrees."""
    height, width = size_px
    focal_px = width / 2 / math.tan(math.radians(ASSUMED_FOV_DEG / 2))
    return (focal_px, focal_px, width / 2, height / 2)
