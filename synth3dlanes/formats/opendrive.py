"""OpenDRIVE: one file a scene, with its roads, their lanes and paint, and what stands beside them."""

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import count, pairwise
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.comparing import Comparison, SourceSample
from synth3dlanes.formats.comparing_maps import FoundLane, MapRule, compare_lanes, paint_word
from synth3dlanes.formats.format import FrameList, ReadFrame, SampleFormat, SampleFrame, maps_of
from synth3dlanes.formats.opendrive_roads import (
    PaintedMark,
    RoadPlace,
    WrittenRoad,
    beside,
    lane_ascends,
    on_planes,
    part_links,
    parts,
)
from synth3dlanes.formats.reading import read_text
from synth3dlanes.formats.writing import FrameAnnotation
from synth3dlanes.labels.labels import MIRRORED
from synth3dlanes.roads.cross_section import CrossSection
from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.cubics import Profile
from synth3dlanes.roads.maps.document import parse_xml
from synth3dlanes.roads.maps.elements import ARROW_FORMS, ARROW_LIGHT, GERMAN_SIGNS, LIGHT
from synth3dlanes.roads.maps.given_map import GivenMap, LanePlace, read_opendrive
from synth3dlanes.roads.maps.lanes import KINDS, MARK_KINDS, SIDES
from synth3dlanes.roads.maps.plan import places as places_along
from synth3dlanes.scene.road_map import (
    LaneName,
    MapLane,
    MapMark,
    MapPaint,
    MapRoad,
    MapSection,
    PlanPiece,
    Polynomial,
    lane_key,
)
from synth3dlanes.scene.roadside import Rail
from synth3dlanes.scene.scene import Symbol
from synth3dlanes.scene.traffic_elements import LensForm, SignKind, TrafficSign, TrafficSignal
from synth3dlanes.system.arrays import Points3, Scalars
from synth3dlanes.world import beside as beside_road
from synth3dlanes.world.beside import on_ground
from synth3dlanes.world.posts import post_frames
from synth3dlanes.world.symbols import SymbolShape, symbol_items
from synth3dlanes.world.world import World, resolve

USER_DATA = "synth3dlanes.segment"
"""The code of the user data that names a lane's segment in our lane graph."""
# Shapes are heights square to the banked plane, so where the ground bends they move points aside.
# Paint of an edge is compared only if all of it is of one kind.
RULE = MapRule("m", 0.15, slack=0.3, word=paint_word, of_pieces=True, painted_share=0.15, gap_m=0.15)
# The cubics of lines, heights and widths are within a millimetre of the same functions.
GAP_M = 0.005
STATION_STEP_M = 1.0
PLAIN = {"dots": "dashed", "dashed_dashed": "dashed"}
"""Kinds of marks that the labels call dashed."""


# Only files that need it are of the version that knows lanes which go against their side of the road.
MAJOR, MINOR, REVERSED_MINOR = "1", "7", "8"
NO_NUMBER = "-1"
# CARLA and others read ids as whole numbers of 32 bits.
NUMBER = re.compile(r"0|[1-9]\d{0,8}")

# What files call our kinds, of several names the first.
LANE_TYPES = {kind: name for name, kind in reversed(KINDS.items())}
MARK_TYPES = {kind: name for name, kind in MARK_KINDS.items()}

# Types and subtypes by ASAM's catalogue of signals and the German signs; the value of a speed limit is its own.
LIGHTS: dict[LensForm, tuple[str, str]] = {form: (ARROW_LIGHT, subtype) for subtype, form in ARROW_FORMS.items()}
LIGHTS["ball"] = LIGHT, NO_NUMBER
SIGNS: dict[SignKind, tuple[str, str]] = {
    kind: (name.partition("-")[0], name.partition("-")[2] or NO_NUMBER) for name, kind in GERMAN_SIGNS.items()
}
SPEED = "274"
# The types and subtypes of our objects; what is not listed is left out.
SYMBOLS = {
    "crosswalk": ("crosswalk", "pedestrian"),
    "stop_line": ("roadMark", "signalLines"),
    "give_way_line": ("roadMark", "yieldLine"),
    "gore": ("roadMark", "area"),
    "arrow_straight": ("roadMark", "arrowStraight"),
    "arrow_left": ("roadMark", "arrowLeft"),
    "arrow_right": ("roadMark", "arrowRight"),
    "arrow_straight_left": ("roadMark", "arrowStraightLeft"),
    "arrow_straight_right": ("roadMark", "arrowStraightRight"),
}
RAILS = {
    "guardrail": ("barrier", "guardRail"),
    "concrete": ("barrier", "jerseyBarrier"),
    "noise_wall": ("barrier", "wall"),
}
POSTS = {"lamp": ("pole", "streetLamp"), "sign": ("pole", "trafficSign"), "delineator": ("pole", "permanentDelineator")}
RAIL_WIDTH_M = {"guardrail": 0.1, "concrete": 0.6, "noise_wall": 0.2}
# Rails are straight in (s, t) over this length; shorter ones are left out.
RAIL_STEP_M, LEAST_RAIL_M = 10.0, 1.0
Element = ElementTree.Element
Placed = Iterator[tuple[WrittenRoad, Element]]


README = f"""OpenDRIVE {MAJOR}.{MINOR}, or {MAJOR}.{REVERSED_MINOR} if a lane has a `direction`: a map of each scene.

- `SPLIT/KEY.xodr`: the roads of the scene of this frame. Its coordinates are those of `world_from_cam` in the frame's
  labels (x, y on the ground, z up, metres), which so places the camera in the map.
- Roads are laid on the terrain by elevation, superelevation and, where the ground bends across the lanes, shape.
- `{USER_DATA}` in a lane's user data is the id of its segment in the lane graph of the labels.
"""


class LaneJoint(NamedTuple):
    """A lane that traffic leaves, and one that it enters there: their road, section, number, and end."""

    one: tuple[str, int, int]
    leaves: str
    other: tuple[str, int, int]
    enters: str


def add(parent: Element, tag: str, **attributes: str | float) -> Element:
    """Add an element with these attributes."""
    texts = {key: value if isinstance(value, str) else _number(value) for key, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, texts)


def _number(value: float) -> str:
    """Ten digits: a micrometre in a kilometre. Smaller than a picometre is noise."""
    return f"{value:.10g}" if abs(value) > 1e-12 else "0"


def annotate(frame: SampleFrame) -> FrameAnnotation:
    text = opendrive(resolve(frame.scene), frame.key)
    return FrameAnnotation(None, text.count('type="driving"'), files={f"{frame.split}/{frame.key}.xodr": text})


def opendrive(world: World, name: str) -> str:
    """The OpenDRIVE file of a world; its inertial frame is the world frame."""
    roads, links = _file_roads(world)
    joined = FileLinks(links, {road.told.id: road.told for road in roads})
    root = ElementTree.Element("OpenDRIVE")
    xy_world = np.concatenate([road.line_world for road in roads])
    (west, south), (east, north) = xy_world.min(axis=0), xy_world.max(axis=0)
    is_reversed = any(lane.against for road in joined.found.values() for part in road.sections for lane in part.lanes)
    minor = REVERSED_MINOR if is_reversed else MINOR
    header = {"revMajor": MAJOR, "revMinor": minor, "name": name, "version": "1.00", "vendor": "synth3dlanes"}
    add(root, "header", **header, north=north, south=south, east=east, west=west)
    elements = {}
    for road, segments in ((at.told, at.segments) for at in roads):
        element = add(root, "road", name=road.id, length=road.length_m, id=joined.roads[road.id])
        element.set("junction", joined.junctions[road.junction] if road.junction else NO_NUMBER)
        element.set("rule", "LHT" if road.keeps_left else "RHT")
        joined.add(add(element, "link"), road)
        view, s = add(element, "planView"), 0.0
        for piece in road.plan:
            _add_piece(view, piece, s)
            s += piece.length_m
        _add_cubics(add(element, "elevationProfile"), "elevation", road.heights)
        lateral = add(element, "lateralProfile")
        _add_cubics(lateral, "superelevation", road.banks)
        for shape in road.shapes:
            add(lateral, "shape", s=shape.s_m, t=shape.t_m, a=shape.a, b=shape.b, c=shape.c, d=shape.d)
        _add_lanes(add(element, "lanes"), road, joined.of_lanes(road), segments)
        elements[road.id] = element
    _add_things(world, roads, elements)
    joined.add_junctions(root, world.network.yields or ())
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _file_roads(world: World) -> tuple[list[WrittenRoad], Iterable[tuple[LaneName, LaneName]]]:
    """The roads of a world as its file tells them, and the links of their lanes: those with sections of their own as
    they are, others in parts."""
    network, found = world.network, list[WrittenRoad]()
    for road in network.roads:
        if road.given is not None:
            segments = {name: name for name in _driving_lanes(road.given)}
            told = on_planes(road.given, road, np.zeros_like)
            found.append(WrittenRoad(told, segments, road.id, (road.start_m, road.end_m)))
    if found:
        return found, network.links
    parted = parts(network)
    return [part.told(world) for part in parted], part_links(network, parted)


def _driving_lanes(road: MapRoad) -> Iterable[LaneName]:
    for i, section in enumerate(road.sections):
        yield from (f"{road.id}.{i}.{lane.number}" for lane in section.lanes if lane.kind == "driving" and lane.number)


def numbered(names: Collection[str], taken: Collection[str] = ()) -> dict[str, str]:
    """A number for each name, which is none of those taken: the name itself if it is one, else the next that is
    free."""
    found = {name: name for name in names if NUMBER.fullmatch(name) and name not in taken}
    used = {*found, *taken}
    free = (str(n) for n in count(1) if str(n) not in used)
    return {name: found.get(name) or next(free) for name in names}


# -- links


LanePairs = dict[tuple[str, str, str], list[tuple[int, int]]]
"""Pairs of lanes by the roads that they are of and the end where the second one is entered."""


class FileLinks:
    """How the roads of a file follow each other, lane by lane; the numbers of roads and junctions. `direct` are the
    names of direct junctions by ends of roads: where lanes lead from one road to several without connecting roads, with
    all ends that these lead to or come from in turn."""

    def __init__(self, links: Iterable[tuple[LaneName, LaneName]], found: Mapping[str, MapRoad]) -> None:
        self.found, self.touches = found, list[LaneJoint]()
        for a, b in links:
            (one, i, m), (other, j, n) = (lane_key(name) for name in (a, b))
            if one in found and other in found:
                leaves = "end" if lane_ascends(found[one], i, m) else "start"
                enters = "start" if lane_ascends(found[other], j, n) else "end"
                self.touches.append(LaneJoint((one, i, m), leaves, (other, j, n), enters))
        self.direct = dict[tuple[str, str], str]()
        for road in found.values():
            for end in ("start", "end"):
                is_new = road.junction is None and (road.id, end) not in self.direct
                if is_new and len({name for name, _ in self._parting(road.id, end)}) > 1:
                    name, reached = f"direct_{len(self.direct)}", [(road.id, end)]
                    while reached:
                        self.direct[reached[-1]] = name
                        reached += [at for at in self._parting(*reached.pop()) if at not in self.direct]
        self.connecting = list(dict.fromkeys(road.junction for road in found.values() if road.junction is not None))
        # Roads and junctions share the numbers: CARLA knows by them which of both a link leads to.
        self.roads = numbered(found)
        self.junctions = numbered(dict.fromkeys([*self.connecting, *self.direct.values()]), self.roads.values())

    def of_lanes(self, road: MapRoad) -> list[LaneJoint]:
        """The joints that the lanes of a road have as links: at a junction its connections have them, not its arms."""
        is_arm = road.junction is None
        return [at for at in self.touches if not (is_arm and self._junction(at.one) != self._junction(at.other))]

    def _junction(self, lane: tuple[str, int, int]) -> str | None:
        return self.found[lane[0]].junction

    def _beyond(self, road: str, end: str) -> dict[tuple[str, str], None]:
        """The ends of other roads that lanes lead to or come from at an end of a road."""
        found: dict[tuple[str, str], None] = {}
        for touch in self.touches:
            if _is_within(touch):
                continue
            sides = [(touch.one[0], touch.leaves), (touch.other[0], touch.enters)]
            for here, there in (sides, sides[::-1]):
                if here == (road, end):
                    found[there] = None
        return found

    def _parting(self, road: str, end: str) -> list[tuple[str, str]]:
        """The ends beyond an end of a road that are of roads outside of junctions."""
        return [at for at in self._beyond(road, end) if self.found[at[0]].junction is None]

    def add(self, element: Element, road: MapRoad) -> None:
        """Add what a road leads to at its ends."""
        for tag, end in (("predecessor", "start"), ("successor", "end")):
            beyond = self._beyond(road.id, end)
            through = [self.found[name].junction for name, _ in beyond if self.found[name].junction is not None]
            if (road.id, end) in self.direct:
                add(element, tag, elementType="junction", elementId=self.junctions[self.direct[road.id, end]])
            elif road.junction is None and through:
                add(element, tag, elementType="junction", elementId=self.junctions[str(through[0])])
            elif beyond:
                (name, contact), *_ = beyond
                add(element, tag, elementType="road", elementId=self.roads[name], contactPoint=contact)

    def add_junctions(self, root: Element, yields: Iterable[tuple[LaneName, LaneName]]) -> None:
        pairs = sorted({(lane_key(low)[0], lane_key(high)[0]) for low, high in yields})
        for name in self.connecting:
            junction = add(root, "junction", name=name, id=self.junctions[name], type="default")
            entered: LanePairs = {}
            for (one, _, m), _, (other, _, n), enters in self.touches:
                if self.found[other].junction == name and self.found[one].junction != name:
                    entered.setdefault((one, other, enters), []).append((m, n))
            self._add_connections(junction, entered, "connectingRoad")
            for low, high in (pair for pair in pairs if all(self.found[road].junction == name for road in pair)):
                add(junction, "priority", high=self.roads[high], low=self.roads[low])
        for name in dict.fromkeys(self.direct.values()):
            junction = add(root, "junction", name=name, id=self.junctions[name], type="direct")
            parted: LanePairs = {}
            for touch in self.touches:
                (one, _, m), leaves, (other, _, n), enters = touch
                ends = (one, leaves), (other, enters)
                if not _is_within(touch) and all(self.direct.get(end) == name for end in ends):
                    parted.setdefault((one, other, enters), []).append((m, n))
            self._add_connections(junction, parted, "linkedRoad")

    def _add_connections(self, junction: Element, entered: LanePairs, key: str) -> None:
        for number, ((one, other, contact), lanes) in enumerate(entered.items()):
            incoming = {"incomingRoad": self.roads[one], "contactPoint": contact}
            connection = add(junction, "connection", id=str(number), **incoming)
            connection.set(key, self.roads[other])
            for m, n in lanes:
                add(connection, "laneLink", **{"from": str(m), "to": str(n)})


def _is_within(touch: LaneJoint) -> bool:
    """Whether it is between two sections of a road."""
    (one, i, _), (other, j, _) = touch.one, touch.other
    return one == other and abs(i - j) == 1 and touch.leaves != touch.enters and (i < j) == (touch.leaves == "end")


def _linked(road: str, i: int, number: int, end: str, touches: list[LaneJoint]) -> list[tuple[str, int]]:
    """The lanes, by road and number, that follow or precede a lane at an end of it."""
    here, found = (road, i, number), []
    for touch in touches:
        if touch.one == here and touch.leaves == end:
            found.append((touch.other[0], touch.other[2]))
        if touch.other == here and touch.enters == end:
            found.append((touch.one[0], touch.one[2]))
    return found


# -- form


def _add_piece(view: Element, piece: PlanPiece, s: float) -> None:
    place = {"x": piece.x_m, "y": piece.y_m, "hdg": piece.heading_rad, "length": piece.length_m}
    geometry = add(view, "geometry", s=s, **place)
    if piece.u is not None and piece.v is not None:
        scale = piece.parameter_end ** np.arange(4)
        named = {f"{letter}U": float(u) for letter, u in zip("abcd", piece.u * scale, strict=True)}
        named |= {f"{letter}V": float(v) for letter, v in zip("abcd", piece.v * scale, strict=True)}
        add(geometry, "paramPoly3", **named, pRange="normalized")
    elif piece.curvature != piece.curvature_end:
        add(geometry, "spiral", curvStart=piece.curvature, curvEnd=piece.curvature_end)
    elif piece.curvature:
        add(geometry, "arc", curvature=piece.curvature)
    else:
        add(geometry, "line")


def _add_cubics(parent: Element, tag: str, cubics: Iterable[Polynomial], key: str = "s") -> None:
    for piece in cubics:
        add(parent, tag, **{key: piece.s_m}, a=piece.a, b=piece.b, c=piece.c, d=piece.d)


# -- lanes


def _add_lanes(element: Element, road: MapRoad, touches: list[LaneJoint], segments: Mapping[LaneName, str]) -> None:
    _add_cubics(element, "laneOffset", road.lane_offsets or [Polynomial(s_m=0.0, a=0.0)])
    for i, section in enumerate(road.sections):
        part = add(element, "laneSection", s=section.s_m)
        for side, sign in SIDES.items():
            lanes = [lane for lane in section.lanes if np.sign(lane.number) == sign]
            lanes = lanes or ([MapLane(number=0, kind="none")] if sign == 0 else [])
            group = add(part, side) if lanes else part
            for lane in sorted(lanes, key=lambda at: -at.number):
                _add_lane(group, road, i, lane, touches, segments)


def _add_lane(
    group: Element, road: MapRoad, i: int, lane: MapLane, touches: list[LaneJoint], segments: Mapping[LaneName, str]
) -> None:
    element = add(group, "lane", id=str(lane.number), type=LANE_TYPES[lane.kind], level=str(lane.level).lower())
    if lane.against:
        element.set("direction", "reversed")
    link = add(element, "link")
    if lane.kind == "driving" and lane.number:
        for tag, end in (("predecessor", "start"), ("successor", "end")):
            for _, number in dict.fromkeys(_linked(road.id, i, lane.number, end, touches)):
                add(link, tag, id=str(number))
    if lane.number:
        _add_cubics(element, "width", lane.widths or [Polynomial(s_m=0.0, a=0.0)], "sOffset")
    for mark in lane.marks:
        _add_mark(element, mark)
    if lane.kind == "driving" and lane.number:
        add(element, "userData", code=USER_DATA, value=segments[f"{road.id}.{i}.{lane.number}"])


def _add_mark(element: Element, mark: MapMark) -> None:
    width_m = 3 * mark.width_m if "_" in mark.kind else mark.width_m
    color = "yellow" if mark.yellow else "white"
    kind = {"type": MARK_TYPES[mark.kind], "weight": "standard"}
    entry = add(element, "roadMark", sOffset=mark.s_m, **kind, color=color, width=width_m)
    if isinstance(mark, PaintedMark):
        entry.set("laneChange", mark.lane_change)
        lines = add(entry, "type", name=MARK_TYPES[mark.kind], width=width_m)
        for t_m, dash_m, gap_m, first_m in mark.stripes:
            places = {"tOffset": t_m, "sOffset": first_m, "width": mark.width_m}
            add(lines, "line", length=dash_m, space=gap_m, **places, color=color)


# -- what lies on roads and stands beside them


def _add_things(world: World, roads: Sequence[WrittenRoad], elements: Mapping[str, Element]) -> None:
    """Add the objects and signals of a world to the elements of its roads, by their ids."""
    objects = [*_symbols(world, roads), *_islands(world, roads), *_rails(world, roads), *_uprights(world, roads)]
    for number, (_, item) in enumerate(objects):
        item.set("id", str(number))
    for tag, found in (("objects", objects), ("signals", [*_signals(world, roads)])):
        for road in roads:
            # References come last.
            own = sorted((item for at, item in found if at is road), key=lambda item: item.tag == "signalReference")
            if own:
                add(elements[road.told.id], tag).extend(own)


def _object(kind: tuple[str, str], sth: Float[np.ndarray, "3"], **attributes: str | float) -> Element:
    """An object of a type and perhaps a subtype at a place, for both directions unless told."""
    words = {"orientation": "none", "type": kind[0], "name": kind[1] or kind[0]}
    words |= {"subtype": kind[1]} if kind[1] else {}
    return add(Element("objects"), "object", **(words | attributes), s=sth[0], t=sth[1])


# -- paint and islands


def _symbols(world: World, roads: Sequence[WrittenRoad]) -> Placed:
    for item, form in zip(symbol_items(world.network, world.scene), world.symbol_shapes, strict=True):
        if item.kind == "crosswalk":
            yield _crosswalk(form, roads)
        else:
            yield _in_lane(item, form, [road for road in roads if item.lane in road.segments.values()] or roads)


def _in_lane(item: Symbol | MapPaint, form: SymbolShape, roads: Sequence[WrittenRoad]) -> tuple[WrittenRoad, Element]:
    """Paint with its outline in (s, t), at its middle; what is in a lane faces its traffic."""
    outline = form.points_world(form.polygons[0] if item.kind.startswith("arrow") else form.outline)
    middle = outline.mean(axis=0) if item.lane is None else form.points_world(np.zeros((1, 2)))[0]
    ((road, sth),) = beside(roads, middle[None])
    words, sizes = dict[str, str](), dict[str, float]()
    numbers = [lane_key(name) for name, segment in road.segments.items() if segment == item.lane]
    for _, section, number in numbers[:1]:
        words["orientation"] = "+" if lane_ascends(road.told, section, number) else "-"
        sizes["width"], sizes["length"] = np.ptp(form.outline, axis=0).tolist()
    element = _object(SYMBOLS[item.kind], sth, zOffset=0.0, hdg=0.0, height=0.0, **words, **sizes)
    places = road.places(outline)
    # Corners go counter-clockwise.
    x, y = places[:, 0], places[:, 1]
    if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() < 0:
        places = places[::-1]
    corners = add(add(element, "outlines"), "outline", id="0", outer="true", closed="true")
    for i, (s, t, _) in enumerate(places):
        add(corners, "cornerRoad", id=str(i), s=s, t=t, dz=0.0, height=0.0)
    if not item.kind.startswith("arrow"):
        _add_validity(element, [number for _, _, number in numbers[:1]])
    return road, element


def _crosswalk(form: SymbolShape, roads: Sequence[WrittenRoad]) -> tuple[WrittenRoad, Element]:
    """A crosswalk, turned so that people walk along u. Its outline is where readers of version 1.4 look, as CARLA, and
    closed as they want it."""
    (x0, y0), (x1, y1) = form.outline.min(axis=0), form.outline.max(axis=0)
    corners_world = form.points_world(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]))
    sides = np.diff(corners_world[:3], axis=0)
    along = sides[int(np.hypot(*sides[1, :2]) > np.hypot(*sides[0, :2]))]
    (place,) = beside(roads, corners_world[:4].mean(axis=0)[None])
    turn_rad = math.atan2(along[1], along[0]) - place.heading_rad
    element = _object(SYMBOLS[form.kind], place.sth, zOffset=0.0, hdg=turn_rad, pitch=0.0, roll=0.0)
    _add_corners(add(element, "outline", id="0", closed="true"), place, corners_world, turn_rad)
    return place.road, element


def _islands(world: World, roads: Sequence[WrittenRoad]) -> Placed:
    for island in world.network.islands:
        corners_world = on_ground(world.ground, np.array(island.outline, float))
        (place,) = beside(roads, corners_world.mean(axis=0)[None])
        element = _object(("trafficIsland", ""), place.sth, zOffset=0.0, hdg=0.0, height=island.height_m)
        _add_corners(add(add(element, "outlines"), "outline", id="0", closed="true"), place, corners_world, 0.0)
        yield place.road, element


def _add_corners(outline: Element, place: RoadPlace, corners_world: Points3, turn_rad: float) -> None:
    """Corners from a place on the road's plane, turned about that from the road's heading."""
    line, axes = place.road.frames(place.sth[:1])
    local = (corners_world - line[0] - place.sth[1] * axes[0, 1]) @ axes[0].T
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    for i, (ahead, left, up) in enumerate(local.tolist()):
        at = {"u": cos * ahead + sin * left, "v": cos * left - sin * ahead, "z": up, "height": 0.0}
        add(outline, "cornerLocal", id=str(i), **at)


# -- what stands beside roads


def _rails(world: World, roads: Sequence[WrittenRoad]) -> Placed:
    for rail in world.scene.roadside.rails:
        for road in roads if rail.kind in RAILS else ():
            low, high = np.clip(sorted((rail.from_m, rail.to_m)), *road.span_m).tolist()
            if road.source == rail.road and road.has_edges and high - low >= LEAST_RAIL_M:
                yield road, _rail(world, rail, road, low, high)


def _rail(world: World, rail: Rail, road: WrittenRoad, low_m: float, high_m: float) -> Element:
    """The stretch of a rail along a road between two stations of the network's."""
    stations = np.linspace(low_m, high_m, 2 + int((high_m - low_m) / RAIL_STEP_M))
    line = beside_road.beside(world.ground, rail.road, rail.side, stations, rail.aside_m)
    places = road.places(on_ground(world.ground, line))
    places, width = places[np.argsort(places[:, 0])], RAIL_WIDTH_M[rail.kind]
    element = _object(RAILS[rail.kind], places[0], zOffset=places[0, 2], height=rail.height_m)
    for a, b in pairwise(places):
        ends = {"tStart": a[1], "tEnd": b[1], "zOffsetStart": a[2], "zOffsetEnd": b[2]}
        sizes = {"heightStart": rail.height_m, "heightEnd": rail.height_m, "widthStart": width, "widthEnd": width}
        add(element, "repeat", s=a[0], length=b[0] - a[0], distance=0.0, **ends, **sizes)
    return element


def _uprights(world: World, roads: Sequence[WrittenRoad]) -> Placed:
    """Posts, trees and buildings, these with the heading of their length."""
    scene, ground = world.scene, world.ground
    posts, trees, buildings = scene.roadside.posts, scene.trees, scene.roadside.buildings
    heights_m = [scene.assets.tree_models[tree.model - 1].height_m * tree.scale for tree in trees]
    kinds = [POSTS[post.kind] for post in posts] + [("tree", "")] * len(trees)
    kinds += [("building", building.kind) for building in buildings]
    sizes = [{"height": post.height_m, "radius": 0.1} for post in posts]
    sizes += [{"height": h, "radius": 0.3 * tree.scale} for h, tree in zip(heights_m, trees, strict=True)]
    sizes += [{"width": at.width_m, "length": at.length_m, "height": at.height_m} for at in buildings]
    middles = np.array([(at.x_m, at.y_m) for at in buildings]).reshape(-1, 2)
    feet = [*(frame.origin for frame in post_frames(ground, posts)), *world.site.trees_world]
    places = beside(roads, np.array([*feet, *on_ground(ground, middles)]).reshape(-1, 3))
    for place, size, building in zip(places[len(feet) :], sizes[len(feet) :], buildings, strict=True):
        size["hdg"] = building.yaw_rad + math.pi / 2 - place.heading_rad
    for place, kind, size in zip(places, kinds, sizes, strict=True):
        yield place.road, _object(kind, place.sth, zOffset=place.sth[2], **size)


# -- signals and signs


def _signals(world: World, roads: Sequence[WrittenRoad]) -> Placed:
    """Signals and signs, each beside the road that is nearest to its head, with the lanes of it that it governs, and
    references to it at the others. Those that govern none are left out."""
    for number, item in enumerate(world.scene.roadside.free_elements):
        governed = {
            road.told.id: [lane_key(name) for name, segment in road.segments.items() if segment in item.lanes]
            for road in roads
        }
        kind = _kind(item)
        if kind is None or not any(governed.values()):
            continue
        head = np.array([[item.x_m, item.y_m]]) + item.reach_m * np.array(
            [math.cos(item.yaw_rad), math.sin(item.yaw_rad)]
        )
        (place,) = beside(roads, on_ground(world.ground, head))
        turn_rad = item.yaw_rad + math.pi / 2 - place.heading_rad
        is_along = math.cos(turn_rad) > 0
        words = {
            "id": str(number),
            "name": item.form if isinstance(item, TrafficSignal) else item.kind,
            "country": "DE",
        }
        words |= {"type": kind[0], "subtype": kind[1], "orientation": "+" if is_along else "-"}
        words |= {"dynamic": "yes" if isinstance(item, TrafficSignal) else "no"}
        sizes = {"s": place.sth[0], "t": place.sth[1], "zOffset": item.height_m}
        sizes["hOffset"] = math.remainder(turn_rad - (0.0 if is_along else math.pi), 2 * math.pi)
        if kind[0] == SPEED and isinstance(item, TrafficSign):
            words["unit"], sizes["value"] = "km/h", float(item.kind.removeprefix("speed_"))
        signal = add(Element("signals"), "signal", **words, **sizes)
        _add_validity(signal, [number for _, _, number in governed[place.road.told.id]] or [0])
        yield place.road, signal
        for road in roads:
            if governed[road.told.id] and road is not place.road:
                yield road, _reference(str(number), road, governed[road.told.id])


def _reference(signal: str, road: WrittenRoad, lanes: Sequence[tuple[str, int, int]]) -> Element:
    """A reference to a signal, where the first of the lanes of a road that it governs ends."""
    _, section, number = lanes[0]
    ascends = lane_ascends(road.told, section, number)
    reference = add(Element("signals"), "signalReference", id=signal, s=road.told.span_m(section)[int(ascends)], t=0.0)
    reference.set("orientation", "+" if ascends else "-")
    _add_validity(reference, [number for _, _, number in lanes])
    return reference


def _add_validity(element: Element, numbers: Sequence[int]) -> None:
    """The lanes of a road that something is valid for; lane 0 says none."""
    for number in sorted(set(numbers)):
        add(element, "validity", fromLane=str(number), toLane=str(number))


def _kind(item: TrafficSignal | TrafficSign) -> tuple[str, str] | None:
    """Type and subtype; None of signs that the standard leaves to countries."""
    if isinstance(item, TrafficSignal):
        return LIGHTS[item.form]
    return (SPEED, NO_NUMBER) if item.kind.startswith("speed_") else SIGNS.get(item.kind)


# -- read back


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    return maps_of(out, "xodr", most_frames, _content)


def _content(path: Path) -> tuple[Element, GivenMap]:
    data = read_text(path).encode()
    given = read_opendrive(data, path.name, str(path))
    return parse_xml(data, str(path)), given


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lane centres in metres, in the world frame, and their links."""
    root, given = frame.content
    largest_m = max(gap_m for road in given.roads.values() for gap_m in _gaps(road))
    problems = [] if largest_m <= GAP_M else [f"expected roads without gaps, got one of {largest_m:.3f} m"]
    segments = _segments(root, given)
    named = {name: segments[name] for name in given.lanes if name in segments}
    lanes = [
        _found(name, of, given.lanes[name], {*given.following.get(name, ())} & named.keys())
        for name, of in named.items()
    ]
    return compare_lanes(lanes, truth, RULE).because(problems)


def _segments(root: Element, given: GivenMap) -> dict[str, str]:
    """The segments of our lane graph by the names of the file's lanes."""
    return {
        f"{given.names[road.get('id', '')]}.{i}.{lane.get('id')}": data.get("value", "")
        for road in root.iter("road")
        for i, section in enumerate(road.iter("laneSection"))
        for lane in section.iter("lane")
        for data in lane.iter("userData")
        if data.get("code") == USER_DATA
    }


def _found(name: str, segment: str, place: LanePlace, after: Collection[str]) -> FoundLane:
    """A lane as its traffic drives: its middle, its edges, and their paint where that is of one kind."""
    road, section = place.road, CrossSection.of(place.road, place.section)
    s = np.linspace(section.start_m, section.end_m, 2 + int((section.end_m - section.start_m) / STATION_STEP_M))
    at, step = next(i for i, lane in enumerate(section.lanes) if lane is place.lane), 1 if place.ascends else -1

    def line(t: Scalars) -> Points3:
        z = section.height(s, t) if road.heights else 0 * s
        return np.column_stack([places_along(road.plan, s, -t), z])[::step]

    edges = dict(zip(("left", "right"), (at, at + 1)[::step], strict=True))
    paint = {side: _paint(road.sections[place.section], section, edge, place.ascends) for side, edge in edges.items()}
    return FoundLane(
        name,
        segment,
        line(section.middle_line(at)(s)),
        {side: line(section.edge(edge, s)) for side, edge in edges.items()},
        {side: word for side, word in paint.items() if word},
        after,
    )


def _paint(told: MapSection, section: CrossSection, edge: int, ascends: bool) -> str:
    """The paint of an edge as traffic sees it that goes with growing s or not; nothing for none or several kinds."""
    n = section.n_left
    number = 0 if edge == n else section.lanes[edge if edge < n else edge - 1].number
    marks = [mark for lane in told.lanes if lane.number == number for mark in lane.marks]
    if len({(mark.kind, mark.yellow) for mark in marks}) != 1 or marks[0].kind == "none":
        return ""
    # From the left along s, but left of lane 0 from its right.
    kind = PLAIN.get(marks[0].kind, marks[0].kind)
    kind = MIRRORED.get(kind, kind) if (number > 0) == ascends else kind
    return f"{kind} {'yellow' if marks[0].yellow else 'white'}"


def _gaps(road: MapRoad) -> Iterator[float]:
    """The jumps of a road's reference line, its heights and its widths."""
    for one, other in pairwise(road.plan):
        x, y, _ = plan_points([one], np.array([one.length_m]))[0]
        yield float(np.hypot(other.x_m - x, other.y_m - y))
    widths = (lane.widths for section in road.sections for lane in section.lanes)
    for cubics in (road.heights, road.banks, road.lane_offsets, *widths):
        for k in range(1, len(cubics)):
            yield abs(float(Profile(cubics[:k])(np.array([cubics[k].s_m]))[0]) - cubics[k].a)
    yield 0.0


FORMAT = SampleFormat(
    title="OpenDRIVE: a map of each scene",
    readme=README,
    write=annotate,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit},
    is_per_scene=True,
    counted="lanes",
)
