"""Our lanes as a foreign camera sees them: lines in the OpenCV camera frame (`_cv`), metres, visible up to a point."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from synth3dlanes.formats.writing import CV_FROM_CAM, Pinhole
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, LaneKind

MIN_DEPTH_M = 0.5
BORDER_PX = 1.0
MAX_FLAT_STEP = 15.0  # |du/dv| beyond which Apollo's parser calls an image step horizontal
NEAR_START_M = 20.0


@dataclass(frozen=True, eq=False)
class LaneAhead:
    """The part of a lane ahead of the camera, near to far. `visible` is a prefix: everything up to the last point that
    the image shows, holes and the stretch below the image included; cars hide nothing, the ground does."""

    lane: Lane
    points_cv: Float[np.ndarray, "n 3"]
    visible: Bool[np.ndarray, " n"]
    in_view: Bool[np.ndarray, " n"]

    @property
    def id(self) -> str:
        return self.lane.id

    def part(self, keep: Bool[np.ndarray, " n"] | slice) -> "LaneAhead":
        """The same line with some of its points only."""
        return LaneAhead(self.lane, self.points_cv[keep], self.visible[keep], self.in_view[keep])


def lines_ahead(labels: Labels, pinhole: Pinhole, kind: LaneKind, step_m: float | None = None) -> tuple[LaneAhead, ...]:
    """The lanes of one kind as the foreign camera sees them, the nearest beside the car first.

    The order makes every loader's "first n lines" harmless. `step_m` refines the sampling with a cubic spline.
    """
    lines = [_line(lane, labels.camera, pinhole, step_m) for lane in labels.lanes if lane.kind == kind]
    return tuple(sorted((line for line in lines if len(line.points_cv) >= 2), key=_from_near_to_far))


def keep_lines(
    lines: Sequence[LaneAhead], dropped: Counter[str], most: float = np.inf, reason: str = ""
) -> tuple[LaneAhead, ...]:
    """The first `most` lines that are seen at all and differ from those before them; count the others."""
    kept: list[LaneAhead] = []
    for line in lines:
        if np.count_nonzero(line.visible) < 2:
            dropped["not visible in the image (outside it or behind the ground)"] += 1
        elif any(_same_visible(line, other) for other in kept):
            dropped["the visible part equals that of another line (paths that split further on)"] += 1
        elif len(kept) == most:
            dropped[reason] += 1
        else:
            kept.append(line)
    return tuple(kept)


def sifted(
    lines: Sequence[LaneAhead], is_kept: Callable[[LaneAhead], bool], dropped: Counter[str], reason: str
) -> list[LaneAhead]:
    """The lines that are kept; count the others."""
    kept = [line for line in lines if is_kept(line)]
    if len(kept) < len(lines):
        dropped[reason] += len(lines) - len(kept)
    return kept


def columns_of(line: LaneAhead, pinhole: Pinhole, rows_px: Int[np.ndarray, " r"]) -> Float[np.ndarray, " r"]:
    """The column of the visible line at each row, up to where it turns over in the image; NaN elsewhere."""
    u_px, v_px = pinhole.project(line.points_cv[line.visible]).T
    turns = np.flatnonzero(np.diff(v_px) >= 0)
    n = int(turns[0]) + 1 if len(turns) else len(v_px)
    if n < 2:
        return np.full(len(rows_px), np.nan)
    return np.interp(rows_px, v_px[:n][::-1], u_px[:n][::-1], left=np.nan, right=np.nan)


def points_at(line: LaneAhead, pinhole: Pinhole, rows_px: Int[np.ndarray, " r"]) -> Float[np.ndarray, "n 2"]:
    """The points of the visible line in the image at those of the rows that it crosses there."""
    columns_px = columns_of(line, pinhole, rows_px)
    return np.column_stack([columns_px, rows_px])[(columns_px >= 0) & (columns_px < pinhole.width_px)]


def ego_places(ahead: Sequence[LaneAhead], camera: CameraLabel) -> dict[str, int]:
    """1 to 4 for the lines left-left, left, right and right-right of the camera, by id: the two nearest on either side
    of those that begin beside it."""
    x_m = {
        line.id: float(road_from_cv(camera, line.points_cv[:1])[0, 0])
        for line in ahead
        if line.points_cv[0, 2] <= NEAR_START_M
    }
    left = sorted((line_id for line_id in x_m if x_m[line_id] < 0), key=lambda line_id: -x_m[line_id])
    right = sorted((line_id for line_id in x_m if x_m[line_id] >= 0), key=lambda line_id: x_m[line_id])
    return {**dict(zip(left, (2, 1), strict=False)), **dict(zip(right, (3, 4), strict=False))}


def road_from_cv(camera: CameraLabel, points_cv: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Points in the road frame, its origin at the camera's foot on the road plane."""
    return transform(camera.road_from_cam, points_cv @ CV_FROM_CAM)


def scene_tags(labels: Labels, pinhole: Pinhole) -> frozenset[str]:
    """Kinds of scene, after OpenLane's test cases, of what the image shows.

    `up_down`: the road leaves the host's plane by 1 m. `steep`: by the camera's height, where flat-ground
    coordinates are singular. `curve`: the direction changes by 10 degrees. `merge_split`: an exit is visible.
    """
    tags = set()
    for line in lines_ahead(labels, pinhole, "centerline"):
        if np.count_nonzero(line.visible) < 3:
            continue
        points_road = road_from_cv(labels.camera, line.points_cv[line.visible])
        headings_rad = np.unwrap(np.arctan2(*np.diff(points_road[:, :2], axis=0).T))
        if np.max(np.abs(points_road[:, 2])) > 1.0:
            tags.add("up_down")
        if np.max(points_road[:, 2]) > labels.camera.height_m:
            tags.add("steep")
        if np.ptp(headings_rad) > np.radians(10):
            tags.add("curve")
        if line.lane.road == "exit":
            tags.add("merge_split")
    return frozenset(tags)


def _line(lane: Lane, camera: CameraLabel, pinhole: Pinhole, step_m: float | None) -> LaneAhead:
    points_cv, on_ground = lane.xyz_cam @ CV_FROM_CAM.T, lane.terrain_visible
    if step_m is not None and len(points_cv) >= 3:
        points_cv, on_ground = _refine(points_cv, on_ground, step_m)
    ahead = _ahead(camera, points_cv)
    points_cv, on_ground = points_cv[ahead], on_ground[ahead]
    if len(points_cv) < 2:
        nothing = np.zeros(len(points_cv), dtype=bool)
        return LaneAhead(lane, points_cv, nothing, nothing)
    in_view = _in_view(pinhole.project(points_cv), pinhole)
    seen = np.flatnonzero(in_view & on_ground)
    visible = np.arange(len(points_cv)) <= (seen[-1] if len(seen) else -1)
    return LaneAhead(lane, points_cv, visible, in_view)


def _ahead(camera: CameraLabel, points_cv: Float[np.ndarray, "n 3"]) -> slice:
    # Both forward coordinates must grow from point to point: evaluators interpolate over them, and one folded
    # line spoils the figures of a whole set.
    forward_m = np.stack([points_cv[:, 2], road_from_cv(camera, points_cv)[:, 1]], axis=1)
    in_front = np.flatnonzero(np.all(forward_m > MIN_DEPTH_M, axis=1))
    if len(in_front) == 0:
        return slice(0, 0)
    start = int(in_front[0])
    folds = np.flatnonzero(np.any(np.diff(forward_m[start:], axis=0) <= 0, axis=1))
    return slice(start, start + int(folds[0]) + 1 if len(folds) else len(points_cv))


def _in_view(points_img: Float[np.ndarray, "n 2"], pinhole: Pinhole) -> Bool[np.ndarray, " n"]:
    u_px, v_px = points_img.T
    inside = (u_px >= BORDER_PX) & (u_px <= pinhole.width_px - BORDER_PX)
    inside &= (v_px >= BORDER_PX) & (v_px <= pinhole.height_px - BORDER_PX)
    steps_img = np.diff(points_img, axis=0, prepend=points_img[:1] - np.diff(points_img[:2], axis=0))
    rising = (steps_img[:, 1] < 0) & (np.abs(steps_img[:, 0]) <= -MAX_FLAT_STEP * steps_img[:, 1])
    return np.asarray(inside & rising)


def _refine(
    points_cv: Float[np.ndarray, "n 3"], on_ground: Bool[np.ndarray, " n"], step_m: float
) -> tuple[Float[np.ndarray, "k 3"], Bool[np.ndarray, " k"]]:
    lengths_m = np.linalg.norm(np.diff(points_cv, axis=0), axis=1)
    knots_m = np.concatenate([[0.0], np.cumsum(lengths_m)])
    pieces = np.maximum(1, np.ceil(lengths_m / step_m - 1e-6).astype(int))
    fine = np.concatenate([i + np.arange(n) / n for i, n in enumerate(pieces)] + [np.array([len(points_cv) - 1.0])])
    stations_m = np.interp(fine, np.arange(len(points_cv)), knots_m)
    # A point between two samples is on visible ground only if both of them are.
    below, above = np.floor(fine).astype(int), np.ceil(fine).astype(int)
    return scipy.interpolate.CubicSpline(knots_m, points_cv)(stations_m), on_ground[below] & on_ground[above]


def _same_visible(line: LaneAhead, other: LaneAhead) -> bool:
    mine, theirs = line.points_cv[line.visible], other.points_cv[other.visible]
    n = min(len(mine), len(theirs))
    return abs(len(mine) - len(theirs)) <= 1 and float(np.max(np.abs(mine[:n] - theirs[:n]))) < 0.05


def _from_near_to_far(line: LaneAhead) -> tuple[bool, float]:
    # Lines that begin further on (behind a split) come after those beside the car.
    return bool(line.points_cv[0, 2] > NEAR_START_M), abs(float(line.points_cv[0, 0]))
