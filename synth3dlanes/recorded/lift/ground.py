"""The ground of a stretch of road as a grid of robust local planes, with its uncertainty. World frame, metres.

A cell has a plane only where points around it support one; nothing is invented between. Points may be on the ground
that are the lowest of their square metre, below a cone over its neighbours, near the path: what stands on the ground,
and what moves over it, is above; bridges over and roads below the path are too far from its height.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from synth3dlanes.recorded.lift.cloud import WorldPoints
from synth3dlanes.recorded.lift.path import Path
from synth3dlanes.recorded.lift.precision import Precision
from synth3dlanes.system.arrays import Points2, Points3, Scalars
from synth3dlanes.system.errors import InputError

# Memory of a grid: 4000 cells of half a metre are 2 km.
MAX_CELLS = 16_000_000
# Radius of a window in standard deviations.
TRUNCATE = 2.0


@dataclass(frozen=True, eq=False)
class GroundGrid:
    """Square cells from `corner` on: the first index counts along x, the second along y."""

    corner: Float[np.ndarray, "2"]
    cell_m: float
    shape: tuple[int, int]

    @staticmethod
    def around(xy_world: Points2, cell_m: float) -> "GroundGrid":
        """The least grid that holds all points. Raises InputError where it is too large."""
        low = np.floor(xy_world.min(axis=0) / cell_m)
        size = np.floor(xy_world.max(axis=0) / cell_m) - low + 1
        if size.prod() > MAX_CELLS:
            extent = " x ".join(f"{n * cell_m:,.0f}" for n in size)
            raise InputError(f"poses: expected a stretch of road of 2 x 2 km at most, got one of {extent} m")
        return GroundGrid(low * cell_m, cell_m, (int(size[0]), int(size[1])))

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        return np.asarray(self.corner + np.array(self.shape) * self.cell_m / 2)

    def cells(self, xy_world: Points2) -> Int[np.ndarray, "n 2"]:
        """The indices of the cells that hold places, in the grid or beyond it."""
        return np.floor((xy_world - self.corner) / self.cell_m).astype(int)

    def numbers(self, cells: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
        """Cells as single numbers; those beyond the grid as the nearest in it."""
        row, col = np.clip(cells, 0, np.array(self.shape) - 1).T
        return np.asarray(row * self.shape[1] + col)

    def holds(self, cells: Int[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        return np.asarray(((cells >= 0) & (cells < self.shape)).all(axis=1))

    def middles(self) -> Float[np.ndarray, "rows cols 2"]:
        x, y = (self.corner[i] + (np.arange(self.shape[i]) + 0.5) * self.cell_m for i in (0, 1))
        return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)

    def total(self, number: Int[np.ndarray, " n"], values: Scalars | None = None) -> Float[np.ndarray, "rows cols"]:
        """The sum of values, or the number of points, in each cell."""
        return np.bincount(number, values, minlength=self.shape[0] * self.shape[1]).reshape(self.shape).astype(float)

    def windowed(self, values: Float[np.ndarray, "rows cols"], window_m: float) -> Float[np.ndarray, "rows cols"]:
        """The sums of values around each cell, weighted with a bell of this standard deviation, which is 1 in its
        middle."""
        sigma = window_m / self.cell_m
        mean = scipy.ndimage.gaussian_filter(values, sigma, mode="constant", truncate=TRUNCATE)
        return np.asarray(mean * (2 * np.pi * sigma**2))

    def scans(
        self, number: Int[np.ndarray, " n"], scan: Int[np.ndarray, " n"], weight: Scalars
    ) -> Float[np.ndarray, "rows cols"]:
        """How many scans tell of each cell: each counts by the mean weight of its points there, relative to others."""
        if not len(number):
            return np.zeros(self.shape)
        both = number * (scan.max() + 1) + scan
        pairs, which = np.unique(both, return_inverse=True)
        which = which.ravel()
        mean = np.bincount(which, weight) / np.bincount(which)
        at = pairs // (scan.max() + 1)
        squares = self.total(at, mean**2)
        return np.where(squares > 0, self.total(at, mean) ** 2 / np.where(squares > 0, squares, 1.0), 0.0)


SQUARE_M = 1.0
# The lowest height of a square is this quantile of its points' heights, because some points are below the ground.
LOW_SHARE = 0.15
# How far the ground beside the path may be above or below it: a constant, and a share of the distance to the side.
BAND_M, BAND_PER_M = 0.4, 0.25
# The steepest rise of the ground relative to the path, and the distance over which it is compared.
STEEPEST, CONE_M = 0.2, 6
# Depth below its neighbours from which a square holds wrong points.
SUNK_M = 0.4
# Greatest distance from the path of points that give the height of the host's frame over the ground.
UNDER_M = 1.5
MIN_UNDER_PATH = 20


def above_ground(cloud: WorldPoints, path: Path) -> Scalars:
    """How far each point is above the rough ground; infinite where that is not known."""
    at, far_m = path.nearest(cloud.xyz_world[:, :2])
    rise = cloud.xyz_world[:, 2] - at[:, 2]
    rise = rise + frame_height(rise[far_m < UNDER_M], at[far_m < UNDER_M])
    in_band = np.abs(rise) < BAND_M + BAND_PER_M * far_m
    grid = GroundGrid.around(cloud.xyz_world[:, :2], SQUARE_M)
    number = grid.numbers(grid.cells(cloud.xyz_world[:, :2]))
    low = _lowest(grid, number[in_band], rise[in_band])
    around = scipy.ndimage.percentile_filter(np.where(np.isnan(low), 0.0, low), 50, 5)
    known = scipy.ndimage.uniform_filter((~np.isnan(low)).astype(float), 5) > 0.8
    low[known & (low < around - SUNK_M)] = np.nan
    cone = np.where(np.isnan(low), np.inf, low)
    reach = int(CONE_M / SQUARE_M)
    i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    cone = scipy.ndimage.grey_erosion(cone, structure=-STEEPEST * SQUARE_M * np.hypot(i, j), mode="nearest")
    ground = np.where(np.isnan(low), np.inf, np.minimum(low, cone)).ravel()[number]
    return np.where(in_band, rise - ground, np.inf)


def frame_height(rise: Scalars, at: Float[np.ndarray, "n 3"]) -> float:
    """How high the host's frame is over the ground, from the heights of points near its path above that frame's
    path."""
    if len(rise) < MIN_UNDER_PATH:
        raise InputError(
            f"scans: expected {MIN_UNDER_PATH} or more points on the ground under the path, got {len(rise)}; "
            "are the lidar's axes x right, y forward, z up, and its metres metres?"
        )
    place = np.unique(np.floor(at[:, :2] / SQUARE_M).astype(int), axis=0, return_inverse=True)[1].ravel()
    order = np.lexsort([rise, place])
    start = np.flatnonzero(np.diff(place[order], prepend=-1))
    n = np.diff([*start, len(order)])
    return -float(np.median(rise[order][start + (LOW_SHARE * (n - 1)).astype(int)]))


def _lowest(grid: GroundGrid, number: np.ndarray, rise: Scalars) -> Float[np.ndarray, "rows cols"]:
    """A low height of each square, NaN without points."""
    order = np.lexsort([rise, number])
    found = number[order]
    start = np.flatnonzero(np.diff(found, prepend=-1))
    n = np.diff([*start, len(found)])
    low = np.full(grid.shape[0] * grid.shape[1], np.nan)
    low[found[start]] = rise[order][start + (LOW_SHARE * (n - 1)).astype(int)]
    return low.reshape(grid.shape)


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
    """Values where they are wanted, from the nearest cells that have values."""
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
