"""From what Cycles rendered to the picture: the air before the lens, motion, noise, the film's curve."""

import numpy as np
from jaxtyping import Float, UInt8

from synth3dlanes.blender.air import through_air
from synth3dlanes.blender.sensor import add_noise, motion_blur
from synth3dlanes.blender.sky import daylight, film_factor
from synth3dlanes.blender.tonemap import tonemap
from synth3dlanes.blender.world import HAZE_PASS
from synth3dlanes.geometry.camera import world_from_cam, world_from_road
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.scene import Scene
from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.streams import stream

# Cycles writes 1e10 where a ray hits nothing.
CYCLES_NO_HIT = 1e9


def develop(scene: Scene, layers: dict[str, Float[np.ndarray, "h w _"]]) -> UInt8[np.ndarray, "h w 3"]:
    """The picture of a scene; its noise follows from seed, split and index. Cars keep pace with the host: they and the
    sky stay sharp while the rest is blurred."""
    plan = RoadPlan(scene)
    pose = world_from_cam(plan)
    film = np.float32(film_factor(scene))
    linear = layers["Combined"][..., :3] / film
    linear = through_air(linear, layers[HAZE_PASS], scene, daylight(scene), pose) * film
    if scene.sensor.motion_blur_m > 0:
        ahead_cam = pose[:3, :3].T @ world_from_road(plan)[:3, 1]
        depth = layers["Depth"][..., 0]
        still = (depth > CYCLES_NO_HIT) | (layers["IndexMA"][..., 0] == SEMANTIC_IDS["car"])
        depth_m = np.where(still, np.float32(np.inf), depth)
        linear = motion_blur(linear, depth_m, scene.camera, scene.sensor.motion_blur_m * ahead_cam)
    if scene.sensor.noise > 0:
        rng = stream(scene.seed, scene.split, scene.index, "sensor_noise")
        linear = add_noise(linear, scene.sensor.noise, rng)
    return tonemap(linear)
