"""Where the host and the cars of a clip are at an instant: each keeps its lane and its speed."""

import numpy as np
from jaxtyping import Float

from synth3dlanes.errors import InputError
from synth3dlanes.geometry.lane_curves import LaneCurve
from synth3dlanes.geometry.network import Network
from synth3dlanes.scene import Camera, Car

STEP_M = 0.25


def host_at(network: Network, camera: Camera, driven_m: float) -> Camera:
    """The host after driving a distance along its lane; raise InputError where the lane leaves its road."""
    if driven_m == 0:
        return camera
    before = network.host_lane(camera.lane, camera.y_m)
    s_m = host_station(network, camera, driven_m)
    lane = network.path(before.id).lane_at(s_m * network.onwards)
    if lane.road != before.road:
        raise InputError(f"camera.lane: expected a lane that stays on the main road in a clip, got {camera.lane}")
    return camera.model_copy(update={"y_m": s_m, "lane": lane.number})


def host_station(network: Network, camera: Camera, driven_m: float) -> float:
    """The host's station, as it drives, after a distance along its lane."""
    if driven_m == 0:
        return camera.y_m
    path = network.path(network.host_lane(camera.lane, camera.y_m).id)
    return station_after(network, path, camera.y_m, driven_m)


def car_at(network: Network, car: Car, time_s: float) -> Car:
    """A car some seconds after the clip's start."""
    if car.speed_m_s * time_s == 0:
        return car
    path = network.path(car.lane)
    s_m = station_after(network, path, car.s_m, car.speed_m_s * time_s)
    return car.model_copy(update={"s_m": s_m, "lane": path.lane_at(s_m * network.onwards).id})


def station_after(network: Network, path: LaneCurve, s_m: float, driven_m: float) -> float:
    """The station as the host drives that traffic on a path reaches after a distance along the path in 3D."""
    return float(stations_after(network, path, s_m, np.array([driven_m]))[0])


def stations_after(
    network: Network, path: LaneCurve, s_m: float, driven_m: Float[np.ndarray, " t"]
) -> Float[np.ndarray, " t"]:
    """`station_after` for several distances."""
    ahead, farthest_m = 1.0 if path.direction == "same" else -1.0, float(driven_m.max())
    # On the inside of a bend a path is shorter than its stations; none is half as long.
    stations = s_m + ahead * np.linspace(0, 2 * farthest_m, 2 * int(np.ceil(farthest_m / STEP_M)) + 1)
    steps_m = np.linalg.norm(np.diff(path.points_world(network.stations(stations)), axis=0), axis=1)
    return np.interp(driven_m, np.concatenate([[0.0], np.cumsum(steps_m)]), stations)
