"""What lies and stands on and beside the roads, as OpenDRIVE's objects."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.opendrive.described import Element, add, add_crosswalk
from synth3dlanes.formats.opendrive.roads import OdrRoad
from synth3dlanes.scene.roadside import Rail
from synth3dlanes.scene.scene import Symbol
from synth3dlanes.world.beside import beside, on_ground
from synth3dlanes.world.buildings import building_frame
from synth3dlanes.world.posts import post_frames
from synth3dlanes.world.symbols import shape
from synth3dlanes.world.world import World

# The types and subtypes of our things; what is not listed is left out.
SYMBOLS = {
    "crosswalk": ("crosswalk", "pedestrian"),
    "stop_line": ("roadMark", "signalLines"),
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
# Rails are straight in (s, t) over this length.
RAIL_STEP_M = 10.0


def add_objects(world: World, roads: Sequence[OdrRoad], elements: Mapping[str, Element]) -> None:
    """Add the objects of a world to the elements of its roads by their names."""
    groups: list[list[Element]] = [[] for _ in roads]
    scene, ground = world.scene, world.ground
    for symbol in scene.symbols:
        _add_symbol(world, symbol, roads, groups)
    for rail in scene.roadside.rails:
        if rail.kind in RAILS:
            _add_rail(world, rail, roads, groups)
    posts = zip(scene.roadside.posts, post_frames(ground, scene.roadside.posts), strict=True)
    for post, frame in posts:
        _add_upright(frame.origin, roads, groups, POSTS[post.kind], height=post.height_m, radius=0.1)
    heights_m = [model.height_m for model in scene.assets.tree_models]
    for tree, base in zip(scene.trees, world.site.trees_world, strict=True):
        _add_upright(
            base, roads, groups, ("tree", ""), height=heights_m[tree.model - 1] * tree.scale, radius=0.3 * tree.scale
        )
    for building in scene.roadside.buildings:
        frame = building_frame(building)
        sizes = {"width": building.width_m, "length": building.length_m, "height": building.height_m}
        base = on_ground(ground, frame.origin[None, :2])[0]
        _add_upright(base, roads, groups, ("building", building.kind), building.yaw_rad + np.pi / 2, **sizes)
    count = 0
    for group, road in zip(groups, roads, strict=True):
        if group:
            objects = add(elements[road.name], "objects")
            for found in group:
                found.set("id", str(count))
                objects.append(found)
                count += 1


def _object(kind: tuple[str, str], at: Float[np.ndarray, "3"], **attributes: str | float) -> Element:
    name = {"type": kind[0], "name": kind[1] or kind[0]} | ({"subtype": kind[1]} if kind[1] else {})
    return add(Element("objects"), "object", **name, s=at[0], t=at[1], **attributes)


def _add_symbol(world: World, symbol: Symbol, roads: Sequence[OdrRoad], groups: list[list[Element]]) -> None:
    form = shape(world.ground, symbol)
    kind = SYMBOLS[symbol.kind]
    outline = form.points_world(form.polygons[0] if symbol.kind.startswith("arrow") else form.outline)
    road = _nearest(roads, outline.mean(axis=0))
    if symbol.kind == "crosswalk":
        (x0, y0), (x1, y1) = form.outline.min(axis=0), form.outline.max(axis=0)
        rectangle = form.points_world(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
        # Its own place is the nearest one of the road, also of a crosswalk beyond the road's end.
        along = roads[road]
        i = int(np.linalg.norm(along.xy_world - rectangle.mean(axis=0)[:2], axis=1).argmin())
        t = float((rectangle.mean(axis=0) - along.line_world[i]) @ along.axes[i, 1])
        corners = (rectangle - along.line_world[i] - t * along.axes[i, 1]) @ along.axes[i].T
        words = {"name": kind[1], "subtype": kind[1]}
        groups[road].append(add_crosswalk(Element("objects"), 0, corners, float(along.s_m[i]), t, **words))
        return
    places = roads[road].places(outline)
    # Corners go counter-clockwise.
    x, y = places[:, 0], places[:, 1]
    if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() < 0:
        places = places[::-1]
    element = _object(kind, places.mean(axis=0), zOffset=0.0, height=0.0, orientation="none")
    corners = add(add(element, "outlines"), "outline", id="0", outer="true", closed="true")
    for i, (s, t, _) in enumerate(places):
        add(corners, "cornerRoad", id=str(i), s=s, t=t, dz=0.0, height=0.0)
    groups[road].append(element)


def _add_rail(world: World, rail: Rail, roads: Sequence[OdrRoad], groups: list[list[Element]]) -> None:
    low, high = sorted((rail.from_m, rail.to_m))
    for road, group in zip(roads, groups, strict=True):
        start, end = max(low, road.network_s.min()), min(high, road.network_s.max())
        if road.edges_of != rail.road or end - start < 1.0:
            continue
        stations = np.linspace(start, end, 2 + int((end - start) / RAIL_STEP_M))
        line = on_ground(world.ground, beside(world.ground, rail.road, rail.side, stations, rail.aside_m))
        places = road.places(line)
        places = places[np.argsort(places[:, 0])]
        width = RAIL_WIDTH_M[rail.kind]
        element = _object(RAILS[rail.kind], places[0], zOffset=places[0, 2], height=rail.height_m, orientation="none")
        for a, b in pairwise(places):
            ends = {"tStart": a[1], "tEnd": b[1], "zOffsetStart": a[2], "zOffsetEnd": b[2]}
            sizes = {"heightStart": rail.height_m, "heightEnd": rail.height_m, "widthStart": width, "widthEnd": width}
            add(element, "repeat", s=a[0], length=b[0] - a[0], distance=0.0, **ends, **sizes)
        group.append(element)


def _add_upright(
    base: Float[np.ndarray, "3"], roads: Sequence[OdrRoad], groups: list[list[Element]], kind: tuple[str, str],
    heading_rad: float | None = None, **sizes: float,
) -> None:  # fmt: skip
    road = _nearest(roads, base)
    place = roads[road].places(base[None])[0]
    turned = {}
    if heading_rad is not None:
        along = roads[road].axes[np.searchsorted(roads[road].s_m[:-1], place[0]), 0]
        turned = {"hdg": float(heading_rad - np.arctan2(along[1], along[0]))}
    groups[road].append(_object(kind, place, zOffset=place[2], orientation="none", **turned, **sizes))


def _nearest(roads: Sequence[OdrRoad], point: Float[np.ndarray, "3"]) -> int:
    """The road whose reference line is nearest; a lane that opens in a junction is none."""
    apart = [
        np.linalg.norm(road.xy_world - point[:2], axis=1).min() if road.name != "opening" else np.inf for road in roads
    ]
    return int(np.argmin(apart))
