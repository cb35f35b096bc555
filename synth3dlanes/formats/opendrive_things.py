"""What lies on roads and stands beside them, as OpenDRIVE's objects and signals."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.opendrive_roads import RoadPlace, WrittenRoad, beside, lane_ascends
from synth3dlanes.roads.maps.elements import ARROW_FORMS, ARROW_LIGHT, GERMAN_SIGNS, LIGHT
from synth3dlanes.scene.road_map import MapPaint, lane_key
from synth3dlanes.scene.roadside import Rail
from synth3dlanes.scene.scene import Symbol
from synth3dlanes.scene.traffic_elements import LensForm, SignKind, TrafficSign, TrafficSignal
from synth3dlanes.system.arrays import Points3
from synth3dlanes.world import beside as beside_road
from synth3dlanes.world.beside import on_ground
from synth3dlanes.world.posts import post_frames
from synth3dlanes.world.symbols import SymbolShape, symbol_items
from synth3dlanes.world.world import World

Element = ElementTree.Element


def add(parent: Element, tag: str, **attributes: str | float) -> Element:
    """Add an element with these attributes."""
    texts = {key: value if isinstance(value, str) else text(value) for key, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, texts)


def text(value: float) -> str:
    """Ten digits: a micrometre in a kilometre. Smaller than a picometre is noise."""
    return f"{value:.10g}" if abs(value) > 1e-12 else "0"


# Types and subtypes by ASAM's catalogue of signals and the German signs; the value of a speed limit is its own.
NONE = "-1"
LIGHTS: dict[LensForm, tuple[str, str]] = {form: (ARROW_LIGHT, subtype) for subtype, form in ARROW_FORMS.items()}
LIGHTS["ball"] = LIGHT, NONE
SIGNS: dict[SignKind, tuple[str, str]] = {
    kind: (name.partition("-")[0], name.partition("-")[2] or NONE) for name, kind in GERMAN_SIGNS.items()
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

Placed = Iterator[tuple[WrittenRoad, Element]]


def add_things(world: World, roads: Sequence[WrittenRoad], elements: Mapping[str, Element]) -> None:
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
    return (SPEED, NONE) if item.kind.startswith("speed_") else SIGNS.get(item.kind)
