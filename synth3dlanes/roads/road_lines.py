"""Lines whose stations are those of their roads, which all roads share: each answers for itself. World frame, metres.
`LineTable` answers the same of lines whose stations are lengths along them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.roads import Road
from synth3dlanes.system.arrays import AnyScalars, Points3, Scalars

# Two points of a line's labels that are closer than this coincide: they have no direction.
APART_M = 0.01
# The direction of the host's way is measured over this length to both sides.
TANGENT_M = 0.01


@dataclass(frozen=True, eq=False)
class HostPlace:
    """A place of the host: its station as it drives, and the points of its way at stations ahead of that."""

    driven_m: float
    ahead: Callable[[Scalars], Points3]

    @property
    def foot_world(self) -> Float[np.ndarray, "2"]:
        """The place from above."""
        return self.ahead(np.zeros(1))[0, :2]

    @property
    def forward(self) -> Float[np.ndarray, "2"]:
        """The unit vector of its way from above."""
        behind, ahead = self.ahead(np.array([-TANGENT_M, TANGENT_M]))[:, :2]
        return np.asarray((ahead - behind) / np.linalg.norm(ahead - behind))


@dataclass(frozen=True, eq=False)
class RoadLines:
    """Lines on roads. `onwards` is 1 where the host drives with growing stations, else -1."""

    curves: Sequence[LaneCurve]
    roads: Mapping[str, Road]
    onwards: float

    def xy_along(
        self, curves: Sequence[LaneCurve], stations: Sequence[Float[np.ndarray, " _"]]
    ) -> list[Float[np.ndarray, "_ 2"]]:
        """World (x, y) of each of some lines at stations."""
        return [curve.xy_world(s) for curve, s in zip(curves, stations, strict=True)]

    def points_along(self, stations: Mapping[LaneCurve, Float[np.ndarray, " _"]]) -> list[Float[np.ndarray, "_ 3"]]:
        """Points on the road surface at stations of lines, one line after the other."""
        return [curve.points_world(s) for curve, s in stations.items()]

    def in_range(self, at: HostPlace, lengths_m: Scalars) -> dict[LaneCurve, Float[np.ndarray, " _"]]:
        """The stations of every line's points at lengths of its road ahead of a place (negative: behind it), and at its
        ends between these, in driving order."""
        along = {curve.road for curve in self.curves}
        driven_m = {name: self.stations_along(self.roads[name], at.driven_m, lengths_m) for name in along}
        return {curve: self._points_of(curve, driven_m[curve.road]) for curve in self.curves}

    def known(self, places: Sequence[HostPlace], lengths_m: Scalars) -> set[str]:
        """The ids of the lines with more than one such point at any of some places, each ahead of the one before."""
        # Along a road a line comes into range or is passed, never both.
        ends = places[0], places[-1]
        return {line.id for at in ends for line, s in self.in_range(at, lengths_m).items() if len(s) > 1}

    def _points_of(self, curve: LaneCurve, driven_m: Scalars) -> Float[np.ndarray, " m"]:
        s = driven_m * self.onwards
        low, high = min(s[0], s[-1]), max(s[0], s[-1])
        ends = np.array([end for end in (curve.start_m, curve.end_m) if low < end < high])
        kept = s[curve.has(s)]
        kept = kept[(np.abs(kept[:, None] - ends) > APART_M).all(axis=1)]
        return np.sort(np.concatenate([kept, ends]))[:: int(self.onwards)]

    def stations_along(self, road: Road, driven_m: float, lengths_m: AnyScalars) -> AnyScalars:
        """Stations as the host drives, at the given lengths of a road ahead of `driven_m`; sorted lengths, negative
        behind it."""
        if lengths_m[0] < 0:
            behind, ahead = lengths_m[lengths_m < 0], lengths_m[lengths_m >= 0]
            before = self._along(road, driven_m, -behind[::-1], -1)[::-1]
            return np.concatenate([before, self._along(road, driven_m, ahead)])
        return self._along(road, driven_m, lengths_m)

    def _along(
        self, road: Road, driven_m: float, lengths_m: AnyScalars, sign: int = 1, reach: float = 1.05
    ) -> AnyScalars:
        """Stations at lengths ahead of `driven_m`, or behind it with the sign -1."""
        grid = driven_m + sign * np.linspace(0, reach * lengths_m[-1], 8 * int(lengths_m[-1]) + 9)
        speed = road.speed((grid[1:] + grid[:-1]) / 2 * self.onwards)
        arc = np.concatenate([[0.0], np.cumsum(speed * np.abs(np.diff(grid)))])
        # On the inside of a bend a road is shorter than its stations.
        if arc[-1] < lengths_m[-1]:
            return self._along(road, driven_m, lengths_m, sign, 1.5 * reach)
        return np.interp(lengths_m, arc, grid)
