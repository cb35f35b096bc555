"""World and View -> radiance and id layers, and the labels' `object_visible`."""

import time
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import bpy
import numpy as np

from synth3dlanes.blender.build import MeshInstance, Studio, build, open_studio, prepare
from synth3dlanes.blender.devices import use_device
from synth3dlanes.blender.lidar import scan
from synth3dlanes.blender.light import HAZE_PASS
from synth3dlanes.blender.occlusion import hidden_by_objects
from synth3dlanes.blender.silhouettes import seen_fractions
from synth3dlanes.blender.structures import search_tree
from synth3dlanes.blender.trace import distances, run_cycles
from synth3dlanes.geometry.frames import transform
from synth3dlanes.imaging.daylight import Daylight
from synth3dlanes.imaging.layers import Layers
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels.labels import Labels
from synth3dlanes.labels.object_labels import as_seen
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Library
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.machine import usable_cores
from synth3dlanes.truth.object_truth import with_pixel_shares
from synth3dlanes.world.camera import rays_of_pixels
from synth3dlanes.world.visibility import seen_over_ground
from synth3dlanes.world.world import View, World

# The portal of a lens, and the screen that its rays pass again.
LENS_BOUNCES = 2


@dataclass(frozen=True, eq=False)
class BlenderOutput:
    """The layers, the labels with `object_visible`, the sweep if the view has a lidar, and the seconds of each
    stage."""

    layers: Layers
    labels: Labels
    sweep: Sweep | None
    timings: dict[str, float]


opened = lru_cache(maxsize=1)(open_studio)


def studio(library: Library = BUILT_IN) -> Studio:
    """The studio of this process with the library's assets; another library replaces it."""
    return opened(library)


def render(
    world: World,
    view: View,
    light: Daylight,
    labels: Labels,
    settings: RenderSettings,
    library: Library = BUILT_IN,
) -> BlenderOutput:
    """Render one view; equal arguments give equal pixels on one kind of machine."""
    clock = [time.perf_counter()]
    lines = [lane.id for lane in labels.lanes if lane.kind == "delimiter"]
    own = studio(library)
    prepared = prepare(own, world, view, lines)
    clock.append(time.perf_counter())
    placed = build(own, world, view, light, prepared)
    clock.append(time.perf_counter())
    configure(settings, light.film)
    # For further renders of the same scene only: persistent data ignores changes between scenes.
    bpy.context.scene.render.use_persistent_data = "normal" in settings.passes or labels.lidar is not None
    is_bent = not view.camera.lens.is_pinhole
    if is_bent:
        bpy.context.scene.cycles.transparent_max_bounces += LENS_BOUNCES
    layers = read_layers(run_cycles(), light.film)
    clock.append(time.perf_counter())
    if "normal" in settings.passes:
        layers = replace(layers, normal=_normals(view.world_from_cam, own.lens if is_bent else own.plain))
    if is_bent:
        layers = layers.only(np.isfinite(rays_of_pixels(view.camera)).all(axis=-1))
    # The sweep comes last, because it moves the camera.
    sweep = None if labels.lidar is None else scan(own.camera, labels.lidar, view.world_from_lidar)
    bpy.context.scene.render.use_persistent_data = False
    clock.append(time.perf_counter())
    seen = with_object_visibility(world, view, labels, placed)
    objects = as_seen(seen.objects or (), layers.instance, None if sweep is None else sweep.points().instance)
    elements = as_seen(seen.traffic_elements or (), layers.instance)
    elements = with_pixel_shares(elements, world.site, seen.camera, layers.instance)
    seen = replace(seen, objects=objects, traffic_elements=elements)
    clock.append(time.perf_counter())
    stages = ("meshes", "build", "cycles", "passes", "occlusion")
    return BlenderOutput(layers, seen, sweep, dict(zip(stages, np.diff(clock).tolist(), strict=True)))


def with_object_visibility(world: World, view: View, labels: Labels, placed: list[MeshInstance]) -> Labels:
    """The labels with every point's `object_visible` and the seen share of every object."""
    eye = view.eye_world
    outlines = [*(lane.xyz_cam for lane in labels.lanes), *(symbol.xyz_cam for symbol in labels.symbols)]
    structures = search_tree(world.site.structures)
    visible = ~hidden_by_objects(placed, structures, eye, transform(view.world_from_cam, np.concatenate(outlines)))
    masks = iter(np.split(visible, np.cumsum([len(points) for points in outlines])[:-1]))
    lanes = tuple(replace(lane, object_visible=next(masks)) for lane in labels.lanes)
    symbols = tuple(replace(symbol, object_visible=next(masks)) for symbol in labels.symbols)
    over_ground = partial(seen_over_ground, world.ground, eye)
    shares = seen_fractions(placed[: len(view.objects)], placed, structures, labels.camera, over_ground)
    return replace(labels, lanes=lanes, symbols=symbols).with_seen_shares(shares)


def configure(settings: RenderSettings, film: float) -> None:
    """Cycles' settings, chosen for cost: see docs/decisions.md#rendering and docs/speed_tried.md."""
    blender = bpy.context.scene
    blender.render.engine = "CYCLES"
    use_device(settings.device)
    blender.render.threads_mode = "FIXED"
    blender.render.threads = usable_cores()
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
    options.debug_use_spatial_splits = True
    options.film_exposure = film
    want_passes(blender.view_layers[0])


def want_passes(layer: bpy.types.ViewLayer) -> None:
    """Make Cycles give the passes that `read_layers` takes."""
    layer.use_pass_z = layer.use_pass_object_index = layer.use_pass_material_index = True


def read_layers(passes: dict[str, np.ndarray], film: float) -> Layers:
    """Cycles' passes as layers. Depth and ids are those of the first sample, at the pixel's centre."""
    return Layers(
        radiance=passes["Combined"][..., :3] / np.float32(film),
        haze=passes[HAZE_PASS][..., :2],
        depth_m=distances(passes),
        semantic=passes["IndexMA"][..., 0].astype(np.uint8),
        instance=passes["IndexOB"][..., 0].astype(np.uint16),
    )


def _normals(world_from_cam: Matrix4, plain: bpy.types.Material) -> np.ndarray:
    """Camera-frame unit normals at the pixels' centres, zero in the sky. Cycles averages normals over a pixel's
    samples, so they need a separate render with one sample and no light."""
    blender = bpy.context.scene
    layer = blender.view_layers[0]
    layer.material_override, layer.use_pass_normal = plain, True
    blender.cycles.samples, blender.cycles.filter_width, blender.cycles.max_bounces = 1, 0.01, 0
    blender.cycles.use_denoising = False
    try:
        normals = run_cycles()["Normal"]
    finally:
        layer.material_override, layer.use_pass_normal = None, False
    return np.asarray(normals @ world_from_cam[:3, :3].astype(np.float32))
