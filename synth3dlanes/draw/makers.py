"""What a maker of roads returns, and what makers draw alike: hills, the host's camera and its first picture; of all
roads that are a map, the host's speed, the terrain, and what drives."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from synth3dlanes.draw.cars import allowed_speed, cars_on_map
from synth3dlanes.draw.crossing import Crosser
from synth3dlanes.draw.draws import SCENE_DECIMALS, Draw, DrawsOf
from synth3dlanes.draw.fitted_terrain import GROUND_GRID_STEP_M, terrain_of
from synth3dlanes.draw.riders import RiderPlaces, places_along_road, places_on_map
from synth3dlanes.params.distributions import extent
from synth3dlanes.params.groups import MotionParams
from synth3dlanes.params.shots import Shots
from synth3dlanes.roads.from_map import bare_roads, map_network
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.scene.host import HostCamera, Shot
from synth3dlanes.scene.road_map import RoadMap
from synth3dlanes.scene.roadside import Roadside
from synth3dlanes.scene.scene import Car, Gaussian, Scene, Symbol, Terrain, Tree
from synth3dlanes.system.errors import InputError
from synth3dlanes.world.ground import Ground

# Terrain and roadside are drawn for a road of some hundred metres.
MAX_DRIVEN_M = 400.0


Stand = Callable[[Scene, Ground], Roadside]


@dataclass(frozen=True)
class Roads:
    """The roads of a scene with the host on them. `fields` are the scene's fields that follow: terrain, road or map,
    town, camera, shot. The rest is called in order, with the scene as drawn up to then and its ground: what stands
    beside the roads, what drives on them, the trees that they add to those drawn, and paint that bounds no lane.
    `has_to_fit` says that trees for which there is no room are an error. `ride` has the places of riders; `crossers`
    are the people that the traffic of a clip lets cross, None where it knows of no people."""

    network: Network
    fields: dict[str, Any]
    stand: Stand
    drive: Callable[[Scene, Ground], tuple[Car, ...]]
    grow: Callable[[Scene, Ground, tuple[Tree, ...]], tuple[Tree, ...]] = lambda scene, ground, trees: trees
    paint: Callable[[Scene, Ground], tuple[Symbol, ...]] = lambda scene, ground: ()
    has_to_fit: bool = True
    ride: RiderPlaces = places_along_road
    crossers: tuple[Crosser, ...] | None = None


Maker = Callable[[DrawsOf, Shots, Assets], Roads]


def map_roads(
    of: DrawsOf,
    roads: RoadMap,
    camera: HostCamera,
    shot: Shot,
    stand: Stand,
    ground_step_m: float = GROUND_GRID_STEP_M,
) -> Roads:
    """A map with the host on its route, on a terrain that meets the heights of the map's roads. In a clip the host
    drives no faster than the bends and the end of its way allow; cars drive along the lanes."""
    hills = draw_hills(of("terrain"))
    bare = bare_roads(roads, hills)
    terrain = terrain_of(bare, hills, ground_step_m)
    network = map_network(roads, bare, terrain, camera.y_m)
    if shot.speed_m_s and not shot.track:
        speed_m_s = allowed_speed(network.way, camera.y_m, shot.speed_m_s, shot.duration_s)
        shot = shot.model_copy(update={"speed_m_s": speed_m_s})
    fields = {"terrain": terrain, "road": None, "map": roads, "camera": camera, "shot": shot}
    return Roads(
        network,
        fields,
        stand,
        drive=lambda scene, ground: cars_on_map(scene, network, of, roads.links),
        ride=places_on_map,
    )


def draw_hills(draw: Draw) -> Terrain:
    """The terrain as a sum of Gaussians."""

    def gaussian() -> Gaussian:
        return Gaussian(
            center_m=(draw("center_m"), draw("center_m")),
            magnitude_m=draw("magnitude_m"),
            sd_m=(draw("sd_m"), draw("sd_m")),
            orientation_rad=draw("orientation_deg"),
        )

    return Terrain(gaussians=tuple(gaussian() for _ in range(draw("n_gaussians"))))


def draw_camera(draw: Draw, lane: int, y_m: float) -> HostCamera:
    """The host in a lane at a station."""
    width_px, height_px = draw("width_px"), draw("height_px")
    focal_px = round(width_px / 2 / math.tan(draw("horizontal_fov_deg") / 2), SCENE_DECIMALS)
    return HostCamera(
        lane=lane,
        y_m=y_m,
        offset_m=draw("offset_m"),
        height_m=draw("height_m"),
        pitch_rad=draw("pitch_deg"),
        width_px=width_px,
        height_px=height_px,
        fx_px=focal_px,
        fy_px=focal_px,
        roll_rad=draw("roll_deg"),
        cx_px=width_px / 2 + draw("principal_offset_px"),
        cy_px=height_px / 2 + draw("principal_offset_px"),
    )


def first_shot(shots: Shots, motion: Draw | None) -> Shot:
    """The first picture of a scene; the host's speed in clips is drawn, unless traffic decides it (None)."""
    if motion is not None:
        check_way(motion.group, shots)  # type: ignore[arg-type]
    speed_m_s = motion("host_speed_m_s") if motion is not None and shots.frames > 1 else 0.0
    return Shot(
        n_frames=shots.frames, fps=shots.fps, n_cameras=shots.n_cameras, speed_m_s=speed_m_s, behind_m=shots.behind_m
    )


def check_way(params: MotionParams, shots: Shots) -> None:
    """Raise InputError where the host of some clip would drive farther than MAX_DRIVEN_M."""
    fastest_m_s, duration_s = extent(params.host_speed_m_s)[1], (shots.frames - 1) / shots.fps
    if fastest_m_s * duration_s > MAX_DRIVEN_M:
        raise InputError(
            f"frames: expected clips of at most {MAX_DRIVEN_M:g} m, got {duration_s:g} s at up to {fastest_m_s:g} m/s "
            "(motion.host_speed_m_s)"
        )
