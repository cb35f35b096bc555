"""Water on pavement and worn paint, as shader nodes without effect at 0: Cycles folds constants, so they cost nothing
in a dry scene with intact paint."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import Image

from synth3dlanes.assets.built_in import assets_dir
from synth3dlanes.blender.shaders import Graph, Socket, texture

# Scale of the map of hollows: water is deeper where it is dark.
HOLLOW_LENGTH_M = 13.0
# The wetness at which puddles begin, and the share of its albedo that pavement keeps under a film of water.
PUDDLES_FROM, WET_ALBEDO = 0.5, 0.45
FILM_ROUGHNESS, PUDDLE_ROUGHNESS = 0.22, 0.03
# Paint is rubbed off where the weighted sum of one map at two scales (metres per tile) is low; RUB_SOFTNESS is the
# width of the transition.
RUB_LENGTHS_M, RUB_WEIGHTS, RUB_SOFTNESS = (0.9, 6.5), (0.6, 0.4), 0.06
MAP = "terrain_macro.jpg"


class Look(NamedTuple):
    """The inputs of `coated`: colour, roughness and share of the coat, and the normal."""

    color: Socket
    roughness: Socket
    amount: Socket
    normal: Socket


def wet(graph: Graph, dry: Look) -> Look:
    """The wet look, controlled by the node value `wetness`: darker and smoother under a film, a mirror in puddles."""
    wetness = graph.value("wetness")
    position = graph.node("ShaderNodeNewGeometry").outputs["Position"]
    hollow = texture(graph, MAP, graph.scale(position, 1 / HOLLOW_LENGTH_M), is_color=False)
    film = graph.math("MULTIPLY", wetness, graph.clamp(graph.math("MULTIPLY_ADD", hollow, -1.2, 1.5)))
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


def rubbed(graph: Graph) -> Any:
    """Share 0..1 of rubbed-off paint, controlled by the node values `rub_level` and `is_rubbed`."""
    position = graph.node("ShaderNodeNewGeometry").outputs["Position"]
    height: Any = 0.0
    for length_m, weight in zip(RUB_LENGTHS_M, RUB_WEIGHTS, strict=True):
        texel = texture(graph, MAP, graph.scale(position, 1 / length_m), is_color=False)
        height = graph.math("MULTIPLY_ADD", texel, weight, height)
    under = graph.math("SUBTRACT", graph.value("rub_level"), height)
    bare = graph.clamp(graph.math("MULTIPLY_ADD", under, 1 / RUB_SOFTNESS, 0.5))
    return graph.math("MULTIPLY", graph.value("is_rubbed"), bare)


def rub_level(share: float) -> float:
    """The value of `rub_level` at which the mean of `rubbed` is `share`."""
    return float(np.quantile(_heights(), share))


@cache
def _heights() -> Float[np.ndarray, " n"]:
    """A sample of the heights that `rubbed` compares with its level, with noise for its soft transition."""
    with Image.open(assets_dir() / "textures" / MAP) as picture:
        values = np.asarray(picture.convert("RGB"), float).mean(axis=2).ravel() / 255
    rng = np.random.default_rng(0)
    heights = sum(weight * rng.choice(values, 100_000) for weight in RUB_WEIGHTS)
    return np.asarray(heights + RUB_SOFTNESS * (rng.random(100_000) - 0.5))
