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
    table, at = ground.network.index.table, ground.network.index.places(xy_world, SEARCH_M)
    on, _, away_m = table.nearest(at)
    at = at.of((away_m < EDGE_M) & (on == at.s))
    z = table.base_points(at.road, at.s, at.t)[:, 2]
    np.minimum.at(low, at.point, z)
    np.maximum.at(high, at.point, z)
    return np.asarray((high - low < APART_M) & ~ground.is_stacked(xy_world))
