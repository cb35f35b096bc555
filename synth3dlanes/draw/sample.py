"""Params -> Scene: draw scenes from named random streams. Degrees become radians here."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any, TypeVar

import numpy as np

from synth3dlanes.draw.cars import CAR_STREAMS, draw_cars
from synth3dlanes.draw.draws import DECIMALS, Draw, DrawsOf, draws_of
from synth3dlanes.draw.like import Neighbourhood
from synth3dlanes.draw.map_standing import map_trees, stand
from synth3dlanes.draw.map_terrain import terrain_of
from synth3dlanes.draw.on_map import MapPlace, draw_map_cars, farthest, host_length, slowed
from synth3dlanes.draw.roadside import draw_roadside
from synth3dlanes.draw.rules import lane_of_host
from synth3dlanes.draw.symbols import draw_symbols
from synth3dlanes.draw.town.draw import cars_of, draw_map, drive, parked_cars, shot_of
from synth3dlanes.draw.town.furniture import furnish, street_trees
from synth3dlanes.draw.traffic import check_way, on_its_road
from synth3dlanes.draw.traffic_elements import draw_elements
from synth3dlanes.draw.trees import draw_trees, trees_with_room
from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.params.params import NO_JUNCTION, CameraParams, Params
from synth3dlanes.params.shots import SINGLE, ShotNumbers, Shots
from synth3dlanes.roads.map_roads import map_network
from synth3dlanes.roads.paper_roads import is_wide_enough, paper_network
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Assets
from synth3dlanes.scene.host import Camera, Host, Lidar, Shot
from synth3dlanes.scene.scene import (
    MIN_MEDIAN_M,
    SCENE_VERSION,
    Air,
    Gaussian,
    Light,
    Markings,
    PaperRoad,
    Scene,
    Sensor,
    Surface,
    Terrain,
    Vegetation,
    Weather,
    to_json,
)
from synth3dlanes.system.processes import process_pool
from synth3dlanes.system.streams import stream
from synth3dlanes.world.world import World, resolve

# Of a lidar's elevations: on the road ahead, a microradian is a centimetre of range.
LIDAR_DECIMALS = 9
# From this many scenes on, several processes are faster than one; each draws CHUNK scenes at a time.
WORTH_PROCESSES, CHUNK = 200, 25


@dataclass(frozen=True)
class Scenes:
    """All values that decide the scenes of a split and their pictures. Equal values give equal scenes."""

    params: Params
    seed: int = 0
    split: str = "train"
    assets: Assets = field(default=BUILT_IN.assets, kw_only=True)
    shots: Shots = field(default=SINGLE, kw_only=True)
    like: Neighbourhood | None = field(default=None, kw_only=True)
    map: MapPlace | None = field(default=None, kw_only=True)


def sample_scene(scenes: Scenes, index: int) -> Scene:
    """Draw the scene of sample `index`, which depends on these arguments alone.

    Raises InputError if there is no room for the least number of cars, or for the trees, in their ranges.
    """
    return sample_world(scenes, index).scene


def sample_world(scenes: Scenes, index: int) -> World:
    """Draw and resolve the scene that sample `index` shows."""
    place = scenes.shots.place(index)
    draw = draw_world if scenes.shots.per_scene == 1 else _latest
    return world_in_shot(draw(scenes, place.scene), scenes.shots, place)


def world_again(scenes: Scenes, scene: Scene) -> World:
    """Draw and resolve the scene anew that `scene`, a sample of any split of this seed, was drawn for."""
    index = scenes.shots.index(ShotNumbers(scene.index, scene.shot.frame, scene.shot.camera))
    return sample_world(replace(scenes, split=scene.split), index)


def world_in_shot(world: World, shots: Shots, place: ShotNumbers) -> World:
    """A drawn world as one frame and one camera see it."""
    if shots == SINGLE:
        return world
    scene = world.scene
    shot = scene.shot.model_copy(update={"frame": place.frame, "camera": place.camera})
    camera = scene.camera
    if shots.cameras:
        spec = shots.cameras[place.camera]
        camera = _mounted(spec, camera, scene.stream(f"camera/{place.camera}"))
    return world.seen_in(with_lidar(scene.model_copy(update={"camera": camera, "shot": shot}), shots.lidar))


def with_lidar(scene: Scene, spec: LidarSpec | None) -> Scene:
    """The scene with a lidar on its host; the scene itself if `lidar` is None."""
    if spec is None:
        return scene
    return scene.model_copy(update={"lidar": _lidar(spec, Draw(spec, scene.stream("lidar")))})


def draw_world(scenes: Scenes, index: int) -> World:
    """Draw and resolve scene `index`: first the road and the host, then what stands beside it, then cars and trees,
    then symbols. With `like`, every draw is near that of a given scene."""
    params, shots, like = scenes.params, scenes.shots, scenes.like
    drawn = scenes.seed, scenes.split, index
    first = draws_of(params, "weather", drawn, like)
    params = params.under(first("kind"), first("daytime"))
    of = DrawsOf(params, drawn, like)
    if scenes.map is not None:
        return _map_world(scenes, scenes.map, index, of)
    if params.is_town and of("town")("junction") != NO_JUNCTION:
        return _town_world(scenes, index, of)
    check_way(params.motion, shots)
    terrain, road, shot = _terrain(of("terrain")), _road(of("road")), _shot(shots, of("motion"))
    network = paper_network(road, terrain)
    camera = on_its_road(network, _host_camera(params.camera, of("camera"), road), shot)
    bare = _bare(scenes, index, of, {"terrain": terrain, "road": road, "camera": camera, "shot": shot})
    world = resolve(bare, network)
    own = of("structures")
    roadside = draw_elements(world, draw_roadside(world, of("roadside"), own), of("roadside", "traffic_elements"), own)
    world = world.furnished(bare.model_copy(update={"roadside": roadside}))
    cars = draw_cars(world, [of("cars", name) for name in CAR_STREAMS], of("motion", "car_speeds"))
    trees = draw_trees(world, of("trees"), of("trees", "tree_places"))
    symbols = draw_symbols(world, of("symbols"))
    return world.furnished(world.scene.model_copy(update={"cars": cars, "trees": trees, "symbols": symbols}))


def _map_world(scenes: Scenes, given: MapPlace, index: int, of: DrawsOf) -> World:
    """Draw and resolve a place of the given map: the host's way, the ground that meets the roads, cars and trees."""
    check_way(of.params.motion, scenes.shots)
    part = given.draw(stream(scenes.seed, scenes.split, index, "map"))
    terrain, at_m = terrain_of(part.map, _terrain(of("terrain"))), host_length(part)
    network = map_network(part.map, terrain, at_m)
    place = {"terrain": terrain, "road": None, "map": part.map}
    camera = _camera(of("camera"), {"lane": 1, "y_m": at_m})
    shot = slowed(network, at_m, _shot(scenes.shots, of("motion")))
    bare = _bare(scenes, index, of, place | {"camera": camera, "shot": shot})
    world = resolve(bare, network)
    world = world.furnished(bare.model_copy(update={"roadside": stand(part, world, of("roadside", "map_standing"))}))
    cars = draw_map_cars(
        world, network, of("cars", "map_cars"), of("motion", "car_speeds"), farthest(of.params.cars.s_m)
    )
    trees, _ = trees_with_room(world, of("trees"), of("trees", "tree_places"))
    trees += map_trees(part, world, of("trees", "map_trees"))
    return world.furnished(world.scene.model_copy(update={"cars": cars, "trees": trees}))


def _town_world(scenes: Scenes, index: int, of: DrawsOf) -> World:
    """Draw and resolve a town: its map and the host's way, the traffic, then what stands along the streets."""
    terrain, markings, assets = _terrain(of("terrain")), _plain(Markings, of("markings")), scenes.assets
    own = of("town_streets")
    bay_m, trees_apart_m = own("bay_m"), own("trees_apart_m")
    town = draw_map(of("town"), own, of("town", "town_layout").rng, markings)
    camera = _camera(of("camera"), {"lane": 1, "y_m": round(town.host.at_m, DECIMALS)})
    town = town._replace(host=town.host._replace(offset_m=camera.offset_m))
    shot, flow = _shot(scenes.shots, None), of("town", "town_flow")
    traffic = drive(town, of("cars", "town_traffic"), own, assets, flow("traffic"), shot.duration_s)
    place = {"terrain": terrain, "road": None, "map": town.map.road_map(town.host.lanes), "town": town.map.town}
    bare = _bare(scenes, index, of, place | {"camera": camera, "shot": shot_of(town, traffic, shot, terrain)})
    world = resolve(bare)
    roadside = furnish(
        town.map, traffic.lights, world.ground, of("town", "town_fronts"), of("roadside"), of("structures"), own
    )
    looks = of("cars", "town_cars")
    cars = cars_of(town, traffic, terrain, looks, assets)
    cars += parked_cars(town, traffic, flow("parked"), bay_m, looks, assets)
    world = world.furnished(bare.model_copy(update={"roadside": roadside, "cars": cars}))
    trees = street_trees(
        town.map, world.ground, roadside, of("town", "town_trees"), trees_apart_m, of("trees", "street_trees")
    )
    trees += draw_trees(world, of("trees"), of("trees", "tree_places"))
    return world.furnished(world.scene.model_copy(update={"trees": trees}))


def _bare(scenes: Scenes, index: int, of: DrawsOf, place: dict[str, Any]) -> Scene:
    """A scene of these roads and this host, on which nothing stands or drives yet."""
    like = scenes.like
    given = like.given(index) if like else (scenes.seed, scenes.split, index)
    return Scene(
        format="synth3dlanes.scene",
        version=SCENE_VERSION,
        seed=scenes.seed,
        split=scenes.split,
        index=index,
        markings=_plain(Markings, of("markings")),
        surface=_plain(Surface, of("surface")),
        cars=(),
        trees=(),
        light=_plain(Light, of("light")),
        air=_plain(Air, of("air")),
        sensor=_plain(Sensor, of("sensor")),
        weather=_plain(Weather, of("weather")),
        host=_plain(Host, of("host")),
        sky=_sky(scenes.assets, stream(*given, "sky")),
        assets=scenes.assets,
        vegetation=_plain(Vegetation, of("vegetation")),
        **place,
    )


# The pictures of one scene are made one after the other.
_latest = lru_cache(maxsize=1)(draw_world)


P = TypeVar("P", Markings, Surface, Light, Air, Sensor, Weather, Host, Vegetation)


def scene_texts(scenes: Scenes, indices: range) -> Iterator[str]:
    """The `scene.json` of each sample in order; many are drawn in parallel, by one process per core."""
    draw = partial(_scene_text, scenes)
    if len(indices) < WORTH_PROCESSES:
        yield from map(draw, indices)
        return
    with process_pool() as pool:
        yield from pool.map(draw, indices, chunksize=CHUNK)


def _scene_text(scenes: Scenes, index: int) -> str:
    return to_json(sample_scene(scenes, index))


def _plain(part: type[P], draw: Draw) -> P:
    """Draw a part of the scene whose fields are one parameter each."""
    return part(**{field: draw(field.replace("_rad", "_deg")) for field in part.model_fields})


def _sky(assets: Assets, rng: np.random.Generator) -> int:
    return 1 + int(rng.random() * len(assets.skies)) if assets.skies else 0


def _terrain(draw: Draw) -> Terrain:
    def gaussian() -> Gaussian:
        return Gaussian(
            center_m=(draw("center_m"), draw("center_m")),
            magnitude_m=draw("magnitude_m"),
            sd_m=(draw("sd_m"), draw("sd_m")),
            orientation_rad=draw("orientation_deg"),
        )

    return Terrain(gaussians=tuple(gaussian() for _ in range(draw("n_gaussians"))))


def _road(draw: Draw) -> PaperRoad:
    drawn = {field: draw(field.replace("_rad", "_deg")) for field in PaperRoad.model_fields}
    if drawn["topology"] > 2:
        drawn["n_lanes"] = max(drawn["n_lanes"], 2)
    if drawn["n_oncoming"] == 0 or drawn["median_m"] < MIN_MEDIAN_M:
        drawn["median_m"] = 0.0
    road = PaperRoad(**drawn)
    return road if is_wide_enough(road) else road.model_copy(update={"n_oncoming": 0, "median_m": 0.0})


def _shot(shots: Shots, draw: Draw | None) -> Shot:
    """The first picture of a scene; the host's speed is drawn, but in towns."""
    speed_m_s = draw("host_speed_m_s") if draw is not None and shots.frames > 1 else 0.0
    return Shot(
        n_frames=shots.frames, fps=shots.fps, n_cameras=shots.n_cameras, speed_m_s=speed_m_s, behind_m=shots.behind_m
    )


def _host_camera(params: CameraParams, draw: Draw, road: PaperRoad) -> Camera:
    """The host on the paper's road."""
    u_lane, y_m = draw.rng.random(), draw("y_m")
    return _camera(draw, {"lane": lane_of_host(params.lane, road.lanes_present(y_m)).draw(u_lane), "y_m": y_m})


def _camera(draw: Draw, place: dict[str, Any]) -> Camera:
    """The host at a place."""
    width_px, height_px = draw("width_px"), draw("height_px")
    focal_px = round(width_px / 2 / math.tan(draw("horizontal_fov_deg") / 2), DECIMALS)
    return Camera(
        **place,
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


def _mounted(spec: CameraSpec, host: Camera, rng: np.random.Generator) -> Camera:
    """A user's camera, at the host's place."""
    return Camera(lane=host.lane, y_m=host.y_m, offset_m=host.offset_m, **spec.drawn(rng.random))


def _lidar(spec: LidarSpec, draw: Draw) -> Lidar:
    """A user's lidar, at its place on the host."""
    place = ("height_m", "right_m", "forward_m", "yaw_deg", "pitch_deg", "roll_deg")
    fixed = {name: getattr(spec, name) for name in ("name", "azimuths", "min_range_m", "max_range_m")}
    elevations_rad = tuple(np.round(np.radians(spec.elevations_deg), LIDAR_DECIMALS).tolist())
    return Lidar(**fixed, **{name.replace("_deg", "_rad"): draw(name) for name in place}, elevations_rad=elevations_rad)
