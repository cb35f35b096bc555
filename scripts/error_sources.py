"""Where errors in space come from: `python -m scripts.error_sources WEIGHTS DIR/SPLIT`.

Parts of what a network predicts are replaced by the truth in turn, and the errors of centre lines are measured again
(1 and 2 sigma near and far, medians sideways and in height beyond 30 m, in cm, at a confidence of 0.5). The first rows
replace what the network is given or gives, and match anew; the others change the errors of the pairs matched as it is.
"""

import sys
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from synth3dlanes_baseline import checkpoint
from synth3dlanes_baseline.curves import METRIC_Y_M, Pose, plane_pose, road_curves
from synth3dlanes_baseline.data import pixels_on
from synth3dlanes_baseline.evaluate import score
from synth3dlanes_baseline.inference import predictions_of
from synth3dlanes_baseline.lanes import Prediction
from synth3dlanes_baseline.loading import labelled_batches
from synth3dlanes_baseline.matching import find_pairs, match, point_weights, sample_detections, sample_truth
from synth3dlanes_baseline.metrics import NEAR_TO_M
from synth3dlanes_baseline.model import LaneNet
from synth3dlanes_baseline.sources import open_split

from synth3dlanes.labels.labels import Labels
from synth3dlanes.system.errors import InputError

THRESHOLD = 0.5
NEAR = METRIC_Y_M <= NEAR_TO_M
HEAD = (
    "| replaced by the truth | AP | near 1s | near 2s | far 1s | far 2s | far, sideways | far, height |\n"
    "|---|---|---|---|---|---|---|---|"
)
GIVEN: dict[str, Callable[[Pose, Pose], Pose]] = {
    "nothing": lambda found, true: found,
    "pitch, given to the network": lambda found, true: Pose(true.pitch_rad, found.height_m),
    "height, given to the network": lambda found, true: Pose(found.pitch_rad, true.height_m),
    "both, given to the network": lambda found, true: true,
}
"""The pose for the view from above, of the predicted and the true one."""
Errors = Float[np.ndarray, "m y 2"]
"""Errors of the matched lanes of an image, sideways and in height, in metres; NaN where not compared."""


def main(weights: str, source: str) -> None:
    """Print the table."""
    torch.set_num_threads(1)
    detector = checkpoint.detector(weights, torch.device("cpu"))
    network = detector.network
    if not isinstance(network, LaneNet):
        raise InputError(f"{weights}: expected weights of 3D-LaneNet")
    labels: list[Labels] = []
    found: dict[str, list[Prediction]] = defaultdict(list)
    with torch.inference_mode():
        for batch in labelled_batches(open_split(source), detector.size_px, detector.trained, 16, 0, detector.device):
            labels += batch.labels
            pixels = pixels_on(detector.device, batch.image)
            predicted = network(pixels, batch.intrinsics).pose.tolist()
            for name, given in GIVEN.items():
                both = zip(predicted, batch.labels, strict=True)
                poses = torch.tensor([given(Pose(*pose), plane_pose(one)) for pose, one in both])
                output = network(pixels, batch.intrinsics, poses)._replace(pose=poses)
                found[name] += predictions_of(batch.keys, output, network.config)
    found["height, and all lanes scaled with it"] = list(map(_scaled, labels, found["nothing"]))
    sys.stdout.write(f"{HEAD}\n")
    for name, predictions in found.items():
        ap = score(zip(labels, predictions, strict=True)).kinds["centerline"].ap
        pairs = [matched(*pair)[0] for pair in zip(labels, predictions, strict=True)]
        sys.stdout.write(f"{_row(name, f'{ap:.3f}', pairs)}\n")
    as_it_is = [matched(*pair) for pair in zip(labels, found["nothing"], strict=True)]
    for name, changed in REPLACED.items():
        sys.stdout.write(f"{_row(name, '', [changed(*pair) for pair in as_it_is])}\n")


def _scaled(labels: Labels, prediction: Prediction) -> Prediction:
    """The prediction scaled to the true height of the camera, which the image does not tell: every point is nearer or
    farther by the same share."""
    assert prediction.pose is not None
    share = labels.camera.height_m / prediction.pose.height_m
    return replace(prediction, lanes=tuple(replace(lane, xyz_cam=lane.xyz_cam * share) for lane in prediction.lanes))


def matched(labels: Labels, prediction: Prediction) -> tuple[Errors, Errors]:
    """The errors of matched centre lines, and, for each of their points, the direction in which an error cannot be seen
    in the image: that in which the lane moves, at equal y, if it is scaled about the camera."""
    truth = sample_truth(tuple(curve for curve in road_curves(labels) if curve.kind == "centerline"))
    lanes = [lane for lane in prediction.lanes if lane.kind == "centerline"]
    pairs = find_pairs(truth, sample_detections(lanes, labels.camera.road_from_cam), point_weights("linear"))
    accepted = match(pairs, THRESHOLD)
    errors = np.stack([pairs.dx_m[accepted], pairs.dz_m[accepted]], axis=-1).astype(float)
    places = np.stack([truth.x_m, truth.z_m - labels.camera.height_m], axis=-1)[pairs.truth[accepted]]
    slopes = np.gradient(places, METRIC_Y_M, axis=1)
    unseen = places - METRIC_Y_M[:, None] * slopes
    return errors, unseen / np.linalg.norm(unseen, axis=-1, keepdims=True)


def unseen_part(errors: Errors, unseen: Errors) -> Errors:
    """The part that the image does not show."""
    return (errors * unseen).sum(-1, keepdims=True) * unseen


def _shared(errors: Errors) -> Errors:
    """The mean over the lanes of the image at each y."""
    known = ~np.isnan(errors)
    return np.broadcast_to(np.where(known, errors, 0).sum(0) / np.maximum(known.sum(0), 1), errors.shape)


REPLACED: dict[str, Callable[[Errors, Errors], Errors]] = {
    "places sideways": lambda errors, unseen: errors * [0, 1],
    "heights": lambda errors, unseen: errors * [1, 0],
    "errors that the image shows": unseen_part,
    "errors that the image does not show": lambda errors, unseen: errors - unseen_part(errors, unseen),
    "errors that the lanes of an image share (means)": lambda errors, unseen: errors - _shared(errors),
    "the rest, which each lane has alone": lambda errors, unseen: np.where(np.isnan(errors), np.nan, _shared(errors)),
    "errors in height that the lanes of an image share": lambda errors, unseen: errors - _shared(errors) * [0, 1],
}


def _row(name: str, ap: str, images: list[Errors]) -> str:
    errors_m = np.concatenate(images)
    distance_m = np.linalg.norm(errors_m, axis=-1)

    def cm(values_m: Float[np.ndarray, "..."], percent: float) -> str:
        return f"{100 * np.nanpercentile(np.abs(values_m), percent):.1f}"

    sigmas = [cm(distance_m[:, part], percent) for part in (NEAR, ~NEAR) for percent in (68, 95)]
    medians = [cm(errors_m[:, ~NEAR, axis], 50) for axis in (0, 1)]
    return f"| {name} | {' | '.join([ap, *sigmas, *medians])} |"


if __name__ == "__main__":
    main(*sys.argv[1:])
