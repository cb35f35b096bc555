"""`synth3dlanes generate`: make a data set, with progress on stderr."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click

from synth3dlanes.production.events import LEVELS, Event, duration

from .options import (
    LINE_EVERY_S,
    JobCommand,
    OutputFile,
    given,
    job_options,
    json_option,
    refuse_place,
    refuse_together,
    warn,
)

# The options that are fields of Job, in the order of the help.
FIELDS = (
    *("n", "out", "split", "splits", "seed", "params", "set", "like", "spreads", "map", "at", "where", "tries"),
    *("camera", "rig", "assets", "views_per_scene", "frames", "fps", "workers", "device", "quality", "samples"),
    *("passes", "lidar", "image_format", "executor", "address", "part"),
)
# Columns of a terminal that has room for a bar beside the numbers.
WIDE = 100


@click.command(cls=JobCommand)
@click.argument("source", metavar="[JOB.YAML]", required=False, type=click.Path(path_type=Path))
@job_options(*FIELDS)
@click.option("--save-job", metavar="FILE", type=OutputFile(".yaml", ".yml"), help="Write these choices to a job file.")
@click.option(
    "--log-level",
    type=click.Choice(LEVELS),
    default="info",
    help="Lowest level of messages to print. DIR/logs has the messages of all levels.",
)
@click.option("--quiet", is_flag=True, help="Print no progress and no messages of the run, only its result.")
@click.option("--dry-run", is_flag=True, help="Print what would be made, and stop.")
@json_option
@click.pass_context
def generate(
    ctx: click.Context,
    /,
    source: Path | None,
    save_job: Path | None,
    log_level: str,
    quiet: bool,
    dry_run: bool,
    as_json: bool,
    **fields: Any,
) -> None:
    """Generate a split of N labelled samples: scenes, or frames of clips with --frames.

    JOB.YAML is a file of these choices (docs/jobs.md), or the dataset.json of a data set to make it anew; options
    override it. Rerun to resume; a larger N extends the split. Ctrl-C finishes the samples in progress, then stops.
    """
    from synth3dlanes.production import job as jobs
    from synth3dlanes.production.run import generate as run
    from synth3dlanes.production.tally import total

    job = jobs.Job(**given(fields)) if source is None else jobs.load_job(source, given(fields), warn)
    refuse_place(str(job.out))
    plans = job.plans(warn)
    drawn_from = job.text(plans[0].recipe, warn)
    if save_job is not None:
        jobs.save_job(job, save_job)
    if dry_run:
        for plan in plans:
            plan = plan.resolved() if job.executor == "local" else plan
            told, expected = f"{plan.text()}, {drawn_from}", plan.expected()
            click.echo(json.dumps({"plan": told, **asdict(expected)}) if as_json else f"{told}\n{expected.text()}")
        return
    refuse_together("quiet", "log_level")
    reports = []
    for plan in plans:
        with progress(log_level, quiet) as notify:

            def tell(event: Event) -> None:
                notify(replace(event, message=f"{drawn_from}; {event.message}") if event.kind == "start" else event)

            reports.append(run(plan, tell, job.executor, job.address))
        if reports[-1].problem:
            click.echo(reports[-1].problem, err=True)
        if not as_json:
            click.echo(f"{job.out}/{plan.recipe.scenes.split}: {reports[-1].text()}")
        if reports[-1].exit_code:
            break
    report = total(reports)
    if as_json:
        click.echo(json.dumps(asdict(report)))
    ctx.exit(report.exit_code)


@contextmanager
def progress(level: str = "info", quiet: bool = False) -> Iterator[Callable[[Event], None]]:
    """A callback for the events of a run: prints messages, and shows a progress bar (on a terminal) or a progress line
    now and then; prints nothing if it is quiet."""
    if quiet:
        yield lambda event: None
        return
    if sys.stderr.isatty():
        with _bar(level) as notify:
            yield notify
        return
    printed, last = time.monotonic(), ""

    def notify_in_lines(event: Event) -> None:
        nonlocal printed, last
        if event.kind != "end" and event.matters(level):
            click.echo(event.message, err=True)
        if event.kind == "end" or time.monotonic() - printed > LINE_EVERY_S:
            line = f"{event.done}/{event.asked}"
            if line != last:
                click.echo(f"{line}  {_pace(event)}".rstrip(), err=True)
            printed, last = time.monotonic(), line

    yield notify_in_lines


@contextmanager
def _bar(level: str) -> Iterator[Callable[[Event], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    is_wide = console.width >= WIDE
    columns: list[ProgressColumn] = [MofNCompleteColumn(), TextColumn("{task.fields[pace]}")]
    if is_wide:
        columns = [BarColumn(), columns[0], TimeElapsedColumn(), columns[1]]
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("", total=None, pace="")

        def notify(event: Event) -> None:
            if event.kind != "end" and event.matters(level):
                bar.console.print(event.message, markup=False)
            pace = _pace(event, " images/h" if is_wide else "/h")
            bar.update(task, completed=event.done, total=event.asked, pace=pace)

        yield notify


def _pace(event: Event, unit: str = " images/h") -> str:
    """Rate and remaining time, or "" while they are unknown."""
    if not event.rate_per_s or event.eta_s is None:
        return ""
    set_aside = f", {event.set_aside} set aside" if event.set_aside else ""
    return f"{3600 * event.rate_per_s:,.0f}{unit}, {duration(event.eta_s)} left{set_aside}"
