"""Sky and sun: a clear-sky radiance table with clouds drawn into one equirectangular image, and a sun lamp.

World frame, azimuth counter-clockwise from x. The table (blender_assets/sky.py) holds no sun disc; the lamp is the sun.
"""

from functools import cache
from zlib import crc32

import bpy
import mathutils
import numpy as np
from jaxtyping import Float
from PIL import Image

from synth3dlanes.blender.assets import assets_dir
from synth3dlanes.blender.shaders import Graph
from synth3dlanes.scene import Light, Scene

# Irradiance of the sun outside the atmosphere in the picture's units: sets how bright exposure 1 is.
SUN_STRENGTH = 3.4
SUN_ANGLE_RAD = 0.0093  # the sun's diameter
SKY_SHAPE = (512, 1024)
HORIZON = SKY_SHAPE[0] // 2
N_CLOUD_MAPS = 4
BELOW_HORIZON = 0.9  # of the horizon's radiance
CLOUD_ALBEDO = 0.75


def make_world() -> None:
    """Make the scene's world and sun, once per process.

    The sampling method must be set here: Cycles builds its 4k importance map for a world that had another one first.
    """
    world = bpy.data.worlds.new("sky")
    world.cycles.sampling_method = "NONE"
    world.use_nodes = True
    world.node_tree.nodes.clear()
    graph = Graph(world.node_tree)
    image = bpy.data.images.new("sky", SKY_SHAPE[1], SKY_SHAPE[0], float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    texture = graph.node("ShaderNodeTexEnvironment", image=image)
    background = graph.node("ShaderNodeBackground", {"Color": texture.outputs[0]})
    graph.node("ShaderNodeOutputWorld", {"Surface": background.outputs[0]})
    bpy.context.scene.world = world
    lamp = bpy.data.lights.new("sun", "SUN")
    lamp.angle = SUN_ANGLE_RAD
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("sun", lamp))


def set_light(scene: Scene) -> None:
    """Point and colour the sun and repaint the sky for one scene; its clouds follow from seed, split and index."""
    light = scene.light
    rng = np.random.default_rng([scene.seed, crc32(scene.split.encode()), scene.index, crc32(b"clouds")])
    pixels = np.ones((*SKY_SHAPE, 4), np.float32)
    pixels[..., :3] = np.moveaxis(SUN_STRENGTH * sky_image(light, cloud_cover(rng)), 0, -1)
    image = bpy.data.images["sky"]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    sun = bpy.data.objects["sun"]
    sun.rotation_mode = "QUATERNION"
    sun.rotation_quaternion = mathutils.Vector(sun_direction(light).tolist()).to_track_quat("Z", "Y")
    color = sun_color(light)
    sun.data.energy = SUN_STRENGTH * float(color.max())
    sun.data.color = (color / color.max()).tolist()


def sun_direction(light: Light) -> Float[np.ndarray, "3"]:
    """Unit vector towards the sun, world frame."""
    zenith, azimuth = light.sun_zenith_rad, light.sun_azimuth_rad
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])


@cache
def _sky_table() -> dict[str, Float[np.ndarray, "..."]]:
    with np.load(assets_dir() / "sky.npz") as table:
        return dict(table)


def sun_color(light: Light) -> Float[np.ndarray, "3"]:
    """The sun's irradiance after the atmosphere, as a share of that outside it."""
    table = _sky_table()
    return _weights(table["sun_zenith_rad"], np.array([light.sun_zenith_rad]))[0] @ table["sun_transmittance"]


def cloud_cover(rng: np.random.Generator) -> Float[np.ndarray, "h w"]:
    """Opacity 0..1 of one of the cloud maps, turned to a random azimuth; rows from zenith to horizon."""
    file = assets_dir() / "textures" / f"clouds_{rng.integers(1, N_CLOUD_MAPS + 1)}.png"
    with Image.open(file) as picture:
        cover = np.asarray(picture, np.float32) / 255
    strength = np.float32(rng.uniform(0.0, 1.0))
    return strength * np.roll(cover, rng.integers(cover.shape[1]), axis=1)


def sky_image(light: Light, cover: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "3 H W"]:
    """Radiance in Blender's equirectangular layout: bottom row first, azimuth falling from pi to -pi."""
    elevation = np.pi * ((np.arange(SKY_SHAPE[0]) + 0.5) / SKY_SHAPE[0] - 0.5)
    azimuth = np.pi - 2 * np.pi * (np.arange(SKY_SHAPE[1]) + 0.5) / SKY_SHAPE[1]
    from_sun = np.abs((azimuth - light.sun_azimuth_rad + np.pi) % (2 * np.pi) - np.pi)
    clear = clear_sky(light, elevation[HORIZON:], from_sun)
    sunlit = sun_color(light) * (0.3 + 0.7 * np.cos(light.sun_zenith_rad)) * CLOUD_ALBEDO / np.pi
    ambient = clear.mean(axis=(1, 2))
    opacity = cover[::-1]
    thickness_shade = 1.25 - 0.5 * opacity
    sky = np.zeros((3, *SKY_SHAPE), np.float32)
    for channel in range(3):
        cloud = sunlit[channel] * thickness_shade + ambient[channel]
        sky[channel, HORIZON:] = clear[channel] + opacity * (cloud - clear[channel])
        sky[channel, :HORIZON] = BELOW_HORIZON * clear[channel, 0].mean()
    return sky


def clear_sky(
    light: Light, elevation_rad: Float[np.ndarray, " h"], from_sun_rad: Float[np.ndarray, " w"]
) -> Float[np.ndarray, "3 h w"]:
    """Cloudless radiance per unit of solar irradiance, interpolated in the table."""
    table = _sky_table()
    at_sun = _weights(table["sun_zenith_rad"], np.array([light.sun_zenith_rad]))[0]
    by_elevation = _weights(table["elevation_rad"], elevation_rad)
    by_azimuth = _weights(table["azimuth_rad"], from_sun_rad)
    dome = np.moveaxis(np.tensordot(at_sun, table["radiance"], 1), -1, 0)
    radiance: Float[np.ndarray, "3 h w"] = by_elevation @ dome @ by_azimuth.T
    return radiance


def _weights(knots: Float[np.ndarray, " k"], x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n k"]:
    """The matrix of linear interpolation: row i holds the weights of the knots at x[i]."""
    return np.stack([np.interp(x, knots, unit) for unit in np.eye(len(knots))], axis=1).astype(np.float32)
