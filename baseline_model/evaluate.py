"""Score a checkpoint, or predictions from a file, against the labels of a split."""

from collections.abc import Iterable, Iterator
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels

from . import checkpoint as checkpoints
from .curves import Pose, onto_plane, road_from_cam, target_pose
from .data import Samples
from .devices import choose_device
from .lanes import Detection, Prediction, read_by_key
from .metrics import Evaluation, EvaluationReport, MetricConfig
from .sources import key_at, labels_at, open_split
from .tusimple import WHOLE_IMG_FROM_CAM, TusimpleOnPlane, check_plane, tusimple_score
from .workers import ImageProgress, told


def through_flat_ground(prediction: Prediction, labels: Labels, plane: str) -> Prediction:
    """Project the lanes into the image and back onto the labels' `plane` or `horizon` plane. Points that do not meet it
    are missing."""
    pose = target_pose(labels, plane)
    lanes = []
    for lane in prediction.lanes:
        flat_cam = _until_fold(onto_plane(lane.xyz_cam, pose), pose)
        if len(flat_cam) >= 2:
            lanes.append(Detection(lane.kind, lane.score, flat_cam))
    return replace(prediction, lanes=tuple(lanes))


def _until_fold(flat_cam: Float[np.ndarray, "n 3"], pose: Pose) -> Float[np.ndarray, "m 3"]:
    """The part before y first decreases: uphill lanes diverge as they approach the horizon and return after it."""
    y_m = transform(road_from_cam(pose), flat_cam)[:, 1]
    turns = np.flatnonzero(np.diff(y_m) <= 0)
    return flat_cam[: int(turns[0]) + 1] if len(turns) else flat_cam


LabelledPrediction = tuple[Labels, Prediction]


def evaluate_checkpoint(
    checkpoint: str | Path,
    data_dir: str | Path,
    config: MetricConfig | None = None,
    device: str = "auto",
    own_model: str | None = None,
    progress: ImageProgress | None = None,
) -> EvaluationReport:
    """Run the checkpoint's network over a split (`DIR/test`) and score it. `own_model` names a user's network,
    `progress` gets the images that are done, and all."""
    detector = checkpoints.detector(checkpoint, choose_device(device), own_model)
    samples = open_split(data_dir)
    return score_on(samples, told(detector.in_samples(samples), len(samples), progress), config)


def evaluate_predictions(
    file: str | Path, data_dir: str | Path, config: MetricConfig | None = None
) -> EvaluationReport:
    """Score predictions in JSON lines (docs/baseline.md). Images without a line count as images without detections;
    unknown and repeated keys are errors."""
    samples = open_split(data_dir)
    given = read_by_key(Path(file), [key_at(samples, i) for i in range(len(samples))])
    return score_on(samples, ((labels_at(samples, i), found) for i, found in enumerate(given)), config)


def evaluate_flat_ground(
    checkpoint: str | Path, data_dir: str | Path, device: str = "auto"
) -> dict[str, EvaluationReport]:
    """The paper's `flat ground` row: the network's lanes are projected to the image and back onto a plane known from
    the labels, either the tangent plane or the `horizon` plane. The paper reports the better one."""
    detector = checkpoints.detector(checkpoint, choose_device(device))
    scores = {plane: Evaluation() for plane in ("plane", "horizon")}
    for labels, prediction in detector.in_samples(open_split(data_dir)):
        for plane, evaluation in scores.items():
            evaluation.add(labels, through_flat_ground(prediction, labels, plane))
    return {f"flat_ground:{plane}": evaluation.report() for plane, evaluation in scores.items()}


def score_on(
    samples: Samples, found: Iterable[LabelledPrediction], config: MetricConfig | None = None
) -> EvaluationReport:
    """Score predictions, which are in the order of the samples; those of tuSimple by its own benchmark too."""
    if not isinstance(samples, TusimpleOnPlane):
        return score(found, config)
    predictions: list[Prediction] = []

    def kept() -> Iterator[LabelledPrediction]:
        for labels, prediction in found:
            check_plane(prediction, samples.split.path)
            predictions.append(prediction)
            yield labels, prediction

    report = score(kept(), config)
    official = tusimple_score(predictions, samples.split, WHOLE_IMG_FROM_CAM, report.config.threshold)
    return replace(report, tusimple=astuple(official))


def score(found: Iterable[LabelledPrediction], config: MetricConfig | None = None) -> EvaluationReport:
    """Score predictions, each with the labels of its image."""
    evaluation = Evaluation(config or MetricConfig())
    for labels, prediction in found:
        evaluation.add(labels, prediction)
    return evaluation.report()
