"""One render by Cycles, whose passes come back as arrays."""

import bpy
import cycles  # type: ignore[import-not-found]
import numpy as np

from synth3dlanes.scene.settings import NO_HIT_DEPTH_M

# Cycles writes 1e10 where a ray hits nothing; larger depths than this count as that.
CYCLES_NO_HIT = 1e9


def run_cycles() -> dict[str, np.ndarray]:
    """Render and return every pass. `Render Result` has no pixels without a window and files are slow, so the passes
    are read from the render engine."""
    layers: dict[str, np.ndarray] = {}
    original = cycles.CyclesRender.render

    def read_passes(engine: bpy.types.RenderEngine, _: None) -> None:
        result = engine.get_result()
        for render_pass in result.layers[0].passes:
            pixels = np.zeros(result.resolution_y * result.resolution_x * render_pass.channels, dtype=np.float32)
            render_pass.rect.foreach_get(pixels)
            layers[render_pass.name] = pixels.reshape(result.resolution_y, result.resolution_x, -1)[::-1]

    # A lambda: Blender counts the callback's arguments, and a decorator (of shape checks) would hide them.
    cycles.CyclesRender.render = lambda engine, depsgraph: read_passes(engine, original(engine, depsgraph))
    try:
        bpy.ops.render.render()
    finally:
        cycles.CyclesRender.render = original
    return layers


def distances(passes: dict[str, np.ndarray]) -> np.ndarray:
    """The depth pass, infinite where nothing is hit."""
    depth = passes["Depth"][..., 0]
    return np.where(depth > CYCLES_NO_HIT, np.float32(NO_HIT_DEPTH_M), depth)
