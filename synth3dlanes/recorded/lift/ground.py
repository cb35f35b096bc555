"""The ground of a stretch of road as a grid of robust local planes, with its uncertainty. World frame, metres.

A cell has a plane only where points around it support one; nothing is invented between.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from synth3dlanes.recorded.lift.cells import GroundGrid
from synth3dlanes.recorded.lift.cloud import WorldPoints
from synth3dlanes.recorded.lift.path import Path
from synth3dlanes.recorded.lift.precision import Precision
from synth3dlanes.recorded.lift.rough import above_ground
from synth3dlanes.system.arrays import Points2, Points3, Scalars
from synth3dlanes.system.errors import InputError

CELL_M = 0.5
# Standard deviations of the windows of the planes, the widest first: each narrower plane replaces the wider one where
# it has support of its own.
WINDOWS_M = (2.0, 1.0, 0.5, 0.3)
# Support of a plane: the least number of points in its window, and how far their mean may be from the cell, as a share
# of the window.
MIN_POINTS, OFF_CENTRE = 6.0, 0.6
# Weight of the wider plane's slopes, as a share of the window squared: it counts in directions that points do not span.
RIDGE = 0.05
# Points farther from the rough ground, and from the planes of each following round, count nothing.
ROUNDS_M = (0.4, 0.2, 0.1, 0.06)
ABOVE_SHARE = 0.7
# Points farther from their lidar count less: their heights follow its angle. Metres, and metres per metre.
POINT_STD_M, STD_PER_M = 0.01, 0.001
# No plane is more certain than this: what the windows smooth away.
LEAST_STD_M = 0.002


@dataclass(frozen=True, eq=False)
class GroundMap:
    """A grid of planes: for each cell the height at its middle and the slopes along x and y, and the standard deviation
    of that height; NaN without support. `intensity` is the mean of the points on the ground."""

    grid: GroundGrid
    plane: Float[np.ndarray, "rows cols 3"]
    std_m: Float[np.ndarray, "rows cols"]
    intensity: Float[np.ndarray, "rows cols"]

    def at(self, xy_world: Points2) -> tuple[Scalars, Scalars]:
        """Heights at places, and their standard deviations; NaN without support.

        The planes of the four cells around a place are blended; a place whose own cell has none is without support.
        """
        grid, planes, stds = self.grid, self.plane.reshape(-1, 3), self.std_m.ravel()
        place = (xy_world - grid.corner) / grid.cell_m - 0.5
        first = np.floor(place).astype(int)
        share = place - first
        height, std, total = np.zeros((3, len(place)))
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            cells = first + np.array([i, j])
            number = grid.numbers(cells)
            own = stds[number]
            has = np.isfinite(own) & grid.holds(cells)
            off = (share - np.array([i, j])) * grid.cell_m
            weight = np.where(has, np.abs(1 - i - share[:, 0]) * np.abs(1 - j - share[:, 1]), 0.0)
            height += weight * np.where(has, planes[number, 0] + (planes[number, 1:] * off).sum(axis=1), 0.0)
            std += weight * np.where(has, own, 0.0)
            total += weight
        cells = grid.cells(xy_world)
        known = grid.holds(cells) & np.isfinite(stds[grid.numbers(cells)])
        total = np.where(known & (total > 0), total, np.nan)
        return height / total, std / total

    def near(self, xy_world: Points2) -> Scalars:
        """Heights at places by the planes of their own cells alone, in a quarter of the time of `at`."""
        cells = self.grid.cells(xy_world)
        number = self.grid.numbers(cells)
        off = xy_world - self.grid.corner - (cells + 0.5) * self.grid.cell_m
        plane = self.plane.reshape(-1, 3)[number]
        return np.where(self.grid.holds(cells), plane[:, 0] + (plane[:, 1:] * off).sum(axis=1), np.nan)

    def slopes(self, xy_world: Points2) -> Points2:
        """Slopes of the ground along x and y; NaN without support."""
        cells = self.grid.cells(xy_world)
        slopes = self.plane.reshape(-1, 3)[self.grid.numbers(cells), 1:]
        return np.where(self.grid.holds(cells)[:, None], slopes, np.nan)


def fit_ground(cloud: WorldPoints, path: Path, precision: Precision) -> GroundMap:
    """The ground below a path from the points of many scans, whose poses and lidar are of a precision.

    Raises InputError where there are no points on it.
    """
    above_m = above_ground(cloud, path)
    near = np.abs(above_m) < ROUNDS_M[0]
    if near.sum() < MIN_POINTS:
        raise InputError(f"scans: expected points on the ground along the path, got {near.sum()} of {len(near)} points")
    xyz, scan, range_m = cloud.xyz_world[near], cloud.scan[near], cloud.range_m[near]
    grid = GroundGrid.around(xyz[:, :2], CELL_M)
    number = grid.numbers(grid.cells(xyz[:, :2]))
    # Sums of squares stay exact for places near the grid's middle.
    origin = np.array([*grid.centre, np.median(xyz[:, 2])])
    local, middles = xyz - origin, grid.middles() - grid.centre
    prior = POINT_STD_M**2 / (POINT_STD_M**2 + (STD_PER_M * range_m) ** 2)
    gap_m, limit_m = above_m[near], ROUNDS_M[0]
    for following_m in ROUNDS_M[1:]:
        weight = prior * _trusted(gap_m, limit_m)
        plane, variance = _planes(grid, number, local, weight, middles)
        of_point = plane.reshape(-1, 3)[number]
        off = local[:, :2] - middles.reshape(-1, 2)[number]
        gap_m = local[:, 2] - of_point[:, 0] - (of_point[:, 1:] * off).sum(axis=1)
        gap_m = np.where(np.isfinite(gap_m), gap_m, np.inf)
        limit_m = following_m
    on = np.abs(gap_m) < limit_m
    # Points of one scan are off together, and all scans by the lidar's place.
    range_m, weight = range_m[on], prior[on]
    independent = scipy.ndimage.maximum_filter(grid.scans(number[on], scan[on], weight), 3)
    with np.errstate(invalid="ignore"):
        far_m = grid.total(number[on], weight * range_m) / grid.total(number[on], weight)
    far_m = _filled(far_m, np.isfinite(variance))
    stated = precision.pose_at(far_m.ravel()).reshape(far_m.shape) ** 2
    shared = precision.calibration_at(far_m.ravel()).reshape(far_m.shape) ** 2
    std_m = np.sqrt(np.maximum(variance, stated) / np.maximum(independent, 1.0) + shared + LEAST_STD_M**2)
    plane[..., 0] += origin[2]
    n = grid.total(number[on])
    with np.errstate(invalid="ignore"):
        intensity = grid.total(number[on], cloud.intensity[near][on]) / n
    return GroundMap(grid, plane, std_m, intensity)


def _filled(
    values: Float[np.ndarray, "rows cols"], wanted: Bool[np.ndarray, "rows cols"]
) -> Float[np.ndarray, "rows cols"]:
    """Values where they are wanted: those of the nearest cells that have some."""
    nearest = scipy.ndimage.distance_transform_edt(np.isnan(values), return_distances=False, return_indices=True)
    return np.where(wanted, values[tuple(nearest)], np.nan)


def _trusted(gap_m: Scalars, limit_m: float) -> Scalars:
    """The weight of points by their height over the ground. What stands on it, as kerbs and grass, is above it."""
    limits_m = np.where(gap_m > 0, ABOVE_SHARE * limit_m, limit_m)
    return np.asarray(np.clip(1 - (gap_m / limits_m) ** 2, 0.0, None) ** 2)


def _planes(
    grid: GroundGrid,
    number: Int[np.ndarray, " n"],
    local: Points3,
    weight: Scalars,
    middles: Float[np.ndarray, "rows cols 2"],
) -> tuple[Float[np.ndarray, "rows cols 3"], Float[np.ndarray, "rows cols"]]:
    """The best plane of each cell, at the cell's middle, and the variance of the points around it."""
    columns = (*local.T, *(local[:, i] * local[:, j] for i in range(3) for j in range(i, 3)))
    sums = [grid.total(number, weight), *(grid.total(number, weight * column) for column in columns)]
    count = grid.total(number[weight > 0])
    plane = np.full((*grid.shape, 3), np.nan)
    variance = np.full(grid.shape, np.nan)
    for window_m in WINDOWS_M:
        has = grid.windowed(count, window_m) >= MIN_POINTS
        n, x, y, z, xx, xy, xz, yy, yz, zz = (grid.windowed(values, window_m)[has] for values in sums)
        n = np.where(n > 0, n, np.nan)
        x, y, z = x / n, y / n, z / n
        xx, xy, xz, yy, yz, zz = (
            xx / n - x * x,
            xy / n - x * y,
            xz / n - x * z,
            yy / n - y * y,
            yz / n - y * z,
            zz / n - z * z,
        )
        off = middles[has] - np.stack([x, y], axis=-1)
        wider = np.nan_to_num(plane[has][:, 1:])
        p, q = wider.T
        # What the wider plane leaves of the slopes.
        rx, ry = xz - xx * p - xy * q, yz - xy * p - yy * q
        ridge = RIDGE * window_m**2
        a, d = xx + ridge, yy + ridge
        determinant = a * d - xy * xy
        p, q = p + (d * rx - xy * ry) / determinant, q + (a * ry - xy * rx) / determinant
        left = zz - 2 * (p * xz + q * yz) + p * p * xx + 2 * p * q * xy + q * q * yy
        found = np.stack([z + p * off[:, 0] + q * off[:, 1], p, q], axis=-1)
        near = np.hypot(off[:, 0], off[:, 1]) < OFF_CENTRE * window_m
        rows = np.flatnonzero(has.ravel())[near & np.isfinite(left)]
        kept = near & np.isfinite(left)
        plane.reshape(-1, 3)[rows] = found[kept]
        variance.reshape(-1)[rows] = np.maximum(left[kept], 0.0)
    return plane, variance
