"""Positions of points, seen from above, on the roads of a scene or a map, and the surface expected there. Metres.

Follows the meshes that Blender renders: surfaces are straight between their rows of vertices.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Int

from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import Road
from synth3dlanes.roads.terrain import gradient_at
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.world import meshes
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.map_meshes import SURFACES
from synth3dlanes.world.meshes import MEDIAN, ROAD, SHOULDER
from synth3dlanes.world.paved_areas import PavedAreas
from synth3dlanes.world.verges import Verges

# Points are projected onto a road that parts from another up to this far before that and this far left of its lanes.
BEHIND_M, ASIDE_M = 20.0, 1.0
# Its faces are cut where they meet the pavement of the other; this far outside that no face is cut.
CUT_M = 0.3
# Points on the other's right shoulder this close to its lanes may be covered by the faces of these.
COVER_M = 2.0
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
class RoadPlaces:
    """Points by station and offset on every road; NaN where one that parts from another is not near."""

    paved: Verges
    xy_world: Points2
    on: dict[str, tuple[Scalars, Scalars]]

    @property
    def s(self) -> Scalars:
        """Stations on the host's road."""
        return self.on[self.paved.network.main.id][0]

    @property
    def t(self) -> Scalars:
        """Offsets on the host's road."""
        return self.on[self.paved.network.main.id][1]

    def at(self, which: Bool[np.ndarray, " n"]) -> "RoadPlaces":
        """The selected points."""
        on = {road: (s[which], t[which]) for road, (s, t) in self.on.items()}
        return RoadPlaces(self.paved, self.xy_world[which], on)

    def outside(self) -> Scalars:
        """Distance from the nearest pavement, negative on it."""
        return np.fmin.reduce([self.outside_of(road) for road in self.paved.network.roads])

    def off_carriageways(self) -> Scalars:
        """The same; infinite where none is near."""
        return np.nan_to_num(self.outside(), nan=np.inf)

    def outside_of(self, road: Road) -> Scalars:
        """Distance from a road's pavement, which overlaps a little with that of one from which it parts."""
        s, t = self.on[road.id]
        if road.parting is None:
            return road.outside(s, t)
        aside = np.maximum(road.left(s) - meshes.SEAM_M - t, t - road.right(s))
        return np.where(s >= road.start_m, aside, np.nan)

    def raised(self) -> Scalars:
        """Height of the pavement over the terrain."""
        raised = np.zeros(self.s.shape)
        for road in self.paved.network.roads:
            on_it = self._on_branch(road, CUT_M)
            if road.ramp is not None and on_it.any():
                rows = np.sort(self.paved.network.stations(self.paved.rows_driven_m))
                raised[on_it] = np.interp(self.on[road.id][0][on_it], rows, road.raised(rows))
        return raised

    def on_slope(self) -> Bool[np.ndarray, " n"]:
        """Which points are on a ramp where it rises."""
        raised = self.raised()
        tops_m = [road.ramp.height_m for road in self.paved.network.roads if road.ramp]
        return (raised > 0) & (raised < min(tops_m, default=0.0))

    def is_firm(self) -> Bool[np.ndarray, " n"]:
        """All points: the surface has one height everywhere."""
        return np.ones(len(self.xy_world), dtype=bool)

    def is_fine(self, row_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are where rows are closer than this. Far behind a host without rear cameras they are not, and
        the pavement is straight between them."""
        rows = np.sort(self.paved.network.stations(self.paved.rows_driven_m))
        before = np.searchsorted(rows, self.s) - 1
        return np.asarray(np.diff(rows)[np.clip(before, 0, len(rows) - 2)] < row_m)

    def slope(self) -> Points2:
        """Rise of the terrain along world x and y."""
        return gradient_at(self.paved.network.terrain, self.xy_world)

    def right_of(self, curve: LaneCurve) -> Scalars:
        """Distance beside a curve, as t grows; infinite where it is not near."""
        return np.nan_to_num(self._along(curve, lambda s, t, offset: t - offset(s)), nan=np.inf)

    def station(self, curve: LaneCurve) -> Scalars:
        """Stations along a curve."""
        found = self._along(curve, lambda s, t, offset: s)
        return np.where(np.isnan(found), self.s, found)

    def is_single(self) -> Bool[np.ndarray, " n"]:
        """All points: no road lies over another."""
        return np.ones(len(self.xy_world), dtype=bool)

    def surface(self, margin_m: float) -> Int[np.ndarray, " n"]:
        """Semantic id of road or shoulder where only one is possible, given a margin; 0 elsewhere."""
        main = self.paved.network.main
        right = main.right(self.s) - main.shoulder_m
        beyond = np.maximum(main.carriageways[0].left_m - self.t, self.t - right)
        for low_m, high_m in main.medians:
            beyond = np.where((self.t > low_m) & (self.t < high_m), np.fmin(self.t - low_m, high_m - self.t), beyond)
        known = (self.outside_of(main) < 0) & ~self._on_grass(margin_m)
        for road in self.paved.network.branches(main):
            _, t = self.on[road.id]
            lanes = np.maximum(road.carriageways[0].left_m - t, t - road.carriageways[-1].right_m)
            is_covered = (self.s > road.start_m - BEHIND_M) & (lanes < COVER_M)
            beyond = np.where((self.t > right - margin_m) & is_covered, 0.0, beyond)
            on_it = (self.outside_of(main) > CUT_M) & (self.outside_of(road) < 0)
            beyond, known = np.where(on_it, lanes, beyond), known | on_it
        paved_m = self.paved.under_paint_m(main) + margin_m
        road_id, shoulder_id = SEMANTIC_IDS["road"], SEMANTIC_IDS["shoulder"]
        return np.where(known & (beyond < -margin_m), road_id, np.where(known & (beyond > paved_m), shoulder_id, 0))

    def _on_branch(self, road: Road, cut_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are on a road's pavement, and not on that of one from which it parts."""
        outside = self.outside_of(road)
        return outside < (0 if road.parting is None else np.minimum(self.outside_of(road.parting.road), cut_m))

    def _along(self, curve: LaneCurve, value: Callable[[Scalars, Scalars, Offset], Scalars]) -> Scalars:
        """Values from the places on the roads along which a curve runs."""
        found = np.full(self.s.shape, np.nan)
        for piece in curve.pieces:
            s, t = self.on[piece.road.id]
            start_m = -np.inf if piece is curve.pieces[0] else piece.start_m
            start_m = start_m if piece.road.parting is None else piece.road.start_m
            found = np.where((self.s >= start_m) & (s >= start_m), value(s, t, piece.offset), found)
        return found

    def _on_grass(self, margin_m: float) -> Bool[np.ndarray, " n"]:
        """Which points may be on the grass of a median."""
        found = np.zeros(self.t.shape, dtype=bool)
        for low_m, high_m in self.paved.grass_in_medians(self.paved.network.main):
            found |= (self.t > low_m - margin_m) & (self.t < high_m + margin_m)
        return found


@dataclass(frozen=True, eq=False)
class MapPlaces:
    """Points on the ground of a map, by the questions that `RoadPlaces` answers for the paper's roads; `known` has
    their places beside curves by the ids of these."""

    ground: Ground
    paved: PavedAreas
    xy_world: Points2
    known: dict[str, tuple[Scalars, Scalars]] = field(default_factory=dict)

    def at(self, which: Bool[np.ndarray, " n"]) -> "MapPlaces":
        """The selected points."""
        return MapPlaces(self.ground, self.paved, self.xy_world[which])

    def outside(self) -> Scalars:
        """Distance from the nearest pavement, negative on it."""
        return self.ground.clearance(self.xy_world)

    def off_carriageways(self) -> Scalars:
        """Distance from the nearest pavement of traffic, negative on it."""
        return self.paved.off_carriageways(self.xy_world)

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
        near, roads = self.ground.network.index.nearby(self.xy_world, np.full(len(self.xy_world), 0.5))
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
        """Stations and distances to the right, computed once: of the piece to which a point is nearest."""
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

    def surface(self, margin_m: float) -> Int[np.ndarray, " n"]:
        """Semantic id of what a lane is paved with, given a margin, on roads outside junctions; 0 elsewhere."""
        found, taken = np.zeros((2, len(self.xy_world)), dtype=int)
        inner = {road.id for road in self.paved.outside}
        near, roads = self.ground.network.index.nearby(self.xy_world, np.full(len(self.xy_world), 0.5))
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


AnyPlaces = RoadPlaces | MapPlaces


def places(ground: Ground, xy_world: Points2) -> AnyPlaces:
    """Project points near a road onto it."""
    if isinstance(ground.paved, PavedAreas):
        return MapPlaces(ground, ground.paved, xy_world)
    on: dict[str, tuple[Scalars, Scalars]] = {}
    for road in ground.network.roads:
        if road.parting is None:
            on[road.id] = road.line.project(xy_world)
            continue
        s, t = on[road.parting.road.id]
        begun, lanes = road.parting.road.carriageways[-1], road.carriageways[0]
        left_m = begun.right_m - (lanes.right_m - lanes.left_m)
        near = (s > road.start_m - BEHIND_M) & (t > left_m - ASIDE_M)
        found = np.full((2, len(s)), np.nan)
        found[:, near] = road.line.project(xy_world[near], np.maximum(s[near], road.start_m))
        on[road.id] = found[0], found[1]
    return RoadPlaces(ground.paved, xy_world, on)
