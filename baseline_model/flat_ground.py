"""The flat-ground baseline (paper, Table 1, last row): what image-only detection with a known plane would give."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from synth3dlanes.frames import transform
from synth3dlanes.labels import Labels

from .curves import road_curves, target_pose
from .lanes import Detection, Prediction
from .poses import Pose, road_from_cam


def through_flat_ground(prediction: Prediction, labels: Labels, plane: str) -> Prediction:
    """Project the lanes into the image and back onto the labels' `plane` or `horizon` plane."""
    pose = target_pose(labels, road_curves(labels), plane)
    lanes = []
    for lane in prediction.lanes:
        flat_cam = onto_plane(lane.xyz_cam, pose)
        if len(flat_cam) >= 2:
            lanes.append(Detection(lane.kind, lane.score, flat_cam))
    return replace(prediction, lanes=tuple(lanes))


def onto_plane(xyz_cam: Float[np.ndarray, "n 3"], pose: Pose) -> Float[np.ndarray, "m 3"]:
    """Each point's viewing ray meets the plane at scale * point. Rays at or above the plane's horizon, and points
    behind the camera, have no such place: those points are dropped and so count as missing."""
    to_road = road_from_cam(pose)
    # Height over the plane along the ray is height + scale * (direction's fall): the camera is at z = height.
    fall = xyz_cam @ to_road[2, :3]
    meets = (fall < -1e-6) & (xyz_cam[:, 1] > 0.05)
    scale = pose.height_m / -fall[meets]
    flat_cam = xyz_cam[meets] * scale[:, None]
    y_m = transform(to_road, flat_cam)[:, 1]
    # Uphill lanes shoot away and come back as they pass the horizon; keep the part before y first falls.
    turns = np.flatnonzero(np.diff(y_m) <= 0)
    return flat_cam[: int(turns[0]) + 1] if len(turns) else flat_cam
