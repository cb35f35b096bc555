"""Score a checkpoint, or predictions from a file, against the labels of a split."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from synth3dlanes.errors import FormatError
from synth3dlanes.labels import Labels

from . import checkpoint as checkpoints
from .data import Samples
from .flat_ground import through_flat_ground
from .inference import choose_device, predict_samples
from .lanes import Prediction, read_predictions
from .metrics import Evaluation, MetricConfig, Report
from .sources import open_split
from .tusimple import TusimpleOnPlane, mean_accuracy

LabelsAt = Callable[[int], Labels]


def evaluate_checkpoint(
    checkpoint: str | Path, data_dir: str | Path, config: MetricConfig | None = None, device: str = "auto"
) -> Report:
    """Run the checkpoint's network over a split (`DIR/test`) and score it."""
    model = checkpoints.build(checkpoints.load(Path(checkpoint)), choose_device(device))
    samples = open_split(data_dir)
    return score(predict_samples(model, samples), samples, config)


def evaluate_predictions(file: str | Path, data_dir: str | Path, config: MetricConfig | None = None) -> Report:
    """Score predictions in JSON lines (docs/baseline.md). Images without a line count as images without detections;
    unknown and repeated keys are errors."""
    samples = open_split(data_dir)
    places = {_key(samples, i): i for i in range(len(samples))}
    found: dict[str, Prediction] = {}
    for prediction in read_predictions(Path(file)):
        if prediction.key not in places:
            raise FormatError(f"{file}: expected keys of {data_dir}, got {prediction.key!r}")
        if prediction.key in found:
            raise FormatError(f"{file}: expected each key once, got {prediction.key!r} again")
        found[prediction.key] = prediction
    return score((found.get(key, Prediction(key, (), None)) for key in places), samples, config)


def evaluate_flat_ground(
    checkpoint: str | Path, data_dir: str | Path, config: MetricConfig | None = None, device: str = "auto"
) -> dict[str, Report]:
    """The paper's `flat ground` row: the network's lanes are projected to the image and back onto a plane known from
    the labels, either the tangent plane or the `horizon` plane. The paper reports the better one."""
    model = checkpoints.build(checkpoints.load(Path(checkpoint)), choose_device(device))
    samples = open_split(data_dir)
    found = list(predict_samples(model, samples))
    reports = {}
    for plane in ("plane", "horizon"):
        flat = (through_flat_ground(p, labels_at(samples, i), plane) for i, p in enumerate(found))
        reports[f"flat_ground:{plane}"] = score(flat, samples, config)
    return reports


def score(predictions: Iterable[Prediction], samples: Samples, config: MetricConfig | None = None) -> Report:
    """Score predictions that are in the order of the samples."""
    config = config or MetricConfig()
    tusimple = None
    if isinstance(samples, TusimpleOnPlane):
        predictions = list(predictions)
        tusimple = mean_accuracy(predictions, samples, config.threshold)
    evaluation = Evaluation(config)
    for index, prediction in enumerate(predictions):
        evaluation.add(labels_at(samples, index), prediction)
    return replace(evaluation.report(), tusimple=tusimple)


def labels_at(samples: Samples, index: int) -> Labels:
    """The labels of a sample, without reading its image if the source allows it."""
    alone: LabelsAt | None = getattr(samples, "labels", None)
    return samples[index].labels if alone is None else alone(index)


def _key(samples: Samples, index: int) -> str:
    alone: Callable[[int], str] | None = getattr(samples, "key", None)
    return samples[index].key if alone is None else alone(index)
