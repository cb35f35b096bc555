"""The images in which `predict` detects lanes: image files, frames of a video, photographs of tuSimple, samples of a
split.

Opening image files needs neither the reader of data sets nor those of formats, which take longer to import than a
photograph takes.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from synth3dlanes.formats.reading import read_image
from synth3dlanes.system.errors import InputError

from .data import CameraImage, Intrinsics, LabelledImage, intrinsics_of, size_of
from .lanes import Prediction

ASSUMED_FOV_DEG = 60.0
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".webp")
VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".ts")


@dataclass(frozen=True, eq=False)
class Pictures:
    """The images of a source, read one after the other; whether their camera is assumed; frames a second where they are
    those of a video or of clips; what raises InputError for lanes that no place in the image follows from; the image
    files that the source is or holds; and the number of images, None for a video's."""

    images: Iterator[CameraImage]
    is_assumed: bool = False
    rate_hz: float | None = None
    check: Callable[[Prediction], None] = lambda _: None
    files: Sequence[Path] = ()
    n_images: int | None = None


def open_pictures(source: str | Path, intrinsics: Intrinsics | None) -> Pictures:
    """The source is opened at once. Without intrinsics, image files and videos are taken for those of a camera with a
    field of view of 60 degrees."""
    if is_video(source):
        return _of_video(Path(source), intrinsics)
    files = image_files(source)
    if not files:
        return _labelled(source, intrinsics)
    return Pictures(
        (_of_file(file, intrinsics) for file in files), intrinsics is None, files=files, n_images=len(files)
    )


def are_photographs(source: str | Path) -> bool:
    """Whether a source has photographs, not samples of a split."""
    if is_video(source) or image_files(source):
        return True
    from .photographs import open_tusimple

    return open_tusimple(source) is not None


def is_video(source: str | Path) -> bool:
    """Whether a source is a video file, by its name."""
    return "://" not in str(source) and Path(source).suffix.lower() in VIDEO_SUFFIXES


def image_files(source: str | Path) -> list[Path]:
    """The image file that a path names, or those of a folder by name."""
    if "://" in str(source):
        return []
    source = Path(source)
    files = [source] if source.is_file() else sorted(source.iterdir()) if source.is_dir() else []
    return [file for file in files if file.suffix.lower() in IMAGE_SUFFIXES]


def assumed_intrinsics(size_px: tuple[int, int]) -> Intrinsics:
    """Those of a camera with square pixels and a horizontal field of view of 60 degrees."""
    height, width = size_px
    focal_px = width / 2 / math.tan(math.radians(ASSUMED_FOV_DEG / 2))
    return (focal_px, focal_px, width / 2, height / 2)


def _of_file(file: Path, intrinsics: Intrinsics | None) -> CameraImage:
    image = read_image(file)
    return CameraImage(file.name, image, intrinsics or assumed_intrinsics(size_of(image)))


def _of_video(file: Path, intrinsics: Intrinsics | None) -> Pictures:
    """Its frames; keys are their numbers in eight digits. The first one is read at once: then it is a video."""
    from synth3dlanes.imaging.video import open_video

    opened = ExitStack()
    try:
        video = opened.enter_context(open_video(file))
        first = next(video.frames)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from None
    camera = intrinsics or assumed_intrinsics(size_of(first))

    def frames() -> Iterator[CameraImage]:
        with opened:
            for number, image in enumerate(chain([first], video.frames)):
                yield CameraImage(f"{number:08d}", image, camera, time_s=number / video.rate_hz)

    return Pictures(frames(), intrinsics is None, video.rate_hz)


def _labelled(source: str | Path, intrinsics: Intrinsics | None) -> Pictures:
    """Photographs of tuSimple, or samples of a split."""
    from .photographs import open_tusimple
    from .sources import clip_rate_hz, open_split
    from .tusimple import check_plane

    frames = open_tusimple(source)
    if intrinsics is not None and frames is not None:
        keys = enumerate(frames.keys())
        images = (CameraImage(key, frames.image(i), intrinsics, frames.lines_px(i)) for i, key in keys)
        return Pictures(images, n_images=len(frames.keys()))
    if "://" not in str(source) and Path(source).suffix.lower() in IMAGE_SUFFIXES:
        raise InputError(f"{source}: expected an image, got no such file")
    samples = open_split(source)
    if intrinsics is not None:
        raise InputError(f"intrinsics: expected none for {source}, whose labels have them")
    images = (_of_sample(samples[i]) for i in range(len(samples)))
    if frames is not None:
        return Pictures(images, check=lambda found: check_plane(found, source), n_images=len(samples))
    return Pictures(images, rate_hz=clip_rate_hz(samples), n_images=len(samples))


def _of_sample(sample: LabelledImage) -> CameraImage:
    labels = sample.labels
    return CameraImage(sample.key, np.asarray(sample.image), intrinsics_of(labels), labels, labels.time_s)
