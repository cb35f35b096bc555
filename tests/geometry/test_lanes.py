"""The four topologies as the paper's table says, in words and in places."""

import numpy as np
import pytest

from synth3dlanes.roads.paper_roads import smooth_min
from synth3dlanes.world.world import resolve
from tests.scenes import changed


def network_of(topology, n=3, **road):
    return resolve(changed(road={"topology": topology, "n_lanes": n, **road})).network


def by_id(network):
    return {curve.id: curve for curve in network.curves}


def x_at(curve, s):
    return float(curve.xy_world(np.array([s]))[0, 0])


def width_m(network):
    return network.main.lane_width_m


def nose_m(network):
    return network.roads[-1].parting.station(0.0)


@pytest.mark.parametrize(
    ("topology", "expected"),
    [
        (2, {("stem_1", "main_1"), ("stem_2", "main_2"), ("stem_3", "main_3"), ("stem_3", "exit_1")}),
        (3, {("stem_1", "main_1"), ("stem_2", "main_2"), ("stem_2", "main_3"), ("stem_3", "exit_1")}),
        (4, {("stem_1", "main_1"), ("stem_2", "main_2"), ("stem_2", "exit_1"), ("stem_3", "exit_2")}),
    ],
)
def test_who_leads_where(topology, expected):
    assert set(network_of(topology).links) == expected


@pytest.mark.parametrize(("topology", "n_lines"), [(1, 4), (2, 6), (3, 7), (4, 6)])
def test_every_painted_line_once(topology, n_lines):
    lines = [curve for curve in network_of(topology).curves if curve.kind == "delimiter"]
    assert len(lines) == n_lines
    solid = {line.id for line in lines if line.marking == "solid"}
    outer = {1: {"main_line_0", "main_line_3"}}.get(topology)
    main_after = 2 if topology == 4 else 3
    exit_lanes = 2 if topology == 4 else 1
    assert solid == (outer or {"main_line_0", f"main_line_{main_after}", "exit_line_0", f"exit_line_{exit_lanes}"})


@pytest.mark.parametrize("topology", [2, 3, 4])
def test_curves_run_on_without_a_break_through_the_split(topology):
    network = network_of(topology, n=4, offset_p50_m=9, offset_m50_m=-6)
    for curve in network.curves:
        if curve.pieces[0].start_m > -np.inf:
            continue
        s = np.linspace(-3, min(3, curve.end_m), 601)
        steps = np.linalg.norm(np.diff(curve.xy_world(s), axis=0), axis=1)
        assert steps.max() < 0.45, curve.id
        across = [network.main.line.project(curve.xy_world(s))[1]]
        assert np.abs(np.diff(across)).max() < 0.03, f"{curve.id} jumps sideways"


def test_the_rounded_minimum_stays_within_two_centimetres_and_has_no_corner():
    q = np.linspace(2, 5, 3001)
    value = smooth_min(q, 3.5)
    assert np.abs(value - np.minimum(q, 3.5)).max() <= 0.0151
    assert np.abs(np.diff(value, 2)).max() < 2e-5


@pytest.mark.parametrize("merge", [False, True])
def test_the_graph_runs_in_driving_direction(merge):
    network = network_of(2, flip_lateral=merge)
    graph = network.graph([curve.id for curve in network.curves])
    if merge:
        assert graph.successors["exit_1"] == ("stem_3",)
        assert {x.id: x.s_start_m for x in graph.segments}["stem_1"] == 0
    else:
        assert graph.successors["stem_3"] == ("main_3", "exit_1")
        assert {x.id: x.s_end_m for x in graph.segments}["stem_1"] == 0
    stem = next(x for x in graph.segments if x.id == "stem_3")
    assert set(stem.centerlines) == {"main_3", "exit_1"}, "both paths of a split share their stem"


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("topology", [1, 2, 3, 4])
def test_what_is_called_left_lies_to_the_left(topology, flip):
    network = network_of(topology, flip_longitudinal=flip)
    lines = by_id(network)
    for curve in lines.values():
        s = 30.0 if curve.id == "stem_line" else 80.0
        if curve.id == "stem_line":
            s = nose_m(network) - 1
        for is_right, sign in ((False, -1), (True, 1)):
            side = curve.beside(is_right, s, lines)
            if side in lines:
                gap = x_at(lines[side], s) - x_at(curve, s)
                assert 0 < sign * gap < 1.2 * width_m(network), (curve.id, side)
