"""`synth3dlanes twins`: render scenes again with one factor changed."""

from typing import Any

import click

from synth3dlanes.system.words import counted

from .generate import progress
from .options import RENDERERS, CountRange, JobCommand, given, job_options, warn


@click.command(cls=JobCommand)
@click.argument("folder", metavar="DIR[/SPLIT]")
@click.option(
    "--vary", metavar="PATH=VALUES", required=True, help="Factor and its values, such as light.exposure=1,2,3."
)
@click.option("--out", metavar="DIR", required=True, help="The new data set: a folder or a URL such as s3://lanes/v1.")
@click.option("--n", type=CountRange(min=1), default=10, help="Number of scenes, from the start of the split.")
@job_options("workers", "device", "assets", workers=RENDERERS)
@click.pass_context
def twins(ctx: click.Context, /, folder: str, vary: str, out: str, n: int, **fields: Any) -> None:
    """Render the scenes of a split (or of DIR, if it has one) again with one factor changed and everything else equal.

    Each value of the factor becomes a split: OUT/twin_1 has the first value, OUT/twin_2 the second. Sample i shows the
    same scene in all of them; its labels differ only if the factor changes lanes, camera or occlusion. PATH names a
    value in scene.json, such as camera.pitch_deg, surface.road_texture or cars, or a parameter such as weather.daytime,
    road.n_lanes or cars.n, from which others follow: these are drawn again, the rest stays. Rerun to resume.
    """
    from synth3dlanes.dataset.splits import one_reader
    from synth3dlanes.production.job import Job
    from synth3dlanes.production.plan import Plan
    from synth3dlanes.production.run import generate
    from synth3dlanes.production.twins import twin_recipes

    source, job = one_reader(folder), Job(**given(fields))
    recipes = twin_recipes(source.url, vary, job.device, job.library(warn))
    count = min(n, len(source))
    for recipe, value in zip(recipes, recipes[0].values, strict=True):
        with progress() as notify:
            report = generate(Plan(out, count, recipe, job.workers), notify)
        if report.problem:
            click.echo(report.problem, err=True)
        made = f"{report.done:,} of {counted(report.asked, 'sample')}"
        click.echo(f"{out}/{recipe.scenes.split}: {made} with {recipe.path} = {value}")
        if report.exit_code:
            ctx.exit(report.exit_code)
