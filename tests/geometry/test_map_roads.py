"""Maps as networks: paths, directions, links, lines and what drives on them."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.labels import labels as label_file
from synth3dlanes.roads.from_paper import paths_through
from synth3dlanes.roads.lane_curves import LaneCurve, Piece
from synth3dlanes.roads.line_forms import Chain, Cubic, Spiral
from synth3dlanes.roads.line_table import RoadLines
from synth3dlanes.roads.network import LanePattern, Network
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene import scene as scene_file
from synth3dlanes.scene.road_map import RoadMap
from synth3dlanes.scene.scene import Terrain
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.horizon import FarHills
from synth3dlanes.world.host_way import HostWay
from synth3dlanes.world.verges import Verges
from synth3dlanes.world.world import resolve
from tests.map_scenes import FOUR_WAY, HILLS, LEFT_TURN, T_JUNCTION, map_scene, sections_road
from tests.scenes import FLAT, hill

MAPS = {"four way": FOUR_WAY, "left turn": LEFT_TURN, "T": T_JUNCTION, "sections": sections_road()}


@pytest.mark.parametrize("name", MAPS)
def test_every_lane_meets_its_successors(name):
    network = resolve(map_scene(MAPS[name], 40.0, terrain=HILLS.model_dump())).network
    for a, b in network.links:
        ends = []
        for lane, which in ((network.lanes[a], 1), (network.lanes[b], 0)):
            s = np.linspace(*lane.driven, 1001)[[-2, -1] if which else [0, 1]]
            ends.append(network.road(lane.road).points(s, lane.middle(s)))
        if (a, b) == ("r.0.-1", "r.1.-2"):  # opens beside its predecessor
            continue
        assert np.linalg.norm(ends[0][1] - ends[1][0]) < 0.01, (a, b)
        ways = [np.diff(end, axis=0)[0] / np.linalg.norm(np.diff(end, axis=0)) for end in ends]
        assert np.degrees(np.arccos(np.clip(ways[0] @ ways[1], -1, 1))) < 0.4, (a, b)


def test_paths_end_at_junctions_and_each_connector_is_one():
    network = resolve(map_scene(T_JUNCTION, 40.0)).network
    found = {path.id: ([lane.id for lane in path.lanes], path.connector, path.junction) for path in network.paths}
    arms = [f"{arm}.0.{n}" for arm in ("south", "east", "west") for n in (1, -1)]
    ways = [f"{a}_{b}.0.-1" for a in ("south", "east", "west") for b in ("south", "east", "west") if a != b]
    assert found == {name: ([name], False, None) for name in arms} | {name: ([name], True, "cross") for name in ways}
    along = {
        path.id: [lane.id for lane in path.lanes] for path in resolve(map_scene(sections_road(), 9.0)).network.paths
    }
    assert along == {
        "r.0.-1": ["r.0.-1"], "r.1.-1": ["r.1.-1", "r.2.-1"], "r.1.-2": ["r.1.-2", "r.2.-2"],
        "r.2.1": ["r.0.1", "r.1.1", "r.2.1"],
    }  # fmt: skip


def test_direction_is_relative_to_the_host_on_its_roads_and_crossing_elsewhere():
    labels = ground_truth(map_scene(FOUR_WAY, 60.0))
    lanes = {lane.id: lane for lane in labels.lanes}
    same = {"south.0.1", "south_north.0.-1", "north.0.-1"}
    oncoming = {"south.0.-1", "north_south.0.-1", "north.0.1"}
    for lane in labels.lanes:
        if lane.kind == "centerline":
            expected = "same" if lane.id in same else "oncoming" if lane.id in oncoming else "crossing"
            assert (lane.id, lane.direction) == (lane.id, expected)
        ahead = lane.xyz_cam[-1, 1] - lane.xyz_cam[0, 1]
        assert lane.direction == "crossing" or ahead > 0, f"{lane.id} goes ahead"
    assert lanes["south.0.0.line"].left == "south.0.-1"
    assert lanes["south.0.0.line"].right == "south.0.1"
    assert (lanes["west.0.1"].left, lanes["west.0.1"].right) == ("west.0.0.line", "west.0.1.line")
    assert (lanes["south.0.-1"].left, lanes["south.0.-1"].right) == ("south.0.-1.line", "south.0.0.line")


def test_the_graph_has_successors_junctions_and_who_yields():
    graph = ground_truth(map_scene(FOUR_WAY, 60.0)).graph
    arms = ("south", "north", "east", "west")
    assert set(graph.successors["south.0.1"]) == {f"south_{arm}.0.-1" for arm in arms[1:]}
    assert graph.successors["west_north.0.-1"] == ("north.0.-1",)
    junctions = {segment.id: segment.junction for segment in graph.segments}
    assert junctions["west_north.0.-1"] == "cross"
    assert junctions["north.0.-1"] is None
    assert graph.yields == tuple((f"east_{arm}.0.-1", "south_north.0.-1") for arm in ("south", "north", "west"))


def test_a_mark_of_two_stripes_is_told_from_the_left_as_its_line_goes():
    lanes = {lane.id: lane for lane in ground_truth(map_scene(sections_road(), 9.0)).lanes}
    middle = lanes["r.0.0.line"]
    assert (middle.marking, middle.double, middle.pair, middle.color) == ("solid", True, "solid_dashed", "yellow")
    assert lanes["r.0.-1.line"].marking == "solid"
    assert (lanes["r.1.-1.line"].marking, lanes["r.1.-1.line"].color) == ("dashed", "white")
    assert len(lanes["r.0.-1.line"].xyz_cam) > 90, "an edge line goes on along the lane that opens"


def test_scenes_and_labels_of_maps_come_back_from_their_files():
    scene = map_scene(FOUR_WAY, 60.0)
    assert scene_file.from_json(scene_file.to_json(scene), "a") == scene
    labels = ground_truth(scene)
    text = label_file.to_json(labels)
    assert label_file.to_json(label_file.from_json(text, "a")) == text


def test_neighbours_and_numbers_count_from_the_left_of_the_traffic():
    graph = ground_truth(map_scene(sections_road(), 60.0)).graph
    at = {segment.id: segment for segment in graph.segments}
    assert (at["r.2.-1"].lane, at["r.2.-1"].left, at["r.2.-1"].right) == (1, None, "r.2.-2")
    assert (at["r.2.-2"].lane, at["r.2.-2"].left, at["r.2.-2"].right) == (2, "r.2.-1", None)
    assert (at["r.1.1"].s_start_m, at["r.1.1"].s_end_m) == (110.0, 50.0)


def test_a_map_names_its_lanes_and_links():
    values = FOUR_WAY.model_dump()
    with pytest.raises(ValueError, match=r"route: expected linked lanes, got south.0.1 and north.0.-1"):
        RoadMap.model_validate(values | {"route": ("south.0.1", "north.0.-1")})
    car = {"model": 1, "scale": 1.0, "color": (1, 1, 1), "gloss": 0.5, "lane": "south.0.-3", "s_m": 3.0}
    with pytest.raises(ValueError, match=r"cars.0.lane: expected driving lanes of the map, got south.0.-3"):
        map_scene(FOUR_WAY, 60.0, cars=(car,))


ARC = Spiral(60.0, (3.0, -2.0), 0.7, 0.02)
SPIRAL = Spiral(80.0, (1.0, 5.0), -0.4, 0.01, -0.0006)
CUBIC = Cubic(50.0, (1.0, 0.9, 0.01, -0.0001), (2.0, 0.5, -0.004, 0.0002))
CHAIN = Chain.of([Spiral(30.0, (0.0, 0.0), 0.2), Spiral(40.0, (30 * np.cos(0.2), 30 * np.sin(0.2)), 0.2, 0.0, 0.001)])
LINES = [Spiral(50.0, (0.0, 1.0), 1.1), ARC, SPIRAL, CUBIC, CHAIN]


@pytest.mark.parametrize("line", LINES)
def test_normals_speed_and_turn_are_those_of_the_points(line):
    s, h = np.linspace(1, 49, 97), 1e-4
    s = s[np.abs(s - 30) > 1e-3] if line is CHAIN else s
    before, here, after = (line.frames(s + step) for step in (-h, 0, h))
    step = (after.points_world - before.points_world) / (2 * h)
    np.testing.assert_allclose(here.speed, np.linalg.norm(step, axis=1), rtol=1e-6)
    right = np.stack([step[:, 1], -step[:, 0]], -1) / here.speed[:, None]
    np.testing.assert_allclose(here.normals, right, atol=1e-6)
    heading = [np.unwrap(np.arctan2(at.normals[:, 1], at.normals[:, 0])) for at in (before, after)]
    np.testing.assert_allclose(here.turn, -(heading[1] - heading[0]) / (2 * h), atol=1e-5)


@pytest.mark.parametrize("line", LINES)
def test_places_are_found_again_and_t_grows_to_the_right(line):
    s = np.linspace(1, line.length_m - 1, 60)
    for t in (-6.0, 0.0, 9.0):
        back_s, back_t = line.project(line.xy(s, t))
        np.testing.assert_allclose([back_s, back_t], [s, np.full(60, t)], atol=1e-6)
    ahead, aside = line.xy(s + 0.1, 0.0) - line.xy(s, 0.0), line.xy(s, 1.0) - line.xy(s, 0.0)
    assert (ahead[:, 0] * aside[:, 1] - ahead[:, 1] * aside[:, 0] < 0).all()


def test_a_polyline_runs_through_its_points_by_length():
    points = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 14.0], [11.0, 20.0]])
    line = Chain.through(points)
    np.testing.assert_allclose(line.frames(np.array([0.0, 5.0, 15.0, 25.0])).points_world, points, atol=1e-9)
    np.testing.assert_allclose(line.frames(np.array([10.0])).points_world, [[3.0, 9.0]], atol=1e-9)


TERRAIN = Terrain(gaussians=(hill(40, 60, 12, 90), hill(-80, 20, -8, 70)))
NO_HILLS = FarHills(0.0, np.zeros((2, 1)), np.zeros(1))


def street(name, start, heading_rad=np.pi / 2, length_m=200.0):
    lane = NetworkLane(f"{name}_1", name, name, 1, Offset(0.0), 3.5, 0.0, length_m)
    line = Spiral(length_m, start, heading_rad)
    return Road(name, line, TERRAIN, Offset(-2.5), Offset(2.5), 0.75, (lane,), 0.0, length_m)


def network_of(roads, links=()):
    """The roads; the host drives along the first one."""
    lanes = [lane for road in roads for lane in road.lanes]
    piece = Piece(roads[0], Offset(0.0), 0.0, roads[0].end_m)
    way = LaneCurve("way", "centerline", roads[0].id, "none", (), (piece,), 0.0, roads[0].end_m)
    paths = paths_through(roads, lanes, links, (), to_right=True)
    by_id = {lane.id: lane for lane in lanes}
    lines = RoadLines(paths, {road.id: road for road in roads}, 1.0)
    return Network(TERRAIN, roads, by_id, links, paths, (), way, lines, LanePattern(3.5, 1))


def test_paths_neighbours_and_successors_follow_from_links():
    """A street that splits into two, and one of the two that another joins."""
    spans = {"stem": (0.0, 200.0), "main": (200.0, 400.0)}
    lanes = [NetworkLane(f"{name}_1", "main", name, 1, Offset(0.0), 3.5, *span) for name, span in spans.items()]
    main = replace(street("main", (0.0, 0.0), length_m=400.0), lanes=tuple(lanes))
    roads = main, street("exit", (0.0, 200.0), 1.4)
    split = network_of(roads, (("stem_1", "main_1"), ("stem_1", "exit_1")))
    assert [(path.id, [lane.id for lane in path.lanes]) for path in split.paths] == [
        ("main_1", ["stem_1", "main_1"]), ("exit_1", ["stem_1", "exit_1"])
    ]  # fmt: skip
    graph = split.graph(["main_1", "exit_1"])
    assert graph.successors == {"stem_1": ("main_1", "exit_1")}
    assert {at.id: at.centerlines for at in graph.segments} == {
        "stem_1": ("main_1", "exit_1"), "main_1": ("main_1",), "exit_1": ("exit_1",)
    }  # fmt: skip
    merge = network_of(roads, (("main_1", "stem_1"), ("exit_1", "stem_1")))
    assert [path.id for path in merge.paths] == ["main_1", "exit_1"]


def test_where_pavements_overlap_the_ground_is_theirs_and_clearance_is_to_the_nearest():
    across = street("near9", (-100.0, 100.0), 0.0)
    way = HostWay(network_of((street("near0", (0.0, 0.0)), across)), 20.0)
    ground = Ground(Verges(way, FLAT.markings, NO_HILLS))
    assert ground.clearance(np.array([[0.0, 100.0], [8.0, 103.0], [5.5, 50.0]])) == pytest.approx([-2.5, 0.5, 3.0])
    crossing = np.array([[0.0, 100.0], [2.0, 101.0], [-2.4, 98.0]])
    np.testing.assert_allclose(ground.above_terrain(crossing), 0, atol=1e-12)
    assert (ground.above_terrain(np.array([[6.0, 104.5]])) < 0).all(), "a verge"
