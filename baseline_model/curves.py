"""Labels as curves that run forward through Y_ref, sampled at fixed y, and poses of the camera. Numpy only.

Frames: camera and road as in the labels (x right, y forward, z up); pitch is positive looking down. Curves are in the
road frame of the labels unless a name says otherwise. Targets and metric use the same curves.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry import frames
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels, LaneKind

MEAN_PITCH_RAD = float(np.radians(2.5))
MEAN_HEIGHT_M = 1.65
Y_REF_M = 20.0
HALF_WIDTH_M = 10.24
"""A lane counts only if it crosses Y_ref inside the top view: 16 columns of 1.28 m."""
NEAR_KNOTS_M = (5.0, 20.0, 40.0)
"""A lane with fewer than two of these points visible cannot be located and is ignored."""
SAME_CURVE_M = 0.3
METRIC_STEP_M, MIN_VALID_POINTS = 0.8, 10
METRIC_Y_M, SHORTEST_M = np.arange(101) * METRIC_STEP_M, MIN_VALID_POINTS * METRIC_STEP_M


class Pose(NamedTuple):
    """The camera's pose relative to a road plane, without roll."""

    pitch_rad: float
    height_m: float


MEAN_POSE = Pose(MEAN_PITCH_RAD, MEAN_HEIGHT_M)


def road_from_cam(pose: Pose) -> Float[np.ndarray, "4 4"]:
    """The camera's pose in the road frame, whose origin is below the camera: the camera is at (0, 0, height)."""
    return frames.road_from_cam(pose.height_m, pose.pitch_rad)


def cam_from_road(pose: Pose) -> Float[np.ndarray, "4 4"]:
    """Inverse of `road_from_cam`: p_cam = R (p_road - C), with the camera at C = (0, 0, height) of the road frame."""
    return frames.invert(road_from_cam(pose))


def onto_plane(rays_cam: Float[np.ndarray, "n 3"], pose: Pose) -> Float[np.ndarray, "m 3"]:
    """Where viewing rays, each given by a point on it, meet the plane, in camera coordinates. Rays at or above the
    plane's horizon and points behind the camera are dropped."""
    # The height over the plane along a ray is height + scale * fall: the camera is at z = height.
    fall = rays_cam @ road_from_cam(pose)[2, :3]
    meets = (fall < -1e-6) & (rays_cam[:, 1] > 0.05)
    return rays_cam[meets] * (pose.height_m / -fall[meets])[:, None]


@dataclass(frozen=True, eq=False)
class RoadCurve:
    """One lane with strictly increasing road y. `visible` means not hidden by the ground; cars do not count (the paper
    drops points occluded "by the terrain"). `is_repeat`: another lane of its kind coincides with it wherever it is
    visible (two paths that separate out of sight); it is neither learned nor counted."""

    kind: LaneKind
    xyz_cam: Float[np.ndarray, "n 3"]
    xyz_road: Float[np.ndarray, "n 3"]
    visible: Bool[np.ndarray, " n"]
    is_repeat: bool = False


@dataclass(frozen=True, eq=False)
class CurveSamples:
    """A curve at given y: x and z, whether the curve reaches y, and whether it is visible there."""

    x_m: Float[np.ndarray, " y"]
    z_m: Float[np.ndarray, " y"]
    in_range: Bool[np.ndarray, " y"]
    visible: Bool[np.ndarray, " y"]


def plane_pose(labels: Labels) -> Pose:
    """The labels' pose relative to the road plane P_road."""
    return Pose(labels.camera.pitch_rad, labels.camera.height_m)


def road_curves(labels: Labels, *, in_image_only: bool = False) -> tuple[RoadCurve, ...]:
    """Every lane with at least two forward points; of curves that coincide, all but one are marked as repeats. Points
    outside the image (neighbour lanes nearer than 6 m) count, as in the paper, unless `in_image_only`."""
    curves = []
    for lane in labels.lanes:
        xyz_road = transform(labels.camera.road_from_cam, lane.xyz_cam)
        part = _forward_part(xyz_road[:, 1])
        if part.stop - part.start >= 2:
            visible = lane.terrain_visible & lane.in_image if in_image_only else lane.terrain_visible
            curves.append(RoadCurve(lane.kind, lane.xyz_cam[part], xyz_road[part], visible[part]))
    return _with_repeats_marked(curves)


def resample(curve: RoadCurve, y_m: Float[np.ndarray, " y"]) -> CurveSamples:
    """Interpolate linearly between the label's samples, which are 1 m apart; the error is below 2 mm. A point is
    visible if both neighbouring samples are. `anchors.sample_curves` does this for tensors; tests compare the two."""
    y_curve_m = curve.xyz_road[:, 1]
    after = np.clip(np.searchsorted(y_curve_m, y_m), 1, len(y_curve_m) - 1)
    in_range = (y_m >= y_curve_m[0]) & (y_m <= y_curve_m[-1])
    return CurveSamples(
        x_m=np.interp(y_m, y_curve_m, curve.xyz_road[:, 0]),
        z_m=np.interp(y_m, y_curve_m, curve.xyz_road[:, 2]),
        in_range=in_range,
        visible=in_range & curve.visible[after - 1] & curve.visible[after],
    )


def is_usable(curve: RoadCurve) -> bool:
    """Whether the metric counts the lane: it crosses Y_ref inside the top view (paper, section 3.4), and at least two
    of the three NEAR_KNOTS_M are visible (our condition). `anchors.encode` decides this for tensors, in the moved top
    view of training; tests compare the two."""
    at = resample(curve, np.array([Y_REF_M, *NEAR_KNOTS_M]))
    return bool(at.in_range[0] and abs(at.x_m[0]) <= HALF_WIDTH_M and at.visible[1:].sum() >= 2)


def target_pose(labels: Labels, mode: str) -> Pose:
    """The pose that a network learns: over the tangent plane (`plane`) or over the labels' `horizon` plane. Labels
    without one (no point of the host's lane is visible, or another data set's) give the tangent plane. `fixed` gives
    the tangent plane too, which the network does not learn."""
    if mode == "horizon" and labels.horizon is not None:
        return Pose(labels.horizon.pitch_rad, labels.horizon.height_m)
    return plane_pose(labels)


def _forward_part(y_m: Float[np.ndarray, " n"]) -> slice:
    """The longest run of strictly increasing y around the sample nearest to Y_ref."""
    if len(y_m) == 0:
        return slice(0, 0)
    middle = int(np.argmin(np.abs(y_m - Y_REF_M)))
    turns = np.flatnonzero(np.diff(y_m) < 1e-6)
    before, behind = turns[turns < middle], turns[turns >= middle]
    return slice(int(before[-1]) + 1 if len(before) else 0, int(behind[0]) + 1 if len(behind) else len(y_m))


def _with_repeats_marked(curves: list[RoadCurve]) -> tuple[RoadCurve, ...]:
    sampled = [resample(curve, METRIC_Y_M) for curve in curves]
    kept: list[int] = []
    # Curves with more visible points come first, so that the shorter copy is the repeat.
    for index in sorted(range(len(curves)), key=lambda i: -int(sampled[i].visible.sum())):
        same = (_repeats(sampled[index], sampled[k]) for k in kept if curves[k].kind == curves[index].kind)
        if not any(same):
            kept.append(index)
    return tuple(replace(curve, is_repeat=index not in kept) for index, curve in enumerate(curves))


def _repeats(candidate: CurveSamples, other: CurveSamples) -> bool:
    """Whether `other` is visible within 0.3 m wherever `candidate` is visible."""
    seen = candidate.visible
    if seen.sum() < MIN_VALID_POINTS or not other.visible[seen].all():
        return False
    distance_m = np.hypot(candidate.x_m[seen] - other.x_m[seen], candidate.z_m[seen] - other.z_m[seen])
    return bool(distance_m.max() < SAME_CURVE_M)
