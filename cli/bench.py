"""`synth3dlanes bench`: rendering speed, time per stage and image quality."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from synth3dlanes.system.words import counted

from .options import RENDERERS, CountRange, JobCommand, given, job_options, json_option, output_console, warn

if TYPE_CHECKING:
    from synth3dlanes.production.bench import Bench


@click.command(cls=JobCommand)
@click.option("--n", type=CountRange(min=1), default=30, help="Number of scenes to time, after a warm-up.")
@job_options(
    *("params", "set", "assets", "workers", "device", "quality", "samples", "passes", "map"),
    *("views_per_scene", "frames"),
    workers=RENDERERS,
    frames="Time clips of this many frames, not pictures.",
)
@click.option(
    "--reference",
    is_flag=True,
    help="Also measure image quality: compare three scenes with 1024 samples per pixel. Takes many minutes.",
)
@click.option("--naive", is_flag=True, help="Also time Blender's default settings on the same scenes. Takes minutes.")
@click.option(
    "--against",
    metavar="FILE",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Compare with an earlier result, saved from --json.",
)
@json_option
def bench(n: int, reference: bool, naive: bool, against: Path | None, as_json: bool, **fields: Any) -> None:
    """Measure rendering speed and the time spent in each stage.

    The time per image is compared with its lower bound, the "floor": path tracing and denoising alone. Samples are
    written to disk as by `generate`, then deleted.
    """

    from synth3dlanes.production import bench as measuring
    from synth3dlanes.production.devices import resolve_device
    from synth3dlanes.production.job import Job

    job = Job(split="bench", **given(fields))
    source = str(job.params)
    wanted = source, job.settings.samples, job.frames, job.views_per_scene, Path(job.map or "").name
    stored = measuring.read_bench(against, *wanted) if against else None
    recipe, slots = resolve_device(job.recipe(warn))
    with output_console(stderr=True).status("warming up") as status:
        found = measuring.bench(source, recipe, n, job.workers or slots.workers, list(slots.masks), status.update)
        if reference:
            found = replace(found, quality=measuring.measure_quality(recipe, status.update))
        if naive:
            found = replace(found, naive=measuring.measure_naive(recipe, status.update))
    if as_json:
        click.echo(json.dumps(found.document(), indent=1))
    else:
        _print(found)
    if stored:
        _print_comparison(measuring.compare(found, stored), err=as_json)


def _print(found: "Bench") -> None:
    from rich.table import Table

    table = Table(
        "stage",
        "seconds",
        "of the floor",
        title=f"{found.params}{f' on {found.map}' * bool(found.map)}"
        f"{f', clips of {found.frames} frames' * (found.frames > 1)}"
        f"{f', {found.views} views of each world' * (found.views > 1)}: "
        f"{counted(found.scenes, 'image')}, {counted(found.workers, 'worker')}",
    )
    for name, seconds in found.stages.items():
        table.add_row(name, f"{seconds:.4f}", f"{seconds / found.floor_seconds_per_image:.3f}")
    table.add_section()
    table.add_row("all", f"{found.seconds_per_image:.3f}", f"{found.ratio:.3f}")
    table.add_row("floor", f"{found.floor_seconds_per_image:.3f}", "1")
    console = output_console()
    console.print(table)
    width, height = found.size_px
    memory = " ".join(f"{mib:.0f}" for mib in found.memory_mib)
    console.print(
        f"{found.images_per_hour:,.0f} images/h, {found.images_per_hour_per_worker:,.0f} a worker "
        f"({width}x{height}, {counted(found.samples, 'sample')}, {found.device}); "
        f"{found.core_seconds_per_image:.2f} core-seconds an image\n"
        f"memory of a worker, MiB: peak {found.peak_memory_mib:.0f}; by quarters of the run {memory}"
    )
    if found.quality:
        pairs = zip(found.quality.psnr_db, found.quality.ssim, strict=True)
        console.print("against the reference: " + "; ".join(f"{a:.2f} dB, SSIM {b:.4f}" for a, b in pairs))
    if found.naive:
        console.print(
            f"naively: {found.naive.seconds_same_samples:.1f} s at {counted(found.samples, 'sample')}, "
            f"{found.naive.seconds:.1f} s at {found.naive.samples}"
        )


def _print_comparison(rows: list[tuple[str, float, float]], err: bool) -> None:
    from rich.table import Table

    table = Table("over the floor", "now", "stored", "now / stored", title="Against the stored result")
    for name, now, before in rows:
        table.add_row(name, f"{now:.4f}", f"{before:.4f}", f"{now / before:.2f}" if before else "-")
    output_console(stderr=err).print(table)
