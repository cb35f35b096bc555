"""Lanelet2: a map of each scene as an OSM file, of lanelets with shared bounds in 3D, and its comparison with labels.

A lanelet is a piece of a lane along which neither the lanes beside it nor the paint on its edges changes. Those beside
each other share their bounds, and those that follow each other the ends of these.

Local coordinates are the world frame, metres; latitude and longitude are those of UTM around ORIGIN_DEG. Here bounds go
with the stations of their roads; in the file as the traffic of the lanelet that has them first. Lines that are drawn
twice, as between neighbours, are one way.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import shapely
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from synth3dlanes.formats.comparing import Comparison, SourceSample, distances
from synth3dlanes.formats.comparing_maps import (
    FoundLane,
    MapRule,
    compare_lanes,
    middle_of,
    paint_word,
    symbol_problems,
)
from synth3dlanes.formats.format import FrameList, ReadFrame, SampleFormat, SampleFrame, maps_of
from synth3dlanes.formats.reading import read_text
from synth3dlanes.formats.writing import FrameAnnotation
from synth3dlanes.geometry.frames import transform
from synth3dlanes.geometry.polylines import lengths_along, resampled, stretches, thinned
from synth3dlanes.labels.labels import MIRRORED
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.maps.elements import GERMAN_SIGNS
from synth3dlanes.roads.maps.lanelets import Lanelet, LaneletBound, read_lanelet
from synth3dlanes.roads.maps.osm import Osm, read_osm
from synth3dlanes.roads.maps.utm import degrees_from_utm, utm_from_degrees, zone_of
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene.scene import Markings
from synth3dlanes.scene.things import classes_in
from synth3dlanes.system.arrays import Polyline3, Scalars
from synth3dlanes.system.errors import FormatError
from synth3dlanes.world.elements import TrafficElement
from synth3dlanes.world.paint import is_double, line_width_m, paint_color, pair_of
from synth3dlanes.world.rails import KERBS, foot_of_front
from synth3dlanes.world.symbols import ARROWS, SymbolShape
from synth3dlanes.world.world import World, resolve

# The tags of a primitive; the members of a relation: type, id and role of each.
Tags = Mapping[str, str]
RelationMembers = list[tuple[str, int, str]]
# Roads without ends are written between these stations.
REACH_M = 250.0
# Distance between the points of bounds before thinning, and the most that thinning moves a line.
BOUND_STEP_M, LINE_M = 0.5, 0.002
LEAST_WIDTH_M = 0.1
# Lines within SAME_M of each other are one. Paint is that of a line at most PAINT_M from a lane's edge, or of a line of
# another road along the share ON_LINE of it; where paint changes nearer than LEAST_M to an end, it does so there.
SAME_M, PAINT_M, ON_LINE, LEAST_M = 0.02, 0.05, 0.9, 1.0
# Lanes are joined over gaps of up to JOIN_M; the next points are at least NEXT_M from where they then meet.
JOIN_M, NEXT_M = 0.5, 0.25
THICK_M = 0.18

# Where the world's origin is: in the middle of a zone, so that x is east.
ORIGIN_DEG = (49.0, 9.0)
SEGMENT = "synth3dlanes.segment"
"""The tag that names a lanelet's segment in our lane graph."""
PLACE_DECIMALS, DEGREE_DECIMALS = 4, 11
STRAIGHT_RAD = math.radians(30)
# A bound without paint is the edge of the pavement if the share ON_BORDER of it is within ON_BORDER_M of that. Kerbs
# are steps of the ground between both sides of an edge.
ON_BORDER, ON_BORDER_M, BORDER_STEP_M = 0.9, 0.1, 0.1
BESIDE_M, LEAST_KERB_M = 0.15, 0.06
# Smaller ones are seams between roads.
LEAST_AREA_M2 = 0.05

# Types of traffic elements; other ones are left out.
TYPES, LIGHT = classes_in("lanelet2", of_elements=True), "traffic_light"
SIGNS: dict[str, str] = {kind: f"de{name}" for name, kind in GERMAN_SIGNS.items()}
RAILS = {"guardrail": "guard_rail", "concrete": "jersey_barrier", **dict.fromkeys(KERBS, "curbstone")}
BORDERS: dict[str, Tags] = {
    "curbstone": {"type": "curbstone", "subtype": "high"},
    **{kind: {"type": kind} for kind in ("road_border", "guard_rail", "jersey_barrier")},
}
LINES = {"stop_line": "stop_line", "give_way_line": "yield_line"}
SPEED, STOPPING = "speed_", ("stop", "give_way")
BULBS = (("red", 1.0), ("yellow", 0.0), ("green", -1.0))
BULBS_APART = 0.3
"""Distance between the lights of a head, as a share of its height."""
ARROW_BULBS = {"left": "left", "right": "right", "straight": "up"}

README = f"""Lanelet2: a map of each scene.

- `SPLIT/KEY.osm`: the roads of the scene of this frame. `local_x`, `local_y` and `ele` are the coordinates of
  `world_from_cam` in the frame's labels (x, y on the ground, z up, metres), which so places the camera in the map.
- `lat` and `lon` are the same places by UTM: `UtmProjector(Origin({ORIGIN_DEG[0]:g}, {ORIGIN_DEG[1]:g}))` of the
  package lanelet2 gives local_x and local_y. Autoware's projector of type `Local` reads these themselves.
- `{SEGMENT}` of a lanelet is the id of its segment in the lane graph of the labels. A segment has several lanelets,
  one behind the other, where paint changes along it or a lane begins beside it.
"""


# -- lanelets


@dataclass(frozen=True)
class Paint:
    """Paint along a road between two of its stations: its tags as s grows, and as s falls, and whether it is a line of
    road works that moves."""

    t: Offset
    from_m: float
    to_m: float
    ascending: Tags
    descending: Tags
    is_temporary: bool


@dataclass(eq=False)
class Bound:
    """A line along a road, as s grows, with the numbers of the joints at its ends."""

    points: Polyline3
    joints: tuple[int, int]
    paint: Paint | None


@dataclass(eq=False)
class LaneletPiece:
    """A part of a lane that is a lanelet, with its bounds and, once it is written, its id."""

    lane: NetworkLane
    left: Bound
    right: Bound
    id: int = 0

    def ends(self, leaves: bool) -> tuple[int, int]:
        """The joints on the left and the right where traffic leaves it, or enters it."""
        at = int(leaves == self.lane.ascends)
        return self.left.joints[at], self.right.joints[at]

    @cached_property
    def middle(self) -> Polyline3:
        """The middle between its bounds as its traffic drives."""
        return np.asarray((self.left.points + self.right.points)[:: 1 if self.lane.ascends else -1] / 2)


@dataclass
class Lanelets:
    """The pieces of all lanes in the order of traffic, and the joints of their bounds: places, of which some are
    one."""

    pieces: dict[str, list[LaneletPiece]] = field(default_factory=dict)
    places: list[Float[np.ndarray, "3"]] = field(default_factory=list)
    same_as: list[int] = field(default_factory=list)

    def joint(self, place: Float[np.ndarray, "3"]) -> int:
        self.places.append(place)
        self.same_as.append(len(self.same_as))
        return len(self.same_as) - 1

    def first(self, joint: int) -> int:
        """The first of the joints that are one with a joint."""
        while self.same_as[joint] != joint:
            joint = self.same_as[joint]
        return joint

    def line(self, bound: Bound) -> Polyline3:
        """The points of a bound between the joints at its ends, as stations grow."""
        ends = [self.places[self.first(joint)] for joint in bound.joints]
        kept = bound.points[1:-1]
        for own, other, end in zip(bound.points[[0, -1]], bound.points[[1, -2]], ends, strict=True):
            if np.linalg.norm(own - end) > SAME_M:
                # What lies behind a joint that has moved, or just before it.
                inward = (other - own) / np.linalg.norm(other - own)
                is_near = np.linalg.norm(kept - own, axis=1) < 2 * JOIN_M
                kept = kept[~is_near | ((kept - end) @ inward > NEXT_M)]
        return np.concatenate([ends[:1], kept, ends[1:]])

    def join(self, leaving: tuple[int, int], entering: tuple[int, int]) -> bool:
        """Make joints on the left and on the right one; not where they are too far apart."""
        pairs = [sorted((self.first(a), self.first(b))) for a, b in zip(leaving, entering, strict=True)]
        if any(np.linalg.norm(self.places[a] - self.places[b]) > JOIN_M for a, b in pairs):
            return False
        for a, b in pairs:
            self.same_as[b] = a
        return True


def lanelets_of(world: World) -> tuple[Lanelets, int]:
    """The lanelets of all lanes, and how many links are left out because lanes do not meet."""
    found, network = Lanelets(), world.network
    for road in network.roads:
        lanes = [(lane, *ends) for lane in road.lanes if (ends := _wide(road, lane))]
        painted = list(_paint_along(world, road))
        before = dict[str, LaneletPiece]()
        for from_m, to_m in pairwise(_cuts(lanes, painted, road)):
            here = [lane for lane, low, high in lanes if low <= from_m and to_m <= high]
            pieces = _pieces(road, here, from_m, to_m, painted, found) if here else {}
            for name, piece in pieces.items():
                if name in before:
                    for old, new in ((before[name].left, piece.left), (before[name].right, piece.right)):
                        found.join((old.joints[1],) * 2, (new.joints[0],) * 2)
                own = found.pieces.setdefault(name, [])
                own.insert(len(own) if piece.lane.ascends else 0, piece)
            before = pieces
    met = [found.join(found.pieces[a][-1].ends(True), found.pieces[b][0].ends(False)) for a, b in network.links]
    return found, met.count(False)


def _wide(road: Road, lane: NetworkLane) -> tuple[float, float] | None:
    """The stations between which a lane is written: readers stumble over bounds that begin at one place."""
    from_m, to_m = np.nan_to_num([lane.start_m, lane.end_m], neginf=-REACH_M, posinf=REACH_M)
    s = np.linspace(from_m, to_m, 3 + int(abs(to_m - from_m) / BOUND_STEP_M))
    low, high = lane.edges
    wide = s[high(s) - low(s) > LEAST_WIDTH_M] if to_m > from_m else s[:0]
    return (float(wide[0]), float(wide[-1])) if len(wide) > 1 else None


def _look(line: LaneCurve, markings: Markings) -> tuple[Tags, Tags]:
    """The tags of a painted line in its own direction, and in the other one."""
    pair, width_m = pair_of(line, markings), line_width_m(line, markings)
    word = pair or ("solid_solid" if is_double(line, markings) and line.marking == "solid" else line.marking)
    tags = {"type": "line_thick" if width_m > THICK_M else "line_thin", "subtype": word}
    tags |= {"color": str(paint_color(line, markings)), "width": f"{width_m:.3f}"}
    if pair is None:
        tags["lane_change"] = "yes" if word == "dashed" else "no"
    return tags, {**tags, "subtype": MIRRORED[pair]} if pair else tags


def painted_lines(world: World) -> Iterator[tuple[Polyline3, Tags, Tags]]:
    """Points of all painted lines, and what they look like in their order and against it."""
    for line in world.network.delimiters:
        low, high = np.nan_to_num([line.start_m, line.end_m], neginf=-REACH_M, posinf=REACH_M)
        s = np.linspace(low, high, 2 + int((high - low) / BOUND_STEP_M))
        tags, other = _look(line, world.scene.markings)
        yield line.points_world(s), *((tags, other) if world.network.onwards > 0 else (other, tags))


def painted_along(points: Polyline3, painted: Sequence[tuple[Polyline3, Tags, Tags]]) -> Tags | None:
    """What a painted line looks like that runs along most of these points, in their order."""
    fine, best, best_share = resampled(points, 2 + len(points)), None, ON_LINE
    low, high = fine.min(axis=0) - PAINT_M, fine.max(axis=0) + PAINT_M
    for line, tags, other in painted:
        near = ((line > low) & (line < high)).all(axis=1)
        if not near.any():
            continue
        first, last = np.flatnonzero(near)[[0, -1]]
        part = line[max(first - 1, 0) : last + 2]
        share = float(np.mean(distances(fine, part) < PAINT_M)) if len(part) > 1 else 0.0
        if share > best_share:
            is_along = np.linalg.norm(part[0] - fine[0]) < np.linalg.norm(part[0] - fine[-1])
            best, best_share = tags if is_along else other, share
    return best


def _paint_along(world: World, road: Road) -> Iterator[Paint]:
    for line in world.network.delimiters:
        tags, other = _look(line, world.scene.markings)
        for piece in line.pieces:
            if piece.road.id == road.id:
                ends = np.clip([max(piece.start_m, line.start_m), min(piece.end_m, line.end_m)], -1e6, 1e6)
                low, high = sorted(piece.on(ends).tolist())
                along = piece.along * world.network.onwards
                is_temporary = bool(world.network.removed) and piece.offset.moves is not None
                yield Paint(piece.offset, low, high, *((tags, other) if along > 0 else (other, tags)), is_temporary)


def _cuts(lanes: Sequence[tuple[NetworkLane, float, float]], painted: Sequence[Paint], road: Road) -> list[float]:
    """The stations where lanelets of a road end: where lanes do, and where paint on their edges begins or ends."""
    ends = {end for _, *own in lanes for end in own}
    for paint in painted:
        for s_m in (paint.from_m, paint.to_m):
            at = np.array([s_m])
            is_on = any(
                low < s_m < high and np.abs(edge(at) - paint.t(at))[0] < PAINT_M
                for lane, low, high in lanes
                for edge in lane.edges
            )
            if is_on and min(abs(s_m - end) for end in ends) > LEAST_M:
                ends.add(s_m)
        for s_m in _meeting(lanes, paint) if paint.is_temporary else ():
            if min(abs(s_m - end) for end in ends) > LEAST_M:
                ends.add(s_m)
    return sorted(ends)


def _meeting(lanes: Sequence[tuple[NetworkLane, float, float]], paint: Paint) -> Iterator[float]:
    """The stations where a line of road works comes to the edge of a lane, or leaves it."""
    for lane, low, high in lanes:
        s = np.arange(max(low, paint.from_m), min(high, paint.to_m), BOUND_STEP_M)
        for edge in lane.edges:
            is_near = np.abs(edge(s) - paint.t(s)) < PAINT_M
            yield from s[1:][is_near[1:] != is_near[:-1]].tolist()


def _pieces(
    road: Road, lanes: Sequence[NetworkLane], from_m: float, to_m: float, painted: Sequence[Paint], found: Lanelets
) -> dict[str, LaneletPiece]:
    """The pieces of lanes of a road between two stations; where these are beside each other they share a bound."""
    s = np.linspace(from_m, to_m, 3 + int((to_m - from_m) / BOUND_STEP_M))
    lines, edges, sides = list[Scalars](), list[Polyline3](), dict[str, list[int]]()
    for lane in lanes:
        offsets = lane.edges
        for t in (offset(s) for offset in offsets):
            at = next((i for i, line in enumerate(lines) if np.abs(line - t).max() < SAME_M), len(lines))
            if at == len(lines):
                lines.append(t)
                edges.append(road.stretch_of(lane).points(s, t))
            sides.setdefault(lane.id, []).append(at)
    places = thinned(np.stack(edges, axis=1), LINE_M)
    bounds = []
    for i, t in enumerate(lines):
        points = places[:, i]
        along = [at for at in painted if np.mean(_is_along(at, s, t)) > 0.5]
        paint = min(along, key=lambda at: float(np.abs(at.t(s) - t).mean()), default=None)
        bounds.append(Bound(points, (found.joint(points[0]), found.joint(points[-1])), paint))
    made = {}
    for lane in lanes:
        low, high = (bounds[i] for i in sides[lane.id])
        made[lane.id] = LaneletPiece(lane, *((low, high) if lane.ascends != road.line.is_mirrored else (high, low)))
    return made


def _is_along(paint: Paint, s: Scalars, t: Scalars) -> Bool[np.ndarray, " n"]:
    return np.asarray((s >= paint.from_m) & (s <= paint.to_m) & (np.abs(paint.t(s) - t) < PAINT_M))


# -- the file


class _Document:
    """An OSM file in the making; ids differ among all that is in it."""

    def __init__(self) -> None:
        self.n, self.nodes, self.places = 0, list[tuple[int, Tags]](), list[Float[np.ndarray, "3"]]()
        self.ways, self.relations = (
            list[tuple[int, list[int], Tags]](),
            dict[int, tuple[dict[str, str], RelationMembers]](),
        )

    def _id(self) -> int:
        self.n += 1
        return self.n

    def node(self, xyz: Float[np.ndarray, "3"], tags: Tags | None = None) -> int:
        self.nodes.append((self._id(), tags or {}))
        self.places.append(xyz)
        return self.n

    def way(self, nodes: Iterable[int], tags: Tags) -> int:
        self.ways.append((self._id(), list(nodes), tags))
        return self.n

    def line(self, points: Polyline3, tags: Tags) -> int:
        """A new way through points of its own."""
        return self.way([self.node(point) for point in points], tags)

    def relation(self, tags: Tags, members: Iterable[tuple[str, int, str]]) -> int:
        """A new relation; members are (type, id, role)."""
        self.relations[self._id()] = dict(tags), list(members)
        return self.n

    def text(self) -> str:
        zone, places = zone_of(ORIGIN_DEG[1]), np.round(np.array(self.places), PLACE_DECIMALS) + 0.0
        degrees = degrees_from_utm(places[:, :2] + utm_from_degrees(np.array([ORIGIN_DEG]), zone), zone)
        root = ElementTree.Element("osm", version="0.6", generator="synth3dlanes")
        ElementTree.SubElement(root, "MetaInfo", format_version="1", map_version="1")
        for (name, tags), (lat, lon), (x, y, z) in zip(self.nodes, degrees.tolist(), places.tolist(), strict=True):
            given = {"lat": f"{lat:.{DEGREE_DECIMALS}f}", "lon": f"{lon:.{DEGREE_DECIMALS}f}"}
            local = {key: f"{value:.{PLACE_DECIMALS}f}" for key, value in (("local_x", x), ("local_y", y), ("ele", z))}
            _add(root, "node", name, {**local, **tags}, (), **given)
        for name, nodes, tags in self.ways:
            _add(root, "way", name, tags, [("nd", {"ref": str(node)}) for node in nodes])
        for name, (tags, members) in self.relations.items():
            parts = [("member", {"type": kind, "ref": str(ref), "role": role}) for kind, ref, role in members]
            _add(root, "relation", name, tags, parts)
        ElementTree.indent(root)
        return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _add(
    root: ElementTree.Element, kind: str, name: int, tags: Tags, parts: Iterable[tuple[str, Tags]], **more: str
) -> None:
    element = ElementTree.SubElement(root, kind, {"id": str(name), "visible": "true", "version": "1", **more})
    for tag, words in parts:
        ElementTree.SubElement(element, tag, dict(words))
    for key, value in tags.items():
        ElementTree.SubElement(element, "tag", k=key, v=value)


def annotate(frame: SampleFrame) -> FrameAnnotation:
    text, lost = lanelet2(resolve(frame.scene))
    dropped = Counter({"links of lanes that do not meet": lost} if lost else {})
    return FrameAnnotation(None, text.count(f'k="{SEGMENT}"'), dropped, {f"{frame.split}/{frame.key}.osm": text})


def lanelet2(world: World) -> tuple[str, int]:
    """The OSM file of a world, and how many links are left out because their lanes do not meet."""
    found, lost = lanelets_of(world)
    document, borders = _Document(), list(_borders(world))
    _write_lanes(document, found, borders, world)
    for points, kind in borders:
        document.line(thinned(points[:, None], LINE_M)[:, 0], BORDERS[kind])
    stops = dict(_write_symbols(document, world))
    _write_rules(document, found, stops, world)
    return document.text(), lost


def _borders(world: World) -> Iterator[tuple[Polyline3, str]]:
    """What bounds the pavement, by its type: edges, with kerbs where the ground beside is higher, and rails."""
    ground = world.ground
    host = world.network.host_points(world.scene.camera, np.zeros(1))[0, :2]
    for points in ground.paved.edges(host, REACH_M):
        if np.allclose(points[0], points[-1]) and shapely.Polygon(points[:, :2]).area < LEAST_AREA_M2:
            continue
        along = np.gradient(points[:, :2], axis=0)
        aside = along[:, ::-1] * [1, -1] * BESIDE_M / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
        step_m = np.abs(ground.height(points[:, :2] + aside) - ground.height(points[:, :2] - aside))
        is_kerb = step_m > LEAST_KERB_M
        for kind, alike in (("curbstone", is_kerb), ("road_border", ~is_kerb)):
            # Each goes on to where the other begins.
            yield from ((points[max(a - 1, 0) : b + 1], kind) for a, b in stretches(alike) if b - max(a - 1, 0) > 1)
    for rail in world.scene.roadside.rails:
        low, high = sorted((rail.from_m, rail.to_m))
        if rail.kind in RAILS and high > low:
            s = np.linspace(low, high, 2 + int((high - low) / BOUND_STEP_M))
            yield foot_of_front(ground, rail, s), RAILS[rail.kind]


def _write_lanes(document: _Document, found: Lanelets, borders: Sequence[tuple[Polyline3, str]], world: World) -> None:
    """The lanelets of the lanes, with their bounds."""
    lines = [resampled(line, 2 + int(lengths_along(line)[-1] / BORDER_STEP_M)) for line, _ in borders]
    kinds = np.repeat([kind for _, kind in borders], [len(line) for line in lines])
    tree = cKDTree(np.concatenate(lines)) if lines else None
    painted = list(painted_lines(world))
    nodes, ways, alike = dict[int, int](), dict[int, int](), dict[frozenset[int], list[tuple[Polyline3, int]]]()

    def node(joint: int) -> int:
        first = found.first(joint)
        if first not in nodes:
            nodes[first] = document.node(found.places[first])
        return nodes[first]

    def tags_of(bound: Bound, points: Polyline3, piece: LaneletPiece) -> Tags:
        if bound.paint is not None:
            return bound.paint.ascending if piece.lane.ascends else bound.paint.descending
        if (paint := painted_along(points[:: 1 if piece.lane.ascends else -1], painted)) is not None:
            return paint
        if tree is not None and piece.lane.junction is None:
            away_m, at = tree.query(resampled(points, 2 + len(points)))
            if np.mean(away_m < ON_BORDER_M) > ON_BORDER:
                return BORDERS[str(Counter(kinds[at].tolist()).most_common(1)[0][0])]
        return {"type": "virtual", "lane_change": "no"}

    def way(bound: Bound, piece: LaneletPiece) -> int:
        if id(bound) not in ways:
            points = found.line(bound)
            same = alike.setdefault(frozenset(map(found.first, bound.joints)), [])
            known = next((name for line, name in same if _is_one(line, points)), None)
            if known is None:
                ends = [node(joint) for joint in bound.joints]
                inner = [document.node(point) for point in points[1:-1]]
                order = [ends[0], *inner, ends[1]][:: 1 if piece.lane.ascends else -1]
                known = document.way(order, tags_of(bound, points, piece))
                same.append((points, known))
            ways[id(bound)] = known
        return ways[id(bound)]

    for pieces in found.pieces.values():
        for piece in pieces:
            tags = {"type": "lanelet", "subtype": "road", "location": world.scene.roads.location}
            tags |= {"one_way": "yes", "participant:vehicle": "yes", SEGMENT: piece.lane.id}
            if piece.lane.junction is not None:
                tags["turn_direction"] = _turn(piece.middle)
            bounds = ((bound, role) for bound, role in ((piece.left, "left"), (piece.right, "right")))
            members = [("way", way(bound, piece), role) for bound, role in bounds]
            piece.id = document.relation(tags, members)


def _is_one(line: Polyline3, other: Polyline3) -> bool:
    """Whether two lines with the same ends are one."""
    return bool(max(distances(line, other).max(), distances(other, line).max()) < SAME_M)


def _turn(middle: Polyline3) -> str:
    (x0, y0), (x1, y1) = ((middle[i + 1] - middle[i])[:2] for i in (0, -2))
    turn_rad = math.atan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)
    return "straight" if abs(turn_rad) < STRAIGHT_RAD else "left" if turn_rad > 0 else "right"


def _write_symbols(document: _Document, world: World) -> Iterator[tuple[str, int]]:
    """Crosswalks, arrows, and stop and give-way lines: of these the lane, where it is known, and the id."""
    roads, known = world.scene.roads, world.network.lanes
    paint = [at.lane for at in roads.paint if (len(at.outline) == 4 if at.kind == "crosswalk" else at.lane in known)]
    for i, form in enumerate(world.symbol_shapes):
        if form.kind == "crosswalk":
            _write_crosswalk(document, form, roads.location)
        elif form.kind in LINES:
            (x0, _), (x1, _) = form.outline.min(axis=0), form.outline.max(axis=0)
            line = document.line(form.points_world(np.array([[x0, 0.0], [x1, 0.0]])), {"type": LINES[form.kind]})
            if paint and (lane := paint[i]) is not None:
                yield lane, line
        elif form.kind in ARROWS:
            (_, y0), (_, y1) = form.outline.min(axis=0), form.outline.max(axis=0)
            tags = {"type": "arrow", "subtype": form.kind.removeprefix("arrow_")}
            document.line(form.points_world(np.array([[0.0, y0], [0.0, y1]])), tags)


def _write_crosswalk(document: _Document, form: SymbolShape, location: str) -> None:
    """A crosswalk as a lanelet along which people walk, with the edges of its bars as bounds."""
    (x0, y0), (x1, y1) = form.outline.min(axis=0), form.outline.max(axis=0)
    x = np.linspace(x0, x1, 2 + int(x1 - x0))
    right, left = (form.points_world(np.column_stack([x, np.full(len(x), y)])) for y in (y0, y1))
    (ax, ay), (bx, by) = (right[-1] - right[0])[:2], (left[0] - right[0])[:2]
    if ax * by < ay * bx:
        left, right = right, left
    ways = [document.line(points, {"type": "pedestrian_marking"}) for points in (left, right)]
    tags = {"type": "lanelet", "subtype": "crosswalk", "location": location}
    tags |= {"one_way": "no", "participant:pedestrian": "yes"}
    document.relation(tags, zip(("way", "way"), ways, ("left", "right"), strict=True))


def _write_rules(document: _Document, found: Lanelets, stops: Mapping[str, int], world: World) -> None:
    """Lights, signs and right of way as regulatory elements of lanelets."""
    lights = dict[str, list[tuple[int, int]]]()

    def rule(subtype: str, members: Iterable[tuple[str, int, str]], pieces: Sequence[LaneletPiece]) -> None:
        if not pieces:
            return
        name = document.relation({"type": "regulatory_element", "subtype": subtype}, members)
        for piece in pieces:
            document.relations[piece.id][1].append(("relation", name, "regulatory_element"))

    for element in world.site.elements:
        lanes = [lane for lane in element.lanes if lane in found.pieces]
        kind = str(element.kind)
        # The face of a limit without a number has none.
        limit = kind.removeprefix(SPEED) if kind.removeprefix(SPEED).isdigit() else ""
        if not lanes:
            continue
        type_ = TYPES.get(element.category)
        if type_ == LIGHT:
            light = _write_light(document, element)
            for lane in lanes:
                lights.setdefault(lane, []).append(light)
        elif type_ and (kind in SIGNS or limit):
            tags = {"type": type_, "subtype": f"de274-{limit}" if limit else SIGNS[kind]}
            members = [("way", _write_board(document, element, tags), "refers")]
            last = [found.pieces[lane][-1] for lane in lanes]
            if limit:
                # It holds from where it stands.
                pose = element.place.world_from_face
                last = [
                    piece for lane in lanes for piece in found.pieces[lane]
                    if (piece.middle[-1] - pose[:3, 3]) @ pose[:3, 1] > 0
                ]  # fmt: skip
                for piece in last:
                    document.relations[piece.id][0]["speed_limit"] = limit
            else:
                members += [("way", stops[lane], "ref_line") for lane in lanes if lane in stops and kind in STOPPING]
            rule("speed_limit" if limit else "traffic_sign", members, last)
    for lane, heads in lights.items():
        members = [
            (("way", name, role)) for head in heads for name, role in zip(head, ("refers", "light_bulbs"), strict=True)
        ]
        members += [("way", stops[lane], "ref_line")] if lane in stops else []
        rule(LIGHT, members, [found.pieces[lane][-1]])
    yields = dict[str, list[str]]()
    for at in world.scene.roads.junctions:
        for one, other in at.yields:
            if one in found.pieces and other in found.pieces:
                yields.setdefault(one, []).append(other)
    for one, others in yields.items():
        lines = [stops[before] for before, after in world.network.links if after == one and before in stops]
        firsts = [found.pieces[name][0] for name in (one, *others)]
        members = [
            ("relation", firsts[0].id, "yield"),
            *(("relation", piece.id, "right_of_way") for piece in firsts[1:]),
        ]
        rule("right_of_way", [*members, *(("way", line, "ref_line") for line in lines)], firsts)


def _write_light(document: _Document, element: TrafficElement) -> tuple[int, int]:
    """The lower edge of a head and its lenses."""
    board = _write_board(document, element, {"type": LIGHT, "subtype": "red_yellow_green"})
    height_m, pose = element.place.size_m[2], element.place.world_from_face
    arrow = {"arrow": ARROW_BULBS[element.kind]} if element.kind in ARROW_BULBS else {}
    front = np.array([[0.0, -element.place.size_m[1] / 2, up * BULBS_APART * height_m] for _, up in BULBS])
    points = zip(transform(pose, front), (color for color, _ in BULBS), strict=True)
    bulbs = [document.node(point, {"color": color, **arrow}) for point, color in points]
    return board, document.way(bulbs, {"type": "light_bulbs", "traffic_light_id": str(board)})


def _write_board(document: _Document, element: TrafficElement, tags: Tags) -> int:
    """The lower edge of a face from its left to its right, as those see it that it is for."""
    width_m, depth_m, height_m = element.place.size_m
    edge = np.array([[-width_m, -depth_m, -height_m], [width_m, -depth_m, -height_m]]) / 2
    return document.line(transform(element.place.world_from_face, edge), {**tags, "height": f"{height_m:.3f}"})


# -- read back


# Middles of lanes are within the limit, and heights within the slack.
RULE = MapRule("m", 0.05, slack=0.3, word=paint_word, of_pieces=True, joined_m=JOIN_M / 2)
CROSSWALK_M, DEGREES_M = 0.02, 0.001
"""How far crosswalks may be from those of the labels, and degrees from local coordinates."""


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    return maps_of(out, "osm", most_frames, lambda path: read_osm(read_text(path).encode(), str(path)))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lanes and crosswalks in metres, in the world frame; sides, links, neighbours and paint; degrees."""
    osm: Osm = frame.content
    found, problems, crosswalks = dict[str, list[Lanelet]](), list[str](), list[Lanelet]()
    for name, relation in osm.relations.items():
        if relation.tags.get("type") == "lanelet":
            try:
                lanelet = read_lanelet(osm, name)
            except FormatError as error:
                problems.append(str(error))
                continue
            if SEGMENT in lanelet.tags:
                found.setdefault(lanelet.tags[SEGMENT], []).append(lanelet)
            elif lanelet.tags.get("subtype") == "crosswalk":
                crosswalks.append(lanelet)
    begins, lanelets = dict[tuple[str, str], list[str]](), [(name, at) for name, own in found.items() for at in own]
    for _, at in lanelets:
        begins.setdefault(at.begins, []).append(at.id)
    lanes = [
        FoundLane(
            at.id,
            name,
            middle_of(at.left.points, at.right.points),
            {"left": at.left.points, "right": at.right.points},
            {"left": _look_of(at.left), "right": _look_of(at.right)},
            begins.get(at.ends, ()),
        )
        for name, at in lanelets
    ]
    outlines = [np.concatenate([at.left.points, at.right.points[::-1]]) for at in crosswalks]
    problems += symbol_problems("crosswalk", outlines, truth, ("crosswalk",), CROSSWALK_M)
    problems += [*_degree_problems(osm), *_neighbour_problems(found, truth)]
    return compare_lanes(lanes, truth, RULE).because(problems)


def _degree_problems(osm: Osm) -> Iterator[str]:
    """Findings where latitude and longitude are not those of the local coordinates."""
    zone = zone_of(ORIGIN_DEG[1])
    found = utm_from_degrees(osm.degrees, zone) - utm_from_degrees(np.array([ORIGIN_DEG]), zone)
    apart_m = np.linalg.norm(found - osm.xyz[:, :2], axis=1)
    if not apart_m.max() <= DEGREES_M:
        yield f"expected lat and lon of local_x and local_y to a millimetre, got them {apart_m.max():.3g} m off"


def _neighbour_problems(found: Mapping[str, list[Lanelet]], truth: SourceSample) -> Iterator[str]:
    """Findings where lanes share a bound that are not beside each other in the lane graph, or the other way round.
    Connectors may share one."""
    segments = {segment.id: segment for segment in truth.labels.graph.segments}
    rights = [(name, at.right) for name, lanelets in found.items() if name in segments for at in lanelets]
    on_right = {(right.way, right.is_against): name for name, right in rights}
    for segment in segments.values():
        swaps = truth.scene.roads.sides_are_hosts and segment.s_start_m > segment.s_end_m
        wanted = segment.right if swaps else segment.left
        lefts = [at.left for at in found.get(segment.id, ())]
        got = {on_right[key] for at in lefts if (key := (at.way, at.is_against)) in on_right}
        is_wrong = got - {wanted} if segment.junction is None else set[str]()
        if is_wrong or (lefts and wanted in found and not got):
            yield f"lane {segment.id}: expected it to share its left bound with {wanted}, got {sorted(got) or 'none'}"


def _look_of(bound: LaneletBound) -> str:
    """What the paint of a bound looks like, as its traffic drives."""
    if bound.tags.get("type") not in ("line_thin", "line_thick"):
        return paint_word("none")
    subtype = str(bound.tags.get("subtype"))
    return f"{MIRRORED.get(subtype, subtype) if bound.is_against else subtype} {bound.tags.get('color')}"


FORMAT = SampleFormat(
    title="Lanelet2: a map of each scene",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit},
    is_per_scene=True,
    counted="lanelets",
)
