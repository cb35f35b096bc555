"""`synth3dlanes params`: print and check parameter files."""

import json

import click

from .options import completing, json_option, refuse_idle, set_option


@click.group()
def params() -> None:
    """Print and check parameter files."""


@params.command()
@click.argument("source", metavar="[NAME|FILE]", default="appendix_i", shell_complete=completing())
@set_option
@click.option("--full", is_flag=True, help="Print every key.")
@json_option
def show(source: str, changes: tuple[str, ...], full: bool, as_json: bool) -> None:
    """Print a preset, whole, or what a parameter file or --set changes of one: as a parameter file with comments."""
    from synth3dlanes.params.params import forms, load_params
    from synth3dlanes.params.params_text import changes_yaml, params_yaml

    refuse_idle(not as_json, ["full"], "with --json, which prints every key")
    loaded = load_params(source, changes)
    if as_json:
        click.echo(json.dumps(forms(loaded)))
    else:
        click.echo(params_yaml(loaded, source) if full else changes_yaml(loaded, source), nl=False)


@params.command()
@click.argument("sources", metavar="NAME|FILE...", nargs=-1, required=True, shell_complete=completing())
@set_option
def check(sources: tuple[str, ...], changes: tuple[str, ...]) -> None:
    """Check parameter files and list every problem in them, and the keys that they leave out."""
    from synth3dlanes.params.params import check_params, load_params
    from synth3dlanes.params.params_text import contradictions, keys_left_out

    check_params(sources, changes)
    for source in sources:
        for line in contradictions(load_params(source, changes)):
            click.echo(f"{source}: {line}", err=True)
        left_out = ", ".join(keys_left_out(source))
        click.echo(f"{source}: ok" + (f"; left out, so as they are by default: {left_out}" if left_out else ""))
