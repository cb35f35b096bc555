"""Where the host of a scene drives: distances from its way, from above, and what is near it. World frame, metres."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.polylines import parted
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.line_table import Stations
from synth3dlanes.roads.network import Network
from synth3dlanes.system.arrays import AnyPoints2, AnyScalars, Points2

# Distance between the places of the way from which distances are measured.
STEP_M = 5.0


@dataclass(frozen=True, eq=False)
class HostWay:
    """The way of the host, which starts at the station `near_m` as it drives, and drives on to the station `driven_m`
    after it; with `both_ways` it looks behind, too."""

    network: Network
    near_m: float
    driven_m: float = 0.0
    both_ways: bool = False

    def range_m(self, ahead_m: float, behind_m: float) -> tuple[float, float]:
        """Stations as the host drives from `behind_m` behind its first place to `ahead_m` ahead of its last; with
        `both_ways` from `ahead_m` behind."""
        return self.near_m - (ahead_m if self.both_ways else behind_m), self.near_m + self.driven_m + ahead_m

    @cached_property
    def places(self) -> Points2:
        """Places along it."""
        driven_m = np.linspace(self.near_m, self.near_m + self.driven_m, 1 + int(np.ceil(self.driven_m / STEP_M)))
        return self.network.way.xy_world(self.network.stations(driven_m))

    def away_at(self, xy_world: AnyPoints2) -> AnyScalars:
        """How far points are from it."""
        # It has few places: a tree takes longer.
        squares = ((xy_world[..., 0] - x) ** 2 + (xy_world[..., 1] - y) ** 2 for x, y in self.places.tolist())
        return np.sqrt(reduce(np.minimum, squares))

    def away_on(self, curves: Sequence[LaneCurve], stations: Stations) -> list[Float[np.ndarray, " _"]]:
        """How far places on each of some curves are from it."""
        counts = [len(s) for s in stations]
        xy_world = np.concatenate([np.zeros((0, 2)), *self.network.lines.xy_along(curves, stations)])
        return parted(self.away_at(xy_world), counts)

    def box(self, reach_m: float) -> tuple[float, float, float, float]:
        """(x0, y0, x1, y1) around all that is this near to it."""
        (x0, y0), (x1, y1) = self.places.min(axis=0) - reach_m, self.places.max(axis=0) + reach_m
        return float(x0), float(y0), float(x1), float(y1)
