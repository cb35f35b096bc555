"""Detect lanes in a split, in image files, folders of images or videos; write predictions, pictures and videos.

Opening image files needs neither the reader of data sets nor those of formats, which take longer to import than a
photograph takes.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from synth3dlanes.formats.reading import read_image
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import Folder
from synth3dlanes.system.words import counted

from . import checkpoint as checkpoints
from .data import CameraImage, Intrinsics, LabelledImage, intrinsics_of, size_of
from .devices import choose_device
from .inference import Detector
from .lanes import Prediction, write_predictions
from .overlay import PICTURE_ENDINGS, LaneVideos, save_pictures
from .smoothing import smoothed
from .workers import ImageProgress, ahead, told

ASSUMED_FOV_DEG = 60.0
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".webp")
UNREAD_SUFFIXES = (".tif", ".tiff", ".gif", ".heic", ".avif", ".jp2", ".ppm", ".pgm", ".dng")
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
    if unread := image_files(source, UNREAD_SUFFIXES):
        told = f"got {counted(len(unread), 'file')} of other kinds: convert or move them"
        raise InputError(f"{unread[0]}: expected images ({', '.join(IMAGE_SUFFIXES)}), {told}")
    files = image_files(source)
    if not files:
        return _labelled(source, intrinsics)

    def read() -> Iterator[CameraImage]:
        for file in files:
            image = read_image(file)
            yield CameraImage(file.name, image, intrinsics or assumed_intrinsics(size_of(image)))

    return Pictures(read(), intrinsics is None, files=files, n_images=len(files))


def are_photographs(source: str | Path) -> bool:
    """Whether a source has photographs, not samples of a split."""
    if is_video(source) or image_files(source):
        return True
    from .photographs import open_tusimple

    return open_tusimple(source) is not None


def is_video(source: str | Path) -> bool:
    """Whether a source is a video file, by its name."""
    return "://" not in str(source) and Path(source).suffix.lower() in VIDEO_SUFFIXES


def image_files(source: str | Path, suffixes: Sequence[str] = IMAGE_SUFFIXES) -> list[Path]:
    """The image file that a path names, or those of a folder by name."""
    if "://" in str(source):
        return []
    source = Path(source)
    files = [source] if source.is_file() else sorted(source.iterdir()) if source.is_dir() else []
    return [file for file in files if file.suffix.lower() in suffixes]


def assumed_intrinsics(size_px: tuple[int, int]) -> Intrinsics:
    """The intrinsics of a camera with square pixels and a horizontal field of view of 60 degrees."""
    height, width = size_px
    focal_px = width / 2 / math.tan(math.radians(ASSUMED_FOV_DEG / 2))
    return (focal_px, focal_px, width / 2, height / 2)


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


@dataclass(eq=False)
class PredictionSummary:
    """What was found, and where it is written; `n_lanes` counts lanes of at least the threshold's confidence."""

    path: Path
    threshold: float
    is_assumed: bool = False
    n_images: int = 0
    n_lanes: int = 0
    best_score: float = 0.0

    def add(self, prediction: Prediction) -> None:
        """Count the lanes of one more image."""
        self.n_images += 1
        self.n_lanes += sum(lane.score >= self.threshold for lane in prediction.lanes)
        self.best_score = max([self.best_score, *(lane.score for lane in prediction.lanes)])

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


@dataclass(frozen=True)
class PredictConfig:
    """How images are taken, and what is drawn of them.

    `intrinsics` (fx, fy, cx, cy, in pixels) are those of image files and videos; without them a horizontal field of
    view of 60 degrees is assumed, that of the paper's camera. Lanes of at least this confidence are drawn of the first
    `n_overlays` images (`overlay.save_pictures`) or, with `has_videos`, of the first clips, in a video each, as of a
    video file. `smooth_s` is the time constant of `smoothing.smoothed`; None leaves frames alone.
    """

    intrinsics: Intrinsics | None = None
    n_overlays: int = 16
    threshold: float = 0.5
    has_videos: bool = False
    smooth_s: float | None = None


DEFAULT = PredictConfig()


def detector_for(
    source: str | Path, checkpoint: str | Path | None = None, device: str = "auto", own_model: str | None = None
) -> Detector:
    """The detector of a checkpoint, or that of the weights in this package which suit the source: `nano` for a split,
    `streets` for photographs. `own_model` names a network of your own as `module:function`."""
    weights = checkpoint or (checkpoints.STREETS if are_photographs(source) else checkpoints.SHIPPED)
    return checkpoints.detector(weights, choose_device(device), own_model)


def predict(
    detector: Detector,
    source: str | Path,
    out_dir: str | Path,
    config: PredictConfig = DEFAULT,
    progress: ImageProgress | None = None,
) -> PredictionSummary:
    """Write `predictions.jsonl` to `out_dir`, and pictures or videos with the lanes (`PredictConfig`).

    `source` is a split of a dataset, an image, a folder of images, a video, or a label file of tuSimple or a folder
    with one. Photographs of tuSimple without intrinsics need a network of the variant on a fixed plane. `progress` gets
    the images that are done, and all, if their number is known.
    """
    pictures = open_pictures(source, config.intrinsics)
    rate_hz = pictures.rate_hz
    if rate_hz is None and (config.smooth_s is not None or config.has_videos):
        raise InputError(f"{source}: expected a video or a split of clips by one camera, got single pictures")
    found = detector.in_images(pictures.images)
    if config.smooth_s is not None:
        found = smoothed(found, config.smooth_s)
    out = Path(out_dir)
    _expect_no_picture_in(out, pictures.files)
    folder = Folder(out)
    folder.make()
    folder.remove_all_unfinished()
    summary = PredictionSummary(out / "predictions.jsonl", config.threshold, pictures.is_assumed)
    drawn = set[str]()
    with LaneVideos(out, rate_hz or 1.0, config.n_overlays) as videos:

        def kept() -> Iterator[Prediction]:
            # The network goes on in a thread while these lines are written and drawn.
            for image, prediction in told(ahead(found), pictures.n_images, progress):
                pictures.check(prediction)
                if is_video(source) or config.has_videos:
                    name = Path(source).stem if is_video(source) else image.key
                    videos.add(name, image, prediction, config.threshold)
                elif summary.n_images < config.n_overlays:
                    # As p.jpg and p.png of one folder.
                    name = _stem(image.key) if _stem(image.key) not in drawn else image.key.replace("/", "_")
                    drawn.add(name)
                    save_pictures(out / name, image, prediction, config.threshold)
                summary.add(prediction)
                yield replace(prediction, time_s=image.time_s)

        write_predictions(summary.path, kept())
    return summary


def _expect_no_picture_in(out: Path, files: Sequence[Path]) -> None:
    """Raise InputError where the pictures of detections would replace images, which are in the same folder."""
    if files and out.resolve() == files[0].parent.resolve():
        pictures = {f"{_stem(file.name)}{ending}" for file in files for ending in PICTURE_ENDINGS}
        lost = next((file for file in files if file.name in pictures), None)
        if lost is not None:
            raise InputError(
                f"out {out}: expected a folder without {lost.name}, which a picture of lanes would replace"
            )


def _stem(key: str) -> str:
    return key.replace("/", "_").rsplit(".", 1)[0]
