"""The points of several scans in the world, thinned. World frame, metres. numpy alone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from synth3dlanes.geometry.frames import transform
from synth3dlanes.recorded.drives.drive import Scan
from synth3dlanes.recorded.lift.path import Path
from synth3dlanes.system.arrays import Matrix4, Points3, Scalars

# Greatest distance of points that are kept from the path, and from the lidar.
REACH_M, MAX_RANGE_M = 30.0, 100.0
# Side of a square, and the most points of one scan that are kept in it: near the lidar there are more than are of use.
SQUARE_M, IN_SQUARE = 0.25, 3
# Nothing farther above the path than this can be the road.
ABOVE_M = 12.0


class WorldPoints(NamedTuple):
    """Points in the world: how strongly each reflects, how far from its lidar it is, and the number of its scan."""

    xyz_world: Points3
    intensity: Scalars
    range_m: Scalars
    scan: Int[np.ndarray, " n"]

    def thinned(self, every: int) -> "WorldPoints":
        return WorldPoints(*(values[::every].copy() for values in self)) if every > 1 else self


def cloud_of(scan: Scan, host_from_lidar: Matrix4, path: Path, number: int) -> WorldPoints:
    """A scan's points near the path, in the world."""
    range_m = np.linalg.norm(scan.xyz_lidar, axis=1)
    chosen = np.flatnonzero(range_m < MAX_RANGE_M)
    xyz = transform(scan.world_from_host @ host_from_lidar, scan.xyz_lidar[chosen].astype(float))
    at, far_m = path.nearest(xyz[:, :2])
    kept = (far_m < REACH_M) & (np.abs(xyz[:, 2] - at[:, 2]) < ABOVE_M)
    chosen, xyz = chosen[kept], xyz[kept]
    order = _thinned(np.floor(xyz / [SQUARE_M, SQUARE_M, 0.5]).astype(int))
    chosen, xyz = chosen[order], xyz[order]
    return WorldPoints(xyz, scan.intensity[chosen].astype(float), range_m[chosen], np.full(len(xyz), number))


def together(clouds: Sequence[WorldPoints]) -> WorldPoints:
    return WorldPoints(*(np.concatenate(parts) for parts in zip(*clouds, strict=True)))


def _thinned(cells: Int[np.ndarray, "n 3"]) -> Int[np.ndarray, " m"]:
    """The first few points of each cell, in order."""
    low = cells.min(axis=0, initial=0)
    size = cells.max(axis=0, initial=0) - low + 1
    number = np.ravel_multi_index(tuple((cells - low).T), tuple(size))
    order = np.argsort(number, kind="stable")
    found = number[order]
    start = np.flatnonzero(np.concatenate([[True], found[1:] != found[:-1]])) if len(found) else np.zeros(0, int)
    rank = np.arange(len(found)) - np.repeat(start, np.diff([*start, len(found)]))
    return np.sort(order[rank < IN_SQUARE])
