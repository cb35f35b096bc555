"""Paint, seams and symbols on the road: where they lie, what they leave free, and that they look in place."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import label as clusters
from scipy.spatial import cKDTree

from synth3dlanes.draw.sample import Scenes, sample_scene, sample_world
from synth3dlanes.geometry.frames import transform
from synth3dlanes.params.params import load_params
from synth3dlanes.scene.scene import Symbol
from synth3dlanes.truth.ground_truth import ground_truth, label
from synth3dlanes.validate.faces import MeshFaces
from synth3dlanes.world.paint import PAINT_LIFT_M
from synth3dlanes.world.seams import CLEAR_M, OLD_ASPHALT, WANDER_M, joint
from synth3dlanes.world.symbols import ARROWS, LENGTHS_M
from synth3dlanes.world.world import resolve
from tests.map_scenes import FOUR_WAY, LEFT_TURN, map_scene, sections_road
from tests.scenes import changed, seen_on_flat_ground
from tests.thorough import first


def painted_at(world, mesh, x_m, at_m):
    """Where a straight flat road has paint x_m to the right of its middle, by the faces of a line."""
    x = seen_on_flat_ground(world, mesh.vertices_world)[mesh.faces][:, :, 0].T
    y = world.network.stations(mesh.uv_m[mesh.faces][:, :, 1]).T
    there = (
        (x.min(axis=0) < x_m) & (x.max(axis=0) > x_m) & (y.min(axis=0) > at_m[0] - 9) & (y.max(axis=0) < at_m[-1] + 99)
    )
    low, high = y[:, there].min(axis=0), y[:, there].max(axis=0)
    return ((at_m[:, None] > low) & (at_m[:, None] < high)).any(axis=1)


@pytest.mark.parametrize("pair", ["solid_dashed", "dashed_solid"])
@pytest.mark.parametrize("flips", [(x, y) for x in (False, True) for y in (False, True)])
@pytest.mark.parametrize("median_m", first(2, [None, 4.0, 0.0]))
def test_the_solid_stripe_of_a_mixed_pair_is_on_the_side_the_scene_says_as_the_host_drives(median_m, flips, pair):
    oncoming = {} if median_m is None else {"n_oncoming": 2, "median_m": median_m}
    road = {"flip_longitudinal": flips[0], "flip_lateral": flips[1], **oncoming}
    markings = {"left_double": True, "width_m": 0.2, "dash_cycle_m": 8.0, "dash_fraction": 0.4}
    world = resolve(changed(road=road, markings=markings | {"left_pair": pair}))
    strips = world.paint(world.view)
    labels = {lane.id: lane for lane in label(world, world.view).lanes}
    lines = [name for name, lane in labels.items() if lane.double]
    assert len(lines) == (2 if median_m else 1)
    at_m = np.arange(-45, 40, 0.1) + 0.033
    for name in lines:
        assert (labels[name].marking, labels[name].pair) == ("solid", pair)
        x_m = labels[name].xyz_cam[0, 0] + world.view.eye_world[0]
        left, right = (painted_at(world, strips[name], x_m + side, at_m) for side in (-0.2, 0.2))
        solid, dashed = (left, right) if pair == "solid_dashed" else (right, left)
        assert solid.all(), "to the right of the line is the right of the driver"
        assert dashed.mean() == pytest.approx(0.4, abs=0.05)
        # The dashes are those of the dashed lines.
        lane = next(lane for lane in labels.values() if lane.marking == "dashed")
        beside_m = lane.xyz_cam[0, 0] + world.view.eye_world[0]
        assert (dashed == painted_at(world, strips[lane.id], beside_m, at_m)).mean() > 0.97
    assert {lane.pair for name, lane in labels.items() if name not in lines} == {None}


def test_the_stripes_of_a_mixed_pair_are_never_dots_and_lose_the_same_stretches():
    markings = {"left_double": True, "left_pair": "solid_dashed", "dash_cycle_m": 8.0, "missing": 0.4, "dots": True}
    world = resolve(changed(markings=markings))
    strips = world.paint(world.view)
    at_m = np.arange(-45, 90, 0.1) + 0.033
    solid, dashed = (painted_at(world, strips["main_line_0"], -5.25 + side, at_m) for side in (-0.12, 0.12))
    assert solid.mean() < 0.9
    assert not (dashed & ~solid).any()
    _, n = clusters(dashed)
    assert n < 20, "a dash is one piece, not four dots"


def test_paint_of_an_exit_lies_over_the_other_roads_pavement_in_a_hollow():
    world = resolve(sample_scene(Scenes(load_params("appendix_i"), seed=9400), index=79))
    eye = world.view.eye_world
    for name, mesh in world.paint(world.view).items():
        painted = mesh.vertices_world[np.unique(mesh.faces)]
        near = painted[np.linalg.norm(painted[:, :2] - eye[:2], axis=1) < 30]
        over_m = near[:, 2] - MeshFaces(world.site.surfaces.pavement).height(near[:, :2])
        assert np.nanmean(over_m > 0) > 0.98, name


SEAMS = {"tar": 1.0, "ghost_lines": 1.0, "joint": 1.0}


@pytest.mark.parametrize("flip", [False, True])
def test_a_joint_lies_inside_a_lane_and_either_side_may_be_older(flip):
    scene = changed(road={"flip_longitudinal": flip}, surface=SEAMS, camera={"lane": 1})
    network = resolve(scene).network
    found = [joint(network, 1.0, scene.model_copy(update={"seed": seed}).stream) for seed in range(40)]
    aside, darker = np.array(found).T
    assert (np.abs(aside[:, None] - [-5.25, -1.75, 1.75, 5.25]).min(axis=1) > CLEAR_M - 1e-6).all()
    assert np.unique(np.round(darker, 6)).tolist() == pytest.approx([1 - 1 / OLD_ASPHALT, 1 - OLD_ASPHALT])


MAPS = {"crossing": FOUR_WAY, "left turn": LEFT_TURN, "a lane that opens": sections_road()}


@pytest.mark.parametrize("name", MAPS)
def test_on_a_map_seams_lie_on_the_hosts_lanes_below_the_paint_and_clear_of_lines(name):
    scene = map_scene(MAPS[name], surface=SEAMS)
    world = resolve(scene)
    network, found = world.network, dict.fromkeys(("tar", "ghost"), 0)
    lanes = [lane for lane in network.lanes.values() if lane.direction == "same" and lane.junction is None]
    lines = np.concatenate([line.xy_world(np.arange(0.0, line.end_m, 0.1)) for line in network.delimiters])
    for kind, mesh in (("tar", world.tar(world.view)), ("ghost", world.ghost_lines(world.view))):
        seen = seen_on_flat_ground(world, mesh.vertices_world)[:, :2]
        near = world.ground.way.away_at(seen) < 40
        assert mesh.vertices_world[:, 2].min() > 0
        assert mesh.vertices_world[near, 2].max() < 0.7 * PAINT_LIFT_M[1]
        in_lane = np.zeros(len(seen), dtype=bool)
        for lane in lanes:
            road = network.road(lane.road)
            s, t = road.line.project(seen)
            left, right = lane.edges
            inside = (s > lane.start_m - 0.3) & (s < lane.end_m + 0.3)
            in_lane |= inside & (t > left(s) - 0.3) & (t < right(s) + 0.3)
        assert in_lane.all()
        # Cracks across the lanes cross lines; what runs along them keeps clear of these.
        middles = seen[mesh.faces].mean(axis=1)
        gaps_m, _ = cKDTree(lines).query(middles)
        is_along = gaps_m > CLEAR_M - WANDER_M - 0.05 - scene.markings.width_m / 2
        found[kind] = int(is_along.sum())
        assert is_along.all() or kind == "tar"
    assert min(found.values()) > 50


def test_no_joint_runs_through_the_lanes_of_a_map():
    """Its texture begins anew on every road, so one joint would be in other places of these."""
    world = resolve(map_scene(FOUR_WAY, surface=SEAMS))
    assert joint(world.network, 1.0, world.scene.stream) == (0.0, 0.0)


FLIPS = [(False, False), (True, False), (False, True), (True, True)]
FEW = ["trees.n=1", "cars.n=0"]
MANY = ["symbols.arrow_rows=3", "symbols.crosswalks=2", "symbols.stop_lines=2", "symbols.gore=true"]


def streets(*changes):
    """Without what stands beside the road: it takes most of the time of drawing."""
    params = load_params("streets", [*FEW, *changes])
    return params.model_copy(update={"roadside": load_params("appendix_i").roadside})


def with_symbols(scene, *symbols):
    return scene.model_copy(update={"symbols": tuple(Symbol(kind=k, lane=lane, s_m=s) for k, lane, s in symbols)})


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


@pytest.mark.parametrize(("kind", "n_lanes"), [("stop_line", 3), ("crosswalk", 5)])
@pytest.mark.parametrize("flip", [False, True])
def test_crosswalks_cross_the_oncoming_lanes_and_stop_lines_do_not_and_both_leave_the_lines_free(kind, n_lanes, flip):
    road = {"flip_longitudinal": flip, "n_oncoming": 2, "median_m": 0.0}
    scene = changed(road=road, markings={"left_double": True, "width_m": 0.2})
    world = resolve(with_symbols(scene, (kind, None, -40)))
    mesh = world.symbols(world.view)[0]
    x = seen_on_flat_ground(world, mesh.vertices_world[mesh.faces])[:, :, 0] * world.network.rightward
    assert x.max() < 5.25 < x.max() + 0.5
    assert x.min() > 5.25 - 3.5 * n_lanes > x.min() - 0.7
    for line_m in 5.25 - 3.5 * np.arange(n_lanes + 1):
        half_m = 0.3 if line_m == -5.25 else 0.1
        assert ((x.max(axis=1) < line_m - half_m + 1e-6) | (x.min(axis=1) > line_m + half_m - 1e-6)).all()


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


@pytest.mark.parametrize("n", first(1, [20, 60]))
def test_symbols_do_not_overlap_and_stand_clear_of_the_split(n):
    counts, params = [], streets(*MANY)
    for index in range(n):
        world = sample_world(Scenes(params), index)
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
