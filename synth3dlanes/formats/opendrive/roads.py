"""The roads of a world as OpenDRIVE describes them: lanes beside reference lines, on banked planes along these.

A point of a road lies at (s, t, h): s is the length of the reference line seen from above, t the distance to its left
and h the height, both measured on the banked plane. With the direction of travel `e_s` of the reference line, which
climbs, `e_t` is the horizontal left normal rolled about `e_s`. World frame, metres and radians.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.road_map import MapLaneKind
from synth3dlanes.system.arrays import Points2, Points3, Scalars

# Least reach of a file to either side of the scene's middle, and the step between fitted places.
REACH_M = 250.0
FIT_STEP_M = 0.1
MIN_END_M = 10.0
# Distance between the lanes of roads that part at which the junction ends.
APART_M = 0.06
# Steps to a point's station; in bends, each leaves a share of the way.
FOOT_STEPS = 20
JUNCTION = "junction"
# Strips that are nowhere wider are left out.
LEAST_WIDTH_M = 1e-6
# Steps to the banked plane that is nearest to the lanes; the third changes it by less than a millimetre.
PLANE_STEPS = 4
# A width, or an offset, which may depend on the station.
Width = float | Callable[[Scalars], Scalars]


@dataclass(frozen=True, eq=False)
class OdrLane:
    """A strip of a road: its OpenDRIVE number (positive to the left of lane 0), its type, the id of the lane segment
    that it is (None for a shoulder or median), and its edges as t, the inner one first."""

    number: int
    kind: MapLaneKind
    segment: str | None
    inner_m: Scalars
    outer_m: Scalars


@dataclass(frozen=True, eq=False)
class OdrRoad:
    """A road with everything at equal steps along it: stations `s_m`, those of the network's road there, the reference
    line from above, its height and the roll of the plane (positive: the left side is higher), the t of lane 0 and the
    lanes from the left. It runs as the host drives or, if it `is_oncoming`, the other way. `before` and `after` name
    the roads or the junction at its ends; `edges_of` the network's road along whose edges it runs, if it does."""

    name: str
    in_junction: bool
    before: str | None
    after: str | None
    is_oncoming: bool
    is_left_hand: bool
    edges_of: str | None
    network_s: Scalars
    s_m: Scalars
    xy_world: Points2
    elevation_m: Scalars
    roll_rad: Scalars
    center_m: Scalars
    lanes: tuple[OdrLane, ...]
    surface_m: Callable[[Points2, Scalars], Scalars]

    @cached_property
    def line_world(self) -> Points3:
        """The reference line."""
        return np.column_stack([self.xy_world, self.elevation_m])

    @cached_property
    def axes(self) -> Float[np.ndarray, "m 3 3"]:
        """The unit vectors e_s, e_t and e_h in the world as rows: heading, then the climb, then the roll about e_s."""
        along = np.gradient(self.line_world, self.s_m, axis=0, edge_order=2)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        left = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along))])
        left /= np.linalg.norm(left, axis=1, keepdims=True)
        up = np.cross(along, left)
        sin, cos = np.sin(self.roll_rad)[:, None], np.cos(self.roll_rad)[:, None]
        return np.stack([along, cos * left + sin * up, cos * up - sin * left], axis=1)

    def plane_points(self, t_m: Scalars) -> Points3:
        """World points of the banked plane at all stations and these t."""
        return np.asarray(self.line_world + t_m[:, None] * self.axes[:, 1])

    def over_plane(self, t_m: Scalars) -> Scalars:
        """Height (z) of the road's surface over the banked plane at all stations and these t."""
        points = self.plane_points(t_m)
        # Where the road climbs, its roll moves these points along it.
        forward = self.axes[:, 0, :2] / np.linalg.norm(self.axes[:, 0, :2], axis=1, keepdims=True)
        ahead = ((points[:, :2] - self.xy_world) * forward).sum(axis=1)
        network_s = np.interp(self.s_m + ahead, self.s_m, self.network_s)
        return self.surface_m(points[:, :2], network_s) - points[:, 2]

    def places(self, points_world: Points3) -> Points3:
        """(s, t, h) of world points; of those before and behind the road, of its ends."""
        s = self.s_m[np.linalg.norm(points_world[:, None, :2] - self.xy_world, axis=2).argmin(axis=1)]
        for _ in range(FOOT_STEPS):
            i = np.clip(np.searchsorted(self.s_m, s), 0, len(self.s_m) - 1)
            to = np.einsum("nij,nj->ni", self.axes[i], points_world - self.line_world[i])
            ahead = to[:, 0] * np.linalg.norm(self.axes[i, 0, :2], axis=1)
            s = np.clip(self.s_m[i] + ahead, 0, self.s_m[-1])
        return np.column_stack([s, to[:, 1:]])

    @property
    def driving(self) -> tuple[OdrLane, ...]:
        return tuple(lane for lane in self.lanes if lane.kind == "driving")


@dataclass(frozen=True)
class _Strip:
    """A strip of a road of the network: its type, its lane, its width, which may depend on the station."""

    kind: MapLaneKind
    segment: str | None
    width_m: Width


@dataclass(frozen=True)
class _Layout:
    """A part of a road of the network: its stations, its reference line, its strips as t grows, the number of those
    before lane 0, the offset of lane 0 from the line, which may depend on the station, what lies before and behind it
    in ascending stations, and whether it is a connecting road of a junction."""

    name: str
    span_m: tuple[float, float]
    road: Road
    line: Offset
    strips: tuple[_Strip, ...]
    n_left: int
    lane_0_m: Width
    before: str | None = None
    after: str | None = None
    is_oncoming: bool = False
    in_junction: bool = False


def roads(network: Network) -> list[OdrRoad]:
    """All roads of a network. Where others part from the host's, these are its part before that, the connecting roads
    of a junction up to where the lanes have parted, and the roads beyond; with a median, also one for oncoming
    traffic."""
    return [_road(network, layout) for layout in _layouts(network)]


def _strips(lanes: list[NetworkLane]) -> tuple[_Strip, ...]:
    return tuple(_Strip("driving", lane.id, lane.width_m) for lane in lanes)


def _layouts(network: Network) -> list[_Layout]:
    road, found = network.main, list[_Layout]()
    partings = [(branch, branch.parting) for branch in network.branches(road) if branch.parting]
    parted_m = max((parting.station(APART_M) for _, parting in partings), default=0.0)
    end_m = max(REACH_M, parted_m + MIN_END_M)
    first, beyond = ([lane for lane in road.lanes_at(s) if lane.direction == "same"] for s in (-REACH_M, parted_m))
    oncoming = _strips([lane for lane in road.lanes_at(-REACH_M) if lane.direction == "oncoming"])
    shoulder = _Strip("shoulder", None, road.shoulder_m)
    facing, own = road.carriageways[0], road.carriageways[-1]
    left, middle_m = (shoulder, *oncoming), (facing.left_m + own.right_m) / 2
    if oncoming and own.left_m - facing.right_m > APART_M:
        median, line = (
            _Strip("median", None, (own.left_m - facing.right_m) / 2),
            Offset((facing.left_m + facing.right_m) / 2),
        )
        strips, half_m = (*left, median), (facing.right_m - facing.left_m) / 2
        found = [_Layout("oncoming", (-REACH_M, end_m), road, line, strips, len(strips) - 1, half_m, is_oncoming=True)]
        oncoming, left, middle_m = (), (median,), (own.left_m + own.right_m) / 2

    def part(
        name: str, span_m: tuple[float, float], left: tuple[_Strip, ...], right: tuple[_Strip, ...],
        before: str | None = None, after: str | None = None,
    ) -> _Layout:  # fmt: skip
        return _Layout(
            name, span_m, road, Offset(middle_m), (*left, *right), len(left), own.left_m - middle_m, before, after
        )

    before, after = first[0].section, beyond[0].section
    if not partings:
        whole = part(before, (-REACH_M, end_m), left, (*_strips(first), shoulder))
        return [*found, *(_along_works(network, whole) if network.links else [whole])]
    junction, apart = (0.0, parted_m), (parted_m, end_m)
    # A lane that opens begins on its neighbour's; connecting roads are for one direction.
    for lane in beyond:
        if lane.middle.moves:
            opening = _Layout("opening", junction, road, lane.middle, _strips([lane]), 0, -lane.width_m / 2)
            found.append(replace(opening, before=before, after=after, in_junction=True))
    through = _strips([lane for lane in beyond if not lane.middle.moves])
    if oncoming:
        found.append(replace(part("facing", junction, left, (), before, after), is_oncoming=True, in_junction=True))
    found += [
        part(before, (-REACH_M, 0.0), left, (*_strips(first), shoulder), None, JUNCTION),
        replace(part("through", junction, () if oncoming else left, through, before, after), in_junction=True),
    ]
    branch, parting = partings[0]
    lanes, line, edge_m = branch.lanes_at(parted_m), Offset(0.0), branch.carriageways[0].left_m
    # The room between both roads is shared until both have their whole shoulders.
    inner = _Strip("shoulder", None, lambda s: np.clip(parting.gap_m(s) / 2, 0, road.shoulder_m))
    name, strips = lanes[0].section, (*_strips(lanes), shoulder)
    return [
        *found,
        _Layout("leaving", junction, branch, line, strips, 0, edge_m, before, name, in_junction=True),
        part(after, apart, left, (*_strips(beyond), inner), JUNCTION, None),
        _Layout(name, apart, branch, line, (inner, *strips), 1, edge_m, JUNCTION, None),
    ]


def _at(width_m: Width, s: Scalars) -> Scalars:
    return np.broadcast_to(width_m(s) if callable(width_m) else width_m, s.shape)


def _between(low: Offset, high: Offset) -> Callable[[Scalars], Scalars]:
    """The width between two lines."""
    return lambda s: high(s) - low(s)


def _moved(width_m: Width, lane_0: Width, was_m: Width, s: Scalars) -> Scalars:
    """The width of the strip left of lane 0 where that moves."""
    return _at(width_m, s) + _at(lane_0, s) - _at(was_m, s)


def _along_works(network: Network, whole: _Layout) -> list[_Layout]:
    """A road without exit in its sections along road works, one behind the other. Where the outermost lines are not at
    the edges of the lanes, what is between is no lane."""
    road, found = network.main, list[_Layout]()
    starts = sorted({lane.start_m for lane in road.lanes if np.isfinite(lane.start_m)})
    ends = [whole.span_m[0], *starts, max(whole.span_m[1], starts[-1] + MIN_END_M)]
    for span_m in pairwise(ends):
        middle = np.array([(span_m[0] + span_m[1]) / 2])
        lanes = [lane for lane in road.lanes_at(float(middle[0])) if lane.direction == "same"]
        lines = [
            line.pieces[0].offset
            for line in network.delimiters
            if line.direction == "same" and line.start_m < span_m[1] and line.end_m > span_m[0]
        ]
        first, *_, last = sorted(lines, key=lambda line: float(line(middle)[0]))
        strips = (
            _Strip("none", None, _between(first, lanes[0].edges[0])),
            *(_Strip("driving", lane.id, _between(*lane.edges)) for lane in lanes),
            _Strip("none", None, _between(lanes[-1].edges[1], last)),
            _Strip("shoulder", None, _between(last, road.right)),
        )
        s = np.linspace(*span_m, 200)
        there = [at for at in strips if at.kind != "none" or _at(at.width_m, s).max() > LEAST_WIDTH_M]
        lane_0 = _between(whole.line, first)
        left = list(whole.strips[: whole.n_left])
        left[-1] = replace(left[-1], width_m=partial(_moved, left[-1].width_m, lane_0, whole.lane_0_m))
        found.append(replace(whole, name=lanes[0].section, span_m=span_m, strips=(*left, *there), lane_0_m=lane_0))
    names = [None, *(at.name for at in found), None]
    linked = [replace(at, before=names[i], after=names[i + 2]) for i, at in enumerate(found)]
    return linked[:: int(network.onwards)]


def _road(network: Network, layout: _Layout) -> OdrRoad:
    ascends = (network.onwards > 0) != layout.is_oncoming
    low_m, high_m = layout.span_m
    s = np.linspace(low_m, high_m, int(np.ceil((high_m - low_m) / FIT_STEP_M)) + 1)[:: 1 if ascends else -1]
    xy = layout.road.xy(s, layout.line(s))
    lengths = lengths_along(xy)
    # To the left of the reference line, seen in its direction.
    leftward = -network.rightward * (-1 if layout.is_oncoming else 1)
    widths = [_at(strip.width_m, s) for strip in layout.strips]
    edges = np.cumsum([np.zeros(len(s)), *widths], axis=0)
    edges = leftward * (edges - edges[layout.n_left] + _at(layout.lane_0_m, s))
    lanes = []
    for i, strip in enumerate(layout.strips):
        outward = -1 if i < layout.n_left else 1
        number = i - layout.n_left if i < layout.n_left else i - layout.n_left + 1
        inner, outer = (edges[i + 1], edges[i]) if outward < 0 else (edges[i], edges[i + 1])
        lanes.append(OdrLane(int(leftward * number), strip.kind, strip.segment, inner, outer))

    def surface_m(xy_world: Points2, network_s: Scalars) -> Scalars:
        return height_at(network.terrain, xy_world) + layout.road.raised(network_s)

    ends = layout.before, layout.after
    is_whole = not layout.is_oncoming and layout.name != "opening"
    flat = OdrRoad(
        name=layout.name,
        in_junction=layout.in_junction,
        before=ends[0] if ascends else ends[1],
        after=ends[1] if ascends else ends[0],
        is_oncoming=layout.is_oncoming,
        is_left_hand=network.rightward < 0,
        edges_of=layout.road.id if is_whole else None,
        network_s=s,
        s_m=lengths,
        xy_world=xy,
        elevation_m=surface_m(xy, s),
        roll_rad=np.zeros(len(s)),
        center_m=edges[layout.n_left],
        lanes=tuple(sorted(lanes, key=lambda lane: -lane.number)),
        surface_m=surface_m,
    )
    return _banked(flat)


def _banked(road: OdrRoad) -> OdrRoad:
    """The road on the plane nearest to its lanes; their edges are still at the same distances from above."""
    lines = [t for lane in road.driving for t in (lane.inner_m, (lane.inner_m + lane.outer_m) / 2, lane.outer_m)]
    aside = np.array(lines)
    banked = road
    for _ in range(PLANE_STEPS):
        t = aside / np.cos(banked.roll_rad)
        over = np.array([banked.over_plane(at) for at in t])
        t_mean, over_mean = t.mean(axis=0), over.mean(axis=0)
        slope = ((t - t_mean) * (over - over_mean)).sum(axis=0) / ((t - t_mean) ** 2).sum(axis=0)
        elevation = banked.elevation_m + over_mean - slope * t_mean
        banked = replace(banked, elevation_m=elevation, roll_rad=banked.roll_rad + slope * np.cos(banked.roll_rad))
    wider = 1 / np.cos(banked.roll_rad)
    return replace(
        banked,
        center_m=road.center_m * wider,
        lanes=tuple(replace(lane, inner_m=lane.inner_m * wider, outer_m=lane.outer_m * wider) for lane in road.lanes),
    )
