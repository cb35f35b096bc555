"""A scene's map -> Network: its roads near a place with their sections, lanes, paths and painted lines, and junctions.
The rules are in docs/network.md; World frame, metres."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from synth3dlanes.geometry.lane_curves import LaneCurve, LinePaint, measured
from synth3dlanes.geometry.map_lines import Chain, Cubic, FiniteLine, MeasuredCubic, Spiral
from synth3dlanes.geometry.map_network import Junction, MapNetwork
from synth3dlanes.geometry.roads import NetworkLane, Offset
from synth3dlanes.geometry.section_road import CrossSection, Profile, SectionRoad, Shapes
from synth3dlanes.labels import Direction, Marking, Pair
from synth3dlanes.road_map import MapMark, MapRoad, PlanPiece, RoadMap
from synth3dlanes.scene import Terrain

# Roads farther from the host than this are left out.
AROUND_M = 450.0
# Painted lines that end this close to each other, and turn by less than this, are one if their marks are.
JOINED_M, JOINED_COS = 0.03, 0.99
# Shorter ones, and lanes that are nowhere wider, are none.
LEAST_LINE_M, LEAST_WIDTH_M = 0.05, 0.1
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
OTHER_WAY: dict[Pair, Pair] = {"solid_dashed": "dashed_solid", "dashed_solid": "solid_dashed"}


def map_network(roads: RoadMap, terrain: Terrain, at_m: float) -> MapNetwork:
    """The roads of a map within AROUND_M of the place at a length along its route, and those of the route."""
    return _Reading(roads, terrain).network(at_m)


def plan_line(plan: Sequence[PlanPiece]) -> Chain:
    """The reference line of a road's plan."""
    return Chain.of([_plan_piece(piece) for piece in plan])


def _plan_piece(piece: PlanPiece) -> FiniteLine:
    start, length_m = (piece.x_m, piece.y_m), piece.length_m
    if piece.u is None or piece.v is None:
        bends = (piece.curvature_end - piece.curvature) / length_m
        return Spiral(length_m, start, piece.heading_rad, piece.curvature, bends)
    c, s = np.cos(piece.heading_rad), np.sin(piece.heading_rad)
    u, v = np.array(piece.u), np.array(piece.v)
    x, y = c * u - s * v, s * u + c * v
    x[0], y[0] = x[0] + piece.x_m, y[0] + piece.y_m
    return MeasuredCubic(length_m, Cubic(piece.parameter_end, _four(x), _four(y)))


def _four(values: Float[np.ndarray, "4"]) -> tuple[float, float, float, float]:
    a, b, c, d = values.tolist()
    return a, b, c, d


class _Edge(NamedTuple):
    """A stretch of a lane's edge with one mark: its road, the number of its section, its line, its stations, its paint
    as s grows, and the lanes on its left and right."""

    name: str
    road: SectionRoad
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
        return self.marking, self.paint if onwards or pair is None else self.paint._replace(pair=OTHER_WAY[pair])


class _Reading:
    """A map and what is made of it step by step."""

    def __init__(self, roads: RoadMap, terrain: Terrain) -> None:
        self.map, self.terrain = roads, terrain

    def network(self, at_m: float) -> MapNetwork:
        near = self._near(at_m)
        lanes = {lane.id: lane for road in near for lane in road.lanes}
        links = [link for link in self.map.links if link[0] in lanes and link[1] in lanes]
        chains = list(_chains(list(lanes.values()), links))
        directions = self._directions(lanes, links, chains)
        lanes = {name: replace(lane, direction=directions[name]) for name, lane in lanes.items()}
        roads = {road.id: replace(road, lanes=tuple(lanes[lane.id] for lane in road.lanes)) for road in near}
        paths = [self._path([lanes[name] for name in chain], roads) for chain in chains]
        path_of = {lane.id: path.id for path in paths for lane in path.lanes}
        drawn = list(_lines([edge for road in roads.values() for edge in self._edges(road)], lanes, path_of))
        junctions = tuple(
            Junction(
                at.id,
                tuple(road for road in roads.values() if road.junction == at.id),
                np.array(at.outline, float).reshape(-1, 2),
                tuple(pair for pair in at.yields if pair[0] in lanes and pair[1] in lanes),
            )
            for at in self.map.junctions
        )
        return MapNetwork(
            self.terrain,
            tuple(roads.values()),
            tuple(line for line, _ in drawn),
            tuple(links),
            given_paths=tuple(_bounded(path, _beside_lanes(drawn)) for path in paths),
            junctions=tuple(at for at in junctions if at.roads),
            route=self._route(roads, lanes),
        )

    # -- roads

    def _near(self, at_m: float) -> list[SectionRoad]:
        """The roads within AROUND_M of a place along the route, and those of the route."""
        wanted = {name.rsplit(".", 2)[0] for name in self.map.route}
        by_id = {road.id: self._road(road) for road in self.map.roads if road.id in wanted}
        lanes = {lane.id: lane for road in by_id.values() for lane in road.lanes}
        host = self._route(by_id, lanes).xy_world(np.array([at_m]))[0]
        found = []
        for road in self.map.roads:
            if road.id in by_id:
                found.append(by_id[road.id])
            elif any(np.hypot(p.x_m - host[0], p.y_m - host[1]) - p.length_m < AROUND_M for p in road.plan):
                found.append(self._road(road))
        return found

    def _road(self, road: MapRoad) -> SectionRoad:
        line, offset = plan_line(road.plan), Profile(road.lane_offsets)
        starts = [section.s_m for section in road.sections] + [line.length_m]
        sections = tuple(
            CrossSection.of(section.lanes, span, offset)
            for section, span in zip(road.sections, pairwise(starts), strict=True)
        )
        lanes = [
            lane for i, section in enumerate(sections) if section.end_m > section.start_m
            for lane in _lanes(road, i, section)
        ]  # fmt: skip
        made = SectionRoad(
            road.id,
            line,
            self.terrain,
            Offset(0.0),
            Offset(0.0),
            0.0,
            tuple(lanes),
            start_m=0.0,
            end_m=line.length_m,
            sections=sections,
            chain=line,
            heights=Profile(road.heights) if road.heights else None,
            banks=Profile(road.banks) if road.banks else None,
            shapes=Shapes(road.shapes) if road.shapes else None,
            junction=road.junction,
        )
        left, right = (Offset(0.0, _paved(made, side)) for side in (0, 1))
        return replace(made, left=left, right=right)

    # -- lanes and paths

    def _route(self, roads: dict[str, SectionRoad], lanes: dict[str, NetworkLane]) -> LaneCurve:
        """The way of the host."""
        return self._path([lanes[name] for name in self.map.route], roads)

    def _path(self, lanes: list[NetworkLane], roads: dict[str, SectionRoad]) -> LaneCurve:
        """The centre line along lanes that follow each other, against the traffic where that is oncoming."""
        first = lanes[0]
        if first.direction == "oncoming":
            lanes = lanes[::-1]
        parts = [(roads[lane.road], lane.middle, *lane.driven) for lane in lanes]
        if first.direction == "oncoming":
            parts = [(road, middle, end_m, start_m) for road, middle, start_m, end_m in parts]
        pieces = measured(parts)
        return LaneCurve(
            first.id,
            "centerline",
            first.road,
            "none",
            None,
            None,
            pieces,
            0.0,
            pieces[-1].end_m,
            first.direction,
            lanes=tuple(lanes),
            connector=first.junction is not None,
            junction=first.junction,
        )

    def _directions(
        self, lanes: dict[str, NetworkLane], links: Sequence[tuple[str, str]], chains: Sequence[list[str]]
    ) -> dict[str, Direction]:
        """The direction of every lane: on the roads that the host drives along, and on what goes on from these, it is
        that of its traffic relative to the host. A connector has that of the lanes that it connects, if it is one."""
        on_route = {lanes[name].road: lanes[name].ascends for name in self.map.route}
        route = frozenset(self.map.route)
        found: dict[str, Direction] = {}
        connectors = []
        for chain in chains:
            own = {lanes[name].ascends == on_route[lanes[name].road] for name in chain if lanes[name].road in on_route}
            is_connector = lanes[chain[0]].junction is not None
            if is_connector:
                connectors.append(chain)
            along: Direction = "crossing" if is_connector or not own else "same" if True in own else "oncoming"
            found.update(dict.fromkeys(chain, "same" if route & set(chain) else along))
        for chain in connectors:
            ends = [found[a] for a, b in links if b == chain[0]] + [found[b] for a, b in links if a == chain[-1]]
            if not route & set(chain) and len(ends) > 1 and len(set(ends)) == 1:
                found.update(dict.fromkeys(chain, ends[0]))
        return found

    # -- painted lines

    def _edges(self, road: SectionRoad) -> Iterator[_Edge]:
        """The stretches of all edges of a road's lanes with one mark."""
        given = next(at for at in self.map.roads if at.id == road.id)
        driving = {lane.id for lane in road.lanes}
        for i, (section, own) in enumerate(zip(given.sections, road.sections, strict=True)):
            for lane in section.lanes:
                n = lane.number
                edge = own.n_left if n == 0 else own.lanes.index(lane) + (n < 0)
                beside = [f"{road.id}.{i}.{number}" for number in _beside(n)]
                left, right = (name if name in driving else None for name in beside)
                marks = [*sorted(lane.marks, key=lambda mark: mark.s_m)]
                ends = [min(own.start_m + mark.s_m, own.end_m) for mark in marks] + [own.end_m]
                for k, (mark, (start_m, end_m)) in enumerate(zip(marks, pairwise(ends), strict=True)):
                    if mark.kind != "none" and end_m - start_m > LEAST_LINE_M:
                        name = f"{road.id}.{i}.{n}.line{k or ''}"
                        line, look = own.edge_line(edge), _look(mark, n)
                        yield _Edge(name, road, line, start_m, end_m, *look, left, right)


def _paved(road: SectionRoad, side: int):  # type: ignore[no-untyped-def]
    return lambda s: road.paved(side, s)


def _beside(number: int) -> tuple[int, int]:
    """The numbers of the lanes left and right of the outer edge of a lane, as s grows."""
    if number == 0:
        return 1, -1
    return (number + 1, number) if number > 0 else (number, number - 1)


def _look(mark: MapMark, number: int) -> tuple[Marking, LinePaint]:
    """The marking and the paint of a mark as s grows: a pair from the left."""
    marking, is_double, pair = MARKINGS[mark.kind]
    if pair and number > 0:
        pair = OTHER_WAY[pair]
    return marking, LinePaint(mark.yellow, mark.width_m, is_double, pair, mark.kind == "dots")


def _lanes(road: MapRoad, number: int, section: CrossSection) -> Iterator[NetworkLane]:
    """The lanes of traffic of a section, from the left; numbers count from the left as their traffic drives."""
    s = np.linspace(section.start_m, section.end_m, 5)
    edges = section.edges(s)
    driving = [
        i for i, lane in enumerate(section.lanes)
        if lane.kind == "driving" and (edges[i + 1] - edges[i]).max() > LEAST_WIDTH_M
    ]  # fmt: skip
    up = {i: (section.lanes[i].number < 0) ^ road.keeps_left ^ section.lanes[i].against for i in driving}
    for i in driving:
        same = [k for k in driving if up[k] == up[i]]
        yield NetworkLane(
            f"{road.id}.{number}.{section.lanes[i].number}",
            road.id,
            f"{road.id}.{number}.{'up' if up[i] else 'down'}",
            1 + (same if up[i] else same[::-1]).index(i),
            section.middle_line(i),
            float((edges[i + 1] - edges[i]).mean()),
            section.start_m,
            section.end_m,
            ascends=up[i],
            junction=road.junction,
        )


def _chains(lanes: Sequence[NetworkLane], links: Sequence[tuple[str, str]]) -> Iterator[list[str]]:
    """The lanes of every path, as traffic drives: on through links where a lane has one successor which has one
    predecessor, up to a junction; through it every connector has a path of its own."""
    after: dict[str, list[str]] = {lane.id: [] for lane in lanes}
    before: dict[str, list[str]] = {lane.id: [] for lane in lanes}
    where = {lane.id: lane.junction for lane in lanes}
    for a, b in links:
        after[a].append(b)
        before[b].append(a)
    goes_on = {
        a: beyond[0]
        for a, beyond in after.items()
        if len(beyond) == 1 and len(before[beyond[0]]) == 1 and where[a] == where[beyond[0]] and beyond[0] != a
    }
    reached, seen = set(goes_on.values()), set[str]()
    for is_ring in (False, True):
        for lane in lanes:
            name: str | None = lane.id
            if lane.id in seen or (lane.id in reached and not is_ring):
                continue
            chain: list[str] = []
            while name is not None and name not in seen:
                chain.append(name)
                seen.add(name)
                name = goes_on.get(name)
            yield chain


def _lines(
    edges: Sequence[_Edge], lanes: dict[str, NetworkLane], path_of: dict[str, str]
) -> Iterator[tuple[LaneCurve, list[_Edge]]]:
    """Painted lines with their stretches: those of edges that end where another one with the same mark goes on."""
    follows = _follows(edges)
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
            parts.append((edges[at], onwards))
            if (at, onwards) not in follows:
                break
            at, onwards = follows[at, onwards]
        yield _line(parts, lanes, path_of), [edge for edge, _ in parts]


def _follows(edges: Sequence[_Edge]) -> dict[tuple[int, bool], tuple[int, bool]]:
    """By a stretch, and whether it is left at its end or at its beginning: the one that goes on there, and whether that
    is entered at its beginning."""
    if not edges:
        return {}
    points, out, keys = [], [], []
    for i, edge in enumerate(edges):
        step = min(0.05, (edge.end_m - edge.start_m) / 2)
        for at_end in (False, True):
            s = np.array([edge.end_m, edge.end_m - step] if at_end else [edge.start_m, edge.start_m + step])
            end, inner = edge.road.points(s, edge.line(s))
            points.append(end)
            out.append((end - inner) / np.linalg.norm(end - inner))
            keys.append((i, at_end))
    found: dict[int, list[int]] = {}
    for a, b in cKDTree(np.array(points)).query_pairs(JOINED_M):
        (i, i_end), (k, k_end) = keys[a], keys[b]
        is_alike = edges[i].look(i_end) == edges[k].look(not k_end)
        if i != k and is_alike and out[a] @ out[b] < -JOINED_COS:
            found.setdefault(a, []).append(b)
            found.setdefault(b, []).append(a)
    return {
        keys[a]: (keys[b[0]][0], not keys[b[0]][1]) for a, b in found.items() if len(b) == 1 and len(found[b[0]]) == 1
    }


def _line(parts: list[tuple[_Edge, bool]], lanes: dict[str, NetworkLane], path_of: dict[str, str]) -> LaneCurve:
    """One painted line of stretches, each as s grows or falls. It goes as the traffic beside it does, along oncoming
    lanes against it; of several, that of the host's lanes counts first, then that on its right."""
    sides = [(edge.left, edge.right) if up else (edge.right, edge.left) for edge, up in parts]
    # Lanes beside it, with whether their traffic goes as the parts do.
    beside = [
        (lanes[name], lanes[name].ascends == up)
        for (edge, up) in parts
        for name in (edge.right, edge.left)
        if name is not None
    ]
    order: tuple[Direction, ...] = ("same", "crossing", "oncoming")
    direction: Direction = "crossing"
    if beside:
        lane, goes_along = min(beside, key=lambda at: order.index(at[0].direction))
        direction = lane.direction
        if goes_along == (direction == "oncoming"):
            parts = [(edge, not up) for edge, up in reversed(parts)]
            sides = [(right, left) for left, right in reversed(sides)]
    edge, up = parts[0]
    marking, paint = edge.look(up)
    pieces = measured(
        (at.road, at.line, *((at.start_m, at.end_m) if goes_up else (at.end_m, at.start_m))) for at, goes_up in parts
    )
    lengths_m = [piece.end_m - piece.start_m for piece in pieces]

    def longest(side: int) -> str | None:
        """The path along the most of a side."""
        total: dict[str, float] = {}
        for names, length_m in zip(sides, lengths_m, strict=True):
            name = names[side]
            if name is not None:
                total[path_of[name]] = total.get(path_of[name], 0.0) + length_m
        return max(total, key=lambda name: total[name]) if total else None

    junctions = {at.road.junction for at, _ in parts}
    return LaneCurve(
        edge.name,
        "delimiter",
        edge.road.id,
        marking,
        longest(0),
        longest(1),
        pieces,
        0.0,
        pieces[-1].end_m,
        direction,
        connector=False,
        junction=junctions.pop() if len(junctions) == 1 else None,
        paint=paint,
    )


def _beside_lanes(drawn: Sequence[tuple[LaneCurve, list[_Edge]]]) -> dict[tuple[str, bool], dict[str, float]]:
    """The lines, and their lengths, by a lane and whether they are on its right as s grows."""
    found: dict[tuple[str, bool], dict[str, float]] = {}
    for line, edges in drawn:
        for edge in edges:
            for lane, on_right in ((edge.left, True), (edge.right, False)):
                if lane is not None:
                    lengths = found.setdefault((lane, on_right), {})
                    lengths[line.id] = lengths.get(line.id, 0.0) + edge.end_m - edge.start_m
    return found


def _bounded(path: LaneCurve, beside: dict[tuple[str, bool], dict[str, float]]) -> LaneCurve:
    """A path with the lines along the most of its sides."""
    found = []
    for is_right in (False, True):
        lengths: dict[str, float] = {}
        for lane, piece in zip(path.lanes, path.pieces, strict=True):
            for name, length_m in beside.get((lane.id, is_right == (piece.along > 0)), {}).items():
                lengths[name] = lengths.get(name, 0.0) + length_m
        found.append(max(lengths, key=lambda name: lengths[name]) if lengths else None)
    return replace(path, left=found[0], right=found[1])
