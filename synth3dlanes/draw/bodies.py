"""Bodies: what stands and drives near the host, from above, at the instants of a clip; things are added one by one.

World frame, metres and seconds. Footprints are the four corners of rectangles.
"""

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.draw.draws import SCENE_DECIMALS
from synth3dlanes.draw.roadside import floor_plan
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.assets.catalogue import ThingModel
from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.scene import Car, PlanInstant, Scene, Thing
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.world import placement
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.motion import stations_after, walked_way
from synth3dlanes.world.posts import post_frames

# Nobody moves by more than ROOM_M, the room between bodies, from one checked instant to the next.
CHECK_EVERY_S, ROOM_M = 0.1, 0.1
# Time between instants of tracks.
TRACK_EVERY_S = 0.5
# Vehicles farther from the host's places are left out.
VEHICLES_M = 110.0
# Footprints of poles with what they hold, and of trunks. Bushes are as wide as their crowns.
POLE_M, TRUNK_M, BUSH_MAX_M = 0.4, 0.6, 2.5
# People look for vehicles that come within AHEAD_S, at these steps of time.
AHEAD_S, AHEAD_STEP_S = 30.0, 0.5
# Headings are measured over this length to both sides.
HEADING_M = 0.5
# The assumed speed of the host in single pictures.
ASSUMED_HOST_M_S = 10.0


class Motion(NamedTuple):
    """Where something is at instants, and where it looks: counter-clockwise from world y."""

    times_s: Scalars
    xy_world: Points2
    yaw_rad: Scalars
    speed_m_s: Scalars

    def thing(self, phase: float, **fields: object) -> Thing:
        """A thing with this motion."""
        values = np.column_stack([self.xy_world, np.unwrap(self.yaw_rad)]).round(SCENE_DECIMALS).tolist()
        names = ("x_m", "y_m", "yaw_rad")
        track = [
            PlanInstant(time_s=time_s, **dict(zip(names, row, strict=True)))
            for time_s, row in zip(self.times_s.round(SCENE_DECIMALS).tolist(), values, strict=True)
        ]
        place = dict(zip(names, values[0], strict=True))
        speed_m_s = round(float(self.speed_m_s[0]), SCENE_DECIMALS)
        moves = tuple(track) if len(track) > 1 else ()
        return Thing.model_validate({**fields, **place, "phase": phase, "speed_m_s": speed_m_s, "track": moves})

    def at(self, times_s: Float[np.ndarray, " t"]) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, "t 2"]]:
        """Places and unit headings at times, as a scene's things go along their tracks."""
        values = np.column_stack([self.xy_world, np.unwrap(self.yaw_rad)])
        if len(self.times_s) > 1:
            within_s = np.clip(times_s, self.times_s[0], self.times_s[-1])
            values = walked_way(self.times_s, values)(within_s)
        else:
            values = np.repeat(values, len(times_s), axis=0)
        return values[:, :2], np.stack([-np.sin(values[:, 2]), np.cos(values[:, 2])], -1)


def track_times(shot: Shot) -> Scalars:
    """The instants of tracks: the clip's first and last, and instants between them."""
    return np.linspace(0.0, shot.duration_s, 1 + int(np.ceil(shot.duration_s / TRACK_EVERY_S)))


class Bodies:
    """The host, the cars and the things of a scene at instants, and what stands there."""

    def __init__(self, scene: Scene, ground: Ground) -> None:
        self.scene, self.ground, self.network = scene, ground, ground.network
        duration_s = scene.shot.duration_s
        self.times_s = np.linspace(0.0, duration_s, 1 + int(np.ceil(duration_s / CHECK_EVERY_S)))
        driven = np.unique([0.0, duration_s / 2, duration_s])
        self.host_places = vehicle_places(scene, self.network, driven, only_host=True)[0].mean(axis=1)
        self.moving = vehicle_places(scene, self.network, self.times_s)
        self.standing = np.array(list(_standing(scene, ground))).reshape(-1, 4, 2)

    @cached_property
    def vehicles_ahead(self) -> Float[np.ndarray, "_ t 4 2"]:
        """The footprints of the host and of the cars near it from the clip's start on, every AHEAD_STEP_S for AHEAD_S,
        when all go on as they do at the clip's end."""
        times_s = np.arange(0.0, AHEAD_S, AHEAD_STEP_S)
        return vehicle_places(self.scene, self.network, times_s, self.host_places)

    def footprints(self, motion: Motion, model: ThingModel, scale: float, room_m: tuple[float, float]) -> np.ndarray:
        """The footprints of a thing at the instants, with room before and behind it, and beside it."""
        ahead_m, beside_m = room_m
        sizes = model.length_m * scale + 2 * ahead_m, model.width_m * scale + 2 * beside_m
        return placement.footprint(*motion.at(self.times_s), *sizes)

    def join(self, motion: Motion, model: ThingModel, scale: float, room_m: tuple[float, float]) -> bool:
        """Add a thing if it touches nothing at any instant, and no road is over or below another there; whether
        it was added."""
        if self.ground.is_stacked(motion.xy_world).any():
            return False
        if not self.is_free(self.footprints(motion, model, scale, room_m)):
            return False
        own = self.footprints(motion, model, scale, (ROOM_M, ROOM_M))
        self.moving = np.concatenate([self.moving, own[None]])
        return True

    def is_free(self, own: Float[np.ndarray, "t 4 2"]) -> bool:
        """Whether footprints touch nothing at the instants."""
        return not (placement.touches_any(own, self.moving) or placement.touches_any(own, self.standing[:, None]))


def vehicle_places(
    scene: Scene,
    network: Network,
    times_s: Float[np.ndarray, " t"],
    near: Float[np.ndarray, "k 2"] | None = None,
    only_host: bool = False,
) -> Float[np.ndarray, "_ t 4 2"]:
    """The footprints of the host and of the cars within VEHICLES_M of some places at times, after the clip's end too,
    when all keep their speed."""
    shot, camera = scene.shot, scene.camera
    host_speed_m_s = shot.speed_m_s if shot.n_frames > 1 else ASSUMED_HOST_M_S
    driven_m = driven_after(shot.track, host_speed_m_s, times_s)
    way = network.host_way(camera)
    found = [way_places(way, camera.y_m * network.onwards, driven_m, camera.offset_m, placement.HOST_SIZE_M)]
    for car in () if only_host else scene.cars:
        model = scene.assets.car_models[car.model - 1]
        size = model.length_m * car.scale, model.width_m * car.scale
        way, start_m = network.car_way(car)
        if near is not None:
            here = way_places(way, start_m, np.zeros(1), car.offset_m, size)[0].mean(axis=0)
            if np.linalg.norm(near - here, axis=1).min() >= VEHICLES_M:
                continue
        driven_m = driven_after(car.track, _speed(scene, car), times_s)
        found.append(way_places(way, start_m, driven_m, car.offset_m, size))
    return np.stack(found)


def _speed(scene: Scene, car: Car) -> float:
    """The speed of a car that has no track."""
    return car.speed_m_s if scene.has_traffic or car.offset_m else ASSUMED_HOST_M_S


def way_places(
    way: LaneCurve,
    start_m: float,
    driven_m: Float[np.ndarray, " t"],
    offset_m: float,
    size: tuple[float, float],
) -> Float[np.ndarray, "t 4 2"]:
    """The footprints of a vehicle of a length and width after distances along a way from a station of it;
    `offset_m` is to its driver's right. Beyond the end of its way it stands there."""
    return placement.footprint(*way_poses(way, start_m, driven_m, offset_m), *size)


def way_poses(
    way: LaneCurve, start_m: float, driven_m: Float[np.ndarray, " t"], offset_m: float
) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, "t 2"]]:
    """Places and unit headings after distances along a way, as of `way_places`."""
    s = np.full(len(driven_m), start_m)
    if driven_m.any():
        s = stations_after(way, start_m, driven_m)
    ahead_m, least_m = HEADING_M if way.ascends else -HEADING_M, way.start_m + HEADING_M
    inside = np.clip(s, least_m, max(way.end_m - HEADING_M, least_m))
    behind, here, ahead = np.split(way.xy_world(np.concatenate([inside - ahead_m, s, inside + ahead_m])), 3)
    heading = (ahead - behind) / np.maximum(np.linalg.norm(ahead - behind, axis=1, keepdims=True), 1e-9)
    right = np.stack([heading[:, 1], -heading[:, 0]], axis=1)
    return here + offset_m * right, heading


def driven_after(track: tuple[tuple[float, float], ...], speed_m_s: float, times_s: Scalars) -> Scalars:
    """How far a vehicle has driven at times: along its track, and at its last speed after that."""
    if len(track) < 2:
        return speed_m_s * times_s
    instants_s, lengths_m = np.array(track).T
    within = scipy.interpolate.PchipInterpolator(instants_s, lengths_m)(np.minimum(times_s, instants_s[-1]))
    last_m_s = (lengths_m[-1] - lengths_m[-2]) / (instants_s[-1] - instants_s[-2])
    return np.asarray(within + last_m_s * np.maximum(times_s - instants_s[-1], 0.0))


def _standing(scene: Scene, ground: Ground) -> Iterator[Float[np.ndarray, "4 2"]]:
    """The corners of buildings, poles and trunks, and of the area that road works close."""
    yield from ground.network.closed
    beside = scene.roadside
    yield from (floor_plan(building)[[0, 6, 48, 42]] for building in beside.buildings)
    poles = [frame.origin[:2] for frame in post_frames(ground, beside.posts)]
    poles += [np.array([item.x_m, item.y_m]) for item in beside.free_elements if item.has_pole]
    yield from (_square(place, POLE_M) for place in poles)
    for tree in scene.trees:
        crown_m = 2 * scene.assets.tree_models[tree.model - 1].crown_radius_m * tree.scale
        is_bush = scene.assets.tree_models[tree.model - 1].height_m * tree.scale < BUSH_MAX_M
        yield _square(np.array([tree.x_m, tree.y_m]), crown_m if is_bush else TRUNK_M)


def _square(middle: Float[np.ndarray, "2"], side_m: float) -> Float[np.ndarray, "4 2"]:
    return placement.footprint(middle, np.array([0.0, 1.0]), side_m, side_m)
