"""From rendered layers to the picture: haze, motion blur, noise, tone curve."""

import numpy as np
from jaxtyping import UInt8

from synth3dlanes.imaging.daylight import Daylight
from synth3dlanes.imaging.film import tonemap
from synth3dlanes.imaging.haze import through_air
from synth3dlanes.imaging.layers import Layers
from synth3dlanes.imaging.sensor import add_noise, motion_blur
from synth3dlanes.scene import Scene
from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.world import View


def develop(scene: Scene, view: View, light: Daylight, layers: Layers) -> UInt8[np.ndarray, "h w 3"]:
    """The picture of a scene; its noise follows from seed, split and index. Motion blur leaves the sky sharp, and cars,
    which are assumed to drive at the host's speed."""
    film = np.float32(light.film)
    linear = through_air(layers.radiance, layers.haze, scene.air.visibility_m, light.airlight, view) * film
    if scene.sensor.motion_blur_m > 0:
        ahead_cam = view.world_from_cam[:3, :3].T @ view.world_from_road[:3, 1]
        depth_m = np.where(layers.semantic == SEMANTIC_IDS["car"], np.float32(np.inf), layers.depth_m)
        linear = motion_blur(linear, depth_m, view.camera, scene.sensor.motion_blur_m * ahead_cam)
    if scene.sensor.noise > 0:
        linear = add_noise(linear, scene.sensor.noise, scene.stream("sensor_noise"))
    return tonemap(linear)
