"""Which points may be on the ground: the lowest of each square metre, below a cone over its neighbours, near the path.

World frame, metres. What stands on the ground, and what moves over it, is above; bridges over and roads below the path
are too far from its height.
"""

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.recorded.lift.cells import GroundGrid
from synth3dlanes.recorded.lift.cloud import WorldPoints
from synth3dlanes.recorded.lift.path import Path
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.system.errors import InputError

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
MIN_POINTS = 20


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
    if len(rise) < MIN_POINTS:
        raise InputError(
            f"scans: expected {MIN_POINTS} or more points on the ground under the path, got {len(rise)}; "
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
