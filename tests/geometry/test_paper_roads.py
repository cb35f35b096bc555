"""The paper's road: its topologies, places, terrain and camera, in words and by formulas."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.roads.terrain import gradient_at, height_at
from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.scene import Car, Gaussian, Terrain
from synth3dlanes.world.horizon import FarHills
from synth3dlanes.world.motion import car_at, host_exposure
from synth3dlanes.world.world import resolve
from tests.scenes import changed


def network_of(topology, **road):
    return resolve(changed(road={"topology": topology, **road})).network


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
    lines = {curve.id: curve for curve in network.curves}
    for curve in lines.values():
        s = network.roads[-1].parting.station(0.0) - 1 if curve.id == "stem_line" else 80.0
        for is_right, sign in ((False, -1), (True, 1)):
            side = curve.beside(is_right, s, lines)
            if side in lines:
                own, other = (line.xy_world(np.array([s]))[0, 0] for line in (curve, lines[side]))
                assert 0 < sign * (other - own) < 1.2 * network.main.lane_width_m, (curve.id, side)


CURVED = {"offset_m100_m": 8.0, "offset_m50_m": -5.0, "offset_p50_m": 6.0, "offset_p100_m": -9.0}


def curved(**road):
    return resolve(changed(road={**CURVED, "topology": 2, **road}))


@pytest.mark.parametrize("exit_offset_m", [0.0, 0.5, 10.0])
@pytest.mark.parametrize("exit_angle_deg", [0.01, 1, 5])
def test_a_road_is_as_wide_open_as_asked_where_it_says(exit_angle_deg, exit_offset_m):
    """At 0.01 degrees without a bend it opens far beyond its curved part."""
    world = curved(exit_angle_rad=np.radians(exit_angle_deg), exit_offset_m=exit_offset_m)
    opening = world.network.road("exit").line.opening
    for q_m in (0.1, 3.6, 20.0):
        assert opening(np.array([opening.station(q_m)]))[0] == pytest.approx(q_m, rel=1e-12)


def test_points_are_found_again():
    world = curved()
    s = np.linspace(2, 95, 60)
    for t in (-8.0, 0.0, 11.0):
        back_s, back_t = world.network.main.line.project(world.network.main.xy(s, t))
        np.testing.assert_allclose([back_s, back_t], [s, np.full(60, t)], atol=1e-6)
        back_s, back_t = world.network.road("exit").line.project(world.network.road("exit").xy(s, t / 2), s + 1.0)
        np.testing.assert_allclose([back_s, back_t], [s, np.full(60, t / 2)], atol=1e-6)


GAUSSIANS = st.builds(
    Gaussian,
    center_m=st.tuples(st.floats(-150, 150), st.floats(-150, 150)),
    magnitude_m=st.floats(-50, 50),
    sd_m=st.tuples(st.floats(25, 250), st.floats(25, 250)),
    orientation_rad=st.floats(0, np.pi / 2),
)
TERRAINS = st.builds(Terrain, gaussians=st.lists(GAUSSIANS, min_size=1, max_size=7).map(tuple))


@given(TERRAINS, st.floats(-200, 200), st.floats(-200, 200))
def test_gradient_equals_central_differences(terrain, x, y):
    step = 1e-3
    around = np.array([[x + step, y], [x - step, y], [x, y + step], [x, y - step]])
    z = height_at(terrain, around)
    differences = [(z[0] - z[1]) / (2 * step), (z[2] - z[3]) / (2 * step)]
    np.testing.assert_allclose(gradient_at(terrain, np.array([[x, y]]))[0], differences, atol=1e-6)


def test_far_hills_rise_behind_all_roads_and_nowhere_else(flat_scene):
    angles, radii_m = np.meshgrid(np.linspace(0, 2 * np.pi, 90), np.linspace(0, 4000, 161))
    xy = np.stack([radii_m * np.cos(angles), radii_m * np.sin(angles)], axis=-1)
    scenes = [flat_scene.model_copy(update={"index": index}) for index in range(20)]
    heights_m = np.array([FarHills.draw(scene.stream("far_hills"), np.zeros(2)).height(xy) for scene in scenes])
    assert not heights_m[:, radii_m < 500].any()
    assert heights_m.min() == 0
    assert 40 < heights_m.max() < 300
    assert len({round(float(height.max()), 3) for height in heights_m}) == 20, "every scene has its own"
    np.testing.assert_array_equal(FarHills.draw(scenes[0].stream("far_hills"), np.zeros(2)).height(xy), heights_m[0])


@pytest.mark.parametrize("flip", [False, True])
def test_lanes_count_from_the_left_whatever_the_flip(flip):
    xs = [
        resolve(changed(road={"topology": 2, "flip_longitudinal": flip}, camera={"lane": lane})).view.world_from_cam[
            0, 3
        ]
        for lane in (1, 2, 3)
    ]
    np.testing.assert_allclose(xs, [-3.5, 0, 3.5], atol=1e-9)


@pytest.mark.parametrize("flip", [False, True])
def test_who_passes_the_split_is_in_the_lane_behind_it(flip):
    network = network_of(2, flip_longitudinal=flip)
    car = Car(model=1, scale=1.0, color=(0.5, 0.5, 0.5), gloss=0.5, lane="stem_1", s_m=-20.0, speed_m_s=40.0)
    cars = [car.model_copy(update={"lane": f"stem_{n}"}) for n in (1, 2, 3)]
    assert [car_at(network, one, 1.0).lane for one in cars] == ["main_1", "main_2", "main_3"]


def test_a_host_that_waits_is_sharp_and_one_that_drives_is_blurred_by_its_way():
    track = ((0.0, 0.0), (1.0, 10.0), (2.0, 20.0), (3.0, 20.0), (4.0, 20.0))
    shots = [Shot(frame=frame, n_frames=9, fps=2.0, track=track) for frame in (2, 7)]
    driving, waiting = (host_exposure(shot, 0.5) for shot in shots)
    assert waiting.driven_m == 0
    assert waiting.duration_s == driving.duration_s == host_exposure(Shot(), 0.5).duration_s
    assert np.isclose(driving.driven_m, 10.0 * driving.duration_s)
    assert host_exposure(Shot(n_frames=2, speed_m_s=10.0), 0.5) == (10.0, 0.05, 0.5)
