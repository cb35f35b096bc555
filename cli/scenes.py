"""`synth3dlanes sample` and `render`: one scene at a time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from synth3dlanes.scene.settings import MAX_SAMPLES, N_SCENE_NUMBERS
from synth3dlanes.system.errors import InputError

from .options import CountRange, JobCommand, given, job_options, refuse_idle_keys, set_option, warn


@click.command(cls=JobCommand)
@click.option(
    "--index", type=click.IntRange(0, N_SCENE_NUMBERS - 1), default=0, help="Index of the sample in the split."
)
@click.option(
    "--n",
    type=CountRange(1, MAX_SAMPLES),
    default=1,
    help="Number of samples, starting at --index; one JSON document per line.",
)
@job_options(
    "seed", "split", "params", "set", "map", "at", "camera", "rig", "assets", "views_per_scene", "frames", "fps"
)
def sample(index: int, n: int, **fields: Any) -> None:
    """Draw random scenes and print them as scene.json, without rendering. Blender is needed only to check --assets."""
    from synth3dlanes.draw.sample import scene_texts
    from synth3dlanes.production.job import Job

    if index + n > N_SCENE_NUMBERS:
        raise InputError(f"n: expected at most {N_SCENE_NUMBERS - index} from index {index}, got {n}")
    scenes = Job(**given(fields)).recipe(warn).scenes
    for text in scene_texts(scenes, range(index, index + n)):
        click.echo(text)


@click.command(cls=JobCommand)
@click.argument("source", metavar="SCENE.JSON|DIR/SPLIT:KEY")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Image to write, .png or .jpg.  [default: NAME.png in the current folder]",
)
@set_option
@job_options("quality", "samples", "passes", "lidar", "device", "assets")
def render(source: str, out: Path | None, changes: tuple[str, ...], **fields: Any) -> None:
    """Render one scene, from a file or a data set. Writes the image, NAME.labels.json and, with --passes,
    NAME.passes.exr. A scene with a lidar, its own or that of --lidar, gives NAME.lidar.exr.

    --set changes the scene first: --set light.exposure=3 changes the exposure, --set cars=[] removes the cars. The
    changed scene is written to NAME.scene.json.
    """
    from synth3dlanes.production.job import Job
    from synth3dlanes.production.render_file import render_file

    job = Job(**given(fields))
    refuse_idle_keys(job.lidar is None, changes, ["lidar", "lidar."], "with --lidar, whose file has it")
    for path in render_file(
        source, out, changes, replace(job.settings, passes=job.passes), job.library(warn), job.lidar_spec
    ):
        click.echo(path)
