"""Roads without sections as OpenDRIVE files tell them: in parts, each with its lanes beside a reference line of its own
and a junction where roads part. World frame, metres."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from synth3dlanes.formats.opendrive.file_roads import WrittenRoad, on_planes
from synth3dlanes.formats.opendrive.marks import LaneEdge, marks
from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.roads.from_map import bare_road
from synth3dlanes.roads.maps.profiles import cubics, pieces
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene.road_map import LaneName, MapLane, MapLaneKind, MapRoad, MapSection, PlanPiece
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.world.world import World

# Least reach of a file to either side of the scene's middle, and the step between fitted places.
REACH_M, FIT_STEP_M = 250.0, 0.1
MIN_END_M = 10.0
# Distance between the lanes of roads that part at which the junction ends.
APART_M = 0.06
JUNCTION = "junction"
# Strips that are nowhere wider are left out.
LEAST_WIDTH_M = 1e-6
# How far the written reference line and widths may be from the world's.
LINE_M, WIDTH_M = 1e-3, 1e-3
# A width, or an offset, which may depend on the station.
Width = float | Callable[[Scalars], Scalars]


@dataclass(frozen=True)
class WrittenStrip:
    """A strip of a road of the network: its type, its lane, its width."""

    kind: MapLaneKind
    segment: str | None
    width_m: Width


WrittenStrips = tuple[WrittenStrip, ...]


@dataclass(frozen=True)
class WrittenPart:
    """A part of a road of the network: its stations, its reference line, its strips as t grows, the number of those
    before lane 0, the offset of lane 0 from the line, the parts before and behind it in ascending stations, and whether
    it is a connecting road of a junction. It runs as the host drives or, if it `is_oncoming`, the other way."""

    name: str
    span_m: tuple[float, float]
    road: Road
    line: Offset
    strips: WrittenStrips
    n_left: int
    lane_0_m: Width
    before: str | None = None
    after: str | None = None
    is_oncoming: bool = False
    in_junction: bool = False

    def lanes(self, network: Network) -> dict[LaneName, str]:
        """Its segments of the lane graph by the names of its lanes in the file."""
        return {
            f"{self.name}.0.{self.number(network, i)}": strip.segment
            for i, strip in enumerate(self.strips)
            if strip.segment is not None
        }

    def leftward(self, network: Network) -> int:
        """1 where t grows to the left of its reference line, seen in its direction, else -1."""
        return int(-network.rightward * (-1 if self.is_oncoming else 1))

    def number(self, network: Network, strip: int) -> int:
        """The number of the lane that a strip is in the file."""
        return self.leftward(network) * (strip - self.n_left + (strip >= self.n_left))

    def told(self, world: World) -> WrittenRoad:
        """The part as its file tells it."""
        network, (low_m, high_m) = world.network, self.span_m
        ascends = (network.onwards > 0) != self.is_oncoming
        s = np.linspace(low_m, high_m, int(np.ceil((high_m - low_m) / FIT_STEP_M)) + 1)[:: 1 if ascends else -1]
        xy, line = self.road.xy(s, self.line(s)), self.line(s)
        s_m = lengths_along(xy)
        edges = np.cumsum([np.zeros(len(s)), *(_at(strip.width_m, s) for strip in self.strips)], axis=0)
        edges += _at(self.lane_0_m, s) - edges[self.n_left]

        def lane(number: int, kind: MapLaneKind, outer: int, width_m: Scalars | None = None) -> MapLane:
            edge = LaneEdge(number, s, s_m, self.road.xy(s, line + edges[outer]), self.is_oncoming)
            # The line between both directions belongs to the lanes of the host's where these are another road's.
            is_theirs = number == 0 and self.is_oncoming and self.in_junction
            return MapLane(
                number=number,
                kind=kind,
                widths=() if width_m is None else tuple(cubics(s_m, width_m, WIDTH_M)),
                marks=() if is_theirs else tuple(marks(world, edge)),
            )

        lanes = [
            lane(self.number(network, i), strip.kind, i + (i >= self.n_left), edges[i + 1] - edges[i])
            for i, strip in enumerate(self.strips)
        ]
        flat = MapRoad(
            id=self.name,
            plan=tuple(_plan(s_m, xy)),
            sections=(
                MapSection(
                    s_m=0.0,
                    lanes=tuple(sorted([*lanes, lane(0, "none", self.n_left)], key=lambda lane: -lane.number)),
                ),
            ),
            lane_offsets=tuple(cubics(s_m, self.leftward(network) * edges[self.n_left], WIDTH_M)),
            junction=JUNCTION if self.in_junction else None,
            keeps_left=network.rightward < 0,
        )

        def raised(at: Scalars) -> Scalars:
            return self.road.raised(np.interp(at, s_m, s))

        return WrittenRoad(
            told=on_planes(flat, bare_road(flat, network.terrain), raised),
            segments=self.lanes(network),
            source=self.road.id,
            span_m=self.span_m,
            has_edges=not self.is_oncoming and self.line.moves is None,
        )


def _plan(s_m: Scalars, xy_world: Points2) -> Iterator[PlanPiece]:
    for piece in pieces(s_m, xy_world, LINE_M, unit_speed=True):
        (x, y), (dx, dy) = piece.abcd[0].tolist(), piece.abcd[1].tolist()
        u, v = (piece.abcd @ np.array([[dx, -dy], [dy, dx]])).T.tolist()
        length_m, heading = piece.end - piece.s, float(np.arctan2(dy, dx))
        cubic = {"u": (0.0, 1.0, *u[2:]), "v": (0.0, 0.0, *v[2:]), "parameter_end": length_m}
        yield PlanPiece(x_m=x, y_m=y, heading_rad=heading, length_m=length_m, **cubic)


def part_links(network: Network, parts: Sequence[WrittenPart]) -> tuple[tuple[LaneName, LaneName], ...]:
    """The links between the lanes of parts that follow each other, as traffic drives."""
    by_name, found = {part.name: part for part in parts}, dict[tuple[LaneName, LaneName], None]()
    for part in parts:
        for there, is_after in ((part.before, False), (part.after, True)):
            for name, segment in part.lanes(network).items():
                joined = {segment, *(lane.id for lane in network.joined_to(network.lanes[segment]))}
                for other, beyond in by_name[there].lanes(network).items() if there in by_name else ():
                    if beyond in joined:
                        goes_on = network.lanes[segment].ascends == is_after
                        found[(name, other) if goes_on else (other, name)] = None
    return tuple(found)


def _driving(lanes: Sequence[NetworkLane]) -> WrittenStrips:
    return tuple(WrittenStrip("driving", lane.id, lane.width_m) for lane in lanes)


def parts(network: Network) -> list[WrittenPart]:
    """The parts of all roads of a network. Where others part from the host's, these are its part before that, the
    connecting roads of a junction up to where the lanes have parted, and the roads beyond; with a median, also one for
    oncoming traffic."""
    road, found = network.main, list[WrittenPart]()
    partings = [(branch, branch.parting) for branch in network.branches(road) if branch.parting]
    parted_m = max((parting.station(APART_M) for _, parting in partings), default=0.0)
    end_m = max(REACH_M, parted_m + MIN_END_M)
    first, beyond = ([lane for lane in road.lanes_at(s) if lane.direction == "same"] for s in (-REACH_M, parted_m))
    oncoming = _driving([lane for lane in road.lanes_at(-REACH_M) if lane.direction == "oncoming"])
    shoulder = WrittenStrip("shoulder", None, road.shoulder_m)
    facing, own = road.carriageways[0], road.carriageways[-1]
    left, middle_m = (shoulder, *oncoming), (facing.left_m + own.right_m) / 2
    if oncoming and own.left_m - facing.right_m > APART_M:
        median = WrittenStrip("median", None, (own.left_m - facing.right_m) / 2)
        line, half_m = Offset((facing.left_m + facing.right_m) / 2), (facing.right_m - facing.left_m) / 2
        strips = (*left, median)
        found = [
            WrittenPart("oncoming", (-REACH_M, end_m), road, line, strips, len(strips) - 1, half_m, is_oncoming=True)
        ]
        oncoming, left, middle_m = (), (median,), (own.left_m + own.right_m) / 2

    def part(name: str, span_m: tuple[float, float], left: WrittenStrips, right: WrittenStrips) -> WrittenPart:
        return WrittenPart(name, span_m, road, Offset(middle_m), (*left, *right), len(left), own.left_m - middle_m)

    before, after = first[0].section, beyond[0].section
    if not partings:
        whole = part(before, (-REACH_M, end_m), left, (*_driving(first), shoulder))
        return [*found, *(_along_works(network, whole) if network.links else [whole])]
    junction, apart = (0.0, parted_m), (parted_m, end_m)
    # A lane that opens begins on its neighbour's; connecting roads are for one direction.
    opening = [lane for lane in beyond if lane.middle.moves]
    connecting = [
        WrittenPart("opening", junction, road, lane.middle, _driving([lane]), 0, -lane.width_m / 2) for lane in opening
    ]
    if oncoming:
        connecting.append(replace(part("facing", junction, left, ()), is_oncoming=True))
    through = _driving([lane for lane in beyond if lane not in opening])
    connecting.append(part("through", junction, () if oncoming else left, through))
    branch, parting = partings[0]
    lanes, line, edge_m = branch.lanes_at(parted_m), Offset(0.0), branch.carriageways[0].left_m
    # The room between both roads is shared until both have their whole shoulders.
    inner = WrittenStrip("shoulder", None, lambda s: np.clip(parting.gap_m(s) / 2, 0, road.shoulder_m))
    name, strips = lanes[0].section, (*_driving(lanes), shoulder)
    return [
        *found,
        *(replace(at, before=before, after=after, in_junction=True) for at in connecting),
        part(before, (-REACH_M, 0.0), left, (*_driving(first), shoulder)),
        WrittenPart("leaving", junction, branch, line, strips, 0, edge_m, before, name, in_junction=True),
        part(after, apart, left, (*_driving(beyond), inner)),
        WrittenPart(name, apart, branch, line, (inner, *strips), 1, edge_m),
    ]


def _at(width_m: Width, s: Scalars) -> Scalars:
    return np.broadcast_to(width_m(s) if callable(width_m) else width_m, s.shape)


def _between(low: Offset, high: Offset) -> Callable[[Scalars], Scalars]:
    """The width between two lines."""
    return lambda s: high(s) - low(s)


def _moved(width_m: Width, lane_0: Width, was_m: Width, s: Scalars) -> Scalars:
    """The width of the strip left of lane 0 where that moves."""
    return _at(width_m, s) + _at(lane_0, s) - _at(was_m, s)


def _along_works(network: Network, whole: WrittenPart) -> list[WrittenPart]:
    """A road without exit in its sections along road works, one behind the other. Where the outermost lines are not at
    the edges of the lanes, what is between is no lane."""
    road, found = network.main, list[WrittenPart]()
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
            WrittenStrip("none", None, _between(first, lanes[0].edges[0])),
            *(WrittenStrip("driving", lane.id, _between(*lane.edges)) for lane in lanes),
            WrittenStrip("none", None, _between(lanes[-1].edges[1], last)),
            WrittenStrip("shoulder", None, _between(last, road.right)),
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
