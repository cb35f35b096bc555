"""Lanelet2 files as given maps: lanelets become roads, those with a turn direction or across others junctions."""

import hashlib
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import shapely
from jaxtyping import Float
from pydantic import ValidationError
from shapely.geometry.base import BaseGeometry

from synth3dlanes.geometry.polylines import resampled
from synth3dlanes.roads.maps.elements import (
    HEAD_M,
    HIGH_M,
    LOW_M,
    SIGN_M,
    SIGNS,
    SPEEDS,
    GivenElement,
)
from synth3dlanes.roads.maps.given_map import (
    FAR_M,
    MAX_MAP_ROADS,
    ROUND_M,
    GivenMap,
    check_sizes,
    names_of,
    packed,
    touching,
    with_heights,
)
from synth3dlanes.roads.maps.lanelet_roads import (
    DRIVING,
    KINDS,
    LaneletBeside,
    RoadOfLanelets,
    keeps_left,
    road_of,
    rows_of,
)
from synth3dlanes.roads.maps.lanelets import Lanelet, read_lanelet
from synth3dlanes.roads.maps.osm import Osm, read_osm
from synth3dlanes.scene.road_map import LaneName, MapJunction, MapPaint, MapRoad
from synth3dlanes.scene.traffic_elements import MAX_LANES, LensForm, Phase, SignKind, TrafficSign, TrafficSignal
from synth3dlanes.system.arrays import Polyline2
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import MAX_NUMBER, Name, SymbolKind, shown, validation_problems

# Lanelets cross each other where they share this area (m^2), seam left out, and their heights differ by less than this.
CROSSED_M2, SEAM_M, SAME_LEVEL_M = 1.0, 0.3, 2.5
# A line across lanes belongs to those whose middle it crosses, at most BEYOND_M beyond their ends.
BEYOND_M = 1.0
# The cosine of the angle that tells what lies along a lane from what lies across.
ALONG = 0.7
# How far faces of heads and boards are before the poles that hold them.
HEAD_BEFORE_M, SIGN_BEFORE_M = 0.52, 0.18
LINES: dict[str, SymbolKind] = {"stop_line": "stop_line", "yield_line": "give_way_line"}
ARROWS: dict[str, SymbolKind] = {
    "left": "arrow_left",
    "right": "arrow_right",
    "straight": "arrow_straight",
    "straight_left": "arrow_straight_left",
    "straight_right": "arrow_straight_right",
}
BULB_ARROWS: dict[str, LensForm] = {"up": "straight", "left": "left", "right": "right"}
# Signs by what Autoware calls them.
AUTOWARE_SIGNS: dict[str, SignKind] = {"stop_sign": "stop"}


def read_lanelet2(data: bytes, source: str, where: str) -> GivenMap:
    """The map in the bytes of an OSM file named `source`, as they are or of gzip; FormatErrors begin with `where`."""
    osm = read_osm(data, where)
    origin = _origin(osm)
    osm = replace(osm, xyz=osm.xyz - [*origin, 0.0])
    left_out, broken = Counter(osm.left_out), list[str]()
    lanelets, crosswalks = _lanelets(osm, left_out, broken)
    names = names_of([lanelet.id for lanelet in lanelets])
    roads = _Roads(lanelets, names, where, broken)
    if not roads.of:
        more = f"; {len(broken) - 1} more lanelets are broken" if len(broken) > 1 else ""
        raise FormatError(f"{where}: {broken[0] if broken else 'expected a lanelet of traffic, got none'}{more}")
    if len(roads.roads) > MAX_MAP_ROADS:
        raise FormatError(f"{where}: expected at most {MAX_MAP_ROADS} roads, got {len(roads.roads)}")
    heights = with_heights(roads.roads)
    links = touching(roads.links(), heights, left_out)
    yields: dict[Name, dict[tuple[LaneName, LaneName], None]] = {name: {} for name in roads.junctions.values()}
    for name, pair in _yields(osm, roads):
        yields[name][pair] = None
    junctions = tuple(MapJunction(id=name, yields=tuple(pairs)) for name, pairs in yields.items())
    paint = (*_crosswalks(crosswalks), *_paint(osm, roads, left_out))
    elements = tuple(_elements(osm, roads, left_out))
    areas = sum(relation.tags.get("type") == "multipolygon" for relation in osm.relations.values())
    left_out["areas"] += areas
    counts = {what: n for what, n in left_out.items() if n}
    found = {name: roads.of[name].road.id for name in names if name in roads.of}
    read = origin, found, heights, links, junctions, paint, (), elements, (), ()
    return GivenMap(source, hashlib.sha256(data).hexdigest(), packed(data), read_lanelet2, *read, counts, tuple(broken))


def _origin(osm: Osm) -> tuple[float, float]:
    """A round place near the middle of a map that is far from (0, 0), else that."""
    x, y = np.median(osm.xyz[:, :2], axis=0).tolist()
    if max(abs(x), abs(y)) < FAR_M:
        return 0.0, 0.0
    return round(x / ROUND_M) * ROUND_M, round(y / ROUND_M) * ROUND_M


def _lanelets(osm: Osm, left_out: Counter[str], broken: list[str]) -> tuple[list[Lanelet], list[Lanelet]]:
    """The lanelets that may be lanes, and the crosswalks."""
    lanelets, crosswalks = list[Lanelet](), list[Lanelet]()
    for name, relation in osm.relations.items():
        subtype = relation.tags.get("subtype", "")
        if relation.tags.get("type") != "lanelet":
            continue
        if subtype != "crosswalk" and subtype not in KINDS:
            left_out[f"lanelets of subtype {shown(subtype)}"] += 1
            continue
        try:
            lanelet = read_lanelet(osm, name)
            if not max(np.abs(at.points).max() for at in (lanelet.left, lanelet.right)) <= MAX_NUMBER:
                raise FormatError(f"lanelet {name}: expected places at most {MAX_NUMBER / 1000:g} km from the others")
        except FormatError as error:
            broken.append(str(error))
            continue
        (crosswalks if subtype == "crosswalk" else lanelets).append(lanelet)
        if subtype in DRIVING and relation.tags.get("one_way") == "no":
            left_out["the other direction of lanelets for both"] += 1
    return lanelets, crosswalks


class _Roads:
    """The roads of the lanelets, by the id of each lanelet and by their own, and the junctions that lanelets are in."""

    def __init__(self, lanelets: Sequence[Lanelet], names: Mapping[str, Name], where: str, broken: list[str]) -> None:
        driving = [lanelet for lanelet in lanelets if lanelet.tags.get("subtype", "") in DRIVING]
        self.junctions = _junctions(driving, names)
        outside = [lanelet for lanelet in lanelets if lanelet.id not in self.junctions]
        rows = rows_of(outside)
        self.is_left_hand = keeps_left(rows)
        inside = [[LaneletBeside(lanelet, True)] for lanelet in driving if lanelet.id in self.junctions]
        self.of, self.roads = dict[str, RoadOfLanelets](), dict[Name, MapRoad]()
        self.by_id = {lanelet.id: lanelet for lanelet in driving}
        for row in (*rows, *inside):
            problem = self._add(row, names)
            if problem and len(row) > 1:
                # Lanelets beside a broken one may be whole.
                for at in (at for at in row if at.kind == "driving"):
                    problem = self._add([LaneletBeside(at.lanelet, True)], names)
                    broken += [problem] if problem else []
            elif problem:
                broken.append(problem)
        self.driving = [lanelet for lanelet in driving if lanelet.id in self.of]

    def _add(self, row: Sequence[LaneletBeside], names: Mapping[str, Name]) -> str:
        """Add the road of a row; what is wrong with it, if anything."""
        first = next(at.lanelet for at in row if at.kind == "driving")
        try:
            found = road_of(names[first.id], row, self.is_left_hand, first.id in self.junctions)
            road = found.road.model_copy(update={"junction": self.junctions.get(first.id)})
            check_sizes(road, f"lanelet {first.id}")
        except FormatError as error:
            text = str(error)
            return text if text.startswith("lanelet ") else f"lanelet {first.id}: {text}"
        except ValidationError as error:
            return validation_problems(error, f"lanelet {first.id}")[0]
        self.roads[road.id] = road
        self.of |= dict.fromkeys((at.lanelet.id for at in row), RoadOfLanelets(road, found.numbers))
        return ""

    def lane(self, lanelet: str) -> LaneName:
        """The lane of a lanelet."""
        found = self.of[lanelet]
        return f"{found.road.id}.0.{found.numbers[lanelet]}"

    def following(self, lanelet: Lanelet) -> list[Lanelet]:
        """The lanelets that begin where one ends."""
        return self._beginning.get(lanelet.ends, [])

    @cached_property
    def _beginning(self) -> dict[tuple[str, str], list[Lanelet]]:
        found: dict[tuple[str, str], list[Lanelet]] = {}
        for lanelet in self.driving:
            found.setdefault(lanelet.begins, []).append(lanelet)
        return found

    def links(self) -> list[tuple[LaneName, LaneName]]:
        """Pairs of lanes, the second of which begins at both ends of the first."""
        return [(self.lane(one.id), self.lane(other.id)) for one in self.driving for other in self.following(one)]


def _middle(lanelet: Lanelet) -> Polyline2:
    """The middle of a lanelet from above."""
    n = 2 + 4 * max(len(lanelet.left.points), len(lanelet.right.points))
    return (resampled(lanelet.left.points[:, :2], n) + resampled(lanelet.right.points[:, :2], n)) / 2


def _junctions(lanelets: Sequence[Lanelet], names: Mapping[str, Name]) -> dict[str, Name]:
    """The junctions of the lanelets that are in one: those with a turn direction or, in a file without any, those that
    cross others, with all that begin or end where these do. Those that touch or cross are in the same junction."""
    areas = [
        shapely.make_valid(shapely.Polygon(np.concatenate([at.left.points, at.right.points[::-1]])[:, :2])).buffer(
            -SEAM_M
        )
        for at in lanelets
    ]
    if not areas:
        return {}
    tree = shapely.STRtree(areas)
    ones, others = tree.query(areas, predicate="intersects")
    pairs = [(a, b) for a, b in zip(ones.tolist(), others.tolist(), strict=True) if a < b]
    crossing = [(a, b) for a, b in pairs if _is_crossing(lanelets[a], lanelets[b], areas[a], areas[b])]
    inside = {i for i, at in enumerate(lanelets) if "turn_direction" in at.tags}
    if not inside:
        inside = {i for a, b in crossing if not _are_siblings(lanelets[a], lanelets[b]) for i in (a, b)}
        ends = {(way, getattr(lanelets[i], way)) for i in inside for way in ("begins", "ends")}
        inside |= {i for i, at in enumerate(lanelets) if ("begins", at.begins) in ends or ("ends", at.ends) in ends}
    first = {i: i for i in inside}

    def root(i: int) -> int:
        while first[i] != i:
            i = first[i]
        return i

    at_corner = dict[str, int]()
    joined = [(a, b) for a, b in crossing if a in inside and b in inside]
    joined += (
        (at_corner.setdefault(node, i), i) for i in sorted(inside) for node in (*lanelets[i].begins, *lanelets[i].ends)
    )
    for a, b in joined:
        low, high = sorted((root(a), root(b)))
        first[high] = low
    return {lanelets[i].id: f"j{names[lanelets[root(i)].id]}"[:60] for i in sorted(inside)}


def _is_crossing(one: Lanelet, other: Lanelet, area: BaseGeometry, of_other: BaseGeometry) -> bool:
    """Whether two lanelets share more than an edge, at one height."""
    both = area.intersection(of_other)
    if both.area < CROSSED_M2 or one.ends == other.begins or other.ends == one.begins:
        return False
    middle = shapely.get_coordinates(both.centroid)[0]
    heights = []
    for lanelet in (one, other):
        points = np.concatenate([lanelet.left.points, lanelet.right.points])
        heights.append(float(points[np.hypot(*(points[:, :2] - middle).T).argmin(), 2]))
    return abs(heights[0] - heights[1]) < SAME_LEVEL_M


def _are_siblings(one: Lanelet, other: Lanelet) -> bool:
    return one.begins == other.begins or one.ends == other.ends


def _yields(osm: Osm, roads: _Roads) -> Iterator[tuple[Name, tuple[LaneName, LaneName]]]:
    """Pairs of lanes of junctions, the first of which yields, with its junction; of a lane before one, those behind."""
    for relation in osm.relations.values():
        if relation.tags.get("type") != "regulatory_element" or relation.tags.get("subtype") != "right_of_way":
            continue
        low, high = (
            [
                at.id
                for name in relation.of(role)
                if name in roads.by_id and name in roads.of
                for at in ([roads.by_id[name]] if name in roads.junctions else roads.following(roads.by_id[name]))
                if at.id in roads.junctions
            ]
            for role in ("yield", "right_of_way")
        )
        for one in low:
            for other in high:
                if other != one:
                    yield roads.junctions[one], (roads.lane(one), roads.lane(other))


# -- paint, lights and signs


def _crosswalks(found: Iterable[Lanelet]) -> Iterator[MapPaint]:
    """Crosswalks between the ends of their bounds: people walk along these."""
    for at in found:
        corners = (at.right.points[0], at.right.points[-1], at.left.points[-1], at.left.points[0])
        yield MapPaint(kind="crosswalk", outline=tuple((float(x), float(y)) for x, y, _ in corners))


def _paint(osm: Osm, roads: _Roads, left_out: Counter[str]) -> Iterator[MapPaint]:
    """Lines across lanes, and arrows in them."""
    middles = [_middle(lanelet) for lanelet in roads.driving]
    tree = shapely.STRtree([shapely.LineString(middle) for middle in middles])
    for name, way in osm.ways.items():
        is_arrow = way.tags.get("type") == "arrow"
        if not is_arrow and way.tags.get("type") not in LINES:
            continue
        arrow = ARROWS.get(way.tags.get("subtype", "")) if is_arrow else None
        try:
            points = osm.points(name)[:, :2]
        except FormatError:
            points = np.zeros((0, 2))
        if len(points) < 2 or (is_arrow and (arrow is None or len(points) > 2)):
            left_out[f"{way.tags['type']}s that cannot be read"] += 1
            continue
        drawn = shapely.LineString(points)
        near = [i for i in sorted(tree.query(drawn.buffer(BEYOND_M), predicate="intersects").tolist())
                if arrow is not None or roads.driving[i].id not in roads.junctions]  # fmt: skip
        # A line may lie just beyond the end of its lane; an arrow is in one.
        crossed = [i for i in near if drawn.intersects(shapely.LineString(middles[i]))]
        if arrow is None:
            # Where one lanelet ends and the next begins, it belongs to the first.
            after = {at.id for i in crossed for at in roads.following(roads.driving[i])}
            crossed = [i for i in crossed if roads.driving[i].id not in after or not _begins_at(middles[i], drawn)]
        along, found = points[-1] - points[0], list[MapPaint]()
        for i in crossed or near:
            foot, ahead = _foot(middles[i], drawn)
            share = float(along @ ahead) / max(float(np.hypot(*along)), 1e-9)
            if share < ALONG if arrow is not None else abs(share) > ALONG or not _is_across(points, foot):
                continue
            s_m = float(roads.of[roads.driving[i].id].station(foot[None])[0])
            found.append(MapPaint(kind=arrow or LINES[way.tags["type"]], lane=roads.lane(roads.driving[i].id), s_m=s_m))
        left_out[f"{way.tags['type']}s on no lane"] += not found
        yield from found[:1] if arrow is not None else found


def _begins_at(middle: Polyline2, drawn: shapely.LineString) -> bool:
    return shapely.Point(middle[0]).distance(drawn) < BEYOND_M


def _foot(middle: Polyline2, drawn: shapely.LineString) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """The place of a middle that is nearest to a line, or to the middle of an arrow, and its direction there."""
    line = shapely.LineString(middle)
    crossed = line.intersection(drawn)
    point = crossed.centroid if not crossed.is_empty else drawn.interpolate(0.5, normalized=True)
    at = line.project(point)
    ends = shapely.get_coordinates([line.interpolate(max(at - 0.5, 0)), line.interpolate(min(at + 0.5, line.length))])
    ahead = (ends[1] - ends[0]) / max(float(np.hypot(*(ends[1] - ends[0]))), 1e-9)
    return shapely.get_coordinates(line.interpolate(at))[0], ahead


def _is_across(points: Polyline2, foot: Float[np.ndarray, "2"]) -> bool:
    """Whether a line reaches over a place or ends just before it."""
    along = points[-1] - points[0]
    share = float((foot - points[0]) @ along) / max(float(along @ along), 1e-9)
    aside = points[0] + share * along - foot
    return -0.05 < share < 1.05 and float(np.hypot(*aside)) < BEYOND_M


def _elements(osm: Osm, roads: _Roads, left_out: Counter[str]) -> Iterator[GivenElement]:
    """The lights and signs of regulatory elements, with the lanes that refer to these."""
    governed: dict[str, list[str]] = {}
    for lanelet in roads.driving:
        for rule in lanelet.rules:
            governed.setdefault(rule, []).append(lanelet.id)
    lanes_of, bulbs = dict[str, dict[str, None]](), dict[str, LensForm]()
    for rule, relation in osm.relations.items():
        if relation.tags.get("type") == "regulatory_element":
            for way in relation.of("refers"):
                lanes_of.setdefault(way, {}).update(dict.fromkeys(governed.get(rule, ())))
            for lenses in (osm.ways[name] for name in relation.of("light_bulbs") if name in osm.ways):
                forms = [form for node in lenses.nodes if (form := BULB_ARROWS.get(osm.arrows.get(node, "")))]
                if forms:
                    bulbs[lenses.tags.get("traffic_light_id", "")] = forms[0]
    for way, lanelets in lanes_of.items():
        tags = osm.ways[way].tags if way in osm.ways else {}
        kind = tags.get("type", "")
        sign = _sign(tags.get("subtype", "")) if kind == "traffic_sign" else None
        if kind not in ("traffic_light", "traffic_sign"):
            continue
        if kind == "traffic_sign" and sign is None:
            left_out[f"signs of subtype {shown(tags.get('subtype', ''))}"] += 1
            continue
        try:
            points = osm.points(way)
        except FormatError:
            left_out[f"broken {kind}s"] += 1
            continue
        own = [roads.by_id[name] for name in lanelets]
        found = _mounted(points, own, *((SIGN_M, SIGN_BEFORE_M) if sign else (HEAD_M, HEAD_BEFORE_M)))
        if found is None:
            left_out[f"{kind}s without an edge"] += 1
            continue
        found["lanes"] = tuple(dict.fromkeys(map(roads.lane, lanelets)))[:MAX_LANES]
        try:
            if sign is not None:
                yield GivenElement(TrafficSign.model_validate({**found, "kind": sign}))
                continue
            form = bulbs.get(way, "ball")
            light = TrafficSignal.model_validate({**found, "phases": (Phase(state="off"),), "form": form})
        except ValidationError:
            left_out[f"broken {kind}s"] += 1
            continue
        after = [
            roads.junctions.get(at.id, "")
            for name in lanelets
            for at in (roads.by_id[name], *roads.following(roads.by_id[name]))
        ]
        junction = next((name for name in after if name), "")
        axis = f"axis {round(light.yaw_rad / (math.pi / 4)) % 4}" if junction else f"alone {way}"
        yield GivenElement(light, junction, axis)


def _mounted(
    points: Float[np.ndarray, "n 3"], lanelets: Sequence[Lanelet], usual_m: float, before_m: float
) -> dict[str, object] | None:
    """Place, direction and height over the nearest lane of a head or a board whose lower edge is drawn from the left to
    the right of those that see it; the direction of its lanes decides where files draw it the other way."""
    x, y, z = ((points[0] + points[-1]) / 2).tolist()
    right = points[-1] - points[0]
    if not np.hypot(*right[:2]) > 1e-3:
        return None
    heading = math.atan2(right[1], right[0]) + math.pi / 2
    known = np.concatenate([at.left.points for at in lanelets] + [at.right.points for at in lanelets] or [points])
    if lanelets:
        ends = np.array([middle[-1] - middle[-2] for middle in map(_middle, lanelets)]).sum(axis=0)
        if ends @ [math.cos(heading), math.sin(heading)] < 0:
            heading += math.pi
    height_m = z - float(known[np.hypot(*(known[:, :2] - [x, y]).T).argmin(), 2])
    if not LOW_M <= height_m <= HIGH_M:
        height_m = usual_m
    x, y = x + before_m * math.cos(heading), y + before_m * math.sin(heading)
    yaw_rad = math.remainder(heading - math.pi / 2, 2 * math.pi)
    return {"x_m": x, "y_m": y, "yaw_rad": yaw_rad, "height_m": height_m}


def _sign(subtype: str) -> SignKind | None:
    """What a sign of a country's number shows, as de206, de274-50, usR1-1; None of one that we do not have."""
    number = subtype[2:]
    if number.startswith(("274-", "274.1-", "274_1-")) and number.rpartition("-")[2].isdigit():
        return SPEEDS.get(int(number.rpartition("-")[2]))
    return SIGNS.get(number) or AUTOWARE_SIGNS.get(subtype)
