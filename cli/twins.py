"""`synth3dlanes twins`: the same scenes, one factor changed."""

from pathlib import Path

import click

from .generate import Workers, progress
from .options import assets_option, device_option, open_assets


@click.command()
@click.argument("folder", metavar="DIR/SPLIT")
@click.option("--vary", metavar="PATH=VALUES", required=True, help="The factor and its values: light.exposure=1,2,3")
@click.option(
    "--out",
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    required=True,
    help="The folder to write them to.",
)
@click.option("--n", type=click.IntRange(min=1), default=10, help="The first so many scenes of the split.")
@click.option("--workers", metavar="N|auto", type=Workers(), default="auto", help="Processes; auto: one per core.")
@device_option
@assets_option
@click.pass_context
def twins(
    ctx: click.Context, folder: str, vary: str, out: Path, n: int, workers: int, device: str, assets: Path | None
) -> None:
    """Render scenes of a split again for each value of one factor, everything else being equal.

    OUT/twin_1 has the first value, OUT/twin_2 the second: sample i is the same scene in all. Labels are equal where
    the factor does not move lanes, camera or what hides them. A path is as in scene.json: camera.pitch_deg,
    surface.road_texture, cars. Run again to resume.
    """
    from synth3dlanes.dataset.read import Reader
    from synth3dlanes.production.plan import Plan
    from synth3dlanes.production.recipe import require_blender
    from synth3dlanes.production.run import generate
    from synth3dlanes.production.twins import twin_recipes

    recipes = twin_recipes(folder, vary, device, open_assets(assets))
    require_blender()
    count = min(n, len(Reader(folder)))
    for recipe, value in zip(recipes, recipes[0].values, strict=True):
        with progress() as notify:
            report = generate(Plan(out, count, recipe, workers), notify)
        if report.problem:
            click.echo(report.problem, err=True)
        click.echo(f"{out}/{recipe.split}: {report.done} of {report.asked} samples with {recipe.path} = {value}")
        if report.exit_code:
            ctx.exit(report.exit_code)
