"""Water and snow on the ground, worn paint, and light thrown back at night, as shader nodes without effect at 0: Cycles
folds constants, so they cost nothing in a dry scene by day with intact paint. Snow on other things is connected only
where there is some."""

from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import Image

from synth3dlanes.blender.shaders import ShaderGraph, Socket, texture
from synth3dlanes.scene.assets.built_in import assets_dir

# Tiles of the map of hollows, along x and y, as roads go: water is deeper where it is dark, in patches of about a metre
# by three, and in wheel tracks, by RUT of the map's range.
HOLLOWS_M, RUT = (38.0, 110.0), 0.06
# The wetness at which puddles begin, and the share of its albedo that pavement keeps under a film of water.
PUDDLES_FROM, WET_ALBEDO = 0.5, 0.45
FILM_ROUGHNESS, PUDDLE_ROUGHNESS = 0.22, 0.03
# Paint is rubbed off where the weighted sum of one map at two scales (metres per tile) is low; RUB_SOFTNESS is the
# width of the transition.
RUB_LENGTHS_M, RUB_WEIGHTS, RUB_SOFTNESS = (0.9, 6.5), (0.6, 0.4), 0.06
MAP = "terrain_macro.jpg"
# Snow (linear). It lies where the map of rubbed paint, stretched by SNOW_STRETCH, is low; its level is lower by TRACK
# in wheel tracks, this far from the middle of a lane and this wide.
SNOW, SNOW_STRETCH, SNOW_SOFTNESS = (0.72, 0.76, 0.82), 2.5, 0.12
TRACK, TRACK_M, TRACK_HALF_M = 0.35, 0.8, 0.32
# Snow lies on faces of trees, structures and cars whose normal's z exceeds the limit, and on CAR_SHARE of the share of
# cars that the ground has.
CAP, CAP_FROM, CAR_CAP_FROM, CAR_SHARE = "snow cap", 0.3, 0.8, 0.7


class Look(NamedTuple):
    """The inputs of `coated`: colour, roughness and share of the coat, and the normal."""

    color: Socket
    roughness: Socket
    amount: Socket
    normal: Socket


def wet(graph: ShaderGraph, dry: Look, ruts: Socket = 0.0) -> Look:
    """The wet look, controlled by the node value `wetness`: darker and smoother under a film, a mirror in puddles, of
    which more are where `ruts` is 1."""
    wetness = graph.value("wetness")
    position = graph.node("ShaderNodeNewGeometry").outputs["Position"]
    tiles = graph.vector("MULTIPLY", position, (1 / HOLLOWS_M[0], 1 / HOLLOWS_M[1], 0.0))
    hollow = graph.math("MULTIPLY_ADD", ruts, -RUT, texture(graph, MAP, tiles, is_color=False))
    film = graph.math("MULTIPLY", wetness, graph.clamp(graph.math("MULTIPLY_ADD", hollow, -0.6, 1.25)))
    level = graph.math("MULTIPLY_ADD", wetness, 0.5, -PUDDLES_FROM / 2)
    deep = graph.clamp(graph.math("MULTIPLY", graph.math("SUBTRACT", graph.math("ADD", level, 0.28), hollow), 14.0))
    puddle = graph.math("MULTIPLY", film, deep)
    # Pavement darkens at less water than it takes to shine.
    shine, dark = graph.math("MULTIPLY", film, film), graph.math("MULTIPLY", film, graph.math("SUBTRACT", 2.0, film))
    smooth = graph.math("MAXIMUM", graph.math("MULTIPLY", film, 0.6), puddle)
    roughness = graph.mix(graph.mix(dry.roughness, FILM_ROUGHNESS, shine), PUDDLE_ROUGHNESS, puddle)
    flat = graph.node("ShaderNodeNewGeometry").outputs["Normal"]
    return Look(
        graph.scale(dry.color, graph.mix(1.0, WET_ALBEDO, dark)),
        roughness,
        graph.mix(dry.amount, 1.0, shine),
        graph.mix_color(dry.normal, flat, smooth),
    )


def snowed(graph: ShaderGraph, bare: Look, spare: Socket = 0.0, blur: Socket = 0.0) -> Look:
    """The look under snow, controlled by the node values `snow_level` (of the map), `is_snowy` and `snow`: with less
    of it where `spare` is 1, and evenly mixed with it where `blur` is 1."""
    under = graph.math("SUBTRACT", graph.value("snow_level"), _height(graph, SNOW_STRETCH))
    under = graph.math("SUBTRACT", under, graph.math("MULTIPLY", spare, TRACK))
    near = graph.clamp(graph.math("MULTIPLY_ADD", under, 1 / SNOW_SOFTNESS, 0.5))
    cover = graph.math("MULTIPLY", graph.value("is_snowy"), graph.mix(near, graph.value("snow"), blur))
    return Look(
        graph.mix_color(bare.color, SNOW, cover),
        graph.mix(bare.roughness, 0.8, cover),
        graph.mix(bare.amount, 0.1, cover),
        bare.normal,
    )


def snow_cap(graph: ShaderGraph, bare: Socket, is_cleared: bool) -> Any:
    """The shader `bare` with snow where it looks up, controlled by the node value that `cap_level` gives."""
    up = graph.node("ShaderNodeSeparateXYZ", {0: graph.node("ShaderNodeNewGeometry").outputs["Normal"]}).outputs[2]
    level, least = graph.value("cap_level"), CAR_CAP_FROM if is_cleared else CAP_FROM
    if is_cleared:
        # By the car's id and colour, so that it is the same in all frames of a clip.
        info = graph.node("ShaderNodeObjectInfo")
        red = graph.node("ShaderNodeSeparateColor", {0: info.outputs["Color"]}).outputs[0]
        luck = graph.math("FRACT", graph.math("MULTIPLY_ADD", info.outputs["Object Index"], 0.618, red))
        lies = graph.math("LESS_THAN", luck, level)
    else:
        under = graph.math("SUBTRACT", level, _height(graph, SNOW_STRETCH))
        lies = graph.clamp(graph.math("MULTIPLY_ADD", under, 1 / SNOW_SOFTNESS, 0.5))
    flat = graph.clamp(graph.math("MULTIPLY", graph.math("SUBTRACT", up, least), 8.0))
    snow = graph.node("ShaderNodeBsdfDiffuse", {"Color": SNOW}).outputs[0]
    return graph.node("ShaderNodeMixShader", {0: graph.math("MULTIPLY", flat, lies), 1: bare, 2: snow}, name=CAP)


def cap_level(share: float, is_cleared: bool) -> float:
    """The node value `cap_level` with this share of the ground under snow: the share of cars with snow on them, or the
    level of the map."""
    return share * CAR_SHARE if is_cleared else rub_level(share)


def wheel_tracks(graph: ShaderGraph, across_m: Socket) -> Any:
    """Share 0..1 of a wheel track at a distance right of the road's middle, by the node values `lane_width_m` and
    `lane_shift`."""
    width_m = graph.value("lane_width_m", 3.5)
    lanes = graph.math("ADD", graph.math("DIVIDE", across_m, width_m), graph.value("lane_shift"))
    aside = graph.math("ABSOLUTE", graph.math("SUBTRACT", graph.math("FRACT", lanes), 0.5))
    off_m = graph.math("ABSOLUTE", graph.math("SUBTRACT", graph.math("MULTIPLY", aside, width_m), TRACK_M))
    return graph.clamp(graph.math("MULTIPLY_ADD", off_m, -4.0, 0.5 + 4 * TRACK_HALF_M))


def thrown_back(graph: ShaderGraph, look: Look, strength: float, most: float) -> Look:
    """The look under light from beside the camera, by the node value `retro`: glass beads in paint and rough pavement
    throw it back at flat angles too, where a matt surface would be dark. `most` limits the gain."""
    geometry = graph.node("ShaderNodeNewGeometry")
    facing = graph.vector_dot(geometry.outputs["Incoming"], geometry.outputs["Normal"])
    gain = graph.math("DIVIDE", strength, graph.math("MAXIMUM", graph.math("ABSOLUTE", facing), strength / most))
    gain = graph.mix(1.0, graph.math("MAXIMUM", gain, 1.0), graph.value("retro"))
    return look._replace(color=graph.scale(look.color, gain))


def _height(graph: ShaderGraph, stretch: float = 1.0) -> Any:
    """The map that paint and snow follow, 0..1, by the position in the world."""
    position = graph.node("ShaderNodeNewGeometry").outputs["Position"]
    height: Any = 0.0
    for length_m, weight in zip(RUB_LENGTHS_M, RUB_WEIGHTS, strict=True):
        texel = texture(graph, MAP, graph.scale(position, 1 / (stretch * length_m)), is_color=False)
        height = graph.math("MULTIPLY_ADD", texel, weight, height)
    return height


def rubbed(graph: ShaderGraph) -> Any:
    """Share 0..1 of rubbed-off paint, controlled by the node values `rub_level` and `is_rubbed`."""
    under = graph.math("SUBTRACT", graph.value("rub_level"), _height(graph))
    bare = graph.clamp(graph.math("MULTIPLY_ADD", under, 1 / RUB_SOFTNESS, 0.5))
    return graph.math("MULTIPLY", graph.value("is_rubbed"), bare)


@lru_cache(maxsize=8)
def rub_level(share: float) -> float:
    """The level of the map below which `share` of it lies: as `rub_level` or `snow_level`, the mean of `rubbed` or of
    `snowed`."""
    return float(np.quantile(_heights(), share))


@cache
def _heights() -> Float[np.ndarray, " n"]:
    """A sample of the heights that `rubbed` compares with its level, with noise for its soft transition."""
    with Image.open(assets_dir() / "textures" / MAP) as picture:
        values = np.asarray(picture.convert("RGB"), float).mean(axis=2).ravel() / 255
    rng = np.random.default_rng(0)
    heights = sum(weight * rng.choice(values, 100_000) for weight in RUB_WEIGHTS)
    return np.asarray(heights + RUB_SOFTNESS * (rng.random(100_000) - 0.5))
