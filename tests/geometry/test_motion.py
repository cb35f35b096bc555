"""Cars and the host of a clip keep their lanes and their speeds."""

import numpy as np
import pytest

from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.scene import Car
from synth3dlanes.world.motion import car_at, host_at, host_exposure
from synth3dlanes.world.world import resolve
from tests.scenes import changed

HILLS = {"topology": 3, "offset_m50_m": 8.0, "offset_p50_m": -6.0}


def car(**values) -> Car:
    drawn = {"model": 1, "scale": 1.0, "color": (0.5, 0.5, 0.5), "gloss": 0.5, "lane": "stem_1", "s_m": -20.0}
    return Car(**drawn | values)


def test_a_car_at_ten_metres_a_second_is_twenty_metres_on_after_two():
    world = resolve(changed(road=HILLS))
    path = world.network.path("stem_1")
    moved = car_at(world.network, car(speed_m_s=10.0), 2.0)
    stations = np.linspace(-20, moved.s_m, 40001)
    points = path.points_world(world.network.stations(stations))
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(20, abs=0.01)
    assert moved.s_m > -20


def test_an_oncoming_car_drives_towards_the_host_and_a_parked_one_stays():
    world = resolve(changed(road={"topology": 1, "n_oncoming": 2, "median_m": 2.0}))
    oncoming = car(lane="oncoming_1", s_m=40.0, speed_m_s=10.0)
    assert car_at(world.network, oncoming, 1.0).s_m < 40 - 9
    assert car_at(world.network, oncoming, 1.0).lane == "oncoming_1"
    assert car_at(world.network, oncoming.model_copy(update={"speed_m_s": 0.0}), 5.0).s_m == 40.0


@pytest.mark.parametrize("flip", [False, True])
def test_who_passes_the_split_is_in_the_lane_behind_it(flip):
    network = resolve(changed(road={"topology": 2, "n_lanes": 3, "flip_longitudinal": flip})).network
    assert [car_at(network, car(lane=f"stem_{n}", speed_m_s=40.0), 1.0).lane for n in (1, 2, 3)] == [
        "main_1", "main_2", "main_3"
    ]  # fmt: skip


def test_the_host_keeps_its_lane_through_a_merge():
    scene = changed(road={"topology": 4, "n_lanes": 3, "flip_lateral": True, "flip_longitudinal": True})
    world = resolve(scene)
    moved = host_at(world.network, scene.camera, -scene.camera.y_m + 30)
    assert moved.y_m > 20
    # An exit lane joins on the left, so the numbers of the lanes beside it go up by one.
    assert (scene.camera.lane, moved.lane) == (2, 3)


def test_a_host_that_waits_is_sharp_and_one_that_drives_is_blurred_by_its_way():
    track = ((0.0, 0.0), (1.0, 10.0), (2.0, 20.0), (3.0, 20.0), (4.0, 20.0))
    shots = [Shot(frame=frame, n_frames=9, fps=2.0, track=track) for frame in (2, 7)]
    driving, waiting = (host_exposure(shot, 0.5) for shot in shots)
    assert waiting.driven_m == 0
    assert waiting.duration_s == driving.duration_s == host_exposure(Shot(), 0.5).duration_s
    assert np.isclose(driving.driven_m, 10.0 * driving.duration_s)
    assert host_exposure(Shot(n_frames=2, speed_m_s=10.0), 0.5) == (10.0, 0.05, 0.5)
