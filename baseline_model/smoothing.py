"""Temporal smoothing: the lanes of consecutive frames of a camera are associated, and smoothed exponentially.

Frame: camera coordinates. Where the motion of the camera is known, the lanes of the frame before are moved by it.
Where it is not, as in a video, lanes are assumed to look the same from frame to frame; they do where the host follows a
road of constant curvature and slope.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import Labels
from synth3dlanes.system.arrays import Matrix4, Points3
from synth3dlanes.system.errors import InputError

from .curves import Pose
from .data import CameraImage
from .lanes import Detection, Prediction

GATE_M = 1.0
"""Lanes that are farther apart sideways, on average, are two: half the distance of painted lines beside each other is
more."""
COMPARED_Y_M = np.arange(5.0, 41.0, 5.0)
"""Where they are compared."""

Detected = tuple[CameraImage, Prediction]


def smoothed(found: Iterable[Detected], time_constant_s: float) -> Iterator[Detected]:
    """The frames with smoothed lanes. A frame that is not later than the one before begins another clip.

    Points and the pose are means in which what is older by the time constant weighs e times less. Scores stay: means of
    them find lanes late and lose them late (docs/baseline.md).
    """
    before: Detected | None = None
    for image, prediction in found:
        if image.time_s is None:
            raise InputError(f"smooth: expected frames of a clip or a video, got the picture {image.key}")
        elapsed_s = image.time_s - (before[0].time_s or 0.0) if before is not None else 0.0
        if before is not None and elapsed_s == 0:
            raise InputError(f"smooth: expected the frames of one camera, got several at {image.time_s:g} s")
        if before is not None and elapsed_s > 0:
            motion = motion_between(before[0], image)
            prediction = _mean(before[1], motion, prediction, 1 - math.exp(-elapsed_s / time_constant_s))
        before = replace(image, image=image.image[:0]), prediction
        yield image, prediction


def motion_between(before: CameraImage, image: CameraImage) -> Matrix4:
    """The motion of the camera between two frames, by their labels; without labels, that of one which stands still."""
    if not (isinstance(before.truth, Labels) and isinstance(image.truth, Labels)):
        return np.eye(4)
    return invert(image.truth.camera.world_from_cam) @ before.truth.camera.world_from_cam


def associate(before: Sequence[Detection], lanes: Sequence[Detection]) -> dict[int, int]:
    """For the index of each lane that was there before, its index then: the nearest pairs of a kind first, within the
    gate."""
    x_before_m, x_m = ([_at(lane, COMPARED_Y_M)[:, 0] for lane in group] for group in (before, lanes))
    apart_m = {
        (i, j): np.abs(x_m[i] - x_before_m[j]).mean()
        for i, lane in enumerate(lanes)
        for j, other in enumerate(before)
        if lane.kind == other.kind
    }
    pairs = dict[int, int]()
    for i, j in sorted(apart_m, key=lambda pair: apart_m[pair]):
        if apart_m[i, j] <= GATE_M and i not in pairs and j not in pairs.values():
            pairs[i] = j
    return pairs


def _mean(before: Prediction, cam_from_before: Matrix4, now: Prediction, share: float) -> Prediction:
    """The later frame's lanes, in the mean with those of the frame before, in which the later ones have this share."""
    moved = [replace(lane, xyz_cam=transform(cam_from_before, lane.xyz_cam)) for lane in before.lanes]
    pairs = associate(moved, now.lanes)
    lanes = [_mean_lane(moved[pairs[i]], lane, share) if i in pairs else lane for i, lane in enumerate(now.lanes)]
    pose = now.pose
    if before.pose is not None and now.pose is not None:
        pose = Pose(*(share * new + (1 - share) * old for new, old in zip(now.pose, before.pose, strict=True)))
    return replace(now, lanes=tuple(lanes), pose=pose)


def _mean_lane(before: Detection, lane: Detection, share: float) -> Detection:
    """At the points of the later lane; where the earlier one does not reach, the later one alone."""
    y_m, reach_m = lane.xyz_cam[:, 1], before.xyz_cam[:, 1]
    is_common = (y_m >= reach_m.min()) & (y_m <= reach_m.max())
    mean = share * lane.xyz_cam + (1 - share) * _at(before, y_m)
    return replace(lane, xyz_cam=np.where(is_common[:, None], mean, lane.xyz_cam))


def _at(lane: Detection, y_m: Float[np.ndarray, " y"]) -> Points3:
    """The lane's points at these y, linear between its own."""
    points = lane.xyz_cam[np.argsort(lane.xyz_cam[:, 1], kind="stable")]
    x_m, z_m = (np.interp(y_m, points[:, 1], points[:, axis]) for axis in (0, 2))
    return np.stack([x_m, y_m, z_m], axis=1)
