"""How far lifted lanes are from true ones: across and in height, by range, and whether their stated standard deviations
hold. In each frame's road frame, metres."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import shapely

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels, Lane
from synth3dlanes.system.arrays import Scalars

# A lifted line is matched to the nearest true line, up to this median distance.
MATCHED_M = 1.5
# A point of a true line is covered where the lifted lane passes it within this distance.
COVERED_M = 1.0


@dataclass(frozen=True, eq=False)
class LiftErrors:
    """Visible points of lifted delimiters: how far ahead, how far off across and in height, what was stated of both.
    `true_ahead_m` and `covered` are of the visible points of the true ones; `strays` counts points of lifted lines that
    are near no true one."""

    ahead_m: Scalars
    lateral_m: Scalars
    height_m: Scalars
    lateral_std_m: Scalars
    height_std_m: Scalars
    true_ahead_m: Scalars
    covered: np.ndarray
    strays: int = 0


def together(several: Sequence[LiftErrors]) -> LiftErrors:
    """The errors of several drives as one."""
    names = [item.name for item in fields(LiftErrors) if item.name != "strays"]
    joined = {name: np.concatenate([getattr(errors, name) for errors in several]) for name in names}
    return LiftErrors(**joined, strays=sum(errors.strays for errors in several))


def errors_of(lifted: Sequence[Labels], truth: Sequence[Labels]) -> LiftErrors:
    """The errors of the labels of frames against the true ones of the same frames."""
    rows: list[np.ndarray] = []
    seen: list[np.ndarray] = []
    strays = 0
    for ours, theirs in zip(lifted, truth, strict=True):
        true_lines = [lane for lane in theirs.lanes if lane.kind == "delimiter"]
        road_from_cam = theirs.camera.road_from_cam
        roads = [transform(road_from_cam, lane.xyz_cam) for lane in true_lines]
        matched: list[list[np.ndarray]] = [[] for _ in true_lines]
        for lane in ours.lanes:
            if lane.kind != "delimiter" or not lane.visible.any():
                continue
            points = transform(road_from_cam, lane.xyz_cam)
            found = [_offsets(points, road) for road in roads]
            off = [
                float(np.median(np.abs(lateral[np.isfinite(lateral)]))) if np.isfinite(lateral).any() else np.inf
                for lateral, _ in found
            ]
            best = int(np.argmin(off)) if off else -1
            if best < 0 or off[best] > MATCHED_M:
                strays += int(lane.visible.sum())
                continue
            lateral, height = found[best]
            kept = lane.visible & np.isfinite(lateral)
            assert lane.std_m is not None, "expected lifted labels"
            rows.append(np.column_stack([points[kept, 1], lateral[kept], height[kept], lane.std_m[kept]]))
            matched[best].append(points)
        for line, road, lines in zip(true_lines, roads, matched, strict=True):
            seen.append(_covered(line, road, lines))
    values = np.concatenate(rows) if rows else np.zeros((0, 5))
    truths = np.concatenate(seen) if seen else np.zeros((0, 2))
    ahead, lateral, height, lateral_std, height_std = values.T
    return LiftErrors(ahead, lateral, height, lateral_std, height_std, truths[:, 0], truths[:, 1] > 0, strays)


def _offsets(points: np.ndarray, road: np.ndarray) -> tuple[Scalars, Scalars]:
    """How far points are from a line, level and in height, at the line's nearest place; NaN beyond its ends."""
    if len(road) < 2:
        return np.full(len(points), np.nan), np.full(len(points), np.nan)
    line, places = shapely.LineString(road[:, :2]), shapely.points(points[:, :2])
    at_m = shapely.line_locate_point(line, places)
    level_m = np.where((at_m > 0) & (at_m < line.length), shapely.distance(line, places), np.nan)
    stations_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(road[:, :2], axis=0).T)))
    return level_m, np.abs(points[:, 2] - np.interp(at_m, stations_m, road[:, 2])) + 0 * level_m


def _covered(line: Lane, road: np.ndarray, lines: Sequence[np.ndarray]) -> np.ndarray:
    """The visible points of a true line: how far ahead, and whether a lifted line passes each."""
    points = road[line.visible]
    near = np.zeros(len(points), bool)
    for lifted in lines:
        lateral = _offsets(points, lifted)[0]
        near |= np.isfinite(lateral) & (lateral < COVERED_M)
    return np.column_stack([points[:, 1], near])
