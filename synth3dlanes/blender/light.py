"""Light and haze in Blender: the daylight as an equirectangular image and a lamp, headlights, street lamps."""

from collections.abc import Sequence
from typing import Any

import bpy
import mathutils
import numpy as np
from jaxtyping import Float

from synth3dlanes.blender.shaders import ShaderGraph, Socket, set_value
from synth3dlanes.geometry.frames import transform
from synth3dlanes.imaging.daylight import Daylight
from synth3dlanes.imaging.haze import KOSCHMIEDER
from synth3dlanes.imaging.sky import SKY_SHAPE, sun_direction
from synth3dlanes.imaging.user_sky import UserSky, hang
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import KINDS, Glow
from synth3dlanes.system.arrays import Matrix4, Points3
from synth3dlanes.world.buildings import GLASS
from synth3dlanes.world.solids import LIT_GLOSS, REFLECTOR_GLOSS, SHEETING_GLOSS

STUDIO = "studio"  # the collection of the camera and the lamps
# Images of the sky. Surfaces are lit by one of fewer pixels, which stays in the processor's cache.
SKY, COARSE_SKY, COARSENESS = "sky", "coarse_sky", 8
SUN_ANGLE_RAD = 0.0093  # angular diameter of the sun
CLOUD_SPREAD_RAD = 0.3  # added to it by a closed layer of clouds
HAZE_PASS = "haze"
# Headlights: their places in the host's road frame (metres), the intensity of both in the beam (in the
# daylight's units), their colour and size.
HEADLIGHTS_ROAD, BEAM, LAMP_COLOR, LAMP_M = ((-0.65, 1.9, 0.65), (0.65, 1.9, 0.65)), 0.32, (1.0, 0.93, 0.82), 0.08
STRAY = 0.01  # share of the beam that goes above its edge
# A street lamp's intensity straight down (about 2000 cd), the angle of its cone, and how many of the nearest are lit.
STREET_LAMP, STREET_COLOR, STREET_CONE_RAD, N_STREET_LAMPS = 0.05, (1.0, 0.8, 0.55), 2.6, 8
# Radiance of lit lamps of cars by the names of their materials (1200 and 240 cd/m2). White paint ten metres before
# headlights has a tenth of a tail lamp's.
CAR_LAMPS = {"car_head": (0.03, 0.0275, 0.024), "car_tail": (0.006, 0.00003, 0.00002)}
# Radiance of a lit window (about 25 cd/m2), its colour, and the share of windows that are lit after sunset.
WINDOW, WINDOW_COLOR, LIT = 0.0006, (1.0, 0.72, 0.42), 0.3
# Retroreflection: the gloss from which faces have it, and their coefficient (cd/lx/m2) times the intensity of the light
# towards them. Signs hang above the beam's edge, reflectors stand at it.
THROWN_BACK: dict[Glow, tuple[float, float]] = {
    "sheeting": (SHEETING_GLOSS - 0.02, 250 * BEAM * STRAY),
    "reflector": (REFLECTOR_GLOSS - 0.02, 300 * BEAM * 0.1),
}
# The glow of kinds by their names, which are those of their materials.
GLOWS = {kind.name: kind.glow for kind in KINDS if kind.glow}
NEAREST_M = 4.0
# Radiance of lit lenses of signals by day (about 6000 cd/m2), and the share of it in the dark.
SIGNAL, SIGNAL_IN_THE_DARK = 0.15, 0.03


def make_world() -> None:
    """Make the scene's world and sun, once per process.

    The sampling method must be set here: Cycles builds its 4k importance map for a world that ever had another method.
    """
    world = bpy.data.worlds.new("sky")
    world.cycles.sampling_method = "NONE"
    world.use_nodes = True
    world.node_tree.nodes.clear()
    graph = ShaderGraph(world.node_tree)
    is_diffuse = graph.node("ShaderNodeLightPath").outputs["Is Diffuse Ray"]
    sky, coarse = _background(graph, SKY, 1), _background(graph, COARSE_SKY, COARSENESS)
    seen = graph.node("ShaderNodeMixShader", {0: is_diffuse, 1: sky, 2: coarse})
    graph.node("ShaderNodeOutputWorld", {"Surface": seen.outputs[0]})
    bpy.context.scene.world = world
    _add_lamp("sun", "SUN")
    for i in range(len(HEADLIGHTS_ROAD)):
        beam = _add_lamp(f"headlight_{i}", "SPOT")
        beam.energy, beam.color = 4 * np.pi**2 * BEAM / len(HEADLIGHTS_ROAD), LAMP_COLOR
        beam.shadow_soft_size, beam.spot_size, beam.spot_blend = LAMP_M, np.radians(140), 0.1
        _shape_beam(beam)
    for i in range(N_STREET_LAMPS):
        street = _add_lamp(f"street_lamp_{i}", "SPOT")
        street.energy, street.color = 4 * np.pi**2 * STREET_LAMP, STREET_COLOR
        street.shadow_soft_size, street.spot_size, street.spot_blend = LAMP_M, STREET_CONE_RAD, 1.0


def _background(graph: ShaderGraph, name: str, coarseness: int) -> Any:
    """The light of an image that `_paint_sky` fills."""
    height, width = SKY_SHAPE[0] // coarseness, SKY_SHAPE[1] // coarseness
    image = bpy.data.images.new(name, width, height, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    texture = graph.node("ShaderNodeTexEnvironment", image=image)
    return graph.node("ShaderNodeBackground", {"Color": texture.outputs[0]}).outputs[0]


def _add_lamp(name: str, kind: str) -> bpy.types.Light:
    """A lamp that is off."""
    lamp = bpy.data.lights.new(name, kind)
    item = bpy.data.objects.new(name, lamp)
    item.rotation_mode = "QUATERNION"
    bpy.data.collections[STUDIO].objects.link(item)
    item.hide_render = kind != "SUN"
    return lamp


def _shape_beam(lamp: bpy.types.Light) -> None:
    """Low beam: a sharp upper edge, level on the left and rising on the right, and below it as much light as makes the
    road evenly bright."""
    lamp.use_nodes = True
    lamp.node_tree.nodes.clear()
    graph = ShaderGraph(lamp.node_tree)
    direction = graph.node("ShaderNodeTexCoord").outputs["Normal"]
    x, y, z = graph.node("ShaderNodeSeparateXYZ", {0: direction}).outputs
    ahead = graph.math("MAXIMUM", graph.math("ABSOLUTE", z), 0.05)
    aside, up = graph.math("DIVIDE", x, ahead), graph.math("DIVIDE", y, ahead)
    kink = graph.math("MINIMUM", graph.math("MAXIMUM", graph.math("MULTIPLY", aside, 0.2), 0.0), 0.03)
    below = graph.math("SUBTRACT", graph.math("SUBTRACT", kink, 0.01), up)
    edge = graph.clamp(graph.math("MULTIPLY_ADD", below, 80.0, 0.5))
    fall = graph.math("DIVIDE", 0.03, graph.math("ADD", graph.math("MAXIMUM", below, 0.0), 0.03))
    width = graph.math("EXPONENT", graph.math("MULTIPLY", graph.math("MULTIPLY", aside, aside), -3.5))
    level = graph.math("MULTIPLY", graph.math("MULTIPLY", fall, fall), edge)
    strength = graph.math("MULTIPLY", graph.math("ADD", level, STRAY), width)
    emission = graph.node("ShaderNodeEmission", {"Strength": strength})
    graph.node("ShaderNodeOutputLight", {"Surface": emission.outputs[0]})


def add_lights() -> None:
    """Let lamps of cars and windows of houses shine, and signs and reflectors in the host's headlights, once per
    process; only the camera and reflections see it."""
    for name, radiance in CAR_LAMPS.items():
        if name in bpy.data.materials:
            red, green, blue = (channel / max(radiance) for channel in radiance)
            _add_shine(ShaderGraph(bpy.data.materials[name].node_tree), (red, green, blue))
    for name, glow in GLOWS.items():
        graph = ShaderGraph(bpy.data.materials[name].node_tree)
        if glow in THROWN_BACK:
            _throw_back(graph, THROWN_BACK[glow][0])
            continue
        paint = graph.node("ShaderNodeAttribute", attribute_name="paint").outputs
        if glow == "lens":
            _add_shine(graph, paint["Color"], graph.math("GREATER_THAN", paint["Alpha"], 0.99 * LIT_GLOSS))
            continue
        luck = graph.node("ShaderNodeNewGeometry").outputs["Random Per Island"]
        is_glass, is_lit = (
            graph.math("GREATER_THAN", paint["Alpha"], 0.99 * GLASS[3]),
            graph.math("LESS_THAN", luck, LIT),
        )
        _add_shine(graph, WINDOW_COLOR, graph.math("MULTIPLY", is_glass, is_lit))
    for name in (*CAR_LAMPS, *GLOWS):
        if name in bpy.data.materials:
            bpy.data.materials[name].cycles.emission_sampling = "NONE"


def _throw_back(graph: ShaderGraph, gloss_from: float) -> None:
    """Let the glossiest faces throw headlights back to the camera, in their colour: less with the square of the
    distance, and by the angle at which the light meets them."""
    paint, geometry = graph.node("ShaderNodeAttribute", attribute_name="paint"), graph.node("ShaderNodeNewGeometry")
    is_it = graph.math("GREATER_THAN", paint.outputs["Alpha"], gloss_from)
    away_m = graph.math("MAXIMUM", graph.node("ShaderNodeCameraData").outputs["View Distance"], NEAREST_M)
    met = graph.vector_dot(geometry.outputs["Incoming"], geometry.outputs["Normal"])
    met = graph.math("DIVIDE", met, graph.math("MULTIPLY", away_m, away_m))
    _add_shine(graph, paint.outputs["Color"], graph.math("MULTIPLY", is_it, met))


def _add_shine(graph: ShaderGraph, color: Socket, share: Socket = 1.0) -> None:
    """Add light to a material's surface: a share of the node value `shine`."""
    output = next(node for node in graph.tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    surface = output.inputs["Surface"].links[0].from_socket
    strength = graph.math("MULTIPLY", share, graph.value("shine"))
    shine = graph.node("ShaderNodeEmission", {"Color": color, "Strength": strength})
    both = graph.node("ShaderNodeAddShader", {0: surface, 1: shine.outputs[0]})
    graph.plug(output.inputs["Surface"], both.outputs[0])


def add_haze() -> None:
    """Add the output `haze` to every existing material, once per process: red is 1 - exp(-distance x extinction), green
    is 1, so that both are 0 in the sky and antialiased as the picture is."""
    group = bpy.data.node_groups.new(HAZE_PASS, "ShaderNodeTree")
    graph = ShaderGraph(group)
    distance_m = graph.node("ShaderNodeCameraData").outputs["View Distance"]
    left = graph.math("EXPONENT", graph.math("MULTIPLY", distance_m, graph.value("minus_per_m")))
    share = graph.node("ShaderNodeCombineColor", {0: graph.math("SUBTRACT", 1.0, left), 1: 1.0}).outputs[0]
    graph.node("ShaderNodeOutputAOV", {"Color": share}, aov_name=HAZE_PASS)
    for material in bpy.data.materials:
        if material.use_nodes:
            material.node_tree.nodes.new("ShaderNodeGroup").node_tree = group
    aov = bpy.context.scene.view_layers[0].aovs.add()
    aov.name, aov.type = HAZE_PASS, "COLOR"


def set_light(
    scene: Scene, light: Daylight, skies: Sequence[UserSky], world_from_host: Matrix4, street_lamps: Points3
) -> None:
    """Set the sun's direction and colour, the sky image, the haze and the lamps for one scene; of the street lamps'
    heads (world) the nearest are lit once the sun has set."""
    sky = hang(skies[scene.sky - 1], scene, light) if scene.sky else light.sky
    blocks = sky.reshape(3, SKY_SHAPE[0] // COARSENESS, COARSENESS, SKY_SHAPE[1] // COARSENESS, COARSENESS)
    _paint_sky(SKY, sky)
    _paint_sky(COARSE_SKY, blocks.mean(axis=(2, 4)))
    sun = bpy.data.objects["sun"]
    sun.rotation_quaternion = mathutils.Vector(sun_direction(scene.light).tolist()).to_track_quat("Z", "Y")
    sun.hide_render = not light.sun.any()
    brightest = max(float(light.sun.max()), 1e-9)
    sun.data.energy = brightest
    sun.data.color = (light.sun / brightest).tolist()
    sun.data.angle = SUN_ANGLE_RAD + CLOUD_SPREAD_RAD * light.softness**2
    haze = bpy.data.node_groups[HAZE_PASS].nodes["minus_per_m"]
    haze.outputs[0].default_value = -KOSCHMIEDER / scene.air.visibility_m
    _set_lamps(scene, world_from_host, street_lamps)


def _paint_sky(name: str, dome: Float[np.ndarray, "3 h w"]) -> None:
    pixels = np.ones((*dome.shape[1:], 4), np.float32)
    pixels[..., :3] = np.moveaxis(dome, 0, -1)
    image = bpy.data.images[name]
    image.pixels.foreach_set(pixels.ravel())
    image.update()


def _set_lamps(scene: Scene, world_from_host: Matrix4, street_lamps: Points3) -> None:
    """Place the lamps that are lit, and turn the others off."""
    is_lit, is_dark = scene.weather.headlights, scene.light.sun_zenith_rad > np.pi / 2
    ahead = mathutils.Matrix(world_from_host[:3, :3].tolist()).to_quaternion() @ mathutils.Quaternion(
        (1, 0, 0), np.pi / 2
    )
    for i, place in enumerate(transform(world_from_host, np.array(HEADLIGHTS_ROAD))):
        _place(f"headlight_{i}", place if is_lit else None, ahead)
    away = np.linalg.norm(street_lamps - world_from_host[:3, 3], axis=1)
    nearest = street_lamps[np.argsort(away)[:N_STREET_LAMPS]] if is_dark else street_lamps[:0]
    for i in range(N_STREET_LAMPS):
        _place(f"street_lamp_{i}", nearest[i] if i < len(nearest) else None, mathutils.Quaternion())
    shines = {name: is_lit * max(radiance) for name, radiance in CAR_LAMPS.items()}
    glows: dict[Glow, float] = {glow: is_lit * gain for glow, (_, gain) in THROWN_BACK.items()}
    glows |= {"lens": SIGNAL * (SIGNAL_IN_THE_DARK if is_dark else 1.0), "window": is_dark * WINDOW}
    shines |= {name: glows[glow] for name, glow in GLOWS.items()}
    for name, radiance in shines.items():
        if name in bpy.data.materials:
            set_value(bpy.data.materials[name], "shine", radiance)


def _place(name: str, place_world: Float[np.ndarray, "3"] | None, rotation: mathutils.Quaternion) -> None:
    """Turn a lamp on at a place, or off."""
    lamp = bpy.data.objects[name]
    lamp.hide_render = place_world is None
    if place_world is not None:
        lamp.location, lamp.rotation_quaternion = place_world.tolist(), rotation
