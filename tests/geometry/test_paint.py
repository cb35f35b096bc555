"""Paint beyond the paper: double lines about their label, lost stretches; and who is the leftmost line."""

import numpy as np
import pytest
from scipy.ndimage import label as clusters

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.params.params import load_params
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.faces import mesh_height
from synth3dlanes.world.paint import DOT_HEIGHT_M, DOT_M, DOTS_M
from synth3dlanes.world.world import resolve
from tests.scenes import changed, seen_on_flat_ground
from tests.thorough import first


def painted_share(world, name, low=-40, high=90):
    """Painted metres of a straight road's line per metre, by the ends of its faces."""
    mesh = world.paint(world.view)[name]
    y = world.network.stations(mesh.uv_m[mesh.faces][:, :, 1])
    return (np.clip(y.max(axis=1), low, high) - np.clip(y.min(axis=1), low, high)).sum() / (high - low)


@pytest.mark.parametrize("flip", [False, True])
def test_a_double_line_is_two_stripes_about_the_left_edge_and_nothing_else_changes(flip):
    road = {"flip_longitudinal": flip}
    plain = resolve(changed(road=road))
    single = plain.paint(plain.view)
    world = resolve(changed(road=road, markings={"left_double": True, "width_m": 0.12}))
    double = world.paint(world.view)
    points = double["main_line_0"].vertices_world
    near = points[(points[:, 1] > -45) & (points[:, 1] < 0)]
    x = np.unique(np.round(seen_on_flat_ground(world, near)[:, 0], 3))
    np.testing.assert_allclose(x, -5.25 + 0.12 * np.array([-1.5, -0.5, 0.5, 1.5]), atol=1e-6)
    for name in single.keys() - {"main_line_0"}:
        np.testing.assert_array_equal(single[name].vertices_world, double[name].vertices_world)


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


@pytest.mark.parametrize("flip", [False, True])
def test_left_edges_have_no_paint_to_their_left(flip):
    world = resolve(changed(road={"topology": 4, "flip_longitudinal": flip}))
    assert {line.id for line in world.site.lines if line.is_inner} == {"main_line_0", "exit_line_0"}
    strips = world.paint(world.view)
    behind = {name: mesh.vertices_world[mesh.vertices_world[:, 1] < -30, 0] for name, mesh in strips.items()}
    leftmost = min((x.min(), name) for name, x in behind.items() if len(x))[1]
    assert leftmost == ("exit_line_0" if flip else "main_line_0")


@pytest.mark.thorough
def test_missing_paint_is_the_share_asked_for_in_stretches_that_stay_where_they_are():
    shares = []
    for seed in range(40):
        scene = changed(markings={"missing": 0.4}).model_copy(update={"seed": seed})
        shares += [painted_share(resolve(scene), name) for name in ("main_line_0", "main_line_3")]
    assert np.mean(shares) == pytest.approx(0.6, abs=0.02)
    assert len(np.unique(np.round(shares, 3))) > 40, "every line of every scene has its own gaps"
    near, far = (resolve(changed(markings={"missing": 0.4}, camera={"y_m": y})) for y in (-60, -20))
    assert painted_share(near, "main_line_0", 0, 90) == pytest.approx(painted_share(far, "main_line_0", 0, 90))


def test_all_of_the_paint_may_be_missing_and_none_is_by_default():
    bare = resolve(changed(markings={"missing": 1.0}))
    assert [painted_share(bare, f"main_line_{i}") for i in range(4)] == pytest.approx([0] * 4)
    assert painted_share(resolve(changed()), "main_line_0") == pytest.approx(1.0)


def test_dashed_lines_are_dots_where_they_were_dashes_and_solid_lines_stay():
    markings = {"dash_cycle_m": 9.0, "dash_fraction": 0.4, "width_m": 0.2}
    dashed, dotted = (resolve(changed(markings=markings | {"dots": dots})) for dots in (False, True))
    before, after = dashed.paint(dashed.view), dotted.paint(dotted.view)
    for name in ("main_line_0", "main_line_3"):
        np.testing.assert_array_equal(after[name].vertices_world, before[name].vertices_world)
    mesh = after["main_line_1"]
    corners = seen_on_flat_ground(dotted, mesh.vertices_world)[mesh.faces]
    y = dotted.network.stations(mesh.uv_m[mesh.faces][:, :, 1])
    near = (y.max(axis=1) < dotted.scene.camera.y_m + DOTS_M) & (y.min(axis=1) > -44.5)
    assert np.ptp(corners[near, :, 0]) == pytest.approx(DOT_M, abs=0.004), "as wide as a dot, about the line"
    assert corners[near, :, 0].mean() == pytest.approx(-1.75, abs=0.002)
    painted = np.zeros(5000, dtype=bool)
    at = np.arange(5000) / 100 - 44.5
    for low, high in zip(y[near].min(axis=1), y[near].max(axis=1), strict=True):
        painted |= (at > low - 1e-6) & (at < high + 1e-6)
    dots, n = clusters(painted)
    middles = np.array([at[dots == i].mean() for i in range(1, n + 1)])
    phase = middles % 9.0
    assert np.abs(phase[:, None] - [0.05, 0.05 + 3.5 / 3, 0.05 + 7 / 3, 3.55]).min(axis=1).max() < 0.01
    top = mesh.vertices_world[mesh.faces][near][:, :, 2].max()
    assert DOT_HEIGHT_M < top < DOT_HEIGHT_M + 0.005
    near_share, far_share = (_area(mesh, *at) / _area(before["main_line_2"], *at) for at in ((12, 30), (150, 250)))
    assert 0.35 < near_share < 0.48, "at 70 m the dots cover a part of a dash as wide as they are"
    assert far_share == pytest.approx(DOT_M / 0.2), "at 200 m they hide each other's gaps"


def _area(mesh, low, high):
    """Of the faces seen from above, between two distances."""
    a, b, c, d = (mesh.vertices_world[mesh.faces[:, i], :2] for i in range(4))
    p, q = c - a, d - b
    inside = (a[:, 1] > low) & (a[:, 1] < high)
    return np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])[inside].sum() / 2


def test_paint_of_an_exit_lies_over_the_other_roads_pavement_in_a_hollow():
    world = resolve(sample_scene(Scenes(load_params("appendix_i"), seed=9400), index=79))
    eye = world.view.eye_world
    for name, mesh in world.paint(world.view).items():
        painted = mesh.vertices_world[np.unique(mesh.faces)]
        near = painted[np.linalg.norm(painted[:, :2] - eye[:2], axis=1) < 30]
        over_m = near[:, 2] - mesh_height(world.site.surfaces.pavement, near[:, :2])
        assert np.nanmean(over_m > 0) > 0.98, name
