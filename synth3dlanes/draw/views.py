"""Further places of the host in a world that is drawn: pictures of one world from several places, in other light."""

from typing import Any

import numpy as np

from synth3dlanes.draw.cars import CAR_GAP_M
from synth3dlanes.draw.draws import SCENE_DECIMALS, DrawsOf
from synth3dlanes.draw.makers import draw_camera
from synth3dlanes.draw.rules import lane_of_host
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.host import HostCamera, Views
from synth3dlanes.scene.scene import Light, Scene
from synth3dlanes.system.streams import stream
from synth3dlanes.world.camera import world_from_host
from synth3dlanes.world.placement import footprint, host_footprint, overlaps_any
from synth3dlanes.world.world import World

# How far ahead of its first place the host may be in other views: the stations of `camera.y_m` are within 60 m.
REACH_M = 40.0
# What is left of a way on a map beyond the last place.
REST_OF_WAY_M = 60.0
# Draws of a place until it is clear of all objects.
TRIES = 30


def first_view(camera: HostCamera, network: Network, n: int) -> Views:
    """The first of `n` views: the place that was drawn, around which the world is built."""
    left_m = network.way.end_m - REST_OF_WAY_M - camera.y_m
    reach_m = round(min(REACH_M, max(left_m, 0.0)), SCENE_DECIMALS)
    return Views(view=0, n=n, lane=camera.lane, y_m=camera.y_m, offset_m=camera.offset_m, reach_m=reach_m)


def seen_from(of: DrawsOf, world: World, view: int) -> Scene:
    """The scene of a further view of a drawn world. `of` has the draws of the world's scene.

    The host has another lane, station and offset, where it touches nobody; the camera another height and pitch; sun,
    exposure and sky are drawn anew. All else is as in the world.
    """
    scene, name = world.scene, f"view/{view}"
    views = scene.shot.views
    assert views is not None, "asked only of worlds with views"
    given = of.like.given(of.drawn[-1]) if of.like else of.drawn
    n_skies = len(scene.assets.skies)
    changes: dict[str, Any] = {
        "camera": _placed(of, world, name, stream(*given, f"place/{name}")),
        "light": of("light", f"light/{name}").part(Light),
        "sky": 1 + int(stream(*given, f"sky/{name}").random() * n_skies) if n_skies else 0,
        "shot": scene.shot.model_copy(update={"views": views.model_copy(update={"view": view})}),
    }
    return scene.model_copy(update=changes)


def _placed(of: DrawsOf, world: World, name: str, rng: np.random.Generator) -> HostCamera:
    """The camera of a view at a place that is clear of all objects, or at the first view's."""
    scene, others = world.scene, _footprints(world)
    views = scene.shot.views
    assert views is not None, "asked only of worlds with views"
    camera = draw_camera(of("camera", f"camera/{name}"), views.lane, views.y_m)
    for _ in range(TRIES):
        u_station, u_lane = rng.random(2).tolist()
        y_m = round(views.y_m + views.reach_m * u_station, SCENE_DECIMALS)
        lane = lane_of_host(of.params.camera.lane, len(world.network.host_ways(y_m))).draw(u_lane)
        placed = camera.model_copy(update={"lane": lane, "y_m": y_m})
        host = np.asarray(host_footprint(world_from_host(world.network, placed)))
        if not len(others) or not overlaps_any(host, others):
            return placed
    return camera.model_copy(update={"offset_m": views.offset_m})


def _footprints(world: World) -> np.ndarray:
    """The corners of all cars, people and other objects with the gap around each, seen from above; (n, 4, 2)."""
    return np.array(
        [
            footprint(
                item.world_from_object[:2, 3],
                item.world_from_object[:2, 1] / np.linalg.norm(item.world_from_object[:2, 1]),
                item.size_m[1] + CAR_GAP_M[0],
                item.size_m[0] + CAR_GAP_M[1],
            )
            for item in world.view.objects
        ]
    )
