"""Our renderer beside BlenderProc's, on the same meshes, materials and light: `python -m scripts.against_blenderproc`.

Needs BlenderProc beside bpy: `pip install blenderproc opencv-python-headless imageio h5py scikit-image trimesh pypng
gitpython "numpy<2"`. Scenes are built by our code; BlenderProc's own functions set its renderer, render and load the
picture. CPU seconds an image, without each renderer's first.
"""

import argparse
import os
import resource
import tempfile

# BlenderProc is imported as a module: its program would install a Blender of its own.
os.environ["OUTSIDE_OF_THE_INTERNAL_BLENDER_PYTHON_ENVIRONMENT_BUT_IN_RUN_SCRIPT"] = "1"

import bpy
import click
import numpy as np
from blenderproc.python.camera import CameraUtility  # type: ignore[import-not-found]
from blenderproc.python.renderer import RendererUtility  # type: ignore[import-not-found]
from blenderproc.python.utility.DefaultConfig import DefaultConfig  # type: ignore[import-not-found]
from blenderproc.python.utility.Utility import Utility  # type: ignore[import-not-found]

from synth3dlanes.blender import render as ours
from synth3dlanes.blender.build import build
from synth3dlanes.dataset.format import encode_image
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.imaging.daylight import Daylight, daylight
from synth3dlanes.imaging.develop import develop
from synth3dlanes.params.params import load_params
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.world.world import World

SAMPLES = 4


def cpu_seconds() -> float:
    """The CPU time of this process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def render_ours(world: World, light: Daylight) -> None:
    """A picture as `generate` makes it."""
    ours.configure(RenderSettings(samples=SAMPLES), light.film)
    layers = ours.read_layers(ours.run_cycles(), light.film)
    encode_image(develop(world.scene, world.view, light, layers, world.site.street_lamps), "jpg")


def render_blenderproc(samples: int) -> None:
    """A picture with the settings of `blenderproc.init`, but for the number of samples, the image's size and the sky.

    Ours that differ from Blender's own defaults and that BlenderProc does not set are undone.
    """
    blender, config = bpy.context.scene, DefaultConfig
    blender.render.use_compositing = blender.render.use_sequencer = True
    blender.cycles.pixel_filter_type, blender.cycles.filter_width = "BLACKMAN_HARRIS", 1.5
    blender.cycles.denoising_prefilter, blender.cycles.denoising_quality = "ACCURATE", "HIGH"
    blender.cycles.film_exposure = 1.0
    RendererUtility.render_init()
    RendererUtility.set_max_amount_of_samples(samples)
    RendererUtility.set_noise_threshold(config.sampling_noise_threshold)
    RendererUtility.set_cpu_threads(0)
    RendererUtility.set_denoiser(config.denoiser)
    RendererUtility.toggle_light_tree(False)
    RendererUtility.set_light_bounces(
        config.diffuse_bounces,
        config.glossy_bounces,
        config.ao_bounces_render,
        config.max_bounces,
        config.transmission_bounces,
        config.transparency_bounces,
        config.volume_bounces,
    )
    RendererUtility.set_output_format(
        config.file_format, config.color_depth, False, config.jpg_quality, config.view_transform
    )
    pose = np.array(blender.camera.matrix_world)
    blender.camera.animation_data_clear()
    blender.frame_start = blender.frame_end = 0
    CameraUtility.add_camera_pose(pose)
    RendererUtility.render(load_keys={"colors"})
    blender.use_nodes = blender.cycles.debug_use_spatial_splits = False
    layer = blender.view_layers[0]
    layer.use_pass_normal = layer.use_pass_diffuse_color = False


def main() -> None:
    """Render the first scenes of a split with each renderer in turn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=9, help="scenes; the first is not counted")
    parser.add_argument("--samples", type=int, default=SAMPLES, help=f"{DefaultConfig.samples}: BlenderProc's default")
    asked = parser.parse_args()
    Utility.temp_dir = tempfile.mkdtemp()
    studio, params = ours.studio(), load_params("appendix_i")
    seconds: dict[str, list[float]] = {"ours": [], "BlenderProc": []}
    for index in range(asked.n):
        world = sample_world(Scenes(params, 77, "train"), index)
        light = daylight(world.scene, float(world.view.eye_world[2]))
        for name, found in seconds.items():
            start = cpu_seconds()
            build(studio, world, world.view, light)
            if name == "ours":
                render_ours(world, light)
            else:
                render_blenderproc(asked.samples)
            found.append(cpu_seconds() - start)
    means = {name: float(np.mean(found[1:])) for name, found in seconds.items()}
    for name, mean in means.items():
        click.echo(f"{name}: {mean:.2f} CPU seconds an image")
    click.echo(f"ratio: {means['BlenderProc'] / means['ours']:.2f}")


if __name__ == "__main__":
    main()
