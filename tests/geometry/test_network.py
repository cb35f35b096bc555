"""Networks made by hand: paths and ids follow from links, and the ground is that of all roads."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.roads.lane_curves import LaneCurve, Piece
from synth3dlanes.roads.map_lines import Spiral
from synth3dlanes.roads.network import LanePattern, Network
from synth3dlanes.roads.paper_roads import paths_through
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene.scene import Terrain
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.horizon import FarHills
from tests.scenes import FLAT, hill

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
    return Network(TERRAIN, roads, by_id, links, paths, (), way, LanePattern(3.5, 1))


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
    ground = Ground(network_of((street("near0", (0.0, 0.0)), across)), 20.0, FLAT.markings, NO_HILLS)
    assert ground.clearance(np.array([[0.0, 100.0], [8.0, 103.0], [5.5, 50.0]])) == pytest.approx([-2.5, 0.5, 3.0])
    crossing = np.array([[0.0, 100.0], [2.0, 101.0], [-2.4, 98.0]])
    np.testing.assert_allclose(ground.above_terrain(crossing), 0, atol=1e-12)
    assert (ground.above_terrain(np.array([[6.0, 104.5]])) < 0).all(), "a verge"
