"""Params -> Scene: draw scenes from named random streams. Degrees become radians here."""

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import lru_cache, partial
from multiprocessing import get_context
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from synth3dlanes.assets.car_colors import sold_color
from synth3dlanes.assets.catalogue import BUILT_IN, Assets
from synth3dlanes.cameras import CameraSpec
from synth3dlanes.distributions import Choice, Integers, Uniform
from synth3dlanes.errors import InputError
from synth3dlanes.geometry import placement
from synth3dlanes.geometry.camera import world_from_host
from synth3dlanes.geometry.lanes import connections
from synth3dlanes.geometry.road import RoadPlan, is_wide_enough
from synth3dlanes.geometry.roadside import footprints
from synth3dlanes.geometry.symbols import LENGTHS_M, gore_range
from synth3dlanes.lidars import LidarSpec
from synth3dlanes.like import Drawn, Like, near
from synth3dlanes.params import CameraParams, Group, Params
from synth3dlanes.roadside import draw_roadside
from synth3dlanes.scene import (
    MIN_MEDIAN_M,
    SCENE_VERSION,
    Air,
    Camera,
    Car,
    Gaussian,
    Host,
    Lidar,
    Light,
    Markings,
    Road,
    Scene,
    Sensor,
    Shot,
    Surface,
    Symbol,
    Terrain,
    Tree,
    Vegetation,
    Weather,
    to_json,
)
from synth3dlanes.schema import SymbolKind
from synth3dlanes.shots import SINGLE, Place, Shots
from synth3dlanes.streams import stream
from synth3dlanes.traffic import SPEED_TRIES, Traffic, check_way, on_main_road
from synth3dlanes.weather import under
from synth3dlanes.world import World, resolve

# Numbers in a scene are rounded to a micrometre or microradian: readable, and equal on every machine.
DECIMALS = 6
# Of a lidar's elevations: on the road ahead, a microradian is a centimetre of range.
LIDAR_DECIMALS = 9
CAR_GAP_M = (1.0, 0.3)
TRIES = 300
# The streams of the cars: looks as in the paper, and what was added since, so that it changes none of these.
CAR_STREAMS = ("cars", "car_places", "car_saturation", "car_palette", "parked_cars")
# Cars park at least this far before a split, or behind a merge.
PARKING_BEFORE_EXIT_M = 20.0
# From this many scenes on, several processes are faster than one; each draws CHUNK scenes at a time.
WORTH_PROCESSES, CHUNK = 200, 25
# The shoulder texture that is pavement.
PAVED = 2
# Least distance along the road between symbols, and between them and the split.
SYMBOL_GAP_M, SPLIT_GAP_M = 1.0, 8.0
# Least distance of a tree from the pavement: metres plus this share of its crown's radius.
TREE_GAP_M, TREE_GAP_OF_CROWN = 1.0, 0.5


def sample_scene(
    params: Params,
    seed: int,
    split: str,
    index: int,
    assets: Assets = BUILT_IN.assets,
    shots: Shots = SINGLE,
    like: Like | None = None,
) -> Scene:
    """Draw the scene of sample `index` of a split; it depends on these arguments alone.

    Raises InputError if there is no room for the cars or trees in their ranges.
    """
    return sample_world(params, seed, split, index, assets, shots, like).scene


def sample_world(
    params: Params,
    seed: int,
    split: str,
    index: int,
    assets: Assets = BUILT_IN.assets,
    shots: Shots = SINGLE,
    like: Like | None = None,
) -> World:
    """Draw and resolve what sample `index` of a split shows. The latest scene of several pictures is kept."""
    place = shots.place(index)
    if shots.per_scene == 1:
        return world_in_shot(draw_world(params, seed, split, place.scene, assets, shots, like), shots, place)
    latest = _latest(params, seed, split, place.scene, assets, shots, like)
    latest[0] = world_in_shot(latest[0], shots, place)
    return latest[0]


@lru_cache(maxsize=1)
def _latest(
    params: Params, seed: int, split: str, scene: int, assets: Assets, shots: Shots, like: Like | None
) -> list[World]:
    """The world of a scene as its latest picture shows it, whose caches serve the next one."""
    return [draw_world(params, seed, split, scene, assets, shots, like)]


def world_in_shot(world: World, shots: Shots, place: Place) -> World:
    """A drawn world as one frame and camera show it."""
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
    """The scene with a user's lidar on its host; without one, the scene itself."""
    if spec is None:
        return scene
    return scene.model_copy(update={"lidar": _lidar(spec, Draw(spec, scene.stream("lidar")))})


def draw_world(
    params: Params,
    seed: int,
    split: str,
    index: int,
    assets: Assets,
    shots: Shots = SINGLE,
    like: Like | None = None,
) -> World:
    """Draw and resolve scene `index` of a split: first the road and the host, then what stands beside it, then cars and
    trees, then symbols. With `like`, every draw is near that of a given scene."""
    check_way(params.motion, shots)
    drawn = seed, split, index
    first = _draw(params, "weather", drawn, like)
    params = under(params, first("kind"), first("daytime"))
    draws = {name: _draw(params, name, drawn, like) for name in Params.model_fields}
    road, shot = _road(draws["road"]), _shot(shots, draws["motion"])
    bare = Scene(
        format="synth3dlanes.scene",
        version=SCENE_VERSION,
        seed=seed,
        split=split,
        index=index,
        terrain=_terrain(draws["terrain"]),
        road=road,
        markings=_plain(Markings, draws["markings"]),
        surface=_plain(Surface, draws["surface"]),
        cars=(),
        trees=(),
        camera=on_main_road(_camera(params.camera, draws["camera"], road), road, shot),
        light=_plain(Light, draws["light"]),
        air=_plain(Air, draws["air"]),
        sensor=_plain(Sensor, draws["sensor"]),
        weather=_plain(Weather, draws["weather"]),
        host=_plain(Host, draws["host"]),
        sky=_sky(assets, stream(*(like.given(index) if like else drawn), "sky")),
        assets=assets,
        vegetation=_plain(Vegetation, draws["vegetation"]),
        shot=shot,
    )
    resolved = resolve(bare)
    roadside = draw_roadside(resolved, draws["roadside"], draws["roadside"].rng)
    world = replace(resolved, scene=bare.model_copy(update={"roadside": roadside}))
    tree_places = _draw(params, "trees", drawn, like, "tree_places")
    speeds = _draw(params, "motion", drawn, like, "car_speeds")
    cars = _cars(world, [_draw(params, "cars", drawn, like, name) for name in CAR_STREAMS], speeds)
    trees = _trees(world, draws["trees"], tree_places)
    symbols = _symbols(world, draws["symbols"])
    return replace(world, scene=world.scene.model_copy(update={"cars": cars, "trees": trees, "symbols": symbols}))


# One random number, or several.
Numbers = TypeVar("Numbers", float, np.ndarray)
P = TypeVar("P", Markings, Surface, Light, Air, Sensor, Weather, Host, Vegetation)


def scene_texts(
    params: Params,
    seed: int,
    split: str,
    indices: range,
    assets: Assets = BUILT_IN.assets,
    shots: Shots = SINGLE,
) -> Iterator[str]:
    """The `scene.json` of each sample in order; many are drawn in parallel, by one process per core."""
    draw = partial(_scene_text, params, seed, split, assets, shots)
    if len(indices) < WORTH_PROCESSES:
        yield from map(draw, indices)
        return
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        yield from pool.map(draw, indices, chunksize=CHUNK)


def _scene_text(params: Params, seed: int, split: str, assets: Assets, shots: Shots, index: int) -> str:
    return to_json(sample_scene(params, seed, split, index, assets, shots))


def _draw(params: Params, group: str, drawn: Drawn, like: Like | None, name: str = "") -> "Draw":
    """Draws of a group of parameters from the stream `name` of a scene (by default that of the group)."""
    of_group, name = getattr(params, group), name or group
    if like is None:
        return Draw(of_group, stream(*drawn, name))
    given = stream(*like.given(drawn[-1]), name)
    return NearDraw(of_group, given, partial(like.spread_of, group), stream(*drawn, name))


class Draw:
    """Draws the parameters of one group, with one random number each."""

    def __init__(self, group: Group, rng: np.random.Generator) -> None:
        self.group = group
        self.rng = rng

    def __call__(self, key: str) -> Any:
        """Draw parameter `key` of the group: degrees become radians, floats are rounded."""
        return self._rounded(key, getattr(self.group, key).draw(self._moved(key, self.rng.random())))

    def rows(self, keys: tuple[str, ...], n: int) -> list[tuple[Any, ...]]:
        """`n` draws of several parameters, row by row."""
        numbers = self.rng.random((n, len(keys)))
        columns = (self._column(key, self._moved(key, numbers[:, j])) for j, key in enumerate(keys))
        return list(zip(*columns, strict=True))

    def _moved(self, key: str, us: Numbers) -> Numbers:
        """The random numbers of a parameter."""
        return us

    def _column(self, key: str, us: Float[np.ndarray, " n"]) -> list[Any]:
        distribution = getattr(self.group, key)
        if not isinstance(distribution, Uniform):
            return [self._rounded(key, distribution.draw(u)) for u in us.tolist()]
        values = distribution.low + (distribution.high - distribution.low) * us
        return list(np.round(np.radians(values) if key.endswith("_deg") else values, DECIMALS).tolist())

    @staticmethod
    def _rounded(key: str, value: Any) -> Any:
        if key.endswith("_deg"):
            value = math.radians(value)
        return round(value, DECIMALS) if isinstance(value, float) else value


class NearDraw(Draw):
    """Draws near those of a given scene, whose random numbers are `rng`'s: real parameters within their spread, others
    as given."""

    def __init__(
        self, group: Group, rng: np.random.Generator, spread: Callable[[str], float], moves: np.random.Generator
    ) -> None:
        super().__init__(group, rng)
        self.spread, self.moves = spread, moves

    def _moved(self, key: str, us: Numbers) -> Numbers:
        if not isinstance(getattr(self.group, key), Uniform):
            return us
        return near(us, self.spread(key), self.moves.random(np.shape(us)))


def _plain(part: type[P], draw: Draw) -> P:
    """Draw a part each of whose fields is one parameter."""
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


def _road(draw: Draw) -> Road:
    drawn = {field: draw(field.replace("_rad", "_deg")) for field in Road.model_fields}
    if drawn["topology"] > 2:
        drawn["n_lanes"] = max(drawn["n_lanes"], 2)
    if drawn["n_oncoming"] == 0 or drawn["median_m"] < MIN_MEDIAN_M:
        drawn["median_m"] = 0.0
    road = Road(**drawn)
    return road if is_wide_enough(road) else road.model_copy(update={"n_oncoming": 0, "median_m": 0.0})


def _shot(shots: Shots, draw: Draw) -> Shot:
    """The first picture of a scene."""
    speed_m_s = draw("host_speed_m_s") if shots.frames > 1 else 0.0
    return Shot(
        n_frames=shots.frames, fps=shots.fps, n_cameras=shots.n_cameras, speed_m_s=speed_m_s, behind_m=shots.behind_m
    )


def _camera(params: CameraParams, draw: Draw, road: Road) -> Camera:
    u_lane = draw.rng.random()
    y_m = draw("y_m")
    width_px, height_px = draw("width_px"), draw("height_px")
    focal_px = round(width_px / 2 / math.tan(draw("horizontal_fov_deg") / 2), DECIMALS)
    return Camera(
        lane=_host_lane(params.lane, u_lane, road.lanes_present(y_m)),
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


def _mounted(spec: CameraSpec, host: Camera, rng: np.random.Generator) -> Camera:
    """A user's camera at the host's place."""
    return Camera(lane=host.lane, y_m=host.y_m, offset_m=host.offset_m, **spec.drawn(rng.random))


def _lidar(spec: LidarSpec, draw: Draw) -> Lidar:
    """A user's lidar at its place on the host."""
    place = ("height_m", "right_m", "forward_m", "yaw_deg", "pitch_deg", "roll_deg")
    fixed = {name: getattr(spec, name) for name in ("name", "azimuths", "min_range_m", "max_range_m")}
    elevations_rad = tuple(np.round(np.radians(spec.elevations_deg), LIDAR_DECIMALS).tolist())
    return Lidar(**fixed, **{name.replace("_deg", "_rad"): draw(name) for name in place}, elevations_rad=elevations_rad)


def _host_lane(lanes: Integers | Choice[int], u: float, present: int) -> int:
    """Draw from the requested lanes that are present; the last lane present if none of them is."""
    if isinstance(lanes, Integers):
        lanes = Integers(min(lanes.low, present), min(lanes.high, present))
    return min(lanes.draw(u), present)


def _cars(world: World, draws: Sequence[Draw], speeds: Draw) -> tuple[Car, ...]:
    """The cars, from the draws of CAR_STREAMS and of their speeds."""
    scene = world.scene
    looks, places, paints, sold, parking = draws
    taken = [placement.host_footprint(world_from_host(world.plan, scene.camera))]
    traffic = Traffic(world.plan, scene.camera, scene.shot) if scene.shot.n_frames > 1 else None
    parked = parking("parked")
    cars = []
    for number in range(looks("n")):
        model, scale = looks("model"), looks("scale")
        (color,) = zip(*looks.rows(("color",), 3), strict=True)
        gloss = looks("gloss")
        body = scene.assets.car_models[model - 1]
        size = body.length_m * scale + CAR_GAP_M[0], body.width_m * scale + CAR_GAP_M[1]
        is_parked = parking.rng.random() < parked
        drawn_m_s = [speeds("car_speed_m_s") for _ in range(SPEED_TRIES)] if traffic else []
        for _ in range(TRIES):
            s_m = places("s_m")
            lanes = (*scene.road.segments_at(s_m), *scene.road.oncoming_segments)
            lane = lanes[int(places.rng.random() * len(lanes))]
            offset_m = 0.0
            if is_parked and (found := _parking(world.plan, s_m, size[1], parking.rng)):
                lane, offset_m = found
            place = placement.footprint(*placement.car_place(world.plan, lane, s_m, offset_m), *size)
            if placement.overlaps_any(place, np.array(taken)):
                continue
            speed_m_s = traffic.join(lane, s_m, offset_m, size, [0.0] if offset_m else drawn_m_s) if traffic else 0.0
            if speed_m_s is not None:
                break
        else:
            raise InputError(f"cars.n: no room for car {number + 1} within cars.s_m of scene {scene.index}")
        taken.append(place)
        saturation = paints("saturation")
        palette, (u_paint, u_shade) = sold("palette"), sold.rng.random(2)
        if palette == "sold":
            color, saturation = sold_color(body, u_paint, u_shade), 1.0
        looks_of = {"model": model, "scale": scale, "color": color, "gloss": gloss, "saturation": saturation}
        cars.append(Car(**looks_of, lane=lane, s_m=s_m, offset_m=offset_m, speed_m_s=speed_m_s))
    return tuple(cars)


def _parking(plan: RoadPlan, s_m: float, width_m: float, rng: np.random.Generator) -> tuple[str, float] | None:
    """A lane at whose outer shoulder a car can stand, and its offset there to the driver's right; None without room.

    Nobody parks where an exit opens.
    """
    lanes = plan.road.segments_at(s_m)
    outermost = [lanes[0] if plan.flips[0] < 0 else lanes[-1]]
    if plan.has_exit and s_m * plan.flips[1] > -PARKING_BEFORE_EXIT_M:
        outermost = []
    if plan.n_oncoming:
        outermost.append(plan.road.oncoming_segments[0 if plan.flips[0] > 0 else -1])
    if not outermost or plan.shoulder_m < width_m:
        return None
    offset_m = float(plan.flips[0]) * (plan.width_m + plan.shoulder_m) / 2
    return outermost[int(rng.random() * len(outermost))], round(offset_m, DECIMALS)


def _trees(world: World, looks: Draw, places: Draw) -> tuple[Tree, ...]:
    drawn = looks.rows(("model", "yaw_deg", "scale"), looks("n"))
    models = world.scene.assets.tree_models
    trees: list[Tree] = []
    structures = footprints(world.ground, world.scene.roadside)
    for _ in range(TRIES):
        if len(trees) == len(drawn):
            return tuple(trees)
        xy = np.array(places.rows(("x_m", "y_m"), 2 * (len(drawn) - len(trees)) + 16))
        clear = world.ground.clearance(xy)
        stands = structures.clear(xy, TREE_GAP_M)
        for (x, y), clearance_m, is_free in zip(xy.tolist(), clear.tolist(), stands.tolist(), strict=True):
            if len(trees) == len(drawn):
                break
            model, yaw_rad, scale = drawn[len(trees)]
            gap_m = TREE_GAP_M + TREE_GAP_OF_CROWN * scale * models[model - 1].crown_radius_m
            if is_free and clearance_m >= gap_m:
                trees.append(Tree(model=model, x_m=x, y_m=y, yaw_rad=yaw_rad, scale=scale))
    missing = len(drawn) - len(trees)
    raise InputError(f"trees.x_m, trees.y_m: no room off the roads for {missing} trees of scene {world.scene.index}")


def _symbols(world: World, draw: Draw) -> tuple[Symbol, ...]:
    """Symbols that do not overlap along the road; those without room are left out, and a gore on a gravel shoulder."""
    road, plan = world.scene.road, world.plan
    asked: dict[SymbolKind, int] = {"crosswalk": draw("crosswalks"), "stop_line": draw("stop_lines")}
    n_arrow_rows, gore = draw("arrow_rows"), draw("gore")
    turns = draw.rng.random(2).tolist()
    taken: list[tuple[float, float]] = []

    def place(length_m: float, beyond_m: float) -> float | None:
        """A free station before the split or, in the plan, beyond a station behind it."""
        for _ in range(TRIES):
            s_m = draw("s_m")
            s_plan, reach_m = s_m * plan.flips[1], length_m / 2 + SYMBOL_GAP_M
            is_clear = s_plan + reach_m < -SPLIT_GAP_M or s_plan - reach_m > beyond_m or not plan.has_exit
            if is_clear and all(abs(s_m - other_m) > (length_m + other) / 2 + SYMBOL_GAP_M for other_m, other in taken):
                taken.append((s_m, length_m))
                return s_m
        return None

    symbols = []
    for kind, n in asked.items():
        for _ in range(n):
            if (s_m := place(LENGTHS_M[kind], math.inf)) is not None:
                symbols.append(Symbol(kind=kind, lane=None, s_m=s_m))
    for _ in range(n_arrow_rows):
        if (s_m := place(LENGTHS_M["arrow_straight"], plan.nose_m + SPLIT_GAP_M)) is not None:
            lanes = road.segments_at(s_m)
            symbols += [Symbol(kind=_arrow(world, lane, turns), lane=lane, s_m=s_m) for lane in lanes]
    room = gore_range(plan)
    if gore and room is not None and world.scene.surface.shoulder_texture == PAVED:
        symbols.append(Symbol(kind="gore", lane=None, s_m=round(room[0] * plan.flips[1], DECIMALS)))
    return tuple(symbols)


def _arrow(world: World, lane: str, turns: list[float]) -> SymbolKind:
    """The arrow of a lane: where its successors lead, or as before a junction on a road without exit, where `turns` in
    [0, 1) decide what the outer lanes may do."""
    plan, merges = world.plan, world.scene.road.flip_lateral
    to_exit: tuple[SymbolKind, SymbolKind] = ("arrow_right", "arrow_straight_right")
    to_main: SymbolKind = "arrow_left"
    if world.scene.road.flip_longitudinal:
        to_exit, to_main = ("arrow_left", "arrow_straight_left"), "arrow_right"
    if not plan.has_exit:
        lefts: tuple[SymbolKind, ...] = ("arrow_straight", "arrow_straight_left", "arrow_left")
        rights: tuple[SymbolKind, ...] = ("arrow_straight", "arrow_straight_right", "arrow_right")
        if lane == "main_1":
            return lefts[int(3 * turns[0])]
        return rights[int(3 * turns[1])] if lane == f"main_{plan.n_lanes}" else "arrow_straight"
    if merges:
        return to_main if lane.startswith("exit") else "arrow_straight"
    follow = [fork.startswith("exit") for stem, fork in connections(plan) if stem == lane]
    return to_exit[0] if follow and all(follow) else to_exit[1] if any(follow) else "arrow_straight"
