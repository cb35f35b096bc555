"""Params -> Scene: draw scenes from named random streams. Degrees become radians here."""

import math
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from synth3dlanes.assets.catalogue import BUILT_IN, Assets
from synth3dlanes.distributions import Choice, Integers, Uniform
from synth3dlanes.errors import InputError
from synth3dlanes.geometry import placement
from synth3dlanes.geometry.camera import world_from_road
from synth3dlanes.geometry.roadside import footprints
from synth3dlanes.params import CameraParams, Group, Params
from synth3dlanes.roadside import draw_roadside
from synth3dlanes.scene import (
    SCENE_VERSION,
    Air,
    Camera,
    Car,
    Gaussian,
    Light,
    Markings,
    Road,
    Scene,
    Sensor,
    Surface,
    Terrain,
    Tree,
    to_json,
)
from synth3dlanes.streams import stream
from synth3dlanes.world import World, resolve

# Numbers in a scene are rounded to a micrometre or microradian: readable, and equal on every machine.
DECIMALS = 6
CAR_GAP_M = (1.0, 0.3)
TRIES = 300
# From this many scenes on, several processes are faster than one; each draws CHUNK scenes at a time.
WORTH_PROCESSES, CHUNK = 200, 25
# Least distance of a tree from the pavement: metres plus this share of its crown's radius.
TREE_GAP_M, TREE_GAP_OF_CROWN = 1.0, 0.5


def sample_scene(params: Params, seed: int, split: str, index: int, assets: Assets = BUILT_IN.assets) -> Scene:
    """Draw scene `index` of a split; it depends on these arguments alone.

    Raises InputError if there is no room for the cars or trees in their ranges.
    """
    return sample_world(params, seed, split, index, assets).scene


def sample_world(params: Params, seed: int, split: str, index: int, assets: Assets = BUILT_IN.assets) -> World:
    """Draw and resolve scene `index` of a split: first the road and the host, then what stands beside
    it, then cars and trees."""
    draws = {name: Draw(group, stream(seed, split, index, name)) for name, group in params}
    road = _road(draws["road"])
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
        camera=_camera(params.camera, draws["camera"], road),
        light=_plain(Light, draws["light"]),
        air=_plain(Air, draws["air"]),
        sensor=_plain(Sensor, draws["sensor"]),
        sky=_sky(assets, stream(seed, split, index, "sky")),
        assets=assets,
    )
    resolved = resolve(bare)
    roadside = draw_roadside(resolved, draws["roadside"], draws["roadside"].rng)
    world = replace(resolved, scene=bare.model_copy(update={"roadside": roadside}))
    car_places = Draw(params.cars, stream(seed, split, index, "car_places"))
    tree_places = Draw(params.trees, stream(seed, split, index, "tree_places"))
    paints = Draw(params.cars, stream(seed, split, index, "car_saturation"))
    cars = _cars(world, draws["cars"], paints, car_places)
    trees = _trees(world, draws["trees"], tree_places)
    return replace(world, scene=world.scene.model_copy(update={"cars": cars, "trees": trees}))


P = TypeVar("P", Markings, Surface, Light, Air, Sensor)


def scene_texts(
    params: Params, seed: int, split: str, indices: range, assets: Assets = BUILT_IN.assets
) -> Iterator[str]:
    """The `scene.json` of each index in order; many are drawn in parallel, by one process per core."""
    draw = partial(_scene_text, params, seed, split, assets)
    if len(indices) < WORTH_PROCESSES:
        yield from map(draw, indices)
        return
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        yield from pool.map(draw, indices, chunksize=CHUNK)


def _scene_text(params: Params, seed: int, split: str, assets: Assets, index: int) -> str:
    return to_json(sample_scene(params, seed, split, index, assets))


class Draw:
    """Draws the parameters of one group, with one random number each."""

    def __init__(self, group: Group, rng: np.random.Generator) -> None:
        self.group = group
        self.rng = rng

    def __call__(self, key: str) -> Any:
        """Draw parameter `key` of the group: degrees become radians, floats are rounded."""
        return self._rounded(key, getattr(self.group, key).draw(self.rng.random()))

    def rows(self, keys: tuple[str, ...], n: int) -> list[tuple[Any, ...]]:
        """`n` draws of several parameters, row by row."""
        numbers = self.rng.random((n, len(keys)))
        return list(zip(*(self._column(key, numbers[:, j]) for j, key in enumerate(keys)), strict=True))

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
    return Road(**{field: draw(field.replace("_rad", "_deg")) for field in Road.model_fields})


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


def _host_lane(lanes: Integers | Choice[int], u: float, present: int) -> int:
    """Draw from the requested lanes that are present; the last lane present if none of them is."""
    if isinstance(lanes, Integers):
        lanes = Integers(min(lanes.low, present), min(lanes.high, present))
    return min(lanes.draw(u), present)


def _cars(world: World, looks: Draw, paints: Draw, places: Draw) -> tuple[Car, ...]:
    scene = world.scene
    taken = [placement.host_footprint(world_from_road(world.plan, scene.camera))]
    cars = []
    for number in range(looks("n")):
        model, scale = looks("model"), looks("scale")
        (color,) = zip(*looks.rows(("color",), 3), strict=True)
        gloss = looks("gloss")
        body = scene.assets.car_models[model - 1]
        size = body.length_m * scale + CAR_GAP_M[0], body.width_m * scale + CAR_GAP_M[1]
        for _ in range(TRIES):
            s_m = places("s_m")
            lanes = scene.road.segments_at(s_m)
            lane = lanes[int(places.rng.random() * len(lanes))]
            place = placement.footprint(*placement.lane_place(world.plan, lane, s_m), *size)
            if not placement.overlaps_any(place, np.array(taken)):
                break
        else:
            raise InputError(f"cars.n: no room for car {number + 1} within cars.s_m of scene {scene.index}")
        taken.append(place)
        saturation = paints("saturation")
        cars.append(Car(model=model, scale=scale, color=color, gloss=gloss, lane=lane, s_m=s_m, saturation=saturation))
    return tuple(cars)


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
