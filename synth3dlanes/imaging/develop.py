"""From rendered layers to the picture: haze, motion, what falls, stray light, glass, noise, tone curve."""

import numpy as np
from jaxtyping import Bool, Float, UInt8

from synth3dlanes.imaging.daylight import Daylight
from synth3dlanes.imaging.falling import add_falling, add_spray
from synth3dlanes.imaging.film import tonemap
from synth3dlanes.imaging.glare import add_glow, add_lamp_heads, add_sun_glare
from synth3dlanes.imaging.glass import add_dirt, add_drops
from synth3dlanes.imaging.haze import through_air
from synth3dlanes.imaging.layers import Layers
from synth3dlanes.imaging.sensor import add_noise, add_vignette, gain, motion_blur
from synth3dlanes.scene.host import HostCamera
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import KINDS
from synth3dlanes.world.camera import rays_of_pixels
from synth3dlanes.world.motion import host_exposure
from synth3dlanes.world.world import View

NO_LAMPS = np.zeros((0, 3))
MOVING_ALONG = [kind.semantic_id for kind in KINDS if kind.keeps_pace]


def develop(
    scene: Scene,
    view: View,
    light: Daylight,
    layers: Layers,
    street_lamps: Float[np.ndarray, "n 3"] = NO_LAMPS,
) -> UInt8[np.ndarray, "h w 3"]:
    """The picture of a scene; its noise, rain, snow, drops and dirt follow from seed, split and index. Motion blur
    leaves the sky sharp, and what is assumed to drive at the host's speed. `street_lamps` are the heads of
    lamps (world)."""
    sensor, is_seen = scene.sensor, _is_seen(view.camera)
    linear = through_air(layers.radiance, layers.haze, scene.air.visibility_m, light.airlight, view)
    if not is_seen.all():
        # There are no rays, and what follows would spread NaN over the picture.
        linear = np.where(is_seen[..., None], linear, np.float32(0))
    airlight = light.airlight.mean(axis=1)
    if scene.weather.rain > 0:
        linear = add_spray(linear, layers.depth_m, scene, view, airlight)
    amplified = gain(linear * np.float32(light.film), is_seen, scene.light.metering)
    film = light.film * amplified
    linear = linear * np.float32(film)
    driven_m = host_exposure(scene.shot, sensor.motion_blur_m).driven_m
    if driven_m > 0:
        ahead_cam = view.world_from_cam[:3, :3].T @ view.world_from_road[:3, 1]
        depth_m = np.where(np.isin(layers.semantic, MOVING_ALONG), np.float32(np.inf), layers.depth_m)
        linear = motion_blur(linear, depth_m, view.camera, driven_m * ahead_cam)
    linear = add_falling(linear, layers.depth_m, scene, view, airlight, film)
    if len(street_lamps) and scene.light.sun_zenith_rad > np.pi / 2:
        linear = add_lamp_heads(linear, layers.depth_m, street_lamps, view, film)
    if sensor.flare > 0:
        stray = add_sun_glare(add_glow(linear), layers.depth_m, scene.light, light, view)
        linear = linear + np.float32(sensor.flare) * (stray - linear)
    if sensor.drops > 0:
        linear = add_drops(linear, sensor.drops, scene.glass_stream("drops"))
    if sensor.dirt > 0:
        linear = add_dirt(linear, sensor.dirt, scene.glass_stream("dirt"))
    if sensor.vignette > 0:
        linear = add_vignette(linear, view.camera, sensor.vignette)
    if sensor.noise > 0:
        linear = add_noise(linear, sensor.noise, scene.picture_stream("sensor_noise"), amplified)
    if not is_seen.all():
        linear = np.where(is_seen[..., None], linear, np.float32(0))
    return tonemap(linear)


def _is_seen(camera: HostCamera) -> Bool[np.ndarray, "h w"]:
    """Which pixels are in the field of the camera's lens."""
    if camera.lens.is_pinhole:
        return np.ones((camera.height_px, camera.width_px), bool)
    return np.asarray(np.isfinite(rays_of_pixels(camera)).all(axis=-1))
