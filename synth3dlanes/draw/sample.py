"""Params -> Scene: draw scenes from named random streams. Degrees become radians here. The things of a scene come last:
all else of a seed is as it is without them."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from synth3dlanes.draw.bodies import Bodies
from synth3dlanes.draw.draws import Draw, DrawsOf, draws_of
from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.like import Neighbourhood
from synth3dlanes.draw.makers import Maker, Roads
from synth3dlanes.draw.mountain import mountain_roads
from synth3dlanes.draw.paper import paper_roads
from synth3dlanes.draw.people import draw_people
from synth3dlanes.draw.riders import draw_riders
from synth3dlanes.draw.town.draw import town_roads
from synth3dlanes.draw.views import first_view, seen_from
from synth3dlanes.draw.works import draw_devices
from synth3dlanes.params.distributions import extent
from synth3dlanes.params.groups import NO_JUNCTION
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.params.params import Params
from synth3dlanes.params.shots import SINGLE, ShotNumbers, Shots
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Assets
from synth3dlanes.scene.host import HostCamera, Lidar
from synth3dlanes.scene.scene import SCENE_VERSION, Scene, Thing, Tree, to_json
from synth3dlanes.system.errors import DrawError
from synth3dlanes.system.processes import process_pool
from synth3dlanes.system.streams import stream
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.roadside import footprints
from synth3dlanes.world.world import World, surfaces_of, world_on

# Decimals of a lidar's elevations in radians: far ahead on the road, a microradian is a centimetre of range.
LIDAR_DECIMALS = 9
# The makers of roads by the parameter that asks for them with any value but none.
MAKERS: dict[tuple[str, str], Maker] = {("town", "junction"): town_roads, ("mountain", "road"): mountain_roads}
# The parts of a scene whose fields are one parameter each.
PARTS = ("markings", "surface", "light", "air", "sensor", "weather", "host", "vegetation")
# Number of scenes from which several processes are faster than one; each draws CHUNK scenes at a time.
WORTH_PROCESSES, CHUNK = 200, 25
# The most rounds in which places are drawn for the trees that have none yet.
TRIES = 300
# Least distance of a tree from the pavement: TREE_GAP_M plus a share of its crown's radius.
TREE_GAP_M, TREE_GAP_OF_CROWN = 1.0, 0.5


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

    Raises DrawError if there is no room for the least number of cars, or for the trees, in their ranges.
    """
    return sample_world(scenes, index).scene


def sample_world(scenes: Scenes, index: int) -> World:
    """Draw and resolve the scene that sample `index` shows."""
    place = scenes.shots.place(index)
    draw = draw_world if scenes.shots.per_scene == 1 else _latest
    return world_in_shot(scenes, draw(scenes, place.scene), place)


def world_again(scenes: Scenes, scene: Scene) -> World:
    """Draw and resolve the scene anew that `scene`, a sample of any split of this seed, was drawn for."""
    index = scenes.shots.index(ShotNumbers(scene.index, scene.shot.frame, scene.shot.camera, scene.shot.view))
    return sample_world(replace(scenes, split=scene.split), index)


def world_in_shot(scenes: Scenes, world: World, place: ShotNumbers) -> World:
    """A drawn world as one view, one frame and one camera see it."""
    scene, shots = world.scene, scenes.shots
    if shots == SINGLE:
        return world
    if place.view:
        scene = seen_from(_draws(scenes, scene.index), world, place.view)
    shot = scene.shot.model_copy(update={"frame": place.frame, "camera": place.camera})
    camera = scene.camera
    if shots.cameras:
        # A user's camera, at the host's place.
        of_view = f"/view/{place.view}" if place.view else ""
        own = shots.cameras[place.camera].drawn(scene.stream(f"camera/{place.camera}{of_view}").random)
        camera = HostCamera(lane=camera.lane, y_m=camera.y_m, offset_m=camera.offset_m, **own)
    return world.seen_in(with_lidar(scene.model_copy(update={"camera": camera, "shot": shot}), shots.lidar))


def with_lidar(scene: Scene, spec: LidarSpec | None) -> Scene:
    """The scene with a lidar on its host; the scene itself if `lidar` is None."""
    if spec is None:
        return scene
    return scene.model_copy(update={"lidar": _lidar(spec, Draw(spec, scene.stream("lidar")))})


def draw_world(scenes: Scenes, index: int) -> World:
    """Draw and resolve scene `index`: roads and host, what stands beside them, what drives on them, trees, paint,
    and people. With `like`, every draw is near a given scene's."""
    of = _draws(scenes, index)
    roads = _maker(scenes, of)(of, scenes.shots, scenes.assets)
    scene = _bare(scenes, of, roads.fields)
    surfaces = surfaces_of(scene, roads.network)
    ground = surfaces.ground
    scene = scene.model_copy(update={"roadside": roads.stand(scene, ground)})
    scene = scene.model_copy(update={"cars": roads.drive(scene, ground)})
    trees = roads.grow(scene, ground, draw_trees(scene, ground, of, roads.has_to_fit))
    scene = scene.model_copy(update={"trees": trees, "symbols": roads.paint(scene, ground)})
    scene = scene.model_copy(update={"things": draw_things(scene, ground, of, roads)})
    if scenes.shots.views == 1:
        return world_on(surfaces, scene)
    # The same world as with one view, on a ground that is fine wherever the host may be.
    views = first_view(scene.camera, roads.network, scenes.shots.views)
    scene = scene.model_copy(update={"shot": scene.shot.model_copy(update={"views": views})})
    return world_on(surfaces_of(scene, roads.network), scene)


def _draws(scenes: Scenes, index: int) -> DrawsOf:
    """The draws of a scene, from the parameters in its weather and at its time of day."""
    drawn = scenes.seed, scenes.split, index
    weather = draws_of(scenes.params, "weather", drawn, scenes.like)
    return DrawsOf(scenes.params.under(weather("kind"), weather("daytime")), drawn, scenes.like)


def _maker(scenes: Scenes, of: DrawsOf) -> Maker:
    """The maker of a scene's roads: the given map's, the parameters' (town, mountain), or the paper's."""
    if scenes.map is not None:
        return scenes.map.roads
    named = (maker for (group, key), maker in MAKERS.items() if of(group)(key) != NO_JUNCTION)
    return next(named, paper_roads)


def _bare(scenes: Scenes, of: DrawsOf, fields: dict[str, Any]) -> Scene:
    """A scene of these roads and this host, on which nothing stands or drives yet."""
    seed, split, index = of.drawn
    given = of.like.given(index) if of.like else of.drawn
    n_skies = len(scenes.assets.skies)
    parts = {name: of(name).part(Scene.model_fields[name].annotation) for name in PARTS}
    return Scene(
        format="synth3dlanes.scene",
        version=SCENE_VERSION,
        seed=seed,
        split=split,
        index=index,
        cars=(),
        trees=(),
        sky=1 + int(stream(*given, "sky").random() * n_skies) if n_skies else 0,
        assets=scenes.assets,
        **parts,
        **fields,
    )


# The pictures of one scene are made one after the other.
_latest = lru_cache(maxsize=1)(draw_world)


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


def _lidar(spec: LidarSpec, draw: Draw) -> Lidar:
    """A user's lidar, at its place on the host."""
    place = ("height_m", "right_m", "forward_m", "yaw_deg", "pitch_deg", "roll_deg")
    fixed = {name: getattr(spec, name) for name in ("name", "azimuths", "min_range_m", "max_range_m")}
    elevations_rad = tuple(np.round(np.radians(spec.elevations_deg), LIDAR_DECIMALS).tolist())
    return Lidar(**fixed, **{name.replace("_deg", "_rad"): draw(name) for name in place}, elevations_rad=elevations_rad)


def draw_trees(scene: Scene, ground: Ground, of: DrawsOf, has_to_fit: bool) -> tuple[Tree, ...]:
    """The trees of a scene. Without room in its ranges a tree is left out; with `has_to_fit` DrawError is raised."""
    looks, places = of("trees"), of("trees", "tree_places")
    drawn = looks.rows(("model", "yaw_deg", "scale"), looks("n"))
    models = scene.assets.tree_models
    trees: list[Tree] = []
    structures = footprints(ground, scene.roadside)
    for _ in range(TRIES):
        if len(trees) == len(drawn):
            break
        xy = np.array(places.rows(("x_m", "y_m"), 2 * (len(drawn) - len(trees)) + 16))
        clear = ground.clearance(xy)
        stands = structures.clear(xy, TREE_GAP_M)
        for (x, y), clearance_m, is_free in zip(xy.tolist(), clear.tolist(), stands.tolist(), strict=True):
            if len(trees) == len(drawn):
                break
            model, yaw_rad, scale = drawn[len(trees)]
            gap_m = TREE_GAP_M + TREE_GAP_OF_CROWN * scale * models[model - 1].crown_radius_m
            if is_free and clearance_m >= gap_m:
                trees.append(Tree(model=model, x_m=x, y_m=y, yaw_rad=yaw_rad, scale=scale))
    if has_to_fit and len(trees) < len(drawn):
        missing = len(drawn) - len(trees)
        raise DrawError(f"trees.x_m, trees.y_m: no room off the roads for {missing} trees of scene {scene.index}")
    return tuple(trees)


def draw_things(scene: Scene, ground: Ground, of: DrawsOf, roads: Roads) -> tuple[Thing, ...]:
    """People, riders, and what stands along road works."""
    devices = tuple(draw_devices(scene, ground, of))
    people, riders = of.params.people, of.params.riders
    most = people.per_100_m, people.crossing, riders.cyclists, riders.motorcyclists
    if not any(extent(number)[1] > 0 for number in most):
        return devices
    bodies = Bodies(scene, ground)
    return (*draw_riders(scene, bodies, of, roads.ride), *draw_people(scene, bodies, of, roads.crossers), *devices)
