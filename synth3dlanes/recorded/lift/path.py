"""The host's path over a drive as a smooth curve, and places along and across it. World frame, metres. numpy, scipy."""

from dataclasses import dataclass

import numpy as np
import scipy

from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.system.arrays import Matrix4, Points2, Points3, Scalars
from synth3dlanes.system.errors import InputError

# Poses closer than this are one place: a car that stands makes no path.
APART_M = 1.0
# Tolerance of the curve at poses, so that it has not their noise; places beside it are exact.
MISSES_M = 0.03
# The curve's knots; how far straight ahead of its last pose, and behind its first, it is continued.
KNOTS_M, BEYOND_M = 2.0, 130.0
SAMPLE_M = 0.5
NEWTON_STEPS = 4


@dataclass(frozen=True, eq=False)
class Path:
    """A smooth curve through the host's places: stations s in metres from the first, offsets d to the right of it.
    `to_plan` and `to_world` are inverse to each other near the curve. `length_m` is the station of the last pose."""

    curve: "scipy.interpolate.CubicSpline"
    length_m: float
    _samples: tuple[Scalars, "scipy.spatial.cKDTree"]

    def at(self, s: Scalars) -> Points3:
        """The places on the path at these stations."""
        return np.asarray(self.curve(s), float)

    def right(self, s: Scalars) -> Points2:
        """Unit vectors to the right of the path, level."""
        along = np.asarray(self.curve(s, 1), float)[:, :2]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        return np.column_stack([along[:, 1], -along[:, 0]])

    def to_plan(self, xy_world: Points2) -> Points2:
        """Stations and offsets (s, d) of places."""
        stations, tree = self._samples
        s = stations[tree.query(xy_world)[1]]
        for _ in range(NEWTON_STEPS):
            gap = xy_world - self.at(s)[:, :2]
            along, bend = self.curve(s, 1)[:, :2], self.curve(s, 2)[:, :2]
            slope = (along**2).sum(1) - (gap * bend).sum(1)
            s = s + np.clip((gap * along).sum(1) / np.maximum(slope, 0.1), -SAMPLE_M, SAMPLE_M)
        return np.column_stack([s, ((xy_world - self.at(s)[:, :2]) * self.right(s)).sum(1)])

    def to_world(self, s: Scalars, d: Scalars) -> Points2:
        """World x and y of places beside the path."""
        return self.at(s)[:, :2] + d[:, None] * self.right(s)

    def nearest(self, xy_world: Points2) -> tuple[Points3, Scalars]:
        """The sampled place of the path that is nearest to each point, and how far it is."""
        stations, tree = self._samples
        far_m, which = tree.query(xy_world)
        return self.at(stations[which]), np.asarray(far_m, float)


def path_of(poses: list[Matrix4]) -> Path:
    """The path through the places of these poses. Raises InputError where the host does not move, or a pose is no
    number."""
    places = np.array([pose[:3, 3] for pose in poses])
    if not np.isfinite(poses).all():
        raise InputError("poses: expected finite numbers, got others")
    kept = [0]
    for i in range(1, len(places)):
        if np.linalg.norm(places[i, :2] - places[kept[-1], :2]) >= APART_M:
            kept.append(i)
    if len(kept) < 2:
        raise InputError(
            f"poses: expected a host that moves by {APART_M:g} m or more, got {len(poses)} poses at a place"
        )
    found = places[kept]
    s = lengths_along(found[:, :2])
    length_m = float(s[-1])
    smooth, _ = scipy.interpolate.make_splprep(found.T, u=s, k=min(3, len(kept) - 1), s=len(kept) * MISSES_M**2)
    knots = np.linspace(0.0, length_m, max(3, round(length_m / KNOTS_M)))
    middle = np.asarray(smooth(knots), float).T
    straight = np.arange(0.0, BEYOND_M + 1, 10.0)[1:]
    starts, ends = middle[0] - middle[1], middle[-1] - middle[-2]
    before = middle[0] + straight[:, None] * starts / np.linalg.norm(starts[:2])
    after = middle[-1] + straight[:, None] * ends / np.linalg.norm(ends[:2])
    whole = scipy.interpolate.CubicSpline(
        np.concatenate([-straight[::-1], knots, length_m + straight]),
        np.concatenate([before[::-1], middle, after]),
        bc_type="natural",
    )
    stations = np.arange(-BEYOND_M, length_m + BEYOND_M, SAMPLE_M)
    return Path(whole, length_m, (stations, scipy.spatial.cKDTree(whole(stations)[:, :2])))
