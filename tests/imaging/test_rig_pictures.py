"""What of a picture goes with the host, not with the camera: its bonnet, its motion, what falls."""

import numpy as np
import pytest

from synth3dlanes.geometry.frames import transform
from synth3dlanes.world.bonnet import bonnet
from synth3dlanes.world.world import resolve
from tests.scenes import changed

HOST = {"bonnet": 0.3, "gray": 0.2, "gloss": 0.5}


@pytest.mark.parametrize(
    "place", [{"right_m": 0.4}, {"yaw_rad": 0.4, "forward_m": 0.5}, {"yaw_rad": -0.3, "right_m": -0.3}]
)
def test_the_bonnet_lies_along_the_middle_of_the_host(place):
    view = resolve(changed(host=HOST, camera={"pitch_rad": 0.0, **place})).view
    points_host = np.linalg.solve(view.world_from_host, np.eye(4)) @ view.world_from_bonnet
    points = transform(points_host, bonnet().vertices_world)
    assert abs(points[:, 0].min() + points[:, 0].max()) < 1e-6
    assert np.ptp(points[:, 0]) == pytest.approx(1.56)
    assert points[:, 1].min() == pytest.approx(place.get("forward_m", 0) + 0.02, abs=0.2)


@pytest.mark.parametrize(
    ("place", "is_seen"),
    [({}, True), ({"yaw_rad": 1.0}, False), ({"yaw_rad": np.pi}, False), ({"forward_m": 2.0}, False)],
)
def test_cameras_that_look_ahead_from_behind_the_windscreen_see_the_bonnet(place, is_seen):
    assert (resolve(changed(host=HOST, camera=place)).view.world_from_bonnet is not None) == is_seen
