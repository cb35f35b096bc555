"""Scene -> image, passes and the last mask of its labels, with Cycles (settings from the measured costs in bench)."""

import os
import time
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import bpy
import cycles  # type: ignore[import-not-found]
import numpy as np
from jaxtyping import Shaped, UInt8

from synth3dlanes.blender.build import Placed, Studio, build, open_studio
from synth3dlanes.blender.devices import use_device
from synth3dlanes.blender.film import CYCLES_NO_HIT, develop
from synth3dlanes.blender.occlusion import hidden_by_objects, seen_fractions
from synth3dlanes.blender.sky import film_factor
from synth3dlanes.catalogue import BUILT_IN, Library
from synth3dlanes.frames import Matrix4, transform
from synth3dlanes.geometry.ground import Ground
from synth3dlanes.geometry.height_map import height_map
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.geometry.visibility import seen_over_ground
from synth3dlanes.labels import Labels
from synth3dlanes.scene import Scene
from synth3dlanes.settings import NO_HIT_DEPTH_M, RenderSettings

PASS_OF = {"depth": "Depth", "semantic": "IndexMA", "instance": "IndexOB"}


@dataclass(frozen=True, eq=False)
class Rendering:
    """An image, its labels with `object_visible`, the passes asked for, and seconds spent by stage."""

    image: UInt8[np.ndarray, "h w 3"]
    labels: Labels
    passes: dict[str, Shaped[np.ndarray, "..."]]
    timings: dict[str, float]


opened = lru_cache(maxsize=1)(open_studio)


def studio(library: Library = BUILT_IN) -> Studio:
    """This process's Blender with the assets in it; those of another library take their place."""
    return opened(library)


def render(scene: Scene, labels: Labels, settings: RenderSettings, library: Library = BUILT_IN) -> Rendering:
    """Render one scene; equal arguments give equal pixels on one kind of machine."""
    clock = [time.perf_counter()]
    placed = build(studio(library), scene, [lane.id for lane in labels.lanes if lane.kind == "delimiter"])
    clock.append(time.perf_counter())
    configure(settings, film_factor(scene))
    layers = run_cycles()
    clock.append(time.perf_counter())
    image = develop(scene, layers)
    passes = {name: _pass(name, layers) for name in settings.passes if name in PASS_OF}
    if "normal" in settings.passes:
        passes["normal"] = _normals(labels.camera.world_from_cam, studio(library).plain)
    if "height" in settings.passes:
        passes["height"] = height_map(RoadPlan(scene)).astype(np.float32)
    clock.append(time.perf_counter())
    seen = with_object_visibility(scene, labels, placed)
    clock.append(time.perf_counter())
    stages = ("build", "cycles", "passes", "occlusion")
    return Rendering(image, seen, passes, dict(zip(stages, np.diff(clock).tolist(), strict=True)))


def with_object_visibility(scene: Scene, labels: Labels, placed: list[Placed]) -> Labels:
    """The labels with every point's `object_visible` and the seen share of every car."""
    world_from_cam = labels.camera.world_from_cam
    eye = world_from_cam[:3, 3]
    points = transform(world_from_cam, np.concatenate([lane.xyz_cam for lane in labels.lanes]))
    visible = ~hidden_by_objects(placed, eye, points)
    ends = np.cumsum([len(lane.xyz_cam) for lane in labels.lanes])[:-1]
    lanes = (
        replace(lane, object_visible=mask) for lane, mask in zip(labels.lanes, np.split(visible, ends), strict=True)
    )
    over_ground = partial(seen_over_ground, Ground(RoadPlan(scene)), eye)
    cars = seen_fractions(placed[: len(scene.cars)], placed, labels, over_ground)
    return replace(labels, lanes=tuple(lanes), car_visible_fraction=cars)


def configure(settings: RenderSettings, film: float) -> None:
    """Cycles' settings, chosen for cost: see docs/decisions.md."""
    blender = bpy.context.scene
    blender.render.engine = "CYCLES"
    use_device(settings.device)
    blender.render.threads_mode = "FIXED"
    blender.render.threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    # Kept for the second render that normals need, and for no longer: it hides changes between scenes.
    blender.render.use_persistent_data = "normal" in settings.passes
    blender.render.use_compositing = False
    blender.render.use_sequencer = False
    blender.render.film_transparent = False
    options = blender.cycles
    options.samples = settings.samples
    options.seed = 0
    options.use_adaptive_sampling = False
    options.use_denoising = True
    options.denoiser = "OPENIMAGEDENOISE"
    options.denoising_input_passes = "RGB_ALBEDO_NORMAL"
    options.denoising_prefilter = "FAST"
    options.denoising_quality = "FAST"
    options.max_bounces, options.diffuse_bounces, options.glossy_bounces = 2, 1, 1
    options.transmission_bounces, options.volume_bounces, options.transparent_max_bounces = 1, 0, 2
    options.caustics_reflective = options.caustics_refractive = False
    options.pixel_filter_type, options.filter_width = "BOX", 1.0
    options.use_light_tree = False
    options.use_auto_tile = False
    options.film_exposure = film
    layer = blender.view_layers[0]
    layer.use_pass_z = True
    layer.use_pass_object_index = "instance" in settings.passes
    layer.use_pass_material_index = True


def run_cycles() -> dict[str, np.ndarray]:
    """Render and read every pass in memory: `Render Result` has no pixels without a window, and files are slow."""
    layers: dict[str, np.ndarray] = {}
    original = cycles.CyclesRender.render

    def read_passes(engine: bpy.types.RenderEngine, _: None) -> None:
        result = engine.get_result()
        for render_pass in result.layers[0].passes:
            pixels = np.zeros(result.resolution_y * result.resolution_x * render_pass.channels, dtype=np.float32)
            render_pass.rect.foreach_get(pixels)
            layers[render_pass.name] = pixels.reshape(result.resolution_y, result.resolution_x, -1)[::-1]

    # A lambda: Blender counts the arguments of what it calls, and a decorator (of shape checks) would hide them.
    cycles.CyclesRender.render = lambda engine, depsgraph: read_passes(engine, original(engine, depsgraph))
    try:
        bpy.ops.render.render()
    finally:
        cycles.CyclesRender.render = original
    return layers


def _pass(name: str, layers: dict[str, np.ndarray]) -> np.ndarray:
    """A pass that Cycles takes from the first sample, at the pixel's very centre."""
    values = layers[PASS_OF[name]][..., 0]
    if name == "depth":
        return np.where(values > CYCLES_NO_HIT, np.float32(NO_HIT_DEPTH_M), values)
    return values.astype(np.uint8 if name == "semantic" else np.uint16)


def _normals(world_from_cam: Matrix4, plain: bpy.types.Material) -> np.ndarray:
    """Camera-frame unit normals at the pixels' centres, zero in the sky. Cycles averages normals over a pixel's
    samples, so they take a render of their own: one sample, no light."""
    blender = bpy.context.scene
    layer = blender.view_layers[0]
    layer.material_override, layer.use_pass_normal = plain, True
    blender.cycles.samples, blender.cycles.filter_width, blender.cycles.max_bounces = 1, 0.01, 0
    blender.cycles.use_denoising = False
    try:
        normals = run_cycles()["Normal"]
    finally:
        layer.material_override, layer.use_pass_normal = None, False
        blender.render.use_persistent_data = False
    return np.asarray(normals @ world_from_cam[:3, :3].astype(np.float32))
