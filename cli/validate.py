"""`synth3dlanes validate`: check the files of a data set, and its labels against its pixels."""

import json
from typing import Any

import click

from .options import (
    JobCommand,
    given,
    job_options,
    json_option,
    output_console,
    progress_bar,
    refuse_idle,
    warn,
    workers_option,
)


@click.command(cls=JobCommand)
@click.argument("folder", metavar="DIR")
@workers_option
@click.option("--limit", metavar="N", type=click.IntRange(min=0), help="Check only N samples of each split.")
@click.option(
    "--rerender",
    metavar="K",
    type=click.IntRange(min=0),
    default=0,
    help="Make K samples again, chosen at random, and compare them with what lies there.",
)
@job_options("assets")
@json_option
@click.pass_context
def validate(
    ctx: click.Context, /, folder: str, workers: int, limit: int | None, rerender: int, as_json: bool, **fields: Any
) -> None:
    """Check every file and sample of a data set (DIR) or one split (DIR/train), and its labels against its images.

    Prints one line per problem and exits with 1 if there is one. DIR/validation then has a picture of each sample
    whose labels or pixels failed. docs/validate.md lists the checks.
    """

    from synth3dlanes.api import validate_dataset
    from synth3dlanes.production.job import Job

    refuse_idle(rerender, ["assets"], "without --rerender")
    library = Job(**given(fields)).library(warn)
    with progress_bar("samples") as move:
        report = validate_dataset(
            folder, workers=workers, limit=limit, rerender=rerender, assets=library, progress=move
        )
    if as_json:
        click.echo(json.dumps(report.document()))
    else:
        output_console(soft_wrap=True).print(report.text())
    ctx.exit(1 if report.problems else 0)
