"""Sun, sky and haze in Blender: the daylight as an equirectangular image and a lamp."""

from collections.abc import Sequence

import bpy
import mathutils
import numpy as np

from synth3dlanes.blender.shaders import Graph
from synth3dlanes.imaging.daylight import Daylight
from synth3dlanes.imaging.haze import KOSCHMIEDER
from synth3dlanes.imaging.sky import SKY_SHAPE, sun_direction
from synth3dlanes.imaging.user_sky import UserSky, hang
from synth3dlanes.scene import Scene

SUN_ANGLE_RAD = 0.0093  # angular diameter of the sun
CLOUD_SPREAD_RAD = 0.3  # added to it by a closed layer of clouds
HAZE_PASS = "haze"


def make_world() -> None:
    """Make the scene's world and sun, once per process.

    The sampling method must be set here: Cycles builds its 4k importance map for a world that ever had another method.
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
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("sun", lamp))


def add_haze() -> None:
    """Add the output `haze` to every existing material, once per process: red is 1 - exp(-distance x extinction), green
    is 1, so that both are 0 in the sky and antialiased as the picture is."""
    group = bpy.data.node_groups.new(HAZE_PASS, "ShaderNodeTree")
    graph = Graph(group)
    distance_m = graph.node("ShaderNodeCameraData").outputs["View Distance"]
    left = graph.math("EXPONENT", graph.math("MULTIPLY", distance_m, graph.value("minus_per_m")))
    share = graph.node("ShaderNodeCombineColor", {0: graph.math("SUBTRACT", 1.0, left), 1: 1.0}).outputs[0]
    graph.node("ShaderNodeOutputAOV", {"Color": share}, aov_name=HAZE_PASS)
    for material in bpy.data.materials:
        if material.use_nodes:
            material.node_tree.nodes.new("ShaderNodeGroup").node_tree = group
    aov = bpy.context.scene.view_layers[0].aovs.add()
    aov.name, aov.type = HAZE_PASS, "COLOR"


def set_light(scene: Scene, light: Daylight, skies: Sequence[UserSky]) -> None:
    """Set the sun's direction and colour, the sky image and the haze for one scene."""
    pixels = np.ones((*SKY_SHAPE, 4), np.float32)
    sky = hang(skies[scene.sky - 1], scene, light) if scene.sky else light.sky
    pixels[..., :3] = np.moveaxis(sky, 0, -1)
    image = bpy.data.images["sky"]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    sun = bpy.data.objects["sun"]
    sun.rotation_mode = "QUATERNION"
    sun.rotation_quaternion = mathutils.Vector(sun_direction(scene.light).tolist()).to_track_quat("Z", "Y")
    brightest = max(float(light.sun.max()), 1e-9)
    sun.data.energy = brightest
    sun.data.color = (light.sun / brightest).tolist()
    sun.data.angle = SUN_ANGLE_RAD + CLOUD_SPREAD_RAD * light.softness**2
    haze = bpy.data.node_groups[HAZE_PASS].nodes["minus_per_m"]
    haze.outputs[0].default_value = -KOSCHMIEDER / scene.air.visibility_m
