"""Detect lanes in a split, in image files, folders of images or videos; write predictions, pictures and videos."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from PIL import Image

from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import Folder
from synth3dlanes.system.words import counted

from . import checkpoint as checkpoints
from .ahead import ImageProgress, ahead, told
from .data import CameraImage, Intrinsics, img_from_cam
from .inference import Detector, choose_device
from .lane_video import LaneVideos
from .lanes import Prediction, write_predictions
from .overlay import PICTURE_ENDINGS, save_pictures
from .pictures import ASSUMED_FOV_DEG, are_photographs, is_video, open_pictures
from .smoothing import smoothed


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
                    _save(out / name, image, prediction, config.threshold)
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


def _save(stem: Path, image: CameraImage, prediction: Prediction, threshold: float) -> None:
    matrix = img_from_cam(image.intrinsics)
    save_pictures(stem, Image.fromarray(image.image), matrix, prediction, image.truth, threshold)
