"""The paint along the edges of lanes: each is that of the delimiter which runs there."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.opendrive.roads import OdrRoad
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.paint import is_dotted, is_double, line_width_m, paint_color, pair_of
from synth3dlanes.world.world import World

# A delimiter runs along an edge where it is this close to it. Lanes that leave a road turn aside at once, which moves
# the lines of two such lanes against those before.
NEAR_M = 0.1
# Shorter stretches are left out.
SHORT_M = 0.5
# Dashes are counted anew after this length, and lengths are measured in these steps.
MARK_M, LENGTH_STEP_M = 50.0, 0.5
# From the first to the last place of a stretch that have to be near, as shares of it.
PROBES = np.array([0.2, 0.5, 0.8])

Kind = Literal["none", "solid", "double", "solid_dashed", "dashed_solid", "dashed", "dots"]
MIRRORED: dict[Kind, Kind] = {"solid_dashed": "dashed_solid", "dashed_solid": "solid_dashed"}


@dataclass(frozen=True)
class Mark:
    """Paint from `s_m` of a road to the next mark, `length_m` away: the width of a stripe, the lengths of dashes and
    gaps, and where the first dash begins after `s_m`. Of stripes that differ, `kind` names the left one first."""

    s_m: float
    kind: Kind = "none"
    color: str = "standard"
    width_m: float = 0.0
    length_m: float = 0.0
    dash_m: float = 0.0
    gap_m: float = 0.0
    first_m: float = 0.0

    @property
    def stripes(self) -> dict[float, tuple[float, float, float]]:
        """By the t of the stripes from the edge: their dashes, gaps and first dash; a solid stripe is one dash."""
        solid, dashes = (self.length_m, 0.0, 0.0), (self.dash_m, self.gap_m, self.first_m)
        if self.kind == "none":
            return {}
        if self.is_double:
            right, left = (dashes if self.kind == dashed else solid for dashed in ("solid_dashed", "dashed_solid"))
            return {-self.width_m: right, self.width_m: left}
        return {0.0: solid if self.kind == "solid" else dashes}

    @property
    def is_double(self) -> bool:
        """Whether there are two stripes."""
        return self.kind in ("double", *MIRRORED)

    @property
    def total_width_m(self) -> float:
        """The width over all stripes."""
        return 3 * self.width_m if self.is_double else self.width_m


def marks(world: World, road: OdrRoad) -> dict[int, list[Mark]]:
    """The marks on the outer edges of all lanes by their numbers, and those of lane 0, which lies between both
    directions or at the inner edge of a road of one direction."""
    edges = {0: road.center_m, **{lane.number: lane.outer_m for lane in road.lanes}}
    found = {number: _along(world, road, road.plane_points(t)[:, :2]) for number, t in edges.items()}
    # The line between both directions belongs to the lanes of the host's where these are another road's.
    return found | ({0: []} if road.is_oncoming and road.in_junction else {})


def _along(world: World, road: OdrRoad, edge_xy: Float[np.ndarray, "m 2"]) -> list[Mark]:
    """All marks of an edge, and `none` between them; nothing where it is not painted at all."""
    found = sorted(
        (mark for line in world.site.lines for mark in _of(world, road, edge_xy, line)), key=lambda at: at[0].s_m
    )
    filled, reached = [], 0.0
    for mark, end_m in found:
        if mark.s_m > reached + SHORT_M:
            filled.append(Mark(reached))
        filled.append(mark)
        reached = end_m
    if found and road.s_m[-1] > reached + SHORT_M:
        filled.append(Mark(reached))
    return filled


def _of(
    world: World, road: OdrRoad, edge_xy: Float[np.ndarray, "m 2"], line: LaneCurve
) -> Iterator[tuple[Mark, float]]:
    """The marks of a delimiter along an edge, each with its end, if it runs there."""
    at = np.flatnonzero((road.network_s >= line.start_m - 1e-6) & (road.network_s <= line.end_m + 1e-6))
    if line.kind != "delimiter" or len(at) < 2 or road.s_m[at[-1]] - road.s_m[at[0]] < SHORT_M:
        return
    probes = at[((len(at) - 1) * PROBES).astype(int)]
    # Stations of different roads differ, so the whole line is looked at.
    there = line.xy_world(np.sort(road.network_s[at]))
    apart_m = np.linalg.norm(edge_xy[probes][:, None] - there, axis=2).min(axis=1)
    if apart_m.max() > NEAR_M:
        return
    markings = world.scene.markings
    look = str(paint_color(line, markings)), line_width_m(line, markings)
    start_m, end_m = float(road.s_m[at[0]]), float(road.s_m[at[-1]])
    pair = pair_of(line, markings)
    if line.marking == "solid" and pair is None:
        yield Mark(start_m, "double" if is_double(line, markings) else "solid", *look, end_m - start_m), end_m
        return
    kind: Kind = "dots" if is_dotted(line, markings) else "dashed"
    if pair:
        kind = MIRRORED[pair] if road.is_oncoming else pair
    cycle_m, dash_m = markings.dash_cycle_m, markings.dash_fraction * markings.dash_cycle_m
    length_m, ascends = _lengths(line, road.network_s[at]), road.network_s[at[-1]] > road.network_s[at[0]]
    # Dashes begin at multiples of their cycle along the line from station 0; seen from behind, they end there.
    first_m = length_m[0] + (-length_m[0] - (0 if ascends else dash_m)) % cycle_m
    # Marks begin with a dash, and are so short that the line is nowhere much longer or shorter than the road.
    begins_m = np.arange(first_m, length_m[-1], cycle_m * max(1, round(MARK_M / cycle_m)))
    begins_m = np.unique([*(begins_m if len(begins_m) else [first_m]), max(first_m + 1e-3, length_m[-1])])
    places_m = np.interp(begins_m, length_m, road.s_m[at])
    for i, (place_m, next_m) in enumerate(pairwise(places_m)):
        scale = (next_m - place_m) / (begins_m[i + 1] - begins_m[i])
        from_m = place_m if i else start_m
        sizes = next_m - from_m, scale * dash_m, scale * (cycle_m - dash_m), place_m - from_m
        yield Mark(float(from_m), kind, *look, *map(float, sizes)), float(next_m)


def _lengths(line: LaneCurve, network_s: Scalars) -> Scalars:
    """Lengths along a line, in the order of these stations, from station 0."""
    to_start = np.clip(
        np.linspace(0, network_s[0], 2 + int(abs(network_s[0]) / LENGTH_STEP_M)), line.start_m, line.end_m
    )
    before, along = (np.linalg.norm(np.diff(line.points_world(s), axis=0), axis=1) for s in (to_start, network_s))
    start_m = np.sign(network_s[0]) * before.sum() * np.sign(network_s[-1] - network_s[0])
    return np.asarray(start_m + np.concatenate([[0.0], np.cumsum(along)]))
