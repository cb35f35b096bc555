"""A network of many roads, made by hand: what is far away costs nothing and changes nothing; ids follow from links."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.roads.map_lines import Spiral
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene.scene import Terrain
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.horizon import FarHills
from tests.scenes import FLAT, hill

TERRAIN = Terrain(gaussians=(hill(40, 60, 12, 90), hill(-80, 20, -8, 70)))
NO_HILLS = FarHills(0.0, np.zeros((2, 1)), np.zeros(1))


class Counted(Spiral):
    """A straight line that counts the points that are projected onto it."""

    n_points = 0

    def project(self, xy_world, guess=None):
        type(self).n_points += len(xy_world)
        return super().project(xy_world, guess)


def street(name, start, heading_rad=np.pi / 2, length_m=200.0):
    lane = NetworkLane(f"{name}_1", name, name, 1, Offset(0.0), 3.5, 0.0, length_m)
    line = Counted(length_m, start, heading_rad)
    return Road(name, line, TERRAIN, Offset(-2.5), Offset(2.5), 0.75, (lane,), 0.0, length_m)


def streets(n_far):
    near = [street(f"near{i}", (30.0 * i, 0.0)) for i in range(3)]
    return Network(TERRAIN, (*near, *(street(f"far{i}", (3000.0, 500.0 * i)) for i in range(n_far))), (), ())


def ground_of(network):
    return Ground(network, 20.0, FLAT.markings, NO_HILLS)


def test_a_network_of_two_hundred_roads_costs_what_the_near_ones_cost():
    x, y = np.meshgrid(np.arange(-40, 120, 3.0), np.arange(-20, 220, 3.0))
    xy, counts, heights = np.stack([x.ravel(), y.ravel()], -1), [], []
    for n_far in (0, 200):
        network = streets(n_far).around(np.array([0.0, 20.0]), 450.0)
        Counted.n_points = 0
        heights.append(ground_of(network).height(xy))
        counts.append((len(network.roads), Counted.n_points))
    assert counts[0] == counts[1]
    assert counts[0][0] == 3
    np.testing.assert_array_equal(*heights)


def test_paths_neighbours_and_successors_follow_from_links():
    """A street that splits into two, and one of the two that another joins."""
    spans = {"stem": (0.0, 200.0), "main": (200.0, 400.0)}
    lanes = [NetworkLane(f"{name}_1", "main", name, 1, Offset(0.0), 3.5, *span) for name, span in spans.items()]
    main = replace(street("main", (0.0, 0.0), length_m=400.0), lanes=tuple(lanes))
    roads = main, street("exit", (0.0, 200.0), 1.4)
    split = Network(TERRAIN, roads, (), (("stem_1", "main_1"), ("stem_1", "exit_1")))
    assert [(path.id, [lane.id for lane in path.lanes]) for path in split.paths] == [
        ("main_1", ["stem_1", "main_1"]), ("exit_1", ["stem_1", "exit_1"])
    ]  # fmt: skip
    graph = split.graph(["main_1", "exit_1"])
    assert graph.successors == {"stem_1": ("main_1", "exit_1")}
    assert {at.id: at.centerlines for at in graph.segments} == {
        "stem_1": ("main_1", "exit_1"), "main_1": ("main_1",), "exit_1": ("exit_1",)
    }  # fmt: skip
    merge = Network(TERRAIN, roads, (), (("main_1", "stem_1"), ("exit_1", "stem_1")))
    assert [path.id for path in merge.paths] == ["main_1", "exit_1"]


def test_where_pavements_overlap_the_ground_is_theirs_and_clearance_is_to_the_nearest():
    across = street("near9", (-100.0, 100.0), 0.0)
    ground = ground_of(Network(TERRAIN, (street("near0", (0.0, 0.0)), across), (), ()))
    assert ground.clearance(np.array([[0.0, 100.0], [8.0, 103.0], [5.5, 50.0]])) == pytest.approx([-2.5, 0.5, 3.0])
    crossing = np.array([[0.0, 100.0], [2.0, 101.0], [-2.4, 98.0]])
    np.testing.assert_allclose(ground.above_terrain(crossing), 0, atol=1e-12)
    assert (ground.above_terrain(np.array([[6.0, 104.5]])) < 0).all(), "a verge"
