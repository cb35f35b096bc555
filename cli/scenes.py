"""`synth3dlanes sample` and `render`: one scene at a time."""

from pathlib import Path

import click

from synth3dlanes.scene.settings import MAX_SAMPLES, N_SCENE_NUMBERS
from synth3dlanes.system.errors import InputError

from .idle import refuse_idle_keys
from .options import (
    CountRange,
    assets_option,
    camera_option,
    clip_options,
    device_option,
    lidar_option,
    open_assets,
    open_params,
    open_shots,
    params_option,
    passes_option,
    refuse_idle_changes,
    rig_option,
    samples_option,
    seed_option,
    set_option,
    split_option,
)


@click.command()
@click.option(
    "--index", type=click.IntRange(0, N_SCENE_NUMBERS - 1), default=0, help="Index of the sample in the split."
)
@click.option(
    "--n",
    type=CountRange(1, MAX_SAMPLES),
    default=1,
    help="Number of samples, starting at --index; one JSON document per line.",
)
@seed_option
@split_option
@params_option
@set_option
@camera_option
@rig_option
@assets_option
@clip_options
def sample(
    index: int,
    n: int,
    seed: int,
    split: str,
    source: str,
    changes: tuple[str, ...],
    camera: str | None,
    rig: str | None,
    assets: Path | None,
    frames: int,
    fps: float,
) -> None:
    """Draw random scenes and print them as scene.json, without rendering. Blender is needed only to check --assets."""
    from synth3dlanes.draw.sample import Scenes, scene_texts

    if index + n > N_SCENE_NUMBERS:
        raise InputError(f"n: expected at most {N_SCENE_NUMBERS - index} from index {index}, got {n}")
    library, shots = open_assets(assets), open_shots(camera, rig, frames, fps)
    refuse_idle_changes(changes, shots)
    params = open_params(source, changes, library)
    scenes = Scenes(params, seed, split, assets=library.assets, shots=shots)
    for text in scene_texts(scenes, range(index, index + n)):
        click.echo(text)


@click.command()
@click.argument("source", metavar="SCENE.JSON|DIR/SPLIT:KEY")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Image to write, .png or .jpg.  [default: NAME.png in the current folder]",
)
@set_option
@samples_option
@passes_option
@lidar_option
@device_option
@assets_option
def render(
    source: str,
    out: Path | None,
    changes: tuple[str, ...],
    samples: int,
    passes: tuple[str, ...],
    lidar: str | None,
    device: str,
    assets: Path | None,
) -> None:
    """Render one scene, from a file or a data set. Writes the image, NAME.labels.json and, with --passes,
    NAME.passes.exr. A scene with a lidar, its own or that of --lidar, gives NAME.lidar.exr.

    --set changes the scene first: --set light.exposure=3 changes the exposure, --set cars=[] removes the cars. The
    changed scene is written to NAME.scene.json.
    """
    from synth3dlanes.params.lidar_files import load_lidar
    from synth3dlanes.production.render_file import render_file
    from synth3dlanes.scene.settings import RenderSettings

    refuse_idle_keys(lidar is None, changes, ["lidar", "lidar."], "with --lidar, whose file has it")
    settings, library = RenderSettings(samples, passes, device), open_assets(assets)
    for path in render_file(source, out, changes, settings, library, load_lidar(lidar) if lidar else None):
        click.echo(path)
