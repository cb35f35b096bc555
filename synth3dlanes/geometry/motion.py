"""Where the host and the cars of a clip are at an instant: each keeps its lane and its speed."""

import numpy as np
from jaxtyping import Float

from synth3dlanes.errors import InputError
from synth3dlanes.geometry.lanes import LaneCurve, connections, host_segment, path_of_segment
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.scene import Camera, Car

STEP_M = 0.25


def host_at(plan: RoadPlan, camera: Camera, driven_m: float) -> Camera:
    """The host after driving a distance along its lane; raise InputError where the lane leaves the main road."""
    if driven_m == 0:
        return camera
    path = path_of_segment(plan, host_segment(plan, camera))
    s_m = host_station(plan, camera, driven_m)
    kind, _, number = segment_of(plan, path, s_m).rpartition("_")
    if kind == "exit":
        raise InputError(f"camera.lane: expected a lane that stays on the main road in a clip, got {camera.lane}")
    return camera.model_copy(update={"y_m": s_m, "lane": int(number)})


def host_station(plan: RoadPlan, camera: Camera, driven_m: float) -> float:
    """The host's world station after driving a distance along its lane."""
    if driven_m == 0:
        return camera.y_m
    return station_after(plan, path_of_segment(plan, host_segment(plan, camera)), camera.y_m, driven_m)


def car_at(plan: RoadPlan, car: Car, time_s: float) -> Car:
    """A car some seconds after the clip's start."""
    if car.speed_m_s * time_s == 0:
        return car
    path = path_of_segment(plan, car.lane)
    s_m = station_after(plan, path, car.s_m, car.speed_m_s * time_s)
    return car.model_copy(update={"s_m": s_m, "lane": segment_of(plan, path, s_m)})


def station_after(plan: RoadPlan, path: LaneCurve, s_m: float, driven_m: float) -> float:
    """The world station that traffic on a path reaches after a distance, measured along the path in 3D."""
    return float(stations_after(plan, path, s_m, np.array([driven_m]))[0])


def stations_after(
    plan: RoadPlan, path: LaneCurve, s_m: float, driven_m: Float[np.ndarray, " t"]
) -> Float[np.ndarray, " t"]:
    """`station_after` for several distances."""
    ahead, farthest_m = 1.0 if path.direction == "same" else -1.0, float(driven_m.max())
    # On the inside of a bend a path is shorter than its stations; none is half as long.
    stations = s_m + ahead * np.linspace(0, 2 * farthest_m, 2 * int(np.ceil(farthest_m / STEP_M)) + 1)
    steps_m = np.linalg.norm(np.diff(path.points_world(plan, plan.plan_station(stations)), axis=0), axis=1)
    return np.interp(driven_m, np.concatenate([[0.0], np.cumsum(steps_m)]), stations)


def segment_of(plan: RoadPlan, path: LaneCurve, s_m: float) -> str:
    """The id of the lane segment that a path runs along at a world station."""
    if path.direction == "oncoming" or not plan.has_exit or s_m * plan.flips[1] >= 0:
        return path.id
    return next(stem for stem, fork in connections(plan) if fork == path.id)
