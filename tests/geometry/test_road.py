"""The road plan against an independent reading of the paper's Appendix I."""

import numpy as np
import pytest

from synth3dlanes.world.world import resolve
from tests.scenes import changed

CURVED = {"offset_m100_m": 8.0, "offset_m50_m": -5.0, "offset_p50_m": 6.0, "offset_p100_m": -9.0}


def curved(**road):
    return resolve(changed(road={**CURVED, "topology": 2, **road}))


@pytest.mark.parametrize("topology", [2, 3, 4])
def test_nose_and_ramp_begin_where_the_specification_says(topology):
    world = curved(topology=topology)
    w = world.scene.road.lane_width_m
    branch = world.network.road("exit")
    q = branch.line.opening
    assert q(np.array([branch.parting.station(0.0)]))[0] == pytest.approx(w)
    assert q(np.array([branch.ramp.start_m]))[0] == pytest.approx(w + 2 * w * world.scene.road.shoulder_factor)


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


def test_stations_are_metres_of_road():
    network = curved().network
    for road in network.roads:
        s = network.stations_along(road, 0.0, np.arange(0.0, 91.0))
        gaps = np.linalg.norm(np.diff(road.xy(s, 0.0), axis=0), axis=1)
        np.testing.assert_allclose(gaps, 1.0, atol=2e-3)
