"""A scene's map -> Network: its roads near a place with their sections, lanes, paths and painted lines, and junctions.
The rules are in docs/network.md; World frame, metres."""

import math
from collections import Counter
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from synth3dlanes.labels.labels import Direction
from synth3dlanes.roads.cross_section import CrossSection, greatest_and_mean
from synth3dlanes.roads.lane_curves import Course, LaneCurve, TableLine, along, ways_through
from synth3dlanes.roads.line_forms import plan_line
from synth3dlanes.roads.line_table import LineTable
from synth3dlanes.roads.network import HostLine, Junction, LanePattern, Network
from synth3dlanes.roads.painted_edges import beside_lanes, bounded, edges_of, lines
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.road_table import RoadTable
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene.road_map import JUMP_M, MapRoad, RoadMap, lane_key
from synth3dlanes.scene.scene import Terrain

# Roads farther from the host than this are left out.
AROUND_M = 450.0
# A path goes on over gaps shorter than GAP_M; its direction is measured over TANGENT_M.
GAP_M, TANGENT_M = 1.0, 0.01
# Lanes whose width exceeds this nowhere do not count.
LEAST_WIDTH_M = 0.1


def map_network(roads: RoadMap, bare: Sequence[Road], terrain: Terrain, at_m: float) -> Network:
    """The roads of a map within AROUND_M of the place at a length along its route, and those of the route; `bare` are
    all its roads without lanes."""
    return _Reading(roads, bare, terrain).network(at_m)


class _Reading:
    """A map and what is made of it step by step."""

    def __init__(self, roads: RoadMap, bare: Sequence[Road], terrain: Terrain) -> None:
        self.map, self.bare, self.terrain, self.route = roads, bare, terrain, frozenset(roads.route)

    def network(self, at_m: float) -> Network:
        near = self._near(at_m)
        lanes = {lane.id: lane for road in near for lane in self._lanes(road)}
        links = [link for link in self.map.links if link[0] in lanes and link[1] in lanes]
        table = RoadTable([stretch for road in near for stretch in road.stretches], self.terrain)
        numbers = {key: i for i, key in enumerate((road.id, k) for road in near for k in range(len(road.sections)))}
        by_id = {road.id: road for road in near}
        middles = {lane.id: _middle(lane, by_id[lane.road], numbers) for lane in lanes.values()}
        meets = _meeting(table, middles, links)
        chains = list(_chains(lanes, links, meets))
        directions = self._directions(lanes, links, chains)
        lanes = {
            name: lane if lane.direction == directions[name] else replace(lane, direction=directions[name])
            for name, lane in lanes.items()
        }
        of_road: dict[str, list[NetworkLane]] = {road.id: [] for road in near}
        for lane in lanes.values():
            of_road[lane.road].append(lane)
        roads = {road.id: replace(road, terrain=self.terrain, lanes=tuple(of_road[road.id])) for road in near}
        courses = {
            lane.id: Course(roads[lane.road].stretch_of(lane), lane.middle, *knots, middle)
            for lane, middle, knots in zip(
                lanes.values(), middles.values(), table.knots([*middles.values()]), strict=True
            )
        }
        found = [
            along([lanes[name] for name in chain], courses, lanes[chain[0]].direction == "oncoming") for chain in chains
        ]
        path_of = {lane.id: path.id for path in found for lane in path.lanes}
        edges = [edge for road in roads.values() for edge in edges_of(self._given[road.id], road)]
        drawn = list(lines(edges, table, numbers, lanes, path_of))
        beside = beside_lanes(drawn)
        junctions = tuple(
            Junction(
                at.id,
                tuple(road for road in roads.values() if road.junction == at.id),
                np.array(at.outline, float).reshape(-1, 2),
            )
            for at in self.map.junctions
        )
        route = [lanes[name] for name in self.map.route]
        way = along(route, courses)
        paths, delimiters = tuple(bounded(path, beside) for path in found), tuple(line for line, _ in drawn)
        driven = {id(at): at for at in (roads[lane.road].stretch_of(lane) for lane in route if lane.junction is None)}
        return Network(
            self.terrain,
            roads=tuple(roads.values()),
            lanes=lanes,
            links=tuple(sorted(links)),
            paths=paths,
            delimiters=delimiters,
            way=way,
            lines=LineTable((*paths, *delimiters), table),
            host_lines=(HostLine(way),),
            is_terrain=False,
            # Lanes lie one beside the other across the texture of every road.
            across=LanePattern(route[0].width_m, 0, is_along=False),
            host_stretches=tuple((at, at.start_m, at.end_m) for at in driven.values()),
            junctions=tuple(at for at in junctions if at.roads),
            islands=self.map.islands,
            yields=tuple(pair for at in self.map.junctions for pair in at.yields),
            courses=courses,
        )

    # -- roads

    @cached_property
    def way(self) -> LaneCurve:
        """The centre line of the host's route."""
        wanted = {lane_key(name)[0] for name in self.map.route}
        by_id = {road.id: road for road in self.bare if road.id in wanted}
        lanes = {lane.id: lane for road in by_id.values() for lane in self._lanes(road)}
        route = [lanes[name] for name in self.map.route]
        courses = {lane.id: Course.of(by_id[lane.road].stretch_of(lane), lane.middle, *lane.driven) for lane in route}
        return along(route, courses)

    def _near(self, at_m: float) -> list[Road]:
        """The roads within AROUND_M of a place along the route, and those of the route."""
        wanted = {lane.road for lane in self.way.lanes}
        host = self.way.xy_world(np.array([at_m]))[0].tolist()

        def is_near(road: MapRoad) -> bool:
            return any(math.dist((p.x_m, p.y_m), host) - p.length_m < AROUND_M for p in road.plan)

        pairs = zip(self.map.roads, self.bare, strict=True)
        return [bare for road, bare in pairs if road.id in wanted or is_near(road)]

    # -- lanes

    def _lanes(self, road: Road) -> Iterator[NetworkLane]:
        """The lanes of traffic of a road."""
        for i, section in enumerate(road.sections):
            if section.end_m > section.start_m:
                yield from _lanes(self._given[road.id], i, section, self.route)

    @cached_property
    def _given(self) -> dict[str, MapRoad]:
        return {road.id: road for road in self.map.roads}

    def _directions(
        self, lanes: dict[str, NetworkLane], links: Sequence[tuple[str, str]], chains: Sequence[list[str]]
    ) -> dict[str, Direction]:
        """The direction of every lane: on the roads that the host drives along, and on what goes on from these, it is
        that of its traffic relative to the host. A connector has that of the lanes that it connects, if it is one."""
        on_route = {lanes[name].road: lanes[name].ascends for name in self.map.route}
        route = self.route
        found: dict[str, Direction] = {}
        connectors = []
        for chain in chains:
            own = {lanes[name].ascends == on_route[lanes[name].road] for name in chain if lanes[name].road in on_route}
            is_connector = lanes[chain[0]].junction is not None
            if is_connector:
                connectors.append(chain)
            along: Direction = "crossing" if is_connector or not own else "same" if True in own else "oncoming"
            found.update(dict.fromkeys(chain, "same" if route & set(chain) else along))
        before, after = dict[str, list[str]](), dict[str, list[str]]()
        for a, b in links:
            after.setdefault(a, []).append(b)
            before.setdefault(b, []).append(a)
        for chain in connectors:
            ends = [found[name] for name in (*before.get(chain[0], ()), *after.get(chain[-1], ()))]
            if not route & set(chain) and len(ends) > 1 and len(set(ends)) == 1:
                found.update(dict.fromkeys(chain, ends[0]))
        return found


def route_way(roads: RoadMap) -> LaneCurve:
    """The centre line of the host's route of a map, from above."""
    names, flat = {lane_key(name)[0] for name in roads.route}, Terrain(gaussians=())
    return _Reading(roads, [bare_road(road, flat) for road in roads.roads if road.id in names], flat).way


def bare_roads(roads: RoadMap, terrain: Terrain) -> list[Road]:
    """All roads of a map without their lanes of traffic."""
    return [bare_road(road, terrain) for road in roads.roads]


def bare_road(road: MapRoad, terrain: Terrain) -> Road:
    """A road of a map without its lanes of traffic."""
    line = plan_line(road.plan)
    return Road(
        road.id,
        line,
        terrain,
        Offset(0.0),
        Offset(0.0),
        0.0,
        (),
        start_m=0.0,
        end_m=line.length_m,
        sections=tuple(CrossSection.of(road, i) for i in range(len(road.sections))),
        bridges=road.bridges,
        tunnels=road.tunnels,
        junction=road.junction,
        given=road,
    ).with_edges()


def _lanes(road: MapRoad, number: int, section: CrossSection, route: frozenset[str]) -> Iterator[NetworkLane]:
    """The lanes of traffic of a section, from the left; numbers count from the left as their traffic drives. Those of
    the host's route may have any width."""
    length_m = section.end_m - section.start_m
    widths_m = {
        i: greatest_and_mean(section.widths[i], length_m) for i, at in enumerate(section.lanes) if at.kind == "driving"
    }
    driving = [
        i for i, (most_m, _) in widths_m.items()
        if most_m > LEAST_WIDTH_M or f"{road.id}.{number}.{section.lanes[i].number}" in route
    ]  # fmt: skip
    up = {i: section.lanes[i].ascends(road.keeps_left) for i in driving}
    for i in driving:
        same = [k for k in driving if up[k] == up[i]]
        yield NetworkLane(
            f"{road.id}.{number}.{section.lanes[i].number}",
            road.id,
            f"{road.id}.{number}.{'up' if up[i] else 'down'}",
            1 + (same if up[i] else same[::-1]).index(i),
            section.middle_line(i),
            widths_m[i][1],
            section.start_m,
            section.end_m,
            # As most are, until those of the host's way are known.
            direction="crossing",
            ascends=up[i],
            junction=road.junction,
            sides=(section.edge_line(i), section.edge_line(i + 1)),
        )


def _middle(lane: NetworkLane, road: Road, numbers: Mapping[tuple[str, int], int]) -> TableLine:
    """The middle of a lane, as its traffic drives."""
    _, section, number = lane_key(lane.id)
    edge = next(i for i, own in enumerate(road.sections[section].lanes) if own.number == number)
    return TableLine(numbers[road.id, section], (edge, edge + 1), *lane.driven)


def _meeting(
    table: RoadTable, middles: Mapping[str, TableLine], links: Sequence[tuple[str, str]]
) -> set[tuple[str, str]]:
    """The links in which the middle of a lane begins where that of the one before ends: neither aside nor in height,
    and about along."""
    if not links:
        return set()
    names, given = {name: i for i, name in enumerate(middles)}, list(middles.values())
    before, after = np.array([(names[a], names[b]) for a, b in links]).T
    first, last = (np.array([getattr(line, end) for line in given]) for end in ("first_m", "last_m"))
    onwards = np.where(last < first, -TANGENT_M, TANGENT_M)
    end, begin, next_to = (
        table.points(given, which, s[which]) for which, s in ((before, last), (after, first), (after, first + onwards))
    )
    gap_m, ahead = begin - end, next_to - begin
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1), TANGENT_M / 2)[:, None]
    along_m = (gap_m * ahead).sum(axis=1)
    aside_m = np.linalg.norm(gap_m - along_m[:, None] * ahead, axis=1)
    meet = (np.abs(along_m) < GAP_M) & (aside_m < JUMP_M)
    return {link for link, is_one in zip(links, meet.tolist(), strict=True) if is_one}


def _chains(
    lanes: Mapping[str, NetworkLane], links: Sequence[tuple[str, str]], meets: Container[tuple[str, str]]
) -> Iterator[list[str]]:
    """The lanes of every path, as traffic drives: on through links where a lane has one successor which has one
    predecessor and which it meets, up to a junction; through it every connector has a path of its own."""
    n_after, n_before = (Counter(link[end] for link in links) for end in (0, 1))
    single = ((a, b) for a, b in links if n_after[a] == 1 and n_before[b] == 1 and a != b)
    goes_on = (link for link in single if link in meets and len({lanes[name].junction for name in link}) == 1)
    for way in ways_through([*lanes.values()], goes_on):
        yield [lane.id for lane in way]
