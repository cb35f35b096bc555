"""`synth3dlanes stats`: does what was drawn follow what was declared, and what do the labels show?"""

import sys
from pathlib import Path

import click

from .options import assets_option, json_option, open_assets, seed_option, set_option

# Of what is no terminal: wide enough for every column whole.
WIDTH = 140


@click.command()
@click.argument("folder", metavar="[DIR]", required=False)
@click.option("--n", type=click.IntRange(min=1), default=2000, help="Scenes to read or draw; of DIR, evenly over it.")
@click.option("--params", "source", metavar="FILE", help="Scenes drawn from these anew, instead of DIR's. No Blender.")
@set_option
@assets_option
@seed_option
@click.option("--out", type=click.Path(path_type=Path), help="One page of plots to write.")
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
    """Compare every parameter's drawn values with its declared distribution; sum up slopes, bends, visibility.

    Takes a data set (DIR), one split (DIR/train), or --params appendix_i for scenes drawn now, which have no images
    and therefore no statistics of labels.
    """
    from rich.console import Console

    from synth3dlanes.dataset.splits import readers, spread
    from synth3dlanes.figures.stats import label_statistics, scene_statistics, to_json
    from synth3dlanes.figures.stats_views import draw_statistics, statistics_table, verdict
    from synth3dlanes.open_source import params_of, read_scene
    from synth3dlanes.params import load_params
    from synth3dlanes.sample import sample_scene

    if (folder is None) == (source is None):
        raise click.UsageError("Expected either DIR or --params FILE.")
    if folder is not None:
        if changes or seed or assets:
            raise click.UsageError("--set, --assets and --seed go with --params: scenes of DIR are as they are.")
        found = readers(folder)
        places = spread(found, n)
        scenes = scene_statistics((read_scene(reader, i) for reader, i in places), params_of(found[0]))
        labels = label_statistics(reader.labels(i) for reader, i in places)
    else:
        own = open_assets(assets).assets
        params = load_params(str(source), changes, own)
        scenes = scene_statistics((sample_scene(params, seed, "train", index, own) for index in range(n)), params)
        labels = None
    if out:
        draw_statistics(scenes, labels).savefig(out, dpi=100)
    if as_json:
        click.echo(to_json(scenes, labels))
        return
    Console(width=None if sys.stdout.isatty() else WIDTH).print(statistics_table(scenes, labels))
    click.echo(verdict(scenes))
    if out:
        click.echo(f"Plots: {out}")
