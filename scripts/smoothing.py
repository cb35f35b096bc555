"""What temporal smoothing does on clips with labels: `python -m scripts.smoothing nano DIR/SPLIT [SECONDS ...]`.

Prints a row for each time constant (0: none), with the motion of the camera known and unknown: average precision, the
errors of the metric, and flicker. Flicker is measured between consecutive frames of the same clip, at a confidence of
0.5: how much the error of a lane that is found in both changes sideways (rms, in cm), how many lanes that are labelled
in both are found in only one, and false lanes a frame.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch
from synth3dlanes_baseline import checkpoint
from synth3dlanes_baseline.curves import METRIC_Y_M, road_curves
from synth3dlanes_baseline.data import CameraImage
from synth3dlanes_baseline.evaluate import score
from synth3dlanes_baseline.lanes import Prediction
from synth3dlanes_baseline.matching import find_pairs, match, point_weights, sample_detections, sample_truth
from synth3dlanes_baseline.predict import open_pictures
from synth3dlanes_baseline.smoothing import Detected, smoothed

from synth3dlanes.labels.labels import Labels

THRESHOLD = 0.5
NEAR = METRIC_Y_M <= 40
HEAD = (
    "| time constant | motion | AP: centre lines | delimiters | near | far | jitter | toggles | false |\n"
    "|---|---|---:|---:|---:|---:|---:|---:|---:|"
)
Errors = dict[str, np.ndarray | None]
"""The error sideways at each y of every lane that counts, by its name; None for a missing one."""


def labels_of(image: CameraImage) -> Labels:
    """The labels of a frame of a clip."""
    assert isinstance(image.truth, Labels)
    return image.truth


def errors_in(image: CameraImage, prediction: Prediction) -> tuple[Errors, int]:
    """The errors of a frame, and how many of its lanes are false."""
    labels, errors, n_false = labels_of(image), Errors(), 0
    for kind in ("centerline", "delimiter"):
        lanes = [lane for lane in labels.lanes if lane.kind == kind]
        names = [lane.id for lane in lanes if road_curves(replace(labels, lanes=(lane,)))]
        truth = sample_truth(road_curves(replace(labels, lanes=tuple(lanes))))
        found = [lane for lane in prediction.lanes if lane.kind == kind and lane.score >= THRESHOLD]
        pairs = find_pairs(truth, sample_detections(found, labels.camera.road_from_cam), point_weights("linear"))
        accepted = match(pairs, THRESHOLD)
        by_truth = {int(pairs.truth[i]): pairs.dx_m[i] for i in accepted}
        errors |= {name: by_truth.get(i) for i, name in enumerate(names) if not truth.ignored[i]}
        used = {int(pairs.detection[i]) for i in accepted}
        n_false += sum(d not in used and not pairs.forgiven[d] for d in range(len(found)))
    return errors, n_false


def flicker(found: list[Detected]) -> tuple[float, float, float]:
    """Jitter in cm, and the toggles in percent and false lanes in numbers a frame."""
    frames = [errors_in(*one) for one in found]
    changes_m, toggles = [], []
    for (earlier, _), (later, _), a, b in zip(frames, frames[1:], found, found[1:], strict=False):
        if (a[0].time_s or 0.0) >= (b[0].time_s or 0.0):
            continue
        for name in earlier.keys() & later.keys():
            before, after = earlier[name], later[name]
            toggles.append((before is None) != (after is None))
            if before is not None and after is not None:
                changes_m.append((after - before)[NEAR])
    jitter_m = np.sqrt(np.nanmean(np.concatenate(changes_m) ** 2))
    return float(100 * jitter_m), float(100 * np.mean(toggles)), float(np.mean([n_false for _, n_false in frames]))


def row(name: str, found: list[Detected]) -> str:
    """The figures of a time constant."""
    report = score((labels_of(image), prediction) for image, prediction in found)
    lines, delimiters = report.kinds["centerline"], report.kinds["delimiter"]
    errors = (lines.at_threshold.near_1sigma_cm, lines.at_threshold.far_1sigma_cm)
    jitter_cm, toggled, n_false = flicker(found)
    cells = (f"{lines.ap:.3f}", f"{delimiters.ap:.3f}", *(f"{error:.0f} cm" for error in errors))
    return f"| {name} | {' | '.join(cells)} | {jitter_cm:.1f} cm | {toggled:.1f} % | {n_false:.2f} |"


def unlabelled(found: list[Detected]) -> Iterator[Detected]:
    """The frames as those of a video, whose motion is unknown."""
    return ((replace(image, truth=()), prediction) for image, prediction in found)


def main(weights: str, source: str, constants: list[str]) -> None:
    """Print the table."""
    images = open_pictures(source, None).images
    found = list(checkpoint.detector(weights, torch.device("cpu")).in_images(images))
    sys.stdout.write(f"{HEAD}\n{row('none | ', found)}\n")
    for constant in constants:
        for name, frames in (("known", iter(found)), ("unknown", unlabelled(found))):
            smooth = [prediction for _, prediction in smoothed(frames, float(constant))]
            pairs = [(image, prediction) for (image, _), prediction in zip(found, smooth, strict=True)]
            sys.stdout.write(f"{row(f'{constant} s | {name}', pairs)}\n")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
