"""The flat-ground baseline (paper, Table 1, last row): image-only detection with a known ground plane."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels

from .curves import target_pose
from .lanes import Detection, Prediction
from .poses import Pose, onto_plane, road_from_cam


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
