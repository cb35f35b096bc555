"""OpenDRIVE: lanes, read by the standard, are the world's in place, height, direction and marks; ids name one thing."""

from collections import Counter
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, draw_world, sample_world
from synth3dlanes.formats.opendrive import numbered, opendrive
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.scene.roadside import Building, Post, Rail, Roadside
from synth3dlanes.scene.scene import Symbol, Tree
from synth3dlanes.scene.traffic_elements import TrafficSign, TrafficSignal
from synth3dlanes.world.paint import is_double, paint_color, painted_rows
from synth3dlanes.world.symbols import shape
from synth3dlanes.world.world import World, resolve
from tests.formats.opendrive_reading import read_roads
from tests.formats.test_verify_table import TOWN
from tests.maps import files
from tests.maps.test_round_trip import forks
from tests.scenes import FLAT, changed, hill
from tests.thorough import first

BENT = {"offset_m100_m": 6, "offset_m50_m": -4, "offset_p50_m": 7, "offset_p100_m": 3, "ramp_slope": 9}
# Beside the road: it is banked by up to 13 degrees, and the ground bends across the lanes.
HILLS = {"gaussians": (hill(25, 20, 9, 32), hill(-60, -70, -14, 60), hill(-20, 110, 8, 45))}
ROADS = [
    {"topology": topology, "flip_longitudinal": x, "flip_lateral": y, "n_oncoming": n, "median_m": median_m}
    for topology, x, y, n, median_m in [
        (1, False, False, 0, 0.0),
        (1, True, True, 2, 0.0),
        (2, False, False, 2, 0.0),
        (2, True, True, 1, 6.0),
        (2, True, False, 0, 0.0),
        (3, False, True, 2, 0.0),
        (3, True, False, 0, 0.0),
        (4, True, False, 1, 0.0),
        (4, False, True, 2, 2.0),
        (4, True, True, 0, 0.0),
    ]
]


def world_of(markings=None, **road):
    return resolve(changed(FLAT, road={**BENT, **road}, terrain=HILLS, markings=markings or {}))


def of_segment(world, segment):
    """The curve on which a lane segment lies."""
    return world.network.path(segment)


def apart(points, line):
    """Distances from above and height differences of points from a dense line."""
    nearest = np.linalg.norm(points[:, None, :2] - line[:, :2], axis=2).argmin(axis=1).clip(1, len(line) - 2)
    along = line[nearest + 1] - line[nearest - 1]
    to = points - line[nearest]
    share = (to[:, :2] * along[:, :2]).sum(axis=1) / (along[:, :2] ** 2).sum(axis=1)
    return np.linalg.norm((to - share[:, None] * along)[:, :2], axis=1), (to - share[:, None] * along)[:, 2]


def differences(world, text):
    """The largest distance from above, and in height, of any lane's centre from the world's."""
    stations = np.arange(-260, 300, 0.1)
    worst = np.zeros(2)
    for road in read_roads(text).values():
        for number, lane in road.by_number.items():
            data = lane.find("userData")
            if data is not None:
                line = of_segment(world, data.get("value")).points_world(stations)
                centers = np.array([road.center(number, s) for s in np.linspace(0, road.length_m, 14)])
                aside, above = apart(centers, line)
                worst = np.maximum(worst, [aside.max(), np.abs(above).max()])
    return worst


each_road = pytest.mark.parametrize("road", first(4, sorted(ROADS, key=lambda road: road not in ROADS[::3])), ids=str)


@each_road
def test_lane_centres_are_the_worlds_in_place_and_height(road):
    world = world_of(**road)
    aside, above = differences(world, opendrive(world, "test"))
    assert aside < 0.02
    assert above < 0.02


@each_road
def test_lanes_reach_from_end_to_end_of_every_curve(road):
    world = world_of(**road)
    found = read_roads(opendrive(world, "test"))
    centers = np.concatenate(
        [
            [file_road.center(number, s) for s in np.linspace(0, file_road.length_m, 100)]
            for file_road in found.values()
            for number, lane in file_road.by_number.items()
            if lane.find("userData") is not None
        ]
    )
    for line in world.site.lines:
        if line.kind == "centerline":
            points = line.points_world(np.linspace(-249, 249, 160))
            assert np.linalg.norm(points[:, None] - centers, axis=2).min(axis=1).max() < 3.0


def test_the_header_encloses_all_reference_lines():
    text = opendrive(world_of(topology=3), "test")
    header = ElementTree.fromstring(text).find("header")
    west, east, south, north = (float(header.get(key)) for key in ("west", "east", "south", "north"))
    lines = [
        file_road.line(np.linspace(0.0, file_road.length_m, 200), np.inf).T[:2]
        for file_road in read_roads(text).values()
    ]
    x, y = np.concatenate(lines, axis=1)
    assert (x.min(), x.max(), y.min(), y.max()) == pytest.approx((west, east, south, north), abs=0.5)


@each_road
def test_traffic_and_successors_are_those_of_the_lane_graph(road):
    world = world_of(**road)
    root = ElementTree.fromstring(opendrive(world, "test"))
    by_id = {element.get("id"): element for element in root.iter("road")}
    roads = {element.id: element for element in read_roads(ElementTree.tostring(root, encoding="unicode")).values()}

    def segment(road_id, number):
        return roads[road_id].by_number[int(number)].find("userData").get("value")

    for file_road in roads.values():
        ahead_is_right = file_road.element.get("rule") == "RHT"
        forward = file_road.point(file_road.length_m, 0.0)[1] > file_road.point(0.0, 0.0)[1]
        for number, lane in file_road.by_number.items():
            if lane.find("userData") is not None:
                # Lanes right of lane 0 go along s in right-hand traffic.
                goes_ahead = forward == ((number < 0) == ahead_is_right)
                assert goes_ahead != lane.find("userData").get("value").startswith("oncoming")
    found = set()
    for connection in root.iter("connection"):
        incoming, connecting = connection.get("incomingRoad"), connection.get("connectingRoad")
        assert by_id[connecting].get("junction") == root.find("junction").get("id")
        before, after = (by_id[connecting].find(f"link/{tag}") for tag in ("predecessor", "successor"))
        assert (connection.get("contactPoint"), before.get("elementId")) == ("start", incoming)
        for link in connection.iter("laneLink"):
            lane = roads[connecting].by_number[int(link.get("to"))]
            assert lane.find("link/predecessor").get("id") == link.get("from")
            out = lane.find("link/successor").get("id")
            ends = [(incoming, link.get("from"), before), (after.get("elementId"), out, after)]
            for (there, number, end), s in zip(ends, (0.0, roads[connecting].length_m), strict=True):
                at = 0.0 if end.get("contactPoint") == "start" else roads[there].length_m
                here, meets = roads[connecting].center(int(link.get("to")), s), roads[there].center(int(number), at)
                inside = roads[connecting].center(int(link.get("to")), abs(s - 1.0))
                along = (inside - here) / np.linalg.norm(inside - here)
                gap = meets - here
                # Lanes end where their own roads do: where a banked road climbs, not side by side.
                assert abs(gap @ along) < 0.5
                assert np.linalg.norm(gap - (gap @ along) * along) < 0.04
            found.add((segment(incoming, link.get("from")), segment(after.get("elementId"), out)))
    graph = world.network.graph([path.id for path in world.network.paths])
    expected = {(a, b) for a, after in graph.successors.items() for b in after}
    if road["topology"] > 1 and not road.get("median_m"):
        expected |= {(f"oncoming_{i}",) * 2 for i in range(1, road.get("n_oncoming", 0) + 1)}
    assert found == expected


def _rows(world, line):
    return painted_rows(world.ground, [(line, line.marking)], world.scene.stream)[0]


def marks_of(file_road):
    """(lane number, mark, its start and end) of all that is painted."""
    for number, lane in file_road.by_number.items():
        marks = lane.findall("roadMark")
        starts = [float(mark.get("sOffset")) for mark in marks]
        assert starts[:1] in ([], [0.0])
        for mark, start, end in zip(marks, starts, [*starts[1:], file_road.length_m], strict=False):
            if mark.get("type") != "none":
                yield number, mark, start, end


@each_road
def test_marks_are_the_delimiters_in_place_colour_and_dashes(road):
    world = world_of({"left_yellow": True, "left_double": True, "dash_cycle_m": 9, "dash_fraction": 0.3}, **road)
    lines = {line.id: line for line in world.site.lines if line.kind == "delimiter"}
    stations = {k: np.arange(max(-260, v.start_m), min(300, v.end_m), 0.05) for k, v in lines.items()}
    dense = {name: line.points_world(stations[name]) for name, line in lines.items()}
    marked = dict.fromkeys(lines, 0.0)
    n_dashes = 0
    for file_road in read_roads(opendrive(world, "test")).values():
        for number, mark, start, end in marks_of(file_road):

            def place(s, file_road=file_road, number=number):
                edge = file_road.sides(number, s)[1]
                return file_road.point(s, float(edge))

            points = np.array([place(s) for s in np.linspace(start, end, 5)[1:4]])
            errors = {name: np.hypot(*apart(points, line)).max() for name, line in dense.items()}
            name = min(errors, key=errors.get)
            line, rows = lines[name], _rows(world, lines[name])
            assert errors[name] < 0.05
            marked[name] += end - start
            kind = "solid solid" if is_double(line, world.scene.markings) else "solid"
            assert mark.get("type") == ("broken" if line.marking == "dashed" else kind)
            assert mark.get("color") == paint_color(line, world.scene.markings)
            stripes = mark.findall("type/line")
            assert [float(stripe.get("width")) for stripe in stripes] == [0.12] * (2 if " " in kind else 1)
            dash, gap, first = (float(stripes[0].get(key)) for key in ("length", "space", "sOffset"))
            if line.marking == "solid":
                assert (first, first + dash, gap) == pytest.approx((0, end - start, 0), abs=1e-6)
                continue
            middles = np.arange(start + first + dash / 2, end, dash / 2 + gap / 2)
            for s, is_painted in zip(middles, [True, False] * len(middles), strict=False):
                station = stations[name][np.linalg.norm(dense[name] - place(s), axis=1).argmin()]
                if rows.s[0] + 2 < station < rows.s[-1] - 2:
                    assert rows.painted[np.searchsorted(rows.s, station) - 1] == is_painted
                    n_dashes += 1
    assert n_dashes > 0
    for name, line in lines.items():
        steps = np.linalg.norm(np.diff(dense[name][:, :2], axis=0), axis=1)
        s = stations[name][:-1]
        # Behind the split, `stem_line` bounds lanes of two connecting roads.
        length = steps[np.abs(s) <= 250].sum() + (steps[s >= 0].sum() if name == "stem_line" else 0)
        assert marked[name] == pytest.approx(length, abs=4), line


@pytest.mark.parametrize(("road", "pair"), list(zip(ROADS, ["solid_dashed", "dashed_solid"] * 5, strict=True)), ids=str)
def test_the_stripes_of_mixed_pairs_lie_on_their_sides_with_their_dashes(road, pair):
    markings = {"left_double": True, "left_pair": pair, "width_m": 0.2, "dash_cycle_m": 9, "dash_fraction": 0.3}
    world = world_of(markings, **road)
    lines = [line for line in world.site.lines if is_double(line, world.scene.markings)]
    s = np.arange(-250, 250, 0.05)
    dense = {line.id: line.points_world(s[(s > line.start_m) & (s < line.end_m)]) for line in lines}
    found = set()
    for file_road in read_roads(opendrive(world, "test")).values():
        for number, mark, start, end in marks_of(file_road):
            stripes = {float(stripe.get("tOffset")): stripe for stripe in mark.findall("type/line")}
            if len(stripes) == 1 or end - start < 10:
                continue
            gaps = {t: float(stripe.get("space")) for t, stripe in stripes.items()}
            (solid_t,) = (t for t, gap in gaps.items() if gap == 0)
            assert sorted(gaps) == pytest.approx([-0.2, 0.2])
            at = (start + end) / 2
            edge = file_road.sides(number, at)[1]
            (here,), (aside,) = (np.atleast_2d(file_road.point(at, float(edge) + t)) for t in (0.0, solid_t))
            name = min(dense, key=lambda name: np.linalg.norm(dense[name][:, :2] - here[:2], axis=1).min())
            # The host drives towards +y: the side of +x is the driver's right.
            assert (aside[0] > here[0]) == (pair == "dashed_solid")
            # OpenDRIVE names the stripes from left to right on lane 0, elsewhere from the inside.
            first, last = (max, min) if number <= 0 else (min, max)
            words = ["solid" if gaps[side(gaps)] == 0 else "broken" for side in (first, last)]
            assert mark.get("type") == " ".join(words)
            # Numbers of lanes increase to the left; lanes are changed from the side of the dashes.
            assert mark.get("laneChange") == ("increase" if solid_t > 0 else "decrease")
            found.add(name)
    assert found == set(dense)


def local_corners(file_road, item):
    """The corners of an object in its own frame, in the world, where the road is nearly flat."""
    s, t, turn = (float(item.get(key)) for key in ("s", "t", "hdg"))
    here, ahead, left = (file_road.point(*at, 0.0) for at in ((s, t), (s + 0.01, t), (s, t + 1.0)))
    along, left = (ahead - here) / np.linalg.norm(ahead - here), left - here
    axes = np.stack([along, left, np.cross(along, left)])
    cos, sin = np.cos(turn), np.sin(turn)
    corners = [[float(c.get(key)) for key in "uvz"] for c in item.iterfind("outline/cornerLocal")]
    return here + np.array(corners) @ [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]] @ axes


def test_objects_stand_and_lie_where_the_worlds_do():
    scene = changed(FLAT, road={**BENT, "topology": 2}, terrain=HILLS)
    rail = Rail(
        kind="guardrail", road="main", side="left", from_m=-60, to_m=60, aside_m=0.5, height_m=0.8, color=(0, 0, 0)
    )
    post = Post(kind="lamp", road="main", side="left", s_m=-20, aside_m=1.5, height_m=8)
    building = Building(
        kind="house", x_m=-40, y_m=-30, yaw_rad=0.4, width_m=9, length_m=14, height_m=6, color=(0, 0, 0), roof=(0, 0, 0)
    )
    scene = scene.model_copy(
        update={
            "symbols": (
                Symbol(kind="crosswalk", lane=None, s_m=-30),
                Symbol(kind="arrow_right", lane="stem_3", s_m=-12),
            ),
            "trees": (Tree(model=1, x_m=30, y_m=-40, yaw_rad=0, scale=1),),
            "roadside": Roadside(rails=(rail,), posts=(post,), buildings=(building,)),
        }
    )
    world = resolve(scene)
    text = opendrive(world, "test")
    found = read_roads(text)
    places = {}
    for file_road in found.values():
        for item in file_road.element.iter("object"):
            s, t, z = (float(item.get(key)) for key in ("s", "t", "zOffset"))
            places[item.get("type"), item.get("subtype")] = (file_road, item, file_road.point(s, t, z))
    tree, house = places["tree", None][2], places["building", "house"][2]
    np.testing.assert_allclose(tree, world.site.trees_world[0], atol=0.05)
    model = world.scene.assets.tree_models[0]
    assert float(places["tree", None][1].get("height")) == pytest.approx(model.height_m)
    (read,) = (body for body in read_opendrive(text.encode(), "t", "t").bodies if body.kind == "tree")
    assert read.size_m[2] == pytest.approx(model.height_m)
    np.testing.assert_allclose(house[:2], (-40, -30), atol=0.05)
    np.testing.assert_allclose(places["pole", "streetLamp"][2], world.site.structures[1].feet_world[0], atol=0.3)
    for symbol, kind in zip(scene.symbols, (("crosswalk", "pedestrian"), ("roadMark", "arrowRight")), strict=True):
        file_road, item, _ = places[kind]
        form = shape(world.ground, symbol)
        outline = form.points_world(form.outline if symbol.lane is None else form.polygons[0])
        if symbol.kind == "crosswalk":
            # CARLA looks for corners in the object's own frame, right below it, the first one again at the end.
            corners_world = local_corners(file_road, item)
            np.testing.assert_allclose(corners_world[0], corners_world[-1], atol=1e-6)
            sides = np.abs([[float(c.get(key)) for key in "uv"] for c in item.iterfind("outline/cornerLocal")])
            assert sides[:, 0].min() > sides[:, 1].max(), "people walk along u"
            corners_world = corners_world[:-1]
        else:
            corners = [(float(c.get("s")), float(c.get("t"))) for c in item.iter("cornerRoad")]
            corners_world = np.array([file_road.point(s, t) for s, t in corners])
        assert np.linalg.norm(corners_world[:, None] - outline, axis=2).min(axis=1).max() < 0.05
        x, y = corners_world[:, :2].T
        assert (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() > 0, "counter-clockwise"
    lengths = [float(r.get("length")) for road in found.values() for r in road.element.iter("repeat")]
    assert sum(lengths) == pytest.approx(120, abs=6)


# What an id names, and which of its names are one kind: by the number alone CARLA tells a road from a junction.
KINDS = {"road": "road", "junction": "road", "signal": "signal", "object": "object", "controller": "controller"}
REFERENCES = ("elementId", "incomingRoad", "connectingRoad", "linkedRoad", "high", "low")
CROSSING = ("town.junction=crossing", "town.control=signals", "town.crosswalks=true", "town.walkway_m=2.6", *TOWN[1:])


def on_forks() -> World:
    given = read_opendrive(files.opendrive(*forks()), "forks.xodr", "map forks.xodr")
    return sample_world(replace(Scenes(load_params("streets"), 5, "round"), map=MapPlace(given)), 0)


def of_preset(preset: str, *changes: str) -> World:
    return sample_world(Scenes(load_params(preset, changes), 5, "round"), 0)


WORLDS = {
    "crossing": lambda: of_preset("town", *CROSSING),
    "direct junction of a given map": on_forks,
    "paper": lambda: of_preset("appendix_i", "road.topology=2"),
    "roundabout": lambda: of_preset(
        "town", "town.junction=roundabout", "town.crosswalks=true", "town.walkway_m=2.6", *TOWN[1:]
    ),
    "streets": lambda: of_preset("streets", "road.topology=3", "symbols.crosswalks=1"),
}


@pytest.mark.parametrize("name", first(3, WORLDS))
def test_ids_are_whole_numbers_of_one_thing_and_references_lead_there(name: str) -> None:
    root = ElementTree.fromstring(opendrive(WORLDS[name](), "test"))
    ids = Counter((KINDS[at.tag], at.get("id", "")) for at in root.iter() if at.tag in KINDS)
    assert all(number == str(int(number)) and 0 <= int(number) < 2**31 for _, number in ids)
    assert set(ids.values()) == {1}
    of_roads = {number for kind, number in ids if kind == "road"}
    named = {value for at in root.iter() for key, value in at.items() if key in REFERENCES}
    named |= {at.get("junction", "") for at in root.iter("road")} - {"-1"}
    assert named <= of_roads
    assert {at.get("id") for at in root.iter("signalReference")} <= {number for kind, number in ids if kind == "signal"}


def test_numbers_are_kept_and_others_get_those_that_are_free() -> None:
    assert numbered(["7", "s0", "2", "s1", "007", "-1"]) == {
        "7": "7",
        "s0": "1",
        "2": "2",
        "s1": "3",
        "007": "4",
        "-1": "5",
    }
    assert numbered(["7", "j0"], ["7", "1"]) == {"7": "2", "j0": "3"}


@pytest.mark.parametrize("name", first(1, ("crossing", "roundabout")))
def test_crosswalks_come_back_where_they_are(name: str) -> None:
    world = WORLDS[name]()
    text = opendrive(world, "test")
    given = read_opendrive(text.encode(), "test.xodr", "map test.xodr")
    ours = [np.array(paint.outline) for paint in world.scene.map.paint if paint.kind == "crosswalk"]
    found = [np.array(paint.outline) for paint in given.paint if paint.kind == "crosswalk"]
    assert len(found) == len(ours) > 0
    for outline in ours:
        apart = [np.linalg.norm(outline[:, None] - other, axis=2).min(axis=1).max() for other in found]
        assert min(apart) < 0.02
    root = ElementTree.fromstring(text)
    crosswalks = [item for item in root.iter("object") if item.get("type") == "crosswalk"]
    assert all(item.find("outline/cornerLocal") is not None for item in crosswalks), "where CARLA looks"


def where(item: TrafficSignal | TrafficSign) -> np.ndarray:
    """The middle of its head from above, its lower edge, and the direction of its traffic."""
    along = np.array([np.cos(item.yaw_rad), np.sin(item.yaw_rad)])
    return np.array([*np.array([item.x_m, item.y_m]) + item.reach_m * along, item.height_m, *along])


@pytest.mark.parametrize(
    "overrides", [("town.junction=crossing", "town.control=signals"), ("town.junction=roundabout",)]
)
def test_they_come_back_at_their_places_with_their_lanes(overrides: tuple[str, ...]) -> None:
    plain = ("trees.n=0", "town.fronts=0", "town.traffic=0", "town.turn_lanes=both", "town.n_lanes=2")
    world = draw_world(Scenes(load_params("town", (*overrides, *plain)), 5), 1)
    written = [item for item in world.scene.roadside.free_elements if item.lanes]
    text = opendrive(world, "town")
    given = read_opendrive(text.encode(), "t", "map t")
    ours = {road.get("id"): road.get("name") for road in ElementTree.fromstring(text).iter("road")}
    assert len(given.elements) == len(written) > 3
    assert set(given.left_out) == {"objects of type pole"}, "lamp posts, which given maps do not have"
    for item in written:
        apart = [np.abs(where(item) - where(read.element)).max() for read in given.elements]
        read = given.elements[int(np.argmin(apart))].element
        assert min(apart) < 0.02
        lanes = (lane.split(".", 1) for lane in read.lanes)
        assert {f"{ours[road]}.{number}" for road, number in lanes} == set(item.lanes)
        assert type(read) is type(item)
        name = "form" if isinstance(item, TrafficSignal) else "kind"
        assert getattr(read, name) == getattr(item, name)
