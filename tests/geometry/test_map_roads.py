"""Maps as networks: labels against an independent reading of the map's polynomials, paths, directions and links."""

import numpy as np
import pytest

from synth3dlanes.labels import labels as label_file
from synth3dlanes.scene import scene as scene_file
from synth3dlanes.scene.road_map import RoadMap
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.world import resolve
from tests.map_scenes import FOUR_WAY, HILLS, LEFT_TURN, T_JUNCTION, map_scene, sections_road

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
