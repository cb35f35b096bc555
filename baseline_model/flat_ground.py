"""The flat-ground baseline (paper, Table 1, last row): image-only detection with a known ground plane."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from synth3dlanes.frames import transform
from synth3dlanes.labels import Labels

from .curves import target_pose
from .lanes import Detection, Prediction
from .poses import Pose, road_from_cam


def through_flat_ground(prediction: Prediction, labels: Labels, plane: str) -> Prediction:
    """Project the lanes into the image and back onto the labels' `plane` or `horizon` plane."""
    pose = target_pose(labels, plane)
    lanes = []
    for lane in prediction.lanes:
        flat_cam = onto_plane(lane.xyz_cam, pose)
        if len(flat_cam) >= 2:
            lanes.append(Detection(lane.kind, lane.score, flat_cam))
    return replace(prediction, lanes=tuple(lanes))


def onto_plane(xyz_cam: Float[np.ndarray, "n 3"], pose: Pose) -> Float[np.ndarray, "m 3"]:
    """Intersect each point's viewing ray with the plane, at scale * point. Rays at or above the plane's horizon and
    points behind the camera do not intersect it; they are dropped and so count as missing."""
    to_road = road_from_cam(pose)
    # The height over the plane along the ray is height + scale * fall: the camera is at z = height.
    fall = xyz_cam @ to_road[2, :3]
    meets = (fall < -1e-6) & (xyz_cam[:, 1] > 0.05)
    scale = pose.height_m / -fall[meets]
    flat_cam = xyz_cam[meets] * scale[:, None]
    y_m = transform(to_road, flat_cam)[:, 1]
    # Uphill lanes diverge as they approach the horizon and return after it; keep the part before y first decreases.
    turns = np.flatnonzero(np.diff(y_m) <= 0)
    return flat_cam[: int(turns[0]) + 1] if len(turns) else flat_cam
