"""`synth3dlanes assets`: check a folder of a user's own cars, trees, textures and skies."""

import json
from dataclasses import asdict
from pathlib import Path

import click

from .options import json_option, output_console


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--example", is_flag=True, help="First create DIR with an example car, tree, textures and sky.")
@json_option
@click.pass_context
def assets(ctx: click.Context, folder: Path, example: bool, as_json: bool) -> None:
    """Check a folder for use with --assets.

    Lists the models, textures and skies found with their sizes, and every problem; exits with 1 if there is one.
    The layout of the folder is described in docs/assets.md.
    """
    from rich.table import Table

    from synth3dlanes.production.user_assets import check_assets, write_example

    if example:
        write_example(folder)
    checked = check_assets(folder)
    if as_json:
        click.echo(json.dumps(asdict(checked)))
    else:
        table = Table("kind", "number", "name", "size", "triangles", "sha256", title=str(folder))
        for row in checked.rows:
            triangles = f"{row.triangles:,}" if row.triangles else ""
            table.add_row(row.kind, str(row.number), row.name, row.size, triangles, row.sha256[:12])
        output_console().print(table)
        for line in checked.warnings:
            click.echo(f"warning: {line}", err=True)
        for line in checked.problems:
            click.echo(f"problem: {line}", err=True)
    ctx.exit(1 if checked.problems else 0)
