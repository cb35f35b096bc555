"""Cars and the host of a clip keep their lanes and their speeds."""

import numpy as np
import pytest

from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.scene import Car
from synth3dlanes.world.motion import car_at, host_exposure
from synth3dlanes.world.world import resolve
from tests.scenes import changed


def car(**values) -> Car:
    drawn = {"model": 1, "scale": 1.0, "color": (0.5, 0.5, 0.5), "gloss": 0.5, "lane": "stem_1", "s_m": -20.0}
    return Car(**drawn | values)


@pytest.mark.parametrize("flip", [False, True])
def test_who_passes_the_split_is_in_the_lane_behind_it(flip):
    network = resolve(changed(road={"topology": 2, "n_lanes": 3, "flip_longitudinal": flip})).network
    assert [car_at(network, car(lane=f"stem_{n}", speed_m_s=40.0), 1.0).lane for n in (1, 2, 3)] == [
        "main_1", "main_2", "main_3"
    ]  # fmt: skip


def test_a_host_that_waits_is_sharp_and_one_that_drives_is_blurred_by_its_way():
    track = ((0.0, 0.0), (1.0, 10.0), (2.0, 20.0), (3.0, 20.0), (4.0, 20.0))
    shots = [Shot(frame=frame, n_frames=9, fps=2.0, track=track) for frame in (2, 7)]
    driving, waiting = (host_exposure(shot, 0.5) for shot in shots)
    assert waiting.driven_m == 0
    assert waiting.duration_s == driving.duration_s == host_exposure(Shot(), 0.5).duration_s
    assert np.isclose(driving.driven_m, 10.0 * driving.duration_s)
    assert host_exposure(Shot(n_frames=2, speed_m_s=10.0), 0.5) == (10.0, 0.05, 0.5)
