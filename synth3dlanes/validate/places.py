"""Positions of points, seen from above, beside the lines and paths of a world. Metres."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Int

from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.world.ground import Ground

# Two roads whose heights differ by more than APART_M at a point on both, or up to EDGE_M beside one, are two surfaces.
APART_M, EDGE_M = 0.01, 0.3
# How far from a point roads are searched for.
SEARCH_M = 0.5
# Points farther than this beside a curve are not near it.
BESIDE_M = 30.0


@dataclass(frozen=True, eq=False)
class Places:
    """Points from above; `known` has their stations and offsets beside curves by the ids of these."""

    xy_world: Points2
    known: dict[str, tuple[Scalars, Scalars]] = field(default_factory=dict)

    def at(self, which: Bool[np.ndarray, " n"] | Int[np.ndarray, " m"]) -> "Places":
        """The selected points."""
        return Places(self.xy_world[which])

    def right_of(self, curve: LaneCurve) -> Scalars:
        """Distance beside a curve, as t grows, or to the right of one that is measured; infinite where it is not
        near."""
        return self._beside(curve)[1]

    def station(self, curve: LaneCurve) -> Scalars:
        """Stations along a curve."""
        return self._beside(curve)[0]

    def _beside(self, curve: LaneCurve) -> tuple[Scalars, Scalars]:
        """Stations and offsets, computed once: of the piece to which a point is nearest."""
        if curve.id in self.known:
            return self.known[curve.id]
        station, right = np.zeros(len(self.xy_world)), np.full(len(self.xy_world), np.inf)
        best = np.full(len(self.xy_world), BESIDE_M)
        for piece in curve.pieces:
            low, high = np.sort(piece.on(np.array([piece.start_m, piece.end_m])))
            s, t = piece.road.line.project(self.xy_world)
            on = np.clip(s, low, high)
            aside = (t - piece.offset(on)) * piece.along
            apart = np.hypot(aside, s - on)
            nearer = apart < best
            station = np.where(nearer, piece.stations(on), station)
            right, best = np.where(nearer, aside, right), np.where(nearer, apart, best)
        self.known[curve.id] = station, right
        return station, right


def is_single(ground: Ground, xy_world: Points2) -> Bool[np.ndarray, " n"]:
    """Which points are not where roads lie over each other, as bridges, or as ways through a junction, each by heights
    of its own."""
    if not any(road.has_heights for road in ground.network.roads):
        return np.ones(len(xy_world), dtype=bool)
    low, high = np.full((2, len(xy_world)), np.inf) * [[1], [-1]]
    near, roads = ground.network.index.nearby(xy_world, np.full(len(xy_world), SEARCH_M))
    rows = np.flatnonzero(near)
    for road, which, s, t in roads:
        inside = road.outside(s, t) < EDGE_M
        at = rows[np.flatnonzero(which)[inside]]
        z = road.base_points(s[inside], t[inside])[:, 2]
        low[at], high[at] = np.minimum(low[at], z), np.maximum(high[at], z)
    return np.asarray((high - low < APART_M) & ~ground.is_stacked(xy_world))
