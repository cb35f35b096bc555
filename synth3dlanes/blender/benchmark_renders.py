"""What `bench` compares renders with: converged pictures, the denoiser's cost, and Blender with its defaults."""

import time
from dataclasses import replace
from statistics import median

import bpy
import numpy as np
from jaxtyping import UInt8

from synth3dlanes.blender.build import build, open_studio
from synth3dlanes.blender.cycles_timing import cycles_stages
from synth3dlanes.blender.render import configure, opened, read_layers, studio, want_passes
from synth3dlanes.blender.trace import run_cycles
from synth3dlanes.imaging.daylight import Daylight, daylight
from synth3dlanes.imaging.develop import develop
from synth3dlanes.scene.assets.catalogue import Library
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.world.world import World, resolve


def reference(scene: Scene, settings: RenderSettings, library: Library) -> UInt8[np.ndarray, "h w 3"]:
    """The scene rendered with these settings, but another seed than `render`'s and no denoising."""
    world, light = _lit(scene)
    build(studio(library), world, world.view, light)
    configure(settings, light.film)
    bpy.context.scene.cycles.seed = 1
    bpy.context.scene.cycles.use_denoising = False
    return develop(scene, world.view, light, read_layers(run_cycles(), light.film))


def denoise_seconds(scene: Scene, settings: RenderSettings, library: Library, repeats: int = 3) -> float:
    """The seconds that the denoiser adds to tracing; they depend on the picture's size alone, so one sample will do."""
    world, light = _lit(scene)
    build(studio(library), world, world.view, light)
    configure(replace(settings, samples=1), light.film)
    seconds: dict[bool, list[float]] = {False: [], True: []}
    for is_on in (False, True) * repeats:
        bpy.context.scene.cycles.use_denoising = is_on
        with cycles_stages() as stages:
            run_cycles()
        seconds[is_on].append(stages["tracing"])
    return max(0.0, median(seconds[True]) - median(seconds[False]))


def naive_seconds(scene: Scene, library: Library, samples: int) -> float:
    """The seconds of a render with Blender's defaults: a new file for each scene, a mesh for each object, the world's
    importance map, 12 bounces, the denoiser at its highest quality. Only `samples` differs from its default of 4096."""
    start = time.perf_counter()
    world, light = _lit(scene)
    build(open_studio(library), world, world.view, light)
    for item in bpy.context.scene.objects:
        if item.type == "MESH":
            item.data = item.data.copy()
    bpy.context.scene.world.cycles.sampling_method = "AUTOMATIC"
    bpy.context.scene.render.engine = "CYCLES"
    bpy.context.scene.cycles.samples = samples
    want_passes(bpy.context.scene.view_layers[0])
    develop(scene, world.view, light, read_layers(run_cycles(), light.film))
    seconds = time.perf_counter() - start
    opened.cache_clear()
    return seconds


def _lit(scene: Scene) -> tuple[World, Daylight]:
    world = resolve(scene)
    return world, daylight(scene, float(world.view.eye_world[2]))
