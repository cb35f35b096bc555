"""Where the host is on a given map: drawn along its driving lanes by length, or given as ROAD:s:lane; its route; and
the part of the map around it, as a scene keeps it: roads near the route, in the scene's world frame."""

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.cubics import SAME_M, part, rounded, value
from synth3dlanes.roads.maps.elements import LEAST_RAIL_M, GivenBody, GivenElement, GivenRail
from synth3dlanes.roads.maps.furniture import section_index
from synth3dlanes.roads.maps.given_map import GivenMap, LanePlace
from synth3dlanes.roads.maps.lanes import lane_between
from synth3dlanes.scene.road_map import (
    MAX_ROADS,
    GroundPoint,
    LaneName,
    MapPaint,
    MapRoad,
    MapSection,
    MapShape,
    MapSpan,
    PlanPiece,
    RoadMap,
    lane_key,
)
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import shown, unknown_key, validation_problems

# Length of the route ahead of the host and behind it, where the map reaches that far.
AHEAD_M, BEHIND_M = 450.0, 150.0
# Places are drawn where at least this length of the way is left, if there are any, in lanes of at least this width.
ONWARD_M, WIDE_M = 250.0, 2.0
TRIES, MAX_ROUTE = 200, 1000
# The least length of the way ahead of a host.
LEAST_AHEAD_M = 10.0
MM_DECIMALS = 3
# Roads that come within KEPT_M of the host are kept; those longer than LONG_M are cut to the pieces that do.
KEPT_M, LONG_M = 500.0, 1000.0
LENGTH_DECIMALS, ANGLE_DECIMALS = 6, 9


class MapStation(NamedTuple):
    """A lane, and a station of its road."""

    lane: LaneName
    s_m: float


def draw_place(given: GivenMap, rng: np.random.Generator) -> MapStation:
    """A place in a driving lane, each metre of which is as likely as any other. Raises InputError for a map without
    driving lanes."""
    names = list(given.lanes)
    if not names:
        raise InputError(f"map {given.source}: expected driving lanes, got none")
    ends = given.lane_ends_m
    best, most_m = MapStation(names[0], given.lanes[names[0]].span_m[0]), -1.0
    for _ in range(TRIES):
        at = float(rng.random() * ends[-1])
        i = min(int(np.searchsorted(ends, at, side="right")), len(names) - 1)
        place = given.lanes[names[i]]
        low, high = place.span_m
        s_m = min(round(high - (float(ends[i]) - at), MM_DECIMALS), high)
        left_m = onward_m(given, MapStation(names[i], s_m)) if width_m(place, s_m) >= WIDE_M else 0.0
        if left_m > most_m:
            best, most_m = MapStation(names[i], max(s_m, low)), left_m
        if most_m >= ONWARD_M:
            break
    return best


def width_m(place: LanePlace, s_m: float) -> float:
    """The width of a lane at a station of its road."""
    return value(place.lane.widths, s_m - place.span_m[0])


def onward_m(given: GivenMap, at: MapStation) -> float:
    """Length of the way ahead of a place, up to where ways are followed."""
    place = given.lanes[at.lane]
    low, high = place.span_m
    beyond = max((given.reach_m[after] for after in given.following.get(at.lane, ())), default=0.0)
    return (high - at.s_m if place.ascends else at.s_m - low) + beyond


def read_place(given: GivenMap, text: str) -> MapStation:
    """The place that ROAD:s:lane says. Raises InputError for one that is not there."""
    parts = text.rsplit(":", 2)
    try:
        road_id, s_m, number = parts[0], float(parts[1]), int(parts[2])
    except (IndexError, ValueError):
        raise InputError(f"at: expected ROAD:s:lane, as 12:30.5:-1, got {shown(text)}") from None
    name = given.names.get(road_id, road_id)
    if name not in given.roads:
        known = unknown_key(road_id, given.names).replace("unknown key", "")
        raise InputError(f"at: expected a road of {given.source}, got {shown(road_id)}{known}")
    road = given.roads[name]
    if not 0 <= s_m <= road.length_m:
        raise InputError(f"at: expected a station of road {road_id} from 0 to {road.length_m:.2f}, got {s_m:g}")
    lane = f"{name}.{section_index(road, s_m)}.{number}"
    if lane not in given.lanes:
        there = [
            str(place.lane.number)
            for key, place in given.lanes.items()
            if key.rpartition(".")[0] == lane.rpartition(".")[0]
        ]
        raise InputError(
            f"at: expected a driving lane of road {road_id} there ({', '.join(there) or 'none'}), got {number}"
        )
    return MapStation(lane, s_m)


def draw_route(given: GivenMap, at: MapStation, rng: np.random.Generator) -> tuple[tuple[LaneName, ...], int]:
    """The lanes that the host drives along, some of them behind it, and the number of its own among them. Where ways
    part, each that goes on far enough is as likely. Raises InputError where the way ends at once."""
    place = given.lanes[at.lane]
    low, high = place.span_m
    driven_m = at.s_m - low if place.ascends else high - at.s_m
    route, before_m = deque([at.lane]), driven_m
    while before_m < BEHIND_M and len(route) < MAX_ROUTE:
        ways = [name for name in given.preceding.get(route[0], ()) if given.lanes[name].length_m > 0]
        if not ways:
            break
        route.appendleft(ways[int(rng.random() * len(ways))])
        before_m += given.lanes[route[0]].length_m
    number, ahead_m = len(route) - 1, place.length_m - driven_m
    while ahead_m < AHEAD_M and len(route) < 2 * MAX_ROUTE:
        ways = given.following.get(route[-1], [])
        wanted_m = min(AHEAD_M - ahead_m, max((given.reach_m[name] for name in ways), default=0.0))
        ways = [name for name in ways if given.reach_m[name] >= wanted_m]
        if not ways:
            break
        route.append(ways[int(rng.random() * len(ways))])
        ahead_m += given.lanes[route[-1]].length_m
    rounds = route.count(route[-1])
    if ahead_m < LEAST_AHEAD_M * rounds or len(route) >= 2 * MAX_ROUTE:
        raise InputError(
            f"map {given.source}: expected a way of {LEAST_AHEAD_M:g} m and more ahead of the host, got"
            f" {ahead_m:.3g} m in {len(route) - number} lanes at {at.lane}, s = {at.s_m:g}"
        )
    return tuple(route), number


@dataclass(frozen=True)
class _Cut:
    """What is kept of a road: stations of the file, and how many sections there are before it."""

    from_m: float
    to_m: float
    sections_before: int
    n_sections: int


class MapPart(NamedTuple):
    """A part of a map, and where the host is on it: the number of its lane on the route, and a station of its road; and
    what stands there."""

    map: RoadMap
    lane: int
    s_m: float
    elements: tuple[GivenElement, ...] = ()
    bodies: tuple[GivenBody, ...] = ()
    rails: tuple[GivenRail, ...] = ()


def part_around(given: GivenMap, at: MapStation, rng: np.random.Generator) -> MapPart:
    """The map around a place. The world's origin is at the host's place on its reference line, and world y is the
    direction of its lane there. Raises InputError for a place or numbers that no scene can have."""
    try:
        return _part_around(given, at, rng)
    except ValidationError as error:
        raise InputError(validation_problems(error, f"map {given.source}")[0]) from None


def _part_around(given: GivenMap, at: MapStation, rng: np.random.Generator) -> MapPart:
    route, number = draw_route(given, at, rng)
    lane = given.lanes[at.lane]
    x, y, heading = plan_points(lane.road.plan, np.array([at.s_m]))[0].tolist()
    z = round(value(lane.road.heights, at.s_m), 3)
    frame = _Frame(round(x, 3), round(y, 3), z, heading if lane.ascends else heading + math.pi)
    cuts = {road.id: _cut(given, road, (x, y)) for road in given.roads_near((x, y), KEPT_M)}
    if len(cuts) > MAX_ROADS:
        raise InputError(f"map {given.source}: expected at most {MAX_ROADS} roads within {KEPT_M:g} m, got {len(cuts)}")
    names = {
        f"{name}.{cut.sections_before + i}.{lane_at.number}": f"{name}.{i}.{lane_at.number}"
        for name, cut in cuts.items()
        for i, section in enumerate(given.roads[name].sections[cut.sections_before :][: cut.n_sections])
        for lane_at in section.lanes
    }
    roads = tuple(frame.road(_plain(given, name, cut)) for name, cut in cuts.items())
    junctions = {road.junction for road in roads}
    paint = (_painted(item, frame, names, cuts) for item in given.paint)
    islands = (item.model_copy(update={"outline": frame.corners(item.outline)}) for item in given.islands)
    first, last = number, number + 1
    while first > 0 and route[first - 1] in names:
        first -= 1
    while last < len(route) and route[last] in names:
        last += 1
    found = {
        "roads": roads,
        "links": _renamed(given.links, names),
        "junctions": tuple(
            item.model_copy(update={"yields": _renamed(item.yields, names)})
            for item in given.junctions
            if item.id in junctions
        ),
        "paint": tuple(item for item in paint if item is not None),
        "islands": tuple(item for item in islands if _is_near(item.outline)),
        # Without lanes that are not kept, to which only links over gaps lead.
        "route": tuple(names[name] for name in route[first:last]),
        "source": given.source,
        "digest": given.digest,
        "given_frame": (frame.x + given.origin[0], frame.y + given.origin[1], frame.z, frame.turn),
    }
    standing = tuple(filter(None, (frame.element(item, names) for item in given.elements)))
    bodies = tuple(body for body in map(frame.body, given.bodies) if _is_near([(body.x_m, body.y_m)]))
    s_m = round(at.s_m - cuts[lane.road.id].from_m, LENGTH_DECIMALS)
    rails = tuple(filter(None, (_rail(item, cuts) for item in given.rails)))
    return MapPart(RoadMap.model_validate(found), number - first, s_m, standing, bodies, rails)


def _renamed(
    pairs: Iterable[tuple[LaneName, LaneName]], names: Mapping[LaneName, LaneName]
) -> tuple[tuple[LaneName, LaneName], ...]:
    """The pairs of lanes that are both kept."""
    return tuple((names[a], names[b]) for a, b in pairs if a in names and b in names)


def _painted(
    item: MapPaint, frame: "_Frame", names: Mapping[LaneName, LaneName], cuts: Mapping[str, _Cut]
) -> MapPaint | None:
    """Paint in the world; None for that of a place that is not kept."""
    if item.lane is None:
        corners = frame.corners(item.outline)
        return item.model_copy(update={"outline": corners}) if _is_near(corners) else None
    if item.lane not in names:
        return None
    s_m = round(item.s_m - cuts[lane_key(item.lane)[0]].from_m, LENGTH_DECIMALS)
    return item.model_copy(update={"lane": names[item.lane], "s_m": s_m})


def _rail(item: GivenRail, cuts: Mapping[str, _Cut]) -> GivenRail | None:
    """A barrier by the stations of what is kept of its road."""
    cut = cuts.get(item.road)
    if cut is None:
        return None
    from_m, to_m = max(item.from_m, cut.from_m) - cut.from_m, min(item.to_m, cut.to_m) - cut.from_m
    return item._replace(from_m=from_m, to_m=to_m) if to_m - from_m >= LEAST_RAIL_M else None


def _cut(given: GivenMap, road: MapRoad, host: tuple[float, float]) -> _Cut:
    """What is kept of a road that is near."""
    if road.length_m <= LONG_M:
        return _Cut(0.0, road.length_m, 0, len(road.sections))
    line = given.outlines[road.id]
    near = np.flatnonzero(np.hypot(*(line - host).T) <= KEPT_M)
    s = np.linspace(0, road.length_m, len(line))
    starts = np.cumsum([0.0, *(piece.length_m for piece in road.plan)])
    first = min(int(np.searchsorted(starts, s[near[0]], side="right")), len(road.plan)) - 1
    last = max(int(np.searchsorted(starts, s[near[-1]], side="left")), first + 1)
    from_m, to_m = float(starts[first]), float(starts[min(last, len(road.plan))])
    ends = pairwise([*(section.s_m for section in road.sections), road.length_m])
    kept = [i for i, (begin, end) in enumerate(ends) if end > from_m + SAME_M and begin < to_m - SAME_M]
    return _Cut(from_m, to_m, kept[0], len(kept))


def _shortened(road: MapRoad, cut: _Cut) -> MapRoad:
    """The part of a road."""
    if cut.from_m == 0 and cut.to_m >= road.length_m - SAME_M:
        return road
    starts = np.cumsum([0.0, *(piece.length_m for piece in road.plan)])
    plan = tuple(
        piece
        for piece, start in zip(road.plan, starts, strict=False)
        if cut.from_m - SAME_M <= start < cut.to_m - SAME_M
    )
    kept = road.sections[cut.sections_before :][: cut.n_sections]
    return road.model_copy(
        update={
            "plan": plan,
            "sections": tuple(_begun(section, cut.from_m) for section in kept),
            "lane_offsets": part(road.lane_offsets, cut.from_m, cut.to_m),
            "heights": part(road.heights, cut.from_m, cut.to_m),
            "banks": part(road.banks, cut.from_m, cut.to_m),
            "shapes": _shapes(road.shapes, cut),
            "bridges": _spans(road.bridges, cut),
            "tunnels": _spans(road.tunnels, cut),
            "given_from_m": round(cut.from_m, LENGTH_DECIMALS),
            "given_section": cut.sections_before,
        }
    )


def _shapes(shapes: Sequence[MapShape], cut: _Cut) -> tuple[MapShape, ...]:
    """The shapes at the stations of a part, with those next to its ends."""
    stations = sorted({shape.s_m for shape in shapes})
    low = max((s for s in stations if s <= cut.from_m), default=cut.from_m)
    high = min((s for s in stations if s >= cut.to_m), default=cut.to_m)
    kept = (shape for shape in shapes if low <= shape.s_m <= high)
    return tuple(shape.model_copy(update={"s_m": shape.s_m - cut.from_m}) for shape in kept)


def _spans(spans: Sequence[MapSpan], cut: _Cut) -> tuple[MapSpan, ...]:
    """The bridges or tunnels on a part, by its stations."""
    ends = [(max(at.from_m, cut.from_m), min(at.to_m, cut.to_m)) for at in spans]
    by_m = cut.from_m
    return tuple(MapSpan(from_m=low - by_m, to_m=high - by_m) for low, high in ends if high > low + SAME_M)


def _begun(section: MapSection, from_m: float) -> MapSection:
    """A section with stations from `from_m` on."""
    if section.s_m >= from_m:
        return section.model_copy(update={"s_m": section.s_m - from_m})
    lanes = (lane_between(lane, from_m - section.s_m, math.inf) for lane in section.lanes)
    return MapSection(s_m=0.0, lanes=tuple(lanes))


def _plain(given: GivenMap, name: str, cut: _Cut) -> MapRoad:
    """What is kept of a road, with rounded numbers but for plan and heights. A whole road is rounded once for all
    scenes."""
    road, kept = given.roads[name], _shortened(given.roads[name], cut)
    if kept is not road:
        return _rounded_road(kept)
    if name not in given.plain_roads:
        given.plain_roads[name] = _rounded_road(road)
    return given.plain_roads[name]


def _rounded_road(road: MapRoad) -> MapRoad:
    return road.model_copy(
        update={
            "sections": tuple(map(_rounded, road.sections)),
            "banks": rounded(road.banks),
            "lane_offsets": rounded(road.lane_offsets),
        }
    )


def _rounded(section: MapSection) -> MapSection:
    lanes = (lane.model_copy(update={"widths": rounded(lane.widths)}) for lane in section.lanes)
    return MapSection(s_m=round(section.s_m, LENGTH_DECIMALS), lanes=tuple(lanes))


def _is_near(corners: Sequence[GroundPoint]) -> bool:
    return any(math.hypot(*corner) < KEPT_M for corner in corners)


@dataclass(frozen=True)
class _Frame:
    """The world frame in that of the map: its origin, and the heading of its y axis."""

    x: float
    y: float
    z: float
    heading: float

    @cached_property
    def turn(self) -> float:
        """The heading of world x in the map."""
        return round(_wrapped(self.heading - math.pi / 2), ANGLE_DECIMALS)

    def point(self, at: GroundPoint) -> GroundPoint:
        """A place of the map in the world."""
        dx, dy = at[0] - self.x, at[1] - self.y
        cos, sin = math.cos(self.turn), math.sin(self.turn)
        return round(cos * dx + sin * dy, LENGTH_DECIMALS), round(cos * dy - sin * dx, LENGTH_DECIMALS)

    def corners(self, outline: Iterable[GroundPoint]) -> tuple[GroundPoint, ...]:
        """An outline of the map in the world."""
        return tuple(map(self.point, outline))

    def road(self, road: MapRoad) -> MapRoad:
        """A road of the map, with rounded numbers but for plan and heights, in the world."""
        heights = (piece.model_copy(update={"a": piece.a - self.z}) for piece in road.heights)
        return road.model_copy(update={"plan": tuple(map(self._piece, road.plan)), "heights": rounded(heights)})

    def element(self, item: GivenElement, names: Mapping[LaneName, LaneName]) -> GivenElement | None:
        """A signal or sign of the map in the world, with those of its lanes that are kept; None of one far away."""
        of = item.element
        x, y = self.point((of.x_m, of.y_m))
        if not _is_near([(x, y)]):
            return None
        lanes = tuple(names[name] for name in of.lanes if name in names)
        yaw_rad = round(_wrapped(of.yaw_rad - self.turn), LENGTH_DECIMALS)
        return item._replace(element=of.model_copy(update={"x_m": x, "y_m": y, "yaw_rad": yaw_rad, "lanes": lanes}))

    def body(self, item: GivenBody) -> GivenBody:
        """A building or a tree of the map in the world."""
        x, y = self.point((item.x_m, item.y_m))
        return item._replace(x_m=x, y_m=y, heading_rad=round(_wrapped(item.heading_rad - self.turn), LENGTH_DECIMALS))

    def _piece(self, piece: PlanPiece) -> PlanPiece:
        x, y = self.point((piece.x_m, piece.y_m))
        heading = round(_wrapped(piece.heading_rad - self.turn), ANGLE_DECIMALS)
        return piece.model_copy(update={"x_m": x, "y_m": y, "heading_rad": heading})


def _wrapped(angle_rad: float) -> float:
    return math.remainder(angle_rad, 2 * math.pi)
