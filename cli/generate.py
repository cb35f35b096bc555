"""`synth3dlanes generate`: make a data set, with progress on stderr."""

import json
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import click

from synth3dlanes.production.events import LEVELS, Event, duration
from synth3dlanes.scene.settings import TRIES

from .idle import refuse_idle, refuse_idle_keys, refuse_repeated, refuse_together
from .options import (
    KEYS_OF_ROADS,
    LINE_EVERY_S,
    RENDERERS,
    CountRange,
    assets_option,
    camera_option,
    clip_options,
    device_option,
    json_option,
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
    workers_option,
)

# Columns of a terminal that has room for a bar beside the numbers.
WIDE = 100


class PartOf(click.ParamType):
    """i/n: part i of n of the work."""

    name = "part"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Read it; the library checks that i is within 1..n."""
        found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", value)
        if found is None:
            self.fail(f"expected i/n such as 2/8, got {value!r}", param, ctx)
        return int(found[1]), int(found[2])


@click.command()
@click.option("--n", type=CountRange(min=1), required=True, help="Number of samples in the split.")
@click.option(
    "--out",
    metavar="DIR",
    required=True,
    help="Data set to create or extend: a folder, or a URL such as s3://lanes/v1.",
)
@split_option
@seed_option
@params_option
@set_option
@click.option(
    "--like",
    metavar="FILE",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Draw scenes near those in FILE, or near the worst in a result of evaluate --json (docs/like.md).",
)
@click.option(
    "--spread",
    "spreads",
    metavar="SHARE|GROUP.KEY=SHARE",
    multiple=True,
    callback=refuse_repeated,
    help="With --like: share of a parameter's range in which it varies; repeatable.  [default: 0.1]",
)
@click.option(
    "--map",
    "map_file",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Place scenes on the roads of an OpenDRIVE or Lanelet2 file (docs/maps.md).",
)
@click.option("--at", metavar="ROAD:S:LANE", help="With --map: the host's place, in place of a random one.")
@click.option(
    "--where",
    metavar="QUERY",
    help='Draw scenes for each sample until one fits, by columns of the index: "max_grade > 0.04 and junction = '
    "'merge'\" (docs/recipes.md).",
)
@click.option("--tries", type=CountRange(min=1), default=TRIES, help="With --where: most scenes to draw for a sample.")
@camera_option
@rig_option
@assets_option
@clip_options
@workers_option(f"{RENDERERS} With Ray: cores per task.")
@device_option
@samples_option
@passes_option
@lidar_option
@click.option(
    "--image-format",
    type=click.Choice(["jpg", "png"]),
    default="jpg",
    help="jpg has quality 95 (sensor.jpeg_quality); png is lossless.",
)
@click.option(
    "--executor",
    type=click.Choice(["local", "ray"]),
    default="local",
    help="Where to run: on this machine or on a Ray cluster.",
)
@click.option(
    "--address", default="auto", help="Address of the Ray cluster. auto: the cluster this machine belongs to."
)
@click.option(
    "--part",
    metavar="I/N",
    type=PartOf(),
    default="1/1",
    help="Make only part I of N, for example one part per machine.",
)
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
    n: int,
    out: str,
    split: str,
    seed: int,
    source: str,
    changes: tuple[str, ...],
    like: Path | None,
    spreads: tuple[str, ...],
    map_file: Path | None,
    at: str | None,
    where: str | None,
    tries: int,
    camera: str | None,
    rig: str | None,
    assets: Path | None,
    frames: int,
    fps: float,
    workers: int,
    device: str,
    samples: int,
    passes: tuple[str, ...],
    lidar: str | None,
    image_format: str,
    executor: Literal["local", "ray"],
    address: str,
    part: tuple[int, int],
    log_level: str,
    quiet: bool,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Generate a split of N labelled samples: scenes, or frames of clips with --frames.

    Rerun to resume; a larger N extends the split. Ctrl-C finishes the samples in progress, then stops.
    """
    from synth3dlanes.draw.like import read_like
    from synth3dlanes.draw.on_map import place_on_map
    from synth3dlanes.draw.sample import Scenes
    from synth3dlanes.production.condition import Condition
    from synth3dlanes.production.given_scenes import given_scenes
    from synth3dlanes.production.plan import Plan
    from synth3dlanes.production.recipe import Recipe
    from synth3dlanes.production.run import generate as run
    from synth3dlanes.scene.settings import RenderSettings

    refuse_idle(like is not None, ["spreads"], "without --like")
    refuse_idle(map_file is not None, ["at"], "without --map")
    refuse_together("like", "map_file")
    refuse_together("like", "where")
    refuse_idle(where is not None, ["tries"], "without --where")
    refuse_idle_keys(map_file is None, changes, KEYS_OF_ROADS, "with --map")
    refuse_idle(executor == "ray", ["address"], "without --executor ray")
    refuse_idle_keys(image_format == "jpg", (*changes, *spreads), ["sensor.jpeg_quality"], "with --image-format png")
    library = open_assets(assets)
    params, shots = open_params(source, changes, library), open_shots(camera, rig, frames, fps, lidar)
    refuse_idle_changes((*changes, *spreads), shots)
    settings = RenderSettings(samples, (*passes, *(["lidar"] if lidar else [])), device)
    given = read_like(given_scenes(like, params, library.assets, bool(shots.cameras)), spreads) if like else None
    place = place_on_map(map_file, at or "") if map_file else None
    scenes = Scenes(params, seed, split, assets=library.assets, shots=shots, like=given, map=place)
    condition = Condition(where, tries) if where is not None else None
    recipe = Recipe(scenes, settings, image_format, library, where=condition)
    plan = Plan(out, n, recipe, workers, part)
    drawn_from = f"parameters {source}{' with ' * bool(changes)}{', '.join(changes)}"
    drawn_from += f", {given.text()}" if given else ""
    drawn_from += f", {place.map.text()}" if place else ""
    drawn_from += f", {condition.probe(scenes)}" if condition else ""
    drawn_from += f", camera {camera}" if camera else f", rig {rig}" if rig else ""
    if dry_run:
        plan = plan.resolved() if executor == "local" else plan
        told, expected = f"{plan.text()}, {drawn_from}", plan.expected()
        click.echo(json.dumps({"plan": told, **asdict(expected)}) if as_json else f"{told}\n{expected.text()}")
        return
    refuse_together("quiet", "log_level")
    with progress(log_level, quiet) as notify:

        def tell(event: Event) -> None:
            notify(replace(event, message=f"{drawn_from}; {event.message}") if event.kind == "start" else event)

        report = run(plan, tell, executor, address)
    if report.problem:
        click.echo(report.problem, err=True)
    if as_json:
        click.echo(json.dumps(asdict(report)))
    else:
        click.echo(f"{out}/{split}: {report.text()}")
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
