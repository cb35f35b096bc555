"""The road plan against an independent reading of the paper's Appendix I."""

import numpy as np
import pytest

from synth3dlanes.world.world import resolve
from tests.scenes import changed

CURVED = {"offset_m100_m": 8.0, "offset_m50_m": -5.0, "offset_p50_m": 6.0, "offset_p100_m": -9.0}


def curved(**road):
    return resolve(changed(road={**CURVED, "topology": 2, **road}))


def reference(world):
    """The quartic by a generic fit, as a numpy polynomial of y."""
    r = world.scene.road
    xs = [r.offset_m50_m + r.offset_m100_m, r.offset_m50_m, 0, r.offset_p50_m, r.offset_p50_m + r.offset_p100_m]
    return np.polynomial.Polynomial.fit([-100, -50, 0, 50, 100], xs, 4).convert()


def test_main_road_is_the_quartic_through_the_five_points_and_its_tangents():
    world = curved()
    f = reference(world)
    s = np.linspace(-100, 100, 41)
    np.testing.assert_allclose(world.network.main.xy(s, 0.0), np.stack([f(s), s], 1), atol=1e-9)
    beyond = world.network.main.xy(np.array([100.0, 130.0]), 0.0)
    np.testing.assert_allclose((beyond[1] - beyond[0])[0] / 30, f.deriv()(100.0), atol=1e-9)


def test_lanes_keep_their_distance_along_the_normal():
    world = curved()
    s = np.linspace(-95, 95, 39)
    f = reference(world)
    to = world.network.main.xy(s, 3.0) - world.network.main.xy(s, 0.0)
    np.testing.assert_allclose(np.linalg.norm(to, axis=1), 3.0, atol=1e-9)
    tangent = np.stack([f.deriv()(s), np.ones_like(s)], 1)
    np.testing.assert_allclose((to * tangent).sum(1), 0, atol=1e-9)
    assert (to[:, 0] > 0).all(), "a positive offset lies to the right of a road that runs along y"


def test_exit_is_displaced_by_q_along_the_main_normal():
    world = curved()
    road = world.scene.road
    s = np.linspace(0, 95, 39)
    q = s * np.tan(road.exit_angle_rad) + road.exit_offset_m * (s / 60) ** 2
    base = (road.n_lanes / 2 - 0.5) * road.lane_width_m
    np.testing.assert_allclose(world.network.road("exit").xy(s, 0.0), world.network.main.xy(s, base + q), atol=1e-9)


def test_exit_lanes_keep_their_width_along_the_exits_own_normal():
    world = curved(topology=4)
    s = np.linspace(1, 80, 80)
    middle = world.network.road("exit").xy(s, 0.0)
    step = world.network.road("exit").xy(s + 1e-4, 0.0) - world.network.road("exit").xy(s - 1e-4, 0.0)
    to = world.network.road("exit").xy(s, 2.0) - middle
    np.testing.assert_allclose(np.linalg.norm(to, axis=1), 2.0, atol=1e-9)
    np.testing.assert_allclose((to * step).sum(1) / np.linalg.norm(step, axis=1), 0, atol=1e-6)


@pytest.mark.parametrize("topology", [2, 3, 4])
def test_nose_and_ramp_begin_where_the_specification_says(topology):
    world = curved(topology=topology)
    w = world.scene.road.lane_width_m
    branch = world.network.road("exit")
    q = branch.line.opening
    assert q(np.array([branch.parting.station(0.0)]))[0] == pytest.approx(w)
    assert q(np.array([branch.ramp.start_m]))[0] == pytest.approx(w + 2 * w * world.scene.road.shoulder_factor)


def test_ramp_rises_from_its_start_to_its_height_by_a_smoothstep():
    world = curved()
    length = world.scene.road.ramp_height_m * world.scene.road.ramp_slope
    ramp = world.network.road("exit").ramp
    s = ramp.start_m + length * np.array([-1, 0, 0.25, 0.5, 0.75, 1, 2])
    np.testing.assert_allclose(ramp(s), 4 * np.array([0, 0, 0.15625, 0.5, 0.84375, 1, 1]), atol=1e-12)


@pytest.mark.parametrize("exit_offset_m", [0.0, 0.5, 10.0])
@pytest.mark.parametrize("exit_angle_deg", [0.01, 1, 5])
def test_a_road_is_as_wide_open_as_asked_where_it_says(exit_angle_deg, exit_offset_m):
    """At 0.01 degrees without a bend it opens far beyond its curved part."""
    world = curved(exit_angle_rad=np.radians(exit_angle_deg), exit_offset_m=exit_offset_m)
    opening = world.network.road("exit").line.opening
    for q_m in (0.1, 3.6, 20.0):
        assert opening(np.array([opening.station(q_m)]))[0] == pytest.approx(q_m, rel=1e-12)


def test_a_ramp_whose_shoulders_never_separate_inside_the_scene_is_unused():
    world = curved(exit_angle_rad=np.radians(1), exit_offset_m=0.0)
    assert world.network.road("exit").ramp is None
    assert not world.network.road("exit").raised(np.linspace(0, 400, 50)).any()


def test_points_are_found_again():
    world = curved()
    s = np.linspace(2, 95, 60)
    for t in (-8.0, 0.0, 11.0):
        back_s, back_t = world.network.main.line.project(world.network.main.xy(s, t))
        np.testing.assert_allclose([back_s, back_t], [s, np.full(60, t)], atol=1e-6)
        back_s, back_t = world.network.road("exit").line.project(world.network.road("exit").xy(s, t / 2), s + 1.0)
        np.testing.assert_allclose([back_s, back_t], [s, np.full(60, t / 2)], atol=1e-6)


def test_flip_longitudinal_moves_the_exit_to_the_left_and_flip_lateral_behind_the_origin():
    s = np.array([60.0])
    assert curved().network.road("exit").xy(s, 0.0)[0, 0] > curved().network.main.xy(s, 0.0)[0, 0]
    left = curved(flip_longitudinal=True)
    assert left.network.road("exit").xy(s, 0.0)[0, 0] < left.network.main.xy(s, 0.0)[0, 0]
    merge = curved(flip_lateral=True)
    np.testing.assert_allclose(
        merge.network.road("exit").xy(s, 0.0), curved().network.road("exit").xy(s, 0.0) * [1, -1], atol=1e-12
    )


def test_stations_are_metres_of_road():
    network = curved().network
    for road in network.roads:
        s = network.stations_along(road, 0.0, np.arange(0.0, 91.0))
        gaps = np.linalg.norm(np.diff(road.xy(s, 0.0), axis=0), axis=1)
        np.testing.assert_allclose(gaps, 1.0, atol=2e-3)
