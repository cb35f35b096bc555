"""`synth3dlanes stats`: drawn values against their declared distributions, and statistics of the labels."""

import json
from pathlib import Path
from typing import Any

import click

from synth3dlanes.system.files import encoded, write

from .options import (
    CountRange,
    JobCommand,
    OutputFile,
    completing,
    given,
    job_options,
    json_option,
    output_console,
    refuse_idle,
    warn,
)


@click.command(cls=JobCommand)
@click.argument("folder", metavar="[DIR]", required=False)
@click.option(
    "--n",
    type=CountRange(min=1),
    default=2000,
    help="Number of scenes to draw, or to read from DIR, evenly spaced.",
)
@click.option(
    "--params",
    "source",
    metavar="FILE",
    shell_complete=completing(),
    help="Draw new scenes from these parameters instead of reading DIR.",
)
@job_options("set", "assets", "seed")
@click.option("--out", type=OutputFile(".png", ".svg", ".pdf"), help="Write the plots to this file.")
@json_option
def stats(folder: str | None, n: int, source: str | None, out: Path | None, as_json: bool, **fields: Any) -> None:
    """Compare the drawn values of every parameter with its declared distribution, and summarise slopes, curvature and
    visibility.

    Reads a data set (DIR) or one split (DIR/train). With --params, draws scenes without rendering them; these have no
    statistics of labels.
    """

    from synth3dlanes.api import dataset_stats
    from synth3dlanes.figures.stats_views import draw_statistics, statistics_table, verdict
    from synth3dlanes.production.job import Job
    from synth3dlanes.scene.assets.catalogue import Library

    if (folder is None) == (source is None):
        raise click.UsageError("Give either DIR or --params FILE.")
    refuse_idle(source is not None, ["set", "seed", "assets"], "without --params")
    if folder is not None:
        found = dataset_stats(folder, n=n)
    else:
        scenes = Job(params=source, **given(fields)).recipe(warn).scenes
        found = dataset_stats(scenes.params, n=n, seed=scenes.seed, assets=Library("", scenes.assets))
    if out:
        figure = draw_statistics(found.scenes, found.labels)
        write(out, encoded(lambda stream: figure.savefig(stream, format=out.suffix[1:], dpi=100)))
    if as_json:
        click.echo(json.dumps(found.document(), allow_nan=False))
        return
    output_console().print(statistics_table(found.scenes, found.labels))
    click.echo(verdict(found.scenes))
    if out:
        click.echo(f"Plots: {out}")
