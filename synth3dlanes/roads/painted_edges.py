"""The painted lines of a map: stretches of lanes' edges that go on into each other. The rules are in docs/network.md;
World frame, metres."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from synth3dlanes.labels.labels import MIRRORED, Direction, Marking, Pair
from synth3dlanes.roads.lane_curves import Course, LaneCurve, LinePaint, Neighbour, TableLine, measured
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.road_table import RoadTable
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene.road_map import JUMP_M, MapMark, MapRoad

# Painted lines that end within JUMP_M of each other, and turn by less than this, are one if their marks are.
JOINED_COS = 0.99
# Markings, and pairs from the inner stripe outwards, by kinds of marks.
MARKINGS: dict[str, tuple[Marking, bool, Pair | None]] = {
    "solid": ("solid", False, None),
    "dashed": ("dashed", False, None),
    "dots": ("dashed", False, None),
    "solid_solid": ("solid", True, None),
    "solid_dashed": ("solid", True, "solid_dashed"),
    "dashed_solid": ("solid", True, "dashed_solid"),
    "dashed_dashed": ("dashed", True, None),
}
# Shorter lines are left out.
LEAST_LINE_M = 0.05


class PaintedEdge(NamedTuple):
    """A stretch of a lane's edge with one mark: its road in a section, the numbers of that section and of the edge, its
    line, its stations, its paint as s grows, and the lanes on its left and right."""

    name: str
    road: Road
    section: int
    edge: int
    line: Offset
    start_m: float
    end_m: float
    marking: Marking
    paint: LinePaint
    left: str | None
    right: str | None

    def look(self, onwards: bool) -> tuple[Marking, LinePaint]:
        """Marking and paint as s grows, or falls."""
        pair = self.paint.pair
        return self.marking, self.paint if onwards or pair is None else self.paint._replace(pair=MIRRORED[pair])


def edges_of(given: MapRoad, road: Road) -> Iterator[PaintedEdge]:
    """The stretches of all edges of a road's lanes with one mark."""
    driving = {lane.id for lane in road.lanes}
    for i, (section, stretch) in enumerate(zip(given.sections, road.stretches, strict=True)):
        (own,) = stretch.sections
        at = {lane.number: k for k, lane in enumerate(own.lanes)}
        for lane in section.lanes:
            n = lane.number
            edge = own.n_left if n == 0 else at[n] + (n < 0)
            beside = [f"{road.id}.{i}.{number}" for number in _beside(n)]
            left, right = (name if name in driving else None for name in beside)
            # Nobody paints the rim of a walkway beside the grass.
            is_rim = edge in own.paved and any(edge in run for run in own.raised)
            marks = [*sorted(lane.marks, key=lambda mark: mark.s_m)]
            ends = [min(own.start_m + mark.s_m, own.end_m) for mark in marks] + [own.end_m]
            for k, (mark, (start_m, end_m)) in enumerate(zip(marks, pairwise(ends), strict=True)):
                if mark.kind != "none" and end_m - start_m > LEAST_LINE_M and not is_rim:
                    name = f"{road.id}.{i}.{n}.line{k or ''}"
                    line, look = own.edge_line(edge), _look(mark, n)
                    yield PaintedEdge(name, stretch, i, edge, line, start_m, end_m, *look, left, right)


def _beside(number: int) -> tuple[int, int]:
    """The numbers of the lanes left and right of the outer edge of a lane, as s grows."""
    if number == 0:
        return 1, -1
    return (number + 1, number) if number > 0 else (number, number - 1)


def _look(mark: MapMark, number: int) -> tuple[Marking, LinePaint]:
    """The marking and the paint of a mark as s grows: a pair from the left."""
    marking, is_double, pair = MARKINGS[mark.kind]
    if pair and number > 0:
        pair = MIRRORED[pair]
    return marking, LinePaint(mark.yellow, mark.width_m, is_double, pair, mark.kind == "dots")


def lines(
    edges: Sequence[PaintedEdge],
    table: RoadTable,
    numbers: Mapping[tuple[str, int], int],
    lanes: dict[str, NetworkLane],
    path_of: dict[str, str],
) -> Iterator[tuple[LaneCurve, list[PaintedEdge]]]:
    """Painted lines with their stretches: those of edges that end where another one with the same mark goes on.
    `numbers` are those of roads in the `table`, by their ids and sections."""
    on_table = [
        TableLine(numbers[edge.road.id, edge.section], (edge.edge, edge.edge), edge.start_m, edge.end_m)
        for edge in edges
    ]
    follows, knots = _follows(edges, table, on_table), list(table.knots(on_table))
    seen: set[int] = set()
    for i in range(len(edges)):
        if i in seen:
            continue
        # Back to where the line begins, or once around.
        at, onwards, n = i, True, 0
        while (at, not onwards) in follows and n < len(edges):
            at, back = follows[at, not onwards]
            onwards, n = not back, n + 1
            if at == i:
                break
        parts = []
        while at not in seen:
            seen.add(at)
            course = Course(edges[at].road, edges[at].line, *knots[at], on_table[at])
            parts.append(_Part(edges[at], course, onwards))
            if (at, onwards) not in follows:
                break
            at, onwards = follows[at, onwards]
        yield _line(parts, lanes, path_of), [part.edge for part in parts]


class _Part(NamedTuple):
    """A stretch of a painted line, its course as s grows, and whether the line goes that way."""

    edge: PaintedEdge
    course: Course
    is_up: bool

    def turned(self) -> "_Part":
        """The part of the line the other way."""
        return self._replace(is_up=not self.is_up)


def _follows(
    edges: Sequence[PaintedEdge], table: RoadTable, on_table: Sequence[TableLine]
) -> dict[tuple[int, bool], tuple[int, bool]]:
    """By a stretch, and whether it is left at its end or at its beginning: the one that goes on there, and whether that
    is entered at its beginning."""
    if not edges:
        return {}
    start, end = (np.array([getattr(edge, name) for edge in edges]) for name in ("start_m", "end_m"))
    step = np.minimum(0.05, (end - start) / 2)
    s, inner_s = np.column_stack([start, end]).ravel(), np.column_stack([start + step, end - step]).ravel()
    which = np.repeat(np.arange(len(edges)), 2)
    points = table.points(on_table, which, s)
    out = points - table.points(on_table, which, inner_s)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    keys = [(i, at_end) for i in range(len(edges)) for at_end in (False, True)]
    found: dict[int, list[int]] = {}
    for a, b in scipy.spatial.cKDTree(points).query_pairs(JUMP_M):
        (i, i_end), (k, k_end) = keys[a], keys[b]
        is_alike = edges[i].look(i_end) == edges[k].look(not k_end)
        if i != k and is_alike and out[a] @ out[b] < -JOINED_COS:
            found.setdefault(a, []).append(b)
            found.setdefault(b, []).append(a)
    return {
        keys[a]: (keys[b[0]][0], not keys[b[0]][1]) for a, b in found.items() if len(b) == 1 and len(found[b[0]]) == 1
    }


def _line(parts: list[_Part], lanes: dict[str, NetworkLane], path_of: dict[str, str]) -> LaneCurve:
    """One painted line of stretches, each as s grows or falls. It goes as the traffic beside it does, along oncoming
    lanes against it; of several, that of the host's lanes counts first, then that on its right."""
    sides = [(edge.left, edge.right) if up else (edge.right, edge.left) for edge, _, up in parts]
    # Lanes beside it, with whether their traffic goes as the parts do.
    beside = [
        (lanes[name], lanes[name].ascends == up)
        for edge, _, up in parts
        for name in (edge.right, edge.left)
        if name is not None
    ]
    order: tuple[Direction, ...] = ("same", "crossing", "oncoming")
    direction: Direction = "crossing"
    if beside:
        lane, goes_along = min(beside, key=lambda at: order.index(at[0].direction))
        direction = lane.direction
        if goes_along == (direction == "oncoming"):
            parts = [part.turned() for part in reversed(parts)]
            sides = [(right, left) for left, right in reversed(sides)]
    edge, _, up = parts[0]
    marking, paint = edge.look(up)
    pieces = measured(course if goes_up else course.turned() for _, course, goes_up in parts)
    beside_it = tuple(
        Neighbour(path_of[name], is_right, piece.start_m, piece.end_m)
        for names, piece in zip(sides, pieces, strict=True)
        for name, is_right in zip(names, (False, True), strict=True)
        if name is not None
    )
    junctions = {part.edge.road.junction for part in parts}
    return LaneCurve(
        edge.name,
        "delimiter",
        edge.road.id,
        marking,
        beside_it,
        pieces,
        0.0,
        pieces[-1].end_m,
        direction,
        connector=False,
        junction=junctions.pop() if len(junctions) == 1 else None,
        paint=paint,
    )


def beside_lanes(drawn: Sequence[tuple[LaneCurve, list[PaintedEdge]]]) -> dict[str, list[Neighbour]]:
    """The lines beside each lane, between two stations of its road, and whether they are on its right as s grows."""
    found: dict[str, list[Neighbour]] = {}
    for line, edges in drawn:
        for edge in edges:
            for lane, is_right in ((edge.left, True), (edge.right, False)):
                if lane is not None:
                    found.setdefault(lane, []).append(Neighbour(line.id, is_right, edge.start_m, edge.end_m))
    return found


def bounded(path: LaneCurve, beside: dict[str, list[Neighbour]]) -> LaneCurve:
    """A path with the lines beside its lanes."""
    found = []
    for lane, piece in zip(path.lanes, path.pieces, strict=True):
        own = beside.get(lane.id, [])
        ends = np.sort(piece.stations([(at.start_m, at.end_m) for at in own])).tolist()
        found += [Neighbour(at.id, at.is_right == (piece.along > 0), *pair) for at, pair in zip(own, ends, strict=True)]
    return replace(path, neighbours=tuple(found))
