"""`synth3dlanes assets`: what a folder of own cars, trees, textures and skies holds."""

import json
from dataclasses import asdict
from pathlib import Path

import click

from .options import json_option


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--example", is_flag=True, help="Make the folder first: a car, a tree, textures and a sky.")
@json_option
@click.pass_context
def assets(ctx: click.Context, folder: Path, example: bool, as_json: bool) -> None:
    """Check a folder for --assets: what was found, how large it is, and everything that is wrong (exit code 1).

    docs/assets.md says how to make one.
    """
    from rich.console import Console
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
        Console().print(table)
        for line in checked.warnings:
            click.echo(f"warning: {line}", err=True)
        for line in checked.problems:
            click.echo(f"problem: {line}", err=True)
    ctx.exit(1 if checked.problems else 0)
