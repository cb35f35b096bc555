"""RoadMap: roads, junctions and the paint on them, as a scene of a town or of a given map keeps them.

World frame, metres and radians. Pure data in the terms of OpenDRIVE: a road is a plan of pieces, a place on it is
(s, t) with t to the left of growing s, lanes are numbered from the reference line outwards, positive on its left.
`roads/from_map.py` makes the network of it.
"""

import math
import operator
from functools import cached_property
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from synth3dlanes.system.schema import DocumentPart, Name, Number, SymbolKind, is_empty

# The most roads of the part of a map that a scene keeps, and lanes on one side of a road.
MAX_ROADS, MAX_LANES = 2000, 20
# Greatest gap between pieces of a plan, and between roads of linked lanes.
MAX_GAP_M = 50.0
# Where an edge of a lane steps farther aside, or up, it is another line.
JUMP_M = 0.03
Station = Annotated[float, Field(ge=-1e5, le=1e5)]
Length = Annotated[float, Field(gt=0, le=1e5)]
GroundPoint = tuple[Number, Number]
# A file's coordinate, in metres; it may be one of a UTM grid.
Coordinate = Annotated[float, Field(ge=-1e8, le=1e8)]
# A lane by ROAD.SECTION.NUMBER, such as `12.0.-1`.
LaneName = Name


def lane_key(name: LaneName) -> tuple[str, int, int]:
    """The road, the section and the number of a lane."""
    road, section, number = name.rsplit(".", 2)
    return road, int(section), int(number)


MapLaneKind = Literal[
    "driving", "shoulder", "border", "parking", "walkway", "cycle", "median", "restricted", "kerb", "none"
]
MapMarkKind = Literal["none", "solid", "dashed", "solid_solid", "solid_dashed", "dashed_solid", "dashed_dashed", "dots"]


class Polynomial(DocumentPart):
    """A value along a road: from station `s_m` on, a + b x + c x^2 + d x^3 of the distance x from it."""

    s_m: Station
    a: Number
    b: Number = 0.0
    c: Number = 0.0
    d: Number = 0.0


class PlanPiece(DocumentPart):
    """A piece of a road's reference line from above: its start, its heading there (counter-clockwise from world x) and
    its length. Its curvature (1/m, to the left) changes evenly from one end to the other; or, with `u` and `v`, it is
    two cubics in the frame of its start (u ahead, v to the left) of a parameter from 0 to `parameter_end`."""

    x_m: Number
    y_m: Number
    heading_rad: Number
    length_m: Length
    curvature: Number = 0.0
    curvature_end: Number = 0.0
    u: tuple[Number, Number, Number, Number] | None = None
    v: tuple[Number, Number, Number, Number] | None = None
    parameter_end: Length = 1.0


class MapMark(DocumentPart):
    """The paint on the outer edge of a lane (of lane 0: on the reference line), from a station of its section on. Of
    two stripes that differ the first is the inner one; of lane 0 the left one."""

    s_m: Station = 0.0
    kind: MapMarkKind
    yellow: bool = False
    width_m: Annotated[float, Field(gt=0, le=2)] = 0.12


class MapLane(DocumentPart):
    """A lane of a section: its number, and its width by stations of the section. Traffic in a driving lane goes with
    growing s on the right of the reference line where traffic keeps right; `against` says that it goes the other
    way. A `level` lane of a banked road has across the height of its inner edge."""

    number: Annotated[int, Field(ge=-MAX_LANES, le=MAX_LANES)]
    kind: MapLaneKind
    widths: tuple[Polynomial, ...] = ()
    marks: tuple[MapMark, ...] = ()
    against: bool = False
    level: Annotated[bool, Field(exclude_if=operator.not_)] = False

    def ascends(self, keeps_left: bool) -> bool:
        """Whether its traffic drives with growing s, where traffic keeps left or right."""
        return ((self.number < 0) != keeps_left) != self.against


class MapSection(DocumentPart):
    """The lanes of a road from a station on, from the left: positive numbers, 0 without a width, negative ones."""

    s_m: Station
    lanes: Annotated[tuple[MapLane, ...], Field(max_length=2 * MAX_LANES + 1)]


class MapShape(DocumentPart):
    """Height of a road's surface over its banked plane at a station: a cubic of the distance to the left of `t_m` on
    that plane, up to the next `t_m` of the station. Between stations it changes evenly."""

    s_m: Station
    t_m: Annotated[float, Field(ge=-1000, le=1000)]
    a: Number
    b: Number = 0.0
    c: Number = 0.0
    d: Number = 0.0


class MapSpan(DocumentPart):
    """A part of a road, from one of its stations to another."""

    from_m: Station
    to_m: Station


class MapRoad(DocumentPart):
    """A road. Without `heights` it lies on the terrain; with them its reference line has these world heights. `banks`
    are angles, positive where the right side is lower. On `bridges` it leaves the ground below it, in `tunnels` the
    ground goes on above it. `junction` is the junction that it connects roads in. Of a road of a given map this is the
    part from station `given_from_m` on, with the sections from number `given_section` on."""

    id: Name
    plan: Annotated[tuple[PlanPiece, ...], Field(min_length=1, max_length=10_000)]
    sections: Annotated[tuple[MapSection, ...], Field(min_length=1, max_length=1000)]
    lane_offsets: tuple[Polynomial, ...] = ()
    heights: tuple[Polynomial, ...] = ()
    banks: tuple[Polynomial, ...] = ()
    shapes: Annotated[tuple[MapShape, ...], Field(max_length=100_000, exclude_if=is_empty)] = ()
    bridges: Annotated[tuple[MapSpan, ...], Field(max_length=1000, exclude_if=is_empty)] = ()
    tunnels: Annotated[tuple[MapSpan, ...], Field(max_length=1000, exclude_if=is_empty)] = ()
    junction: Name | None = None
    keeps_left: bool = False
    given_from_m: Station = 0.0
    given_section: Annotated[int, Field(ge=0, le=1000)] = 0

    @property
    def length_m(self) -> float:
        """Length of the reference line."""
        return sum(piece.length_m for piece in self.plan)

    def span_m(self, section: int) -> tuple[float, float]:
        """The stations between which a section holds, by its number."""
        after = self.sections[section + 1 : section + 2]
        return self.sections[section].s_m, after[0].s_m if after else self.length_m

    @model_validator(mode="after")
    def _has_no_gaps(self) -> "MapRoad":
        """Check that each piece can reach the next one."""
        for one, other in pairwise(self.plan):
            gap_m = math.dist((one.x_m, one.y_m), (other.x_m, other.y_m)) - one.length_m
            if gap_m > MAX_GAP_M:
                raise ValueError(f"plan: expected pieces that follow each other, got a gap of {gap_m:.0f} m")
        return self


class MapJunction(DocumentPart):
    """A junction: the outline of its pavement from above (empty: the union of its roads), and pairs of its lanes; the
    first lane of a pair yields to the second."""

    id: Name
    outline: tuple[GroundPoint, ...] = ()
    yields: tuple[tuple[LaneName, LaneName], ...] = ()


class MapPaint(DocumentPart):
    """Paint that bounds no lane. An arrow is in the middle of `lane` at station `s_m` of its road, in the direction of
    its traffic; a stop or give-way line crosses the lane there. A crosswalk fills the four corners of `outline`: the
    first two are its near edge, across the road; its bars run along the road from that edge to the other."""

    kind: SymbolKind
    lane: LaneName | None = None
    s_m: Station = 0.0
    outline: tuple[GroundPoint, ...] = ()


class MapIsland(DocumentPart):
    """A raised area on the pavement with a kerb around it: a traffic island, or the middle of a roundabout."""

    outline: Annotated[tuple[GroundPoint, ...], Field(min_length=3, max_length=1000)]
    height_m: Annotated[float, Field(ge=0, le=1)] = 0.12
    surface: Literal["paved", "grass"] = "paved"


class RoadMap(DocumentPart):
    """The part of a map around a host. `links` are pairs of lanes (one, the next) as traffic drives. The host drives
    along `route`, lanes each linked to the next; its station is the length from the beginning of the first one.
    `source` and `digest` name the file of a given map and its SHA-256; `given_frame` is where the world's origin lies
    in it: x, y, z and the heading of world x."""

    roads: Annotated[tuple[MapRoad, ...], Field(min_length=1, max_length=MAX_ROADS)]
    links: tuple[tuple[LaneName, LaneName], ...] = ()
    junctions: tuple[MapJunction, ...] = ()
    paint: tuple[MapPaint, ...] = ()
    islands: tuple[MapIsland, ...] = ()
    route: Annotated[tuple[LaneName, ...], Field(min_length=1)]
    source: str = ""
    digest: str = ""
    given_frame: tuple[Coordinate, Coordinate, Number, Number] | None = None
    # As the paper's numbers have them: there is no one number of lanes, no exit, no works and no flips, and left and
    # right in the lane graph are those of each lane's own traffic.
    n_lanes: ClassVar[int] = 0
    n_oncoming: ClassVar[int] = 0
    junction_kind: ClassVar[str] = "none"
    exit_side: ClassVar[str] = "none"
    works: ClassVar[None] = None
    flip_lateral: ClassVar[bool] = False
    location: ClassVar[Literal["urban", "nonurban"]] = "urban"
    sides_are_hosts: ClassVar[bool] = False

    @property
    def words(self) -> str:
        """The roads in a few words."""
        return f"map {self.source}" if self.source else "town"

    @property
    def facts(self) -> dict[str, str]:
        """What a summary says of the roads."""
        return {"map": self.words, "roads, junctions": f"{len(self.roads)}, {len(self.junctions)}"}

    @cached_property
    def road_ids(self) -> frozenset[str]:
        """The ids of all roads."""
        return frozenset(road.id for road in self.roads)

    @cached_property
    def all_links(self) -> frozenset[tuple[str, str]]:
        """The links, to ask whether there is one."""
        return frozenset(self.links)

    @cached_property
    def lanes(self) -> dict[str, MapLane]:
        """All lanes by their names."""
        return {
            f"{road.id}.{i}.{lane.number}": lane
            for road in self.roads
            for i, section in enumerate(road.sections)
            for lane in section.lanes
        }

    @cached_property
    def driving_lanes(self) -> frozenset[str]:
        """The names of the lanes of traffic."""
        return frozenset(name for name, lane in self.lanes.items() if lane.kind == "driving" and lane.number)

    @model_validator(mode="after")
    def _names_its_lanes(self) -> "RoadMap":
        """Check that ids are unique and that all lanes that are named exist."""
        if len(self.road_ids) < len(self.roads):
            raise ValueError("roads: expected ids that differ")
        lanes = self.lanes
        named = [("route", name) for name in self.route]
        named += [("links", name) for link in self.links for name in link]
        named += [("paint", paint.lane) for paint in self.paint if paint.lane is not None]
        named += [("junctions.yields", name) for at in self.junctions for pair in at.yields for name in pair]
        for where, name in named:
            if name not in lanes:
                raise ValueError(f"{where}: expected lanes of the roads, got {name}")
        links = self.all_links
        for a, b in pairwise(self.route):
            if (a, b) not in links:
                raise ValueError(f"route: expected linked lanes, got {a} and {b}")
        for name in self.route:
            if name not in self.driving_lanes:
                raise ValueError(f"route: expected driving lanes, got {name}")
        places = {road.id: (road.plan[0].x_m, road.plan[0].y_m, road.length_m) for road in self.roads}
        for a, b in {(lane_key(a)[0], lane_key(b)[0]) for a, b in links}:
            (*at_a, length_a), (*at_b, length_b) = places[a], places[b]
            if math.dist(at_a, at_b) > length_a + length_b + MAX_GAP_M:
                raise ValueError(f"links: expected roads that touch, got {a} and {b}")
        known = {at.id for at in self.junctions}
        for road in self.roads:
            if road.junction is not None and road.junction not in known:
                raise ValueError(f"roads: expected a junction of the map, got {road.junction}")
        return self
