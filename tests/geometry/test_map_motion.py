"""The host and cars on a map: along their routes, through turns, by tracks."""

import numpy as np
import pytest

from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.motion import car_at
from synth3dlanes.world.world import resolve
from tests.map_scenes import ARM_M, HALF_M, HILLS, LEFT_TURN, WIDTH_M, map_scene

TRACK = ((0.0, 0.0), (2.0, 18.0), (4.0, 28.5), (6.0, 28.5), (10.0, 70.0))
CAR = {
    "model": 1, "scale": 1.0, "color": (0.8, 0.1, 0.1), "gloss": 0.5, "lane": "east.0.1", "s_m": 30.0,
    "route": ("east_south.0.-1", "south.0.-1"), "track": TRACK,
}  # fmt: skip
RADIUS_M = HALF_M + WIDTH_M / 2


def frame(time_s: float, **parts):
    shot = {"frame": round(time_s * 10), "n_frames": 110, "fps": 10.0, "speed_m_s": 8.0}
    return resolve(map_scene(LEFT_TURN, 90.0, shot=shot, **parts))


def test_the_host_drives_its_route_and_looks_along_its_tangent():
    for time_s in np.arange(0, 10, 0.7):
        pose, driven_m = frame(float(time_s)).view.world_from_host, 90 + 8 * round(time_s * 10) / 10
        turning_m = driven_m - ARM_M
        if turning_m < 0:
            place, heading = [WIDTH_M / 2, -HALF_M + turning_m], [0, 1]
        elif turning_m < RADIUS_M * np.pi / 2:
            a = turning_m / RADIUS_M
            place = [WIDTH_M / 2 - RADIUS_M * (1 - np.cos(a)), -HALF_M + RADIUS_M * np.sin(a)]
            heading = [-np.sin(a), np.cos(a)]
        else:
            place, heading = [-HALF_M - turning_m + RADIUS_M * np.pi / 2, WIDTH_M / 2], [-1, 0]
        np.testing.assert_allclose(pose[:2, 3], place, atol=0.002)
        np.testing.assert_allclose(pose[:2, 1], heading, atol=2e-3)


def test_a_car_is_at_the_lengths_of_its_track_and_never_drives_back():
    network = frame(0.0, cars=(CAR,)).network
    car = frame(0.0, cars=(CAR,)).scene.cars[0]
    way, start_m = network.car_way(car)
    line = way.points_world(np.linspace(0, way.end_m, 40_000))
    lengths_m = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    places = []
    for time_s, length_m in TRACK:
        at = car_at(network, car, time_s)
        lane = network.lanes[at.lane]
        s = np.array([at.s_m])
        places.append(network.road(lane.road).points(s, lane.middle(s))[0])
        expected = [np.interp(start_m + length_m, lengths_m, line[:, k]) for k in (0, 1, 2)]
        np.testing.assert_allclose(places[-1], expected, atol=0.01)
    assert (places[2] == places[3]).all(), "it waits"
    driven = [car_at(network, car, float(t)) for t in np.arange(0, 10, 0.25)]
    along = [
        network.car_way(at)[1] + {"east.0.1": 0, "east_south.0.-1": 120, "south.0.-1": 142}[at.lane] for at in driven
    ]
    assert (np.diff(along) >= -1e-6).all()
    assert [at.lane for at in driven][-1] == "south.0.-1"
    assert all(at.speed_m_s == 0 for at in driven[17:24]), "with no speed"


@pytest.mark.parametrize("lane", ["east.0.1", "north.0.-1", "south_west.0.-1"])
def test_a_car_stands_on_the_surface_and_heads_as_its_lane_does(lane):
    car = CAR | {"lane": lane, "s_m": 8.0, "route": (), "track": ()}
    world = resolve(map_scene(LEFT_TURN, 90.0, cars=(car,), terrain=HILLS.model_dump()))
    (pose,), network = world.view.world_from_cars, world.network
    at, road = network.lanes[lane], network.road(network.lanes[lane].road)
    s = np.array([8.0, 8.0 + (0.01 if at.ascends else -0.01)])
    foot, ahead = road.points(s, at.middle(s))
    heading = (ahead - foot)[:2] / np.linalg.norm((ahead - foot)[:2])
    np.testing.assert_allclose(pose[:2, 1] / np.linalg.norm(pose[:2, 1]), heading, atol=5e-3)
    assert np.linalg.norm(pose[:3, 3] - foot) < 0.02


def test_the_labelled_velocity_of_a_car_on_a_track_is_that_of_the_frame():
    """A car that brakes, waits and starts anew: its places a tenth of a second before and behind tell its speed."""
    labels = {
        time_s: ground_truth(frame(time_s, cars=(CAR,)).scene)
        for time_s in (0.9, 1.0, 1.1, 4.9, 5.0, 5.1, 7.9, 8.0, 8.1)
    }
    places = {
        time_s: (at.camera.world_from_cam @ at.objects[0].cam_from_object)[:3, 3] for time_s, at in labels.items()
    }
    speeds = []
    for before, now, after in ((0.9, 1.0, 1.1), (4.9, 5.0, 5.1), (7.9, 8.0, 8.1)):
        moved = (places[after] - places[before]) / 0.2
        told = labels[now].camera.world_from_cam[:3, :3] @ labels[now].objects[0].velocity_cam
        np.testing.assert_allclose(told, moved, atol=0.3)
        speeds.append(np.linalg.norm(told))
    assert speeds[1] == 0 < 2 < speeds[0] < speeds[2]
