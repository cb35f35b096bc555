"""Symbols on the road: where they lie, that they look in place, and that they keep clear of lines and of each other."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.geometry.frames import transform
from synth3dlanes.params.params import load_params
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.scene.scene import Symbol
from synth3dlanes.system.errors import FormatError
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.symbols import ARROWS, LENGTHS_M, shape
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed, seen_on_flat_ground

FLIPS = [(False, False), (True, False), (False, True), (True, True)]
FEW = ["trees.n=1", "cars.n=0"]
MANY = ["symbols.arrow_rows=3", "symbols.crosswalks=2", "symbols.stop_lines=2", "symbols.gore=true"]


def streets(*changes):
    """Without what stands beside the road: it takes most of the time of drawing."""
    params = load_params("streets", [*FEW, *changes])
    return params.model_copy(update={"roadside": load_params("appendix_i").roadside})


def with_symbols(scene, *symbols):
    return scene.model_copy(update={"symbols": tuple(Symbol(kind=k, lane=lane, s_m=s) for k, lane, s in symbols)})


def area(polygon):
    """Of a polygon, by the shoelace formula."""
    x, y = polygon.T
    return abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2


def face_areas(mesh):
    """Of the faces seen from above; positive with the front side up."""
    a, b, c, d = (mesh.vertices_world[mesh.faces[:, i], :2] for i in range(4))
    p, q = c - a, d - b
    return (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]) / 2


@pytest.mark.parametrize(("across", "along"), FLIPS)
@pytest.mark.parametrize("kind", ARROWS)
def test_an_arrow_lies_on_its_lane_and_points_as_the_host_drives(kind, across, along):
    scene = with_symbols(changed(road={"flip_longitudinal": across, "flip_lateral": along}), (kind, "main_3", -30))
    (label,) = ground_truth(scene).symbols
    x, y = label.xyz_cam[:, 0], transform(ground_truth(scene).camera.road_from_cam, label.xyz_cam)[:, 1]
    middle = 3.5  # the host is in the middle of lane 2 of 3
    np.testing.assert_allclose([y.min(), y.max()], [20 - 2.5, 20 + 2.5], atol=1e-6)
    reach = x - middle
    sides = {"left": -reach.min() > 1.5 * reach.max(), "right": reach.max() > -1.5 * reach.min()}
    assert [side for side, is_so in sides.items() if is_so] == [side for side in sides if side in kind]
    if kind == "arrow_straight":
        assert y[np.argmin(np.abs(reach) + (y < 22))] == pytest.approx(22.5), "the head is ahead"


@pytest.mark.parametrize("kind", ["arrow_straight_left", "stop_line", "crosswalk"])
def test_paint_covers_its_polygons_once_and_is_seen_where_it_lies(kind):
    world = resolve(with_symbols(FLAT, (kind, "main_2" if kind.startswith("arrow") else None, -35)))
    (mesh,), form = world.symbols(world.view), shape(world.ground, world.scene.symbols[0])
    assert (face_areas(mesh) > -1e-9).all(), "faces face up"
    seen = seen_on_flat_ground(world, mesh.vertices_world)
    flat = dataclasses.replace(mesh, vertices_world=seen)
    assert face_areas(flat).sum() == pytest.approx(sum(map(area, form.polygons)), rel=1e-6)
    assert mesh.vertices_world[:, 2].min() > 0.001
    low, high = seen[:, 1].min(), seen[:, 1].max()
    assert (low, high) == pytest.approx((-35 - LENGTHS_M[kind] / 2, -35 + LENGTHS_M[kind] / 2), abs=1e-6)


@pytest.mark.parametrize("kind", ["stop_line", "crosswalk"])
@pytest.mark.parametrize("flip", [False, True])
def test_crossings_leave_the_lines_free(kind, flip):
    markings = {"left_double": True, "width_m": 0.2}
    world = resolve(with_symbols(changed(markings=markings, road={"flip_longitudinal": flip}), (kind, None, -40)))
    mesh = world.symbols(world.view)[0]
    x = seen_on_flat_ground(world, mesh.vertices_world[mesh.faces])[:, :, 0]
    for line, half_m in ((-5.25, 0.3), (-1.75, 0.1), (1.75, 0.1), (5.25, 0.1)):
        beside = (x.max(axis=1) < line - half_m + 1e-6) | (x.min(axis=1) > line + half_m - 1e-6)
        assert beside.all()
    assert (np.abs(x) < 5.25).all()


@pytest.mark.parametrize(("kind", "n_lanes"), [("stop_line", 3), ("crosswalk", 5)])
@pytest.mark.parametrize("flip", [False, True])
def test_crosswalks_cross_the_oncoming_lanes_and_stop_lines_do_not(kind, n_lanes, flip):
    road = {"flip_longitudinal": flip, "n_oncoming": 2, "median_m": 0.0}
    scene = changed(road=road, markings={"left_double": True, "width_m": 0.2})
    world = resolve(with_symbols(scene, (kind, None, -40)))
    mesh = world.symbols(world.view)[0]
    x = seen_on_flat_ground(world, mesh.vertices_world)[:, 0] * world.network.rightward
    assert x.max() < 5.25 < x.max() + 0.5
    assert x.min() > 5.25 - 3.5 * n_lanes > x.min() - 0.7
    double_m = 0.3
    assert not ((x > -5.25 - double_m + 1e-6) & (x < -5.25 + double_m - 1e-6)).any()


@pytest.mark.parametrize("topology", [2, 3, 4])
@pytest.mark.parametrize(("across", "along"), FLIPS)
def test_a_gore_is_hatched_between_its_lines_before_the_ramp_rises(topology, across, along):
    road = {"topology": topology, "flip_longitudinal": across, "flip_lateral": along, "exit_angle_rad": 0.08}
    scene = changed(road=road | {"shoulder_factor": 0.7}, camera={"lane": 1})
    network = resolve(scene).network
    main, branch = network.roads
    nose_m = branch.parting.station(0.0)
    start = float(nose_m + 8) * network.onwards
    world = resolve(with_symbols(scene, ("gore", None, start)))
    (mesh,) = world.symbols(world.view)
    seen = seen_on_flat_ground(world, mesh.vertices_world)[:, :2]
    s, t = main.line.project(seen)
    _, branch_t = branch.line.project(seen, s)
    assert (face_areas(mesh) > -1e-9).all()
    assert len(mesh.faces) > 20
    assert s.min() > nose_m
    assert s.max() < branch.ramp.start_m + 0.5
    half_m = scene.markings.width_m / 2
    assert (t > (scene.road.n_main_after - scene.road.n_lanes / 2) * scene.road.lane_width_m + half_m).all(), (
        "right of the main road's line, in the plan"
    )
    assert (branch_t < -scene.road.n_exit_lanes * scene.road.lane_width_m / 2 - half_m).all(), "left of the exit's line"


def test_symbols_do_not_overlap_and_stand_clear_of_the_split():
    counts, params = [], streets(*MANY)
    for index in range(60):
        world = resolve(sample_scene(Scenes(params), index))
        scene, network = world.scene, world.network
        counts.append(len(scene.symbols))
        rows = {
            (s.kind.startswith("arrow") or s.kind, s.s_m): LENGTHS_M[s.kind] for s in scene.symbols if s.kind != "gore"
        }
        places = sorted((s_m, length) for (_, s_m), length in rows.items())
        for (a, la), (b, lb) in pairwise(places):
            assert b - a > (la + lb) / 2
        for symbol in scene.symbols:
            s = symbol.s_m * network.onwards
            for branch in network.roads[1:]:
                assert s < -8 or (s > branch.parting.station(0.0) and symbol.kind not in ("stop_line", "crosswalk"))
    assert np.mean(counts) > 8


def test_arrows_point_where_their_lane_leads():
    kinds = {"right": set(), "left": set()}
    params = streets("symbols.arrow_rows=2", "road.topology=4", "road.flip_lateral=false")
    for index in range(16):
        scene = sample_scene(Scenes(params, 1, "train"), index)
        for symbol in scene.symbols:
            if symbol.kind.startswith("arrow") and symbol.lane.startswith("stem"):
                side = "left" if scene.road.flip_longitudinal else "right"
                lane = int(symbol.lane.removeprefix("stem_"))
                outer = lane == (1 if side == "left" else scene.road.n_lanes)
                kinds[side].add((outer, symbol.kind))
                assert not outer or symbol.kind == f"arrow_{side}"
    assert all(kinds.values())


def test_a_symbol_needs_its_lane():
    scene = with_symbols(FLAT, ("arrow_left", "main_7", -20))
    with pytest.raises(FormatError, match=r"symbols\.0\.lane: expected one of main_1, main_2, main_3, got main_7"):
        scene_module.from_json(scene_module.to_json(scene), "scene.json")
    scene = with_symbols(FLAT, ("gore", None, 20))
    with pytest.raises(FormatError, match=r"symbols\.0\.kind: expected a road with an exit"):
        scene_module.from_json(scene_module.to_json(scene), "scene.json")
