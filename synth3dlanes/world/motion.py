"""Where the host and the cars of a clip are at an instant: each keeps its lane and its speed, or has a track."""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.host import HostCamera, Shot
from synth3dlanes.scene.scene import Car, Scene, Thing
from synth3dlanes.system.errors import InputError

WAY_STEP_M = 0.25
# Stations are rounded to less than this.
ENDS_M = 0.01
# The host's speed in single pictures.
SPEED_M_S = 25.0


class HostExposure(NamedTuple):
    """The host's speed during the exposure of a picture, the exposure's duration, and how far the host drives in it."""

    speed_m_s: float
    duration_s: float
    driven_m: float


class MovedThing(NamedTuple):
    """A thing at an instant, with its speed then; its velocity in the world's plan; how far it has gone."""

    thing: Thing
    velocity_world: Float[np.ndarray, "2"]
    driven_m: float


def host_at(network: Network, camera: HostCamera, driven_m: float) -> HostCamera:
    """The host after driving a distance along its lane; raise InputError where the lane leaves its road, and where its
    way does not reach."""
    way, y_m = network.way, host_station(network, camera, driven_m)
    if not way.start_m <= y_m * network.onwards <= way.end_m:
        driven = f" and {driven_m:g} m driven" if driven_m else ""
        raise InputError(
            f"camera.y_m: expected the host on its way, from {way.start_m:g} to {way.end_m:.1f} m, "
            f"got {camera.y_m:g} m{driven}"
        )
    return camera if driven_m == 0 else network.host_on(camera, y_m)


def host_station(network: Network, camera: HostCamera, driven_m: float) -> float:
    """The host's station, as it drives, after a distance along its lane."""
    return float(host_stations(network, camera, np.array([driven_m]))[0])


def host_stations(network: Network, camera: HostCamera, driven_m: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
    """`host_station` for several distances."""
    if not driven_m.any():
        return np.full(driven_m.shape, camera.y_m)
    return network.stations(stations_after(network.host_way(camera), camera.y_m * network.onwards, driven_m))


def car_at(network: Network, car: Car, time_s: float, where: str = "cars") -> Car:
    """A car some seconds after the clip's start, with its speed then. Raises InputError, which begins with `where`, for
    one that is not in its lane at the start, and where its lanes do not reach; and as `Network.path` for its lane."""
    lane = next(at for at in network.path(car.lane).lanes if at.id == car.lane)
    low_m, high_m = sorted((lane.start_m * network.onwards, lane.end_m * network.onwards))
    if not low_m - ENDS_M <= car.s_m <= high_m + ENDS_M:
        raise InputError(f"{where}.s_m: expected {low_m:g} to {high_m:g} m in lane {car.lane}, got {car.s_m:g}")
    driven_m, speed_m_s = car.speed_m_s * time_s, car.speed_m_s
    if car.track:
        driven_m, speed_m_s = _on_track(car.track, time_s)
        car = car.model_copy(update={"speed_m_s": speed_m_s})
    if driven_m == 0:
        return car
    way, start_m = network.car_way(car)
    s = float(stations_after(way, start_m, np.array([driven_m]))[0])
    if not way.start_m - ENDS_M <= s <= way.end_m + ENDS_M:
        raise InputError(
            f"{where}: expected lanes that go on for {driven_m:g} m, which it drives in {time_s:g} s, got shorter ones"
        )
    return network.car_on(car, s)


def car_speed(scene: Scene, car: Car) -> float:
    """A car's speed at the instant of a scene. In single pictures without traffic, cars that are not parked drive at
    SPEED_M_S, as the host does."""
    if scene.has_traffic:
        return car.speed_m_s
    return 0.0 if car.offset_m else SPEED_M_S


def thing_at(thing: Thing, time_s: float) -> MovedThing:
    """A thing some seconds after the clip's start."""
    if not thing.track:
        ahead = np.array([-np.sin(thing.yaw_rad), np.cos(thing.yaw_rad)])
        driven_m = thing.speed_m_s * time_s
        x_m, y_m = (np.array([thing.x_m, thing.y_m]) + driven_m * ahead).tolist()
        return MovedThing(thing.model_copy(update={"x_m": x_m, "y_m": y_m}), thing.speed_m_s * ahead, driven_m)
    times_s = np.array([instant.time_s for instant in thing.track])
    places = np.array([(instant.x_m, instant.y_m, instant.yaw_rad) for instant in thing.track])
    places[:, 2] = np.unwrap(places[:, 2])
    velocity = np.zeros(2)
    lengths_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places[:, :2], axis=0).T))])
    if len(times_s) > 1 and times_s[0] <= time_s <= times_s[-1]:
        way = walked_way(times_s, places)
        (x_m, y_m, yaw_rad), velocity = way(time_s).tolist(), way(time_s, 1)[:2]
    else:
        x_m, y_m, yaw_rad = places[0 if time_s < times_s[0] else -1].tolist()
    update = {"x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad, "speed_m_s": float(np.hypot(*velocity))}
    return MovedThing(thing.model_copy(update=update), velocity, float(np.interp(time_s, times_s, lengths_m)))


def walked_way(
    times_s: Float[np.ndarray, " k"], places: Float[np.ndarray, "k 3"]
) -> "scipy.interpolate.CubicHermiteSpline":
    """x, y and heading of a thing as smooth functions of time through the instants of its track, of which there are two
    or more. Who walks straight, or stands, goes as by PCHIP. At a corner of right angles it keeps seven tenths of its
    speed, where PCHIP of x and y would stop it."""
    slopes = scipy.interpolate.PchipInterpolator(times_s, places)(times_s, 1)
    steps_s = np.diff(times_s)
    velocities = np.diff(places[:, :2], axis=0) / steps_s[:, None]
    speeds = np.linalg.norm(velocities, axis=1)
    moves = (speeds[:-1] > 0) & (speeds[1:] > 0)
    safe = np.where(speeds > 0, speeds, 1.0)
    weights = 2 * steps_s[1:] + steps_s[:-1], steps_s[1:] + 2 * steps_s[:-1]
    mean = sum(weights) / (weights[0] / safe[:-1] + weights[1] / safe[1:])
    ahead = velocities / safe[:, None]
    slopes[1:-1, :2] = (np.where(moves, mean, 0.0) / 2)[:, None] * (ahead[:-1] + ahead[1:])
    return scipy.interpolate.CubicHermiteSpline(times_s, places, slopes)


def host_driven(shot: Shot, time_s: float) -> float:
    """How far the host has driven at a time of its clip."""
    return _on_track(shot.track, time_s)[0] if shot.track else shot.speed_m_s * time_s


def host_exposure(shot: Shot, motion_blur_m: float) -> HostExposure:
    """An exposure in which the host drives `motion_blur_m`: at its speed in a clip, at SPEED_M_S in a single picture.
    On a track, where it may wait, it lasts as long as at SPEED_M_S."""
    if len(shot.track) > 1:
        speed_m_s, duration_s = host_speed(shot, shot.time_s), motion_blur_m / SPEED_M_S
        return HostExposure(speed_m_s, duration_s, speed_m_s * duration_s)
    speed_m_s = shot.speed_m_s or SPEED_M_S
    return HostExposure(speed_m_s, motion_blur_m / speed_m_s, motion_blur_m)


def host_speed(shot: Shot, time_s: float) -> float:
    """The host's speed in m/s at a time of its clip."""
    return _on_track(shot.track, time_s)[1] if shot.track else shot.speed_m_s


def _on_track(track: tuple[tuple[float, float], ...], time_s: float) -> tuple[float, float]:
    """How far a car has driven, and its speed; it stands before its first instant and behind its last."""
    times_s, lengths_m = np.array(track).T
    if len(times_s) == 1 or not times_s[0] <= time_s <= times_s[-1]:
        return float(lengths_m[0 if time_s < times_s[0] else -1]), 0.0
    driven = scipy.interpolate.PchipInterpolator(times_s, lengths_m)
    return float(driven(time_s)), max(float(driven(time_s, 1)), 0.0)


def stations_after(path: LaneCurve, s: float, driven_m: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
    """The stations of a path that its traffic reaches after distances along it in 3D from a station."""
    ahead, farthest_m = 1.0 if path.ascends else -1.0, float(driven_m.max())
    # On the inside of a bend a path is shorter than its stations; none is half as long.
    stations = s + ahead * np.linspace(0, 2 * farthest_m, 2 * int(np.ceil(farthest_m / WAY_STEP_M)) + 1)
    steps_m = np.linalg.norm(np.diff(path.points_world(stations), axis=0), axis=1)
    return np.interp(driven_m, np.concatenate([[0.0], np.cumsum(steps_m)]), stations)
