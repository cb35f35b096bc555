"""The paint along edges of lanes as OpenDRIVE's marks, in place: each that of the delimiter which runs there."""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from synth3dlanes.labels.labels import MIRRORED
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.scene.road_map import MapMark, MapMarkKind
from synth3dlanes.scene.scene import Markings
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.world.paint import is_dotted, is_double, line_width_m, paint_color, pair_of
from synth3dlanes.world.world import World

# Greatest distance of a delimiter from the edge that it runs along: lanes that leave a road turn aside at once, which
# moves their lines against those before.
ON_EDGE_M = 0.1
# Shorter stretches are left out.
SHORT_M = 0.5
# Dashes are counted anew after this length, and lengths are measured in these steps.
MARK_M, LENGTH_STEP_M = 50.0, 0.5
# From the first to the last place of a stretch that have to be near, as shares of it.
PROBES = np.array([0.2, 0.5, 0.8])

# Towards which lane numbers, which increase to the left, a mark may be crossed: from the side of its dashes.
LANE_CHANGES = {"dashed": "both", "dots": "both", "solid_dashed": "increase", "dashed_solid": "decrease"}
DOUBLE: frozenset[MapMarkKind] = frozenset({"solid_solid", "solid_dashed", "dashed_solid"})
# The pattern of a stripe: the lengths of its dashes and gaps, and where the first dash begins.
Pattern = tuple[float, float, float]


class PaintedMark(MapMark):
    """A mark with its paint in place: of each stripe the t from the edge, the lengths of dashes and gaps, and where the
    first dash begins. A solid stripe is one dash."""

    stripes: tuple[tuple[float, float, float, float], ...]
    lane_change: str


class LaneEdge(NamedTuple):
    """The outer edge of a lane by its number, or lane 0: stations of the road, those in the file, and its places. The
    file's road runs as the host drives or, if it `is_oncoming`, the other way."""

    number: int
    road_s: Scalars
    s_m: Scalars
    xy_world: Points2
    is_oncoming: bool


def marks(world: World, edge: LaneEdge) -> Iterator[MapMark]:
    """All marks of an edge, and `none` between them; nothing where it is not painted at all."""
    painted = [mark for line in world.network.delimiters for mark in _of(line, world.scene.markings, edge)]
    reached = 0.0
    for mark, end_m in sorted(painted, key=lambda at: at[0].s_m):
        if mark.s_m > reached + SHORT_M:
            yield MapMark(s_m=reached, kind="none")
        # From the left; on lanes to the left of lane 0 the inner stripe comes first.
        yield mark.model_copy(update={"kind": MIRRORED.get(mark.kind, mark.kind)}) if edge.number > 0 else mark
        reached = end_m
    if painted and edge.s_m[-1] > reached + SHORT_M:
        yield MapMark(s_m=reached, kind="none")


def _of(line: LaneCurve, markings: Markings, edge: LaneEdge) -> Iterator[tuple[PaintedMark, float]]:
    """The marks of a delimiter along an edge, each with its end, if it runs there; of stripes that differ, the left one
    is named first."""
    _, road_s, s_m, edge_xy, is_oncoming = edge
    at = np.flatnonzero((road_s >= line.start_m - 1e-6) & (road_s <= line.end_m + 1e-6))
    if len(at) < 2 or s_m[at[-1]] - s_m[at[0]] < SHORT_M:
        return
    probes = at[((len(at) - 1) * PROBES).astype(int)]
    # Stations of different roads differ, so the whole line is looked at.
    there = line.xy_world(np.sort(road_s[at]))
    apart_m = np.linalg.norm(edge_xy[probes][:, None] - there, axis=2).min(axis=1)
    if apart_m.max() > ON_EDGE_M:
        return
    width_m = line_width_m(line, markings)

    def painted(kind: MapMarkKind, s_m: float, length_m: float, dashes: Pattern = (0.0, 0.0, 0.0)) -> PaintedMark:
        solid = (length_m, 0.0, 0.0)
        patterns: dict[float, Pattern] = {0.0: solid if kind == "solid" else dashes}
        if kind in DOUBLE:
            right, left = (dashes if kind == dashed else solid for dashed in ("solid_dashed", "dashed_solid"))
            patterns = {-width_m: right, width_m: left}
        return PaintedMark(
            s_m=s_m,
            kind=kind,
            yellow=paint_color(line, markings) == "yellow",
            width_m=width_m,
            stripes=tuple((t_m, *pattern) for t_m, pattern in patterns.items()),
            lane_change=LANE_CHANGES.get(kind, "none"),
        )

    start_m, end_m = float(s_m[at[0]]), float(s_m[at[-1]])
    pair, ascends = pair_of(line, markings), road_s[at[-1]] > road_s[at[0]]
    if line.marking == "solid" and pair is None:
        yield painted("solid_solid" if is_double(line, markings) else "solid", start_m, end_m - start_m), end_m
        return
    kind: MapMarkKind = "dots" if is_dotted(line, markings) else "dashed"
    if pair:
        kind = MIRRORED[pair] if is_oncoming else pair
    cycle_m, dash_m = markings.dash_cycle_m, markings.dash_fraction * markings.dash_cycle_m
    length_m = _lengths(line, road_s[at])
    # Dashes begin at multiples of their cycle along the line from station 0; seen from behind, they end there.
    first_m = length_m[0] + (-length_m[0] - (0 if ascends else dash_m)) % cycle_m
    # Marks begin with a dash, and are so short that the line is nowhere much longer or shorter than the road.
    begins_m = np.arange(first_m, length_m[-1], cycle_m * max(1, round(MARK_M / cycle_m)))
    begins_m = np.unique([*(begins_m if len(begins_m) else [first_m]), max(first_m + 1e-3, length_m[-1])])
    places_m = np.interp(begins_m, length_m, s_m[at])
    for i, (place_m, next_m) in enumerate(pairwise(places_m)):
        scale = (next_m - place_m) / (begins_m[i + 1] - begins_m[i])
        from_m = place_m if i else start_m
        dashes = float(scale * dash_m), float(scale * (cycle_m - dash_m)), float(place_m - from_m)
        yield painted(kind, float(from_m), float(next_m - from_m), dashes), float(next_m)


def _lengths(line: LaneCurve, road_s: Scalars) -> Scalars:
    """Lengths along a line, in the order of these stations, from station 0."""
    to_start = np.clip(np.linspace(0, road_s[0], 2 + int(abs(road_s[0]) / LENGTH_STEP_M)), line.start_m, line.end_m)
    before, along = (np.linalg.norm(np.diff(line.points_world(s), axis=0), axis=1) for s in (to_start, road_s))
    start_m = np.sign(road_s[0]) * before.sum() * np.sign(road_s[-1] - road_s[0])
    return np.asarray(start_m + np.concatenate([[0.0], np.cumsum(along)]))
