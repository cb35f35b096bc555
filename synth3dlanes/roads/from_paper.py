"""The paper's numbers -> Network: a main road, perhaps with oncoming lanes, and perhaps an exit that leaves it.

Stations and offsets are those of the plan, see line_forms.py.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np

from synth3dlanes.labels.labels import Direction, Marking
from synth3dlanes.roads.lane_curves import LaneCurve, Neighbour, Piece, joined, neighbours, ways_through
from synth3dlanes.roads.line_forms import S_END_M, Displaced, Flips, Opening, Quartic
from synth3dlanes.roads.line_table import RoadLines
from synth3dlanes.roads.maps.cubics import Profile
from synth3dlanes.roads.network import HostLine, LanePattern, Network
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Parting, Ramp, Road
from synth3dlanes.roads.works import WorksLanes
from synth3dlanes.scene.road_map import Polynomial
from synth3dlanes.scene.scene import PaperRoad, Terrain
from synth3dlanes.system.arrays import AnyScalars

# The lanes beside a painted line as t grows; its parts: the road, the offset there, and the station where it begins.
LanesBeside = tuple[str | None, str | None]
Parts = list[tuple[Road, Offset, float]]

# Least length of an exit per station, as a share of the main road's: from where a bend would compress it further, it
# goes on straight, because the displaced curve would fold back on itself.
MIN_STRETCH = 0.3
# Lower limit of the ramp's length; avoids a division by zero.
MIN_RAMP_LENGTH_M = 0.1
# Length behind the split over which the pavement of a lane that leaves narrows to nothing (topology 4).
TAPER_M = 20.0
# min(q, width) has a corner at the nose. It is rounded where q is within CORNER_M of the width, so that the lane is
# smooth; this moves the lane by at most 1.5 cm.
CORNER_M = 0.06
# The host drives between these stations, and a little beyond.
HOST_ROAD_M = 115.0


class LaneSection(NamedTuple):
    """A section of the host's lanes of the main road, between two stations."""

    name: str
    start_m: float
    end_m: float


def smooth_min(q: AnyScalars, width_m: float) -> AnyScalars:
    """min(q, width) with its corner rounded; equal to min(q, width) outside CORNER_M of it."""
    h = np.clip(CORNER_M - np.abs(q - width_m), 0, None)
    return np.minimum(q, width_m) - h * h / (4 * CORNER_M)


def paper_network(road: PaperRoad, terrain: Terrain) -> Network:
    """The roads of the paper's numbers over a terrain; drawing and resolving a scene ask for the same."""
    return _Plan(road, terrain).network


def is_wide_enough(road: PaperRoad) -> bool:
    """Whether the bends of a road leave room for its oncoming lanes: on the inside of a sharp one they would fold."""
    plan = _Plan(road, Terrain(gaussians=()))
    _, _, speed, turn = plan.line.frames(np.linspace(-S_END_M, S_END_M, 401))
    return bool((speed - turn * (plan.left_m - plan.shoulder_m) >= MIN_STRETCH * speed).all())


@dataclass(frozen=True, eq=False)
class _Plan:
    """The paper's numbers, and what is made of them step by step. Lanes 1..n and lines 0..n count from the plan's
    left."""

    road: PaperRoad
    terrain: Terrain

    @cached_property
    def flips(self) -> Flips:
        return Flips(-1.0 if self.road.flip_longitudinal else 1.0, -1.0 if self.road.flip_lateral else 1.0)

    @cached_property
    def line(self) -> Quartic:
        return Quartic(self.road, self.flips)

    @property
    def shoulder_m(self) -> float:
        return self.road.shoulder_factor * self.road.lane_width_m

    def middle_m(self, lane: int) -> float:
        """Offset of the middle of lane 1..n of the main road before the split."""
        return self.road.boundary_m(lane) - self.road.lane_width_m / 2

    @property
    def left_m(self) -> float:
        """Offset of the leftmost lane boundary."""
        road = self.road
        if not road.n_oncoming:
            return self.road.boundary_m(0)
        return self.road.boundary_m(0) - road.median_m - road.n_oncoming * road.lane_width_m

    @property
    def exit_half_m(self) -> float:
        """Half the width of the exit's lanes."""
        return self.road.n_exit_lanes * self.road.lane_width_m / 2

    @property
    def exit_base_m(self) -> float:
        """Main-road offset of the exit's line at the split: the middle of the exit's lanes there."""
        return self.road.boundary_m(self.road.n_lanes) - self.exit_half_m

    @cached_property
    def opening(self) -> Opening:
        opening = Opening(float(np.tan(self.road.exit_angle_rad)), self.road.exit_offset_m)
        s = np.linspace(0, S_END_M, 401)
        _, _, speed, turn = self.line.frames(s)
        displaced = self.exit_base_m + opening.polynomial(s)[0]
        folded = np.flatnonzero(speed - turn * displaced < MIN_STRETCH * speed)
        return replace(opening, end_m=float(s[folded[0]])) if folded.size else opening

    @cached_property
    def nose_m(self) -> float:
        """Station of the nose, where the opening is one lane wide."""
        return self.opening.station(self.road.lane_width_m)

    @cached_property
    def works(self) -> WorksLanes | None:
        """The lanes along road works, if there are any."""
        return None if self.road.works is None else WorksLanes(self.road, self.road.works)

    @cached_property
    def sections(self) -> tuple[LaneSection, ...]:
        """The sections of the main road of a road without exit: one or, with road works, three."""
        if self.works is None:
            return (LaneSection("main", -np.inf, np.inf),)
        low_m, high_m = self.works.span_m
        first, last = ("main", "after")[:: int(self.flips.y)]
        return (
            LaneSection(first, -np.inf, low_m),
            LaneSection("works", low_m, high_m),
            LaneSection(last, high_m, np.inf),
        )

    # -- ids: numbers count from the host's left

    def _seen(self, number: int, last: int) -> int:
        return last - number if self.flips.x < 0 else number

    def lane_id(self, section: str, lane: int) -> str:
        """The id of lane 1..n of a section."""
        return f"{section}_{self._seen(lane, self._count(section) + 1)}"

    def line_id(self, section: str, j: int) -> str:
        """The id of the painted line j = 0..n of a section's lanes."""
        return f"{section}_line_{self._seen(j, self._count(section))}"

    def _count(self, section: str) -> int:
        road = self.road
        counts = {"stem": road.n_lanes, "after": road.n_lanes, "main": road.n_main_after, "exit": road.n_exit_lanes}
        if self.works is not None:
            counts["works"] = self.works.n
        return counts.get(section, road.n_oncoming)

    # -- lanes and links

    def section(
        self,
        name: str,
        road: str,
        middles: list[Offset],
        span_m: tuple[float, float],
        direction: Direction = "same",
        works: WorksLanes | None = None,
    ) -> list[NetworkLane]:
        """The lanes of a section, from the host's left; those along road works have their widths and sides."""
        lanes = [
            NetworkLane(
                self.lane_id(name, k),
                road,
                name,
                self._seen(k, len(middles) + 1),
                at,
                works.width_m if works else self.road.lane_width_m,
                *span_m,
                direction,
                ascends=(direction == "same") == (self.flips.y > 0),
                sides=(works.boundary(k - 1), works.boundary(k)) if works else None,
            )
            for k, at in enumerate(middles, 1)
        ]
        return sorted(lanes, key=lambda lane: lane.number)

    @cached_property
    def main_lanes(self) -> list[NetworkLane]:
        """The lanes of the main road: of its stem before the split, beyond it, and oncoming ones."""
        road, whole = self.road, (-np.inf, np.inf)
        middles = [Offset(self.middle_m(lane)) for lane in range(1, road.n_lanes + 1)]
        after = middles[: road.n_main_after]
        if road.topology == 3:
            after[-1] = Offset(self.middle_m(road.n_lanes - 1), self._opens)
        oncoming = [Offset(self.left_m + (lane - 0.5) * road.lane_width_m) for lane in range(1, road.n_oncoming + 1)]
        if road.topology > 1:
            lanes = self.section("stem", "main", middles, (-np.inf, 0.0))
            lanes += self.section("main", "main", after, (0.0, np.inf))
        else:
            lanes = []
            for at in self.sections:
                works = self.works if at.name == "works" else None
                own = [works.middle(k) for k in range(1, works.n + 1)] if works else middles
                lanes += self.section(at.name, "main", own, (at.start_m, at.end_m), works=works)
        return lanes + self.section("oncoming", "main", oncoming, whole, "oncoming")

    def _opens(self, s: AnyScalars) -> AnyScalars:
        """How far a lane that opens beside its neighbour has come."""
        return smooth_min(self.opening(np.maximum(s, 0)), self.road.lane_width_m)

    @cached_property
    def exit_lanes(self) -> list[NetworkLane]:
        road, first = self.road, self.road.n_lanes - self.road.n_exit_lanes
        middles = [Offset(self.middle_m(first + lane) - self.exit_base_m) for lane in range(1, road.n_exit_lanes + 1)]
        return self.section("exit", "exit", middles, (0.0, np.inf))

    @property
    def links(self) -> tuple[tuple[str, str], ...]:
        """(lane, lane) of every way, as traffic drives; from the plan's left."""
        road, n = self.road, self.road.n_lanes
        if road.topology == 1:
            return tuple(self._links_of_works())
        pairs = [(lane, "main", lane) for lane in range(1, road.n_main_after + 1)]
        if road.topology == 3:
            pairs[-1] = (n - 1, "main", n)
        pairs += [(n - road.n_exit_lanes + lane, "exit", lane) for lane in range(1, road.n_exit_lanes + 1)]
        named = [(self.lane_id("stem", stem), self.lane_id(section, lane)) for stem, section, lane in pairs]
        return tuple(named if self.flips.y > 0 else [(fork, stem) for stem, fork in named])

    def _links_of_works(self) -> Iterator[tuple[str, str]]:
        works = self.works
        if works is None:
            return
        names = [at.name for at in self.sections][:: int(self.flips.y)]
        for k in range(1, works.n + 1):
            lanes = [self.lane_id(name, k if name == "works" else k + works.before_first) for name in names]
            yield from pairwise(lanes)

    # -- roads

    @cached_property
    def main_road(self) -> Road:
        road = self.road
        edge_m, lost_m = (
            road.n_lanes * road.lane_width_m / 2 + self.shoulder_m,
            (road.n_lanes - road.n_main_after) * road.lane_width_m,
        )
        taper_m = min(TAPER_M, self.nose_m)
        cubics = ((-S_END_M, 0.0, 0.0), (0.0, 0.0, -lost_m / taper_m), (taper_m, -lost_m, 0.0))
        tapers = Profile(tuple(Polynomial(s_m=s, a=a, b=b) for s, a, b in cubics))
        right = Offset(edge_m, tapers if lost_m else None)
        left = Offset(self.left_m - self.shoulder_m)
        return Road("main", self.line, self.terrain, left, right, self.shoulder_m, tuple(self.main_lanes))

    @cached_property
    def exit_road(self) -> Road:
        road, width_m = self.road, self.road.lane_width_m
        edge_m, start_m = self.exit_half_m + self.shoulder_m, self.opening.station(width_m + 2 * self.shoulder_m)
        length_m = max(road.ramp_height_m * road.ramp_slope, MIN_RAMP_LENGTH_M)
        return Road(
            "exit",
            Displaced(self.line, self.exit_base_m, self.opening),
            self.terrain,
            Offset(-edge_m),
            Offset(edge_m),
            self.shoulder_m,
            tuple(self.exit_lanes),
            start_m=0.0,
            ramp=Ramp(start_m, length_m, road.ramp_height_m) if start_m <= S_END_M else None,
            parting=Parting(
                self.main_road,
                lambda s: self.opening(s) - width_m,
                lambda gap_m: self.opening.station(gap_m + width_m),
                road.ramp_height_m,
            ),
        )

    @property
    def network(self) -> Network:
        main, sections = self.main_road, self.main_lanes
        roads = (main,) if self.road.topology == 1 else (main, self.exit_road)
        if len(roads) > 1:
            sections = sections + self.exit_lanes
        # The host's, then oncoming ones; those of a section from the host's left.
        lanes = sorted(sections, key=lambda lane: lane.direction == "oncoming")
        lines = self._delimiters() + self._oncoming_delimiters()
        facing = (
            {*(self.line_id(at.name, 0) for at in self.sections), self.line_id("oncoming", self.road.n_oncoming)}
            if self.road.n_oncoming
            else set()
        )
        facing = facing or {line.id for line in lines if all(at.is_right for at in line.neighbours)}
        paths = paths_through(roads, lanes, self.links, lines, to_right=self.flips.x > 0)
        path_of = {lane.id: path.id for path in paths for lane in path.lanes}
        delimiters = tuple(
            replace(
                line,
                is_inner=line.id in facing,
                neighbours=tuple(at._replace(id=path_of[at.id]) for at in line.neighbours),
            )
            for line in lines
        )
        # Where ways part, a lane is that of the first one.
        path_along = {lane.id: path for path in reversed(paths) for lane in path.lanes}
        hosts = [lane for lane in main.lanes if lane.direction == "same"]
        whole = (Piece(main, Offset(0.0), -np.inf, np.inf),)
        return Network(
            self.terrain,
            roads,
            {lane.id: lane for lane in lanes},
            self.links,
            paths,
            delimiters,
            LaneCurve("main", "centerline", "main", "none", (), whole, ascends=self.flips.y > 0),
            RoadLines((*paths, *delimiters), {road.id: road for road in roads}, self.flips.y),
            across=self.texture,
            host_lines=tuple(HostLine(path_along[lane.id], lane.start_m, lane.end_m) for lane in hosts),
            host_stretches=((main, -HOST_ROAD_M, HOST_ROAD_M),),
            removed=self._removed,
            closed=np.zeros((0, 4, 2)) if self.works is None else self.works.closed(main),
        )

    @property
    def texture(self) -> LanePattern:
        """The lanes of the main road across its texture."""
        own, medians = self.main_road.carriageways[-1], self.main_road.medians
        median_m = sum(right_m - left_m for left_m, right_m in medians)
        return LanePattern(self.road.lane_width_m, own.n_lanes % 2, own.left_m - median_m / 2, median_m)

    # -- painted lines

    def _line(
        self, section: str, j: int, marking: Marking, parts: Parts, start_m: float = -np.inf, end_m: float = np.inf
    ) -> LaneCurve:
        """Painted line j of a section; parts are a road, an offset and where it begins."""
        road = "exit" if section == "exit" else "main"
        direction: Direction = "oncoming" if section == "oncoming" else "same"
        sides, pieces = self._seen_sides(self._beside(section, j)), joined(parts)
        return LaneCurve(self.line_id(section, j), "delimiter", road, marking, sides, pieces, start_m, end_m, direction)

    def _beside(self, section: str, j: int) -> LanesBeside:
        """The lanes beside line j of a section as t grows, that between both directions included."""
        left, right = (self.lane_id(section, lane) if 0 < lane <= self._count(section) else None for lane in (j, j + 1))
        if j == 0 and section in {at.name for at in self.sections} and self.road.is_divided_by_line:
            left = self.lane_id("oncoming", self.road.n_oncoming)
        return left, right

    def _seen_sides(self, beside: LanesBeside) -> tuple[Neighbour, ...]:
        """Lanes on both sides, as the host sees them."""
        return neighbours(*beside[:: int(self.flips.x)])

    def _on_main(self, t_m: float) -> Parts:
        return [(self.main_road, Offset(t_m), -np.inf)]

    def _through(self, j: int, section: str = "main") -> LaneCurve:
        """Line j of the main road that runs along all of it."""
        road, marking = self.road, self._marking(j, self.road.n_lanes)
        if j == 0 and road.is_divided_by_line:
            marking = "dashed" if road.divider_dashed else "solid"
        return self._line(section, j, marking, self._on_main(self.road.boundary_m(j)))

    @staticmethod
    def _marking(j: int, n: int) -> Marking:
        return "dashed" if 0 < j < n else "solid"

    def _along(self, j: int) -> list[LaneCurve]:
        """Line j of a road without exit: where road works move or remove it, the lines before, along and behind
        them."""
        works, whole = self.works, self._through(j)
        if works is None:
            return [whole]
        if not works.is_moved(j):
            beside = [
                at._replace(start_m=section.start_m, end_m=section.end_m)
                for section in self.sections
                for at in self._seen_sides(
                    self._beside(section.name, j - works.before_first if section.name == "works" else j)
                )
            ]
            return [replace(whole, neighbours=tuple(beside))]
        lines = [
            replace(self._through(j, section.name), start_m=section.start_m, end_m=section.end_m)
            for section in self.sections
            if section.name != "works"
        ]
        if (found := works.line_of(j)) is not None:
            i, offset = found
            parts = [(self.main_road, offset, -np.inf)]
            temporary = self._line("works", i, self._marking(i, works.n), parts, *works.span_m)
            lines.insert(1, replace(temporary, paint=works.paint))
        return lines

    @property
    def _removed(self) -> tuple[LaneCurve, ...]:
        """The lines of the road along works that move or end there."""
        if self.works is None:
            return ()
        low_m, high_m = self.works.span_m
        gone = (j for j in range(self.road.n_lanes + 1) if self.works.is_moved(j))
        return tuple(replace(self._through(j), start_m=low_m, end_m=high_m) for j in gone)

    def _delimiters(self) -> list[LaneCurve]:
        n, n_after, topology = self.road.n_lanes, self.road.n_main_after, self.road.topology
        if topology == 1:
            return [line for j in range(n + 1) for line in self._along(j)]
        main, half_m, nose_m = self.main_road, self.exit_half_m, self.nose_m

        def beyond(road: Road, t_m: float) -> Parts:
            return [(road, Offset(t_m), nose_m)]

        def leaving(stem_m: float, t_m: float) -> Parts:
            return [(main, Offset(stem_m), -np.inf), (self.exit_road, Offset(t_m), 0.0)]

        lines = [self._through(j) for j in range(n if topology == 2 else n - 1)]
        if topology == 3:
            # The dashed line between the last two lanes continues along the exit's left side to the nose.
            parted = self._seen_sides((self.lane_id("main", n), self.lane_id("exit", 1)))
            stem = self._line("main", n - 1, "dashed", leaving(self.road.boundary_m(n - 1), -half_m), -np.inf, nose_m)
            lines += [
                replace(stem, id="stem_line", neighbours=parted),
                self._line("main", n - 1, "dashed", beyond(main, self.road.boundary_m(n - 1)), nose_m),
            ]
        lines += [
            self._line("main", n_after, "solid", beyond(main, self.road.boundary_m(n_after)), nose_m),
            self._line("exit", 0, "solid", beyond(self.exit_road, -half_m), nose_m),
        ]
        if topology == 4:
            lines.append(self._line("exit", 1, "dashed", leaving(self.road.boundary_m(n - 1), 0.0)))
        return [*lines, self._line("exit", self.road.n_exit_lanes, "solid", leaving(self.road.boundary_m(n), half_m))]

    def _oncoming_delimiters(self) -> list[LaneCurve]:
        """The lines of the oncoming lanes; without a median the innermost is the main road's own."""
        n = self.road.n_oncoming
        return [
            self._line("oncoming", j, self._marking(j, n), self._on_main(self.left_m + j * self.road.lane_width_m))
            for j in range(n if self.road.is_divided_by_line or n == 0 else n + 1)
        ]


def paths_through(
    roads: Sequence[Road],
    lanes: Sequence[NetworkLane],
    links: Sequence[tuple[str, str]],
    delimiters: Sequence[LaneCurve],
    to_right: bool,
) -> tuple[LaneCurve, ...]:
    """The centre line of every way through the links, as t grows, which is to the right as the host drives or to its
    left. It has the id of its last lane where roads split, of its first where they merge. `lanes` are section by
    section from the host's left."""
    sections = [list(group) for _, group in groupby(lanes, key=lambda lane: lane.section)]
    ways = list(ways_through([lane for section in sections for lane in section[:: 1 if to_right else -1]], links))
    at = -1 if len({way[-1].id for way in ways}) >= len({way[0].id for way in ways}) else 0
    by_id = {road.id: road for road in roads}
    found = []
    for way in ways:
        named, along = way[at], sorted(way, key=lambda lane: lane.start_m)
        found.append(
            LaneCurve(
                named.id,
                "centerline",
                named.road,
                "none",
                tuple(at for is_right in (False, True) for at in _lines_beside(along, delimiters, is_right)),
                joined((by_id[lane.road], lane.middle, lane.start_m) for lane in along),
                along[0].start_m,
                along[-1].end_m,
                direction=named.direction,
                lanes=tuple(along),
                lane_starts_m=tuple(lane.start_m for lane in along),
                ascends=named.ascends,
            )
        )
    return tuple(found)


def _lines_beside(along: Sequence[NetworkLane], delimiters: Sequence[LaneCurve], is_right: bool) -> Iterator[Neighbour]:
    """The lines on a side of a path: of each of its lanes the one that runs to its end. The first and the last one have
    no outer ends."""
    found = list[Neighbour]()
    for lane in along:
        own = (lane.id, not is_right)
        reaching = (line for line in delimiters if line.end_m >= lane.end_m)
        line = next((line for line in reaching if own in {(at.id, at.is_right) for at in line.neighbours}), None)
        if line is not None:
            found.append(Neighbour(line.id, is_right, lane.start_m, lane.end_m))
    ends = [-np.inf, *(at.start_m for at in found[1:]), np.inf]
    yield from (at._replace(start_m=low, end_m=high) for at, (low, high) in zip(found, pairwise(ends), strict=False))
