"""Positions of points, seen from above, on the roads and junctions of a map, and the surface expected there. Metres."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Int

from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.world.map_ground import MapGround
from synth3dlanes.world.map_meshes import SURFACES
from synth3dlanes.world.meshes import MEDIAN, ROAD, SHOULDER

# A kerb may be this far from a point.
KERB_ROOM_M = 0.08
# Two roads whose heights differ by more than APART_M at a point on both, or up to EDGE_M beside one, are two surfaces.
APART_M, EDGE_M = 0.01, 0.3
# The surface changes within this far of the ends of sections.
SEAM_M = 0.05
# Slopes are measured over this length to both sides.
SLOPE_STEP_M = 0.05
# Points farther than this beside a curve are not near it.
BESIDE_M = 30.0
IDS = {ROAD: SEMANTIC_IDS["road"], SHOULDER: SEMANTIC_IDS["shoulder"], MEDIAN: SEMANTIC_IDS["terrain"]}


@dataclass(frozen=True, eq=False)
class MapPlaces:
    """Points on the ground of a map, by the questions that `RoadPlaces` answers for the paper's roads."""

    ground: MapGround
    xy_world: Points2

    def at(self, which: Bool[np.ndarray, " n"]) -> "MapPlaces":
        """The selected points."""
        return MapPlaces(self.ground, self.xy_world[which])

    def outside(self) -> Scalars:
        """Distance from the nearest pavement, negative on it."""
        return self.ground.clearance(self.xy_world)

    def off_carriageways(self) -> Scalars:
        """Distance from the nearest pavement of traffic, negative on it."""
        return self.ground.off_carriageways(self.xy_world)

    @cached_property
    def _raised(self) -> Scalars:
        return self.ground.above_terrain(self.xy_world)

    def raised(self) -> Scalars:
        """Height of the pavement over the terrain."""
        return self._raised

    def on_slope(self) -> Bool[np.ndarray, " n"]:
        """Which points are beside a kerb, or where a road leaves the terrain."""
        steps = KERB_ROOM_M * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        around = [self.ground.above_terrain(self.xy_world + step) for step in steps]
        return np.ptp([self.raised(), *around], axis=0) > KERB_ROOM_M / 4

    def is_firm(self) -> Bool[np.ndarray, " n"]:
        """Which points have one height from above: those beside kerbs have not."""
        return ~self.on_slope() & self.is_single()

    def is_single(self) -> Bool[np.ndarray, " n"]:
        """Which points are not where roads lie over each other, as bridges, or as ways through a junction, each by
        heights of its own."""
        if not any(road.has_heights for road in self.ground.network.roads):
            return np.ones(len(self.xy_world), dtype=bool)
        low, high = np.full((2, len(self.xy_world)), np.inf) * [[1], [-1]]
        near, roads = self.ground.network.nearby(self.xy_world, np.full(len(self.xy_world), 0.5))
        rows = np.flatnonzero(near)
        for road, which, s, t in roads:
            inside = road.outside(s, t) < EDGE_M
            at = rows[np.flatnonzero(which)[inside]]
            z = road.base_points(s[inside], t[inside])[:, 2]
            low[at], high[at] = np.minimum(low[at], z), np.maximum(high[at], z)
        return (high - low < APART_M) & ~self.ground.is_stacked(self.xy_world)

    def is_fine(self, row_m: float) -> Bool[np.ndarray, " n"]:
        """All points: rows are close wherever roads are laid."""
        return np.ones(len(self.xy_world), dtype=bool)

    def slope(self) -> Points2:
        """Rise of the pavement along world x and y."""
        height = self.ground.height
        steps = [
            (height(self.xy_world + step) - height(self.xy_world - step)) / (2 * SLOPE_STEP_M)
            for step in SLOPE_STEP_M * np.eye(2)
        ]
        return np.stack(steps, axis=-1)

    def right_of(self, curve: LaneCurve) -> Scalars:
        """Distance to the right of a curve; infinite where it is not near."""
        return self._beside(curve)[1]

    def station(self, curve: LaneCurve) -> Scalars:
        """Stations along a curve."""
        return self._beside(curve)[0]

    def _beside(self, curve: LaneCurve) -> tuple[Scalars, Scalars]:
        """Stations and distances to the right: of the piece to which a point is nearest."""
        station, right = np.zeros(len(self.xy_world)), np.full(len(self.xy_world), np.inf)
        best = np.full(len(self.xy_world), BESIDE_M)
        for piece in curve.pieces:
            low, high = np.sort(piece.on(np.array([piece.start_m, piece.end_m])))
            s, t = piece.road.line.project(self.xy_world)
            on = np.clip(s, low, high)
            aside = (t - piece.offset(on)) * piece.along
            apart = np.hypot(aside, s - on)
            nearer = apart < best
            station = np.where(nearer, np.vectorize(piece.station, otypes=[float])(on), station)
            right, best = np.where(nearer, aside, right), np.where(nearer, apart, best)
        return station, right

    def surface(self, margin_m: float) -> Int[np.ndarray, " n"]:
        """Semantic id of what a lane is paved with, given a margin, on roads outside junctions; 0 elsewhere."""
        found, taken = np.zeros((2, len(self.xy_world)), dtype=int)
        inner = {road.id for road in self.ground.outside}
        near, roads = self.ground.network.nearby(self.xy_world, np.full(len(self.xy_world), 0.5))
        rows = np.flatnonzero(near)
        for road, which, s, t in roads:
            at = rows[which]
            inside = road.outside(s, t) < margin_m
            taken[at[inside]] += 1
            if road.id not in inner:
                continue
            for section, on in road.sections_at(s):
                amid = np.zeros(len(s), dtype=bool)
                amid[on] = (s[on] > section.start_m + SEAM_M) & (s[on] < section.end_m - SEAM_M)
                here = np.flatnonzero(amid)
                edges = section.edges(s[here])
                for k, lane in enumerate(section.lanes):
                    within = inside[here] & (t[here] > edges[k] + margin_m) & (t[here] < edges[k + 1] - margin_m)
                    found[at[here[within]]] = 0 if lane.kind == "none" else IDS[SURFACES.get(lane.kind, ROAD)]
        return np.where(taken == 1, found, 0)
