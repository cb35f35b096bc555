"""Check the height map: points of the main road must be at its heights, and it must not be moved as a whole."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Lane
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Bounded, Finding, Measure, Result
from synth3dlanes.validate.points import joined, judge
from synth3dlanes.world import height_map

# The height map is used where 3 x 3 cells differ by less than this: a slope of about 0.5 against the road plane.
# Beside a kerb of a map the map's cells are between both heights.
MAX_SPREAD_M, MAX_SPREAD_AT_KERBS_M = 0.4, 0.1
# Of the whole height map: in 92 images it is at most 0.0002 m off in the median, and 0.007 cells. On a road without
# slopes nothing tells rows apart.
MIN_ON_MAP, MAX_MAP_M, MAX_MAP_CELLS, MIN_MAP_SLOPE_M = 30, 0.005, 0.2, 0.004


def check_height(evidence: Evidence) -> Iterator[Result]:
    """Findings about lines and about the whole map, and measure `height_m`."""
    lanes = [lane for lane in evidence.labels.lanes if _on_main(lane)]
    measures = [_height(evidence, lane) for lane in lanes]
    for lane, measure in zip(lanes, measures, strict=True):
        yield from judge(lane.id, measure)
    yield from _moved(evidence)
    yield from joined(measures)


def _on_main(lane: Lane) -> bool:
    """Whether a lane is on the main road, or on any of a map."""
    return lane.road == "main" or lane.connector is not None


def _on_map(
    evidence: Evidence, lane: Lane
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, "2 m"], Float[np.ndarray, " m"]]:
    """Which points of a lane on the main road are over the height map, their row and column, and their height. Cells
    where the ground is too steep against the road plane to be a single height over it are left out, and places where
    roads lie over each other."""
    camera, height_m = evidence.camera, evidence.passes["height"]
    x, y, z = transform(camera.road_from_cam, lane.xyz_cam).T
    (rows, columns), (width_m, length_m) = height_map.SHAPE, height_map.CELL_M
    row, column = (rows * length_m - y) / length_m - 0.5, x / width_m + columns / 2 - 0.5
    at = (row >= 0) & (row <= rows - 1) & (column >= 0) & (column <= columns - 1)
    at &= evidence.is_single[lane.id]
    spread_m = maximum_filter(height_m, 3) - minimum_filter(height_m, 3)
    most_m = MAX_SPREAD_M if lane.connector is None else MAX_SPREAD_AT_KERBS_M
    at[at] = spread_m[np.rint(row[at]).astype(int), np.rint(column[at]).astype(int)] < most_m
    return at, np.stack([row, column])[:, at], z[at]


def _height(evidence: Evidence, lane: Lane) -> Measure:
    """Absolute height of points on the main road over the height map."""
    at, cells, z_m = _on_map(evidence, lane)
    height_m = evidence.passes["height"]
    return Measure("height_m", lane.xyz_cam[at, 1], np.abs(z_m - map_coordinates(height_m, cells, order=1)))


def _moved(evidence: Evidence) -> Iterator[Result]:
    """Findings if the whole height map is too high or low, or some rows or columns off: a map that is moved by one cell
    is off by its own slope everywhere."""
    height_m = evidence.passes["height"]
    lanes = [lane for lane in evidence.labels.lanes if _on_main(lane)]
    found = [_on_map(evidence, lane)[1:] for lane in lanes]
    cells, z_m = (np.concatenate([part[i] for part in found], axis=-1) for i in (0, 1))
    if len(z_m) < MIN_ON_MAP:
        return
    off_m = map_coordinates(height_m, cells, order=1) - z_m
    numbers = [Bounded("height.map_m", float(np.median(off_m)), -MAX_MAP_M, MAX_MAP_M)]
    for axis, name in enumerate(("rows", "columns")):
        slope_m = map_coordinates(np.gradient(height_m, axis=axis), cells, order=1)
        moved = -float((off_m * slope_m).sum() / max(float((slope_m**2).sum()), len(z_m) * MIN_MAP_SLOPE_M**2))
        numbers.append(Bounded(f"height.map_{name}", moved, -MAX_MAP_CELLS, MAX_MAP_CELLS))
    yield from numbers
    if any(number.is_beyond for number in numbers):
        above_m, rows, columns = (number.value for number in numbers)
        yield Finding(
            "",
            f"height: expected the labels' road, got it {above_m:+.3f} m off in the median, as a map that is moved by "
            f"{rows:+.1f} rows or {columns:+.1f} columns is",
        )
