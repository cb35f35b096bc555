"""`synth3dlanes stats`: drawn values against their declared distributions, and statistics of the labels."""

import sys
from pathlib import Path

import click

from synth3dlanes.files import replacing

from .options import OutputFile, assets_option, json_option, open_assets, seed_option, set_option

# Table width where stdout is not a terminal: wide enough for every column.
WIDTH = 140


@click.command()
@click.argument("folder", metavar="[DIR]", required=False)
@click.option(
    "--n",
    type=click.IntRange(min=1),
    default=2000,
    help="Number of scenes to draw, or to read from DIR, evenly spaced.",
)
@click.option(
    "--params", "source", metavar="FILE", help="Draw new scenes from these parameters instead of reading DIR."
)
@set_option
@assets_option
@seed_option
@click.option("--out", type=OutputFile(".png", ".svg", ".pdf"), help="Write the plots to this file.")
@json_option
def stats(
    folder: str | None,
    n: int,
    source: str | None,
    changes: tuple[str, ...],
    assets: Path | None,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Compare the drawn values of every parameter with its declared distribution, and summarise slopes, curvature and
    visibility.

    Reads a data set (DIR) or one split (DIR/train). With --params, draws scenes without rendering them; these have no
    statistics of labels.
    """
    from rich.console import Console

    from synth3dlanes.dataset.splits import evenly_spaced, readers
    from synth3dlanes.figures.stats import label_statistics, scene_statistics, to_json
    from synth3dlanes.figures.stats_views import draw_statistics, statistics_table, verdict
    from synth3dlanes.params import load_params
    from synth3dlanes.sample import Scenes, sample_scene
    from synth3dlanes.sources import read_scene, scenes_of

    if (folder is None) == (source is None):
        raise click.UsageError("Give either DIR or --params FILE.")
    if folder is not None:
        if changes or seed or assets:
            raise click.UsageError("--set, --assets and --seed can only be used with --params.")
        found = readers(folder)
        places = evenly_spaced(found, n)
        drawn = (read_scene(reader, i) for reader, i in evenly_spaced(found, n, is_once_a_scene=True))
        origin = scenes_of(found[0])
        scenes = scene_statistics(drawn, origin.params, bool(origin.shots.cameras))
        labels = label_statistics(reader.labels(i) for reader, i in places)
    else:
        own = open_assets(assets).assets
        origin = Scenes(load_params(str(source), changes, own), seed, assets=own)
        scenes = scene_statistics((sample_scene(origin, index) for index in range(n)), origin.params)
        labels = None
    if out:
        with replacing(out) as stream:
            draw_statistics(scenes, labels).savefig(stream, format=out.suffix[1:], dpi=100)
    if as_json:
        click.echo(to_json(scenes, labels))
        return
    Console(width=None if sys.stdout.isatty() else WIDTH).print(statistics_table(scenes, labels))
    click.echo(verdict(scenes))
    if out:
        click.echo(f"Plots: {out}")
