"""Traffic of a clip: the speeds at which host and cars keep their lanes without touching."""

import numpy as np
from jaxtyping import Float

from synth3dlanes.params.distributions import Uniform
from synth3dlanes.params.params import MotionParams
from synth3dlanes.params.shots import Shots
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.host import Camera, Shot
from synth3dlanes.system.errors import InputError
from synth3dlanes.world import placement
from synth3dlanes.world.motion import stations_after

# Between two instants that are checked no car gains more on another than the gap between them.
CHECK_EVERY_S = 0.05
# Speeds that are drawn for a car before it gets one of those that others have.
SPEED_TRIES = 8
# Terrain and roadside are drawn for a road of some hundred metres.
MAX_DRIVEN_M = 400.0

Way = Float[np.ndarray, "t 4 2"]


def check_way(params: MotionParams, shots: Shots) -> None:
    """Raise InputError where the host of some clip would drive farther than MAX_DRIVEN_M."""
    speed, duration_s = params.host_speed_m_s, (shots.frames - 1) / shots.fps
    fastest_m_s = speed.high if isinstance(speed, Uniform) else max(speed.values)
    if fastest_m_s * duration_s > MAX_DRIVEN_M:
        raise InputError(
            f"frames: expected clips of at most {MAX_DRIVEN_M:g} m, got {duration_s:g} s at up to {fastest_m_s:g} m/s "
            "(motion.host_speed_m_s)"
        )


def on_its_road(network: Network, camera: Camera, shot: Shot) -> Camera:
    """The host, in the lane beside its own if its own leads from its road within the clip."""
    lane = network.host_lane(camera.lane, camera.y_m)
    beside = [at for at in network.lanes_at(camera.y_m * network.onwards) if abs(at.number - lane.number) == 1]
    # On the inside of a bend a lane is shorter than its stations.
    reached_m = camera.y_m + 2 * shot.speed_m_s * shot.duration_s
    after = network.successors(lane.id) if reached_m * network.onwards >= lane.end_m else []
    if not after or any(at.road == lane.road for at in after):
        return camera
    return camera.model_copy(update={"lane": beside[0].number})


class Traffic:
    """Host and cars on their ways through a clip, to which cars are added one by one."""

    def __init__(self, network: Network, camera: Camera, shot: Shot) -> None:
        self.network = network
        self.times_s = np.linspace(0, shot.duration_s, int(np.ceil(shot.duration_s / CHECK_EVERY_S)) + 1)
        host_lane = network.host_lane(camera.lane, camera.y_m).id
        host = self.way(host_lane, camera.y_m, camera.offset_m, placement.HOST_SIZE_M, shot.speed_m_s)
        self.ways, self.speeds = [host], [shot.speed_m_s]

    def way(self, lane: str, s_m: float, offset_m: float, size_m: tuple[float, float], speed_m_s: float) -> Way:
        """The footprints at all instants of a car of some length and width."""
        stations = np.full(len(self.times_s), s_m)
        if speed_m_s:
            stations = stations_after(self.network, self.network.path(lane), s_m, speed_m_s * self.times_s)
        return placement.footprint(*placement.car_place(self.network, lane, stations, offset_m), *size_m)

    def join(
        self, lane: str, s_m: float, offset_m: float, size_m: tuple[float, float], speeds: list[float]
    ) -> float | None:
        """Add a car with the first of these speeds, or those of the others, at which it never touches another; return
        that speed, None without one."""
        others = np.array(self.ways)
        for speed in dict.fromkeys([*speeds, *(self.speeds if speeds != [0.0] else [])]):
            way = self.way(lane, s_m, offset_m, size_m, speed)
            if not placement.overlaps_any(way, others):
                self.ways.append(way)
                self.speeds.append(speed)
                return speed
        return None
