"""`synth3dlanes list`: what options and commands know by a name."""

import json
from collections.abc import Callable

import click

from .networks import SHIPPED
from .options import json_option, output_console

Listing = list[tuple[str, str]]


def _yaml_files(kind: str) -> Listing:
    from synth3dlanes.params.params_text import presets_described

    return presets_described(kind)


def _formats() -> Listing:
    from synth3dlanes.formats.format import described

    return described()


def _benchmarks() -> Listing:
    from synth3dlanes.production.benchmarks import benchmark_names, load_benchmark

    found = {name: load_benchmark(name) for name in benchmark_names()}
    return [(name, f"{benchmark.title}. {benchmark.about}") for name, benchmark in found.items()]


KINDS: dict[str, Callable[[], Listing]] = {
    "presets": lambda: _yaml_files(""),
    "cameras": lambda: _yaml_files("cameras"),
    "rigs": lambda: _yaml_files("rigs"),
    "lidars": lambda: _yaml_files("lidars"),
    "formats": _formats,
    "models": lambda: list(SHIPPED.items()),
    "benchmarks": _benchmarks,
}


@click.command("list")
@click.argument("kind", metavar="KIND", type=click.Choice(list(KINDS)))
@json_option
def list_names(kind: str, as_json: bool) -> None:
    """List everything of a kind that has a name, with a line on each.

    KIND is presets (for --params), cameras (--camera), rigs (--rig), lidars (--lidar), formats (export --format),
    models (predict, evaluate, train --init) or benchmarks (benchmark).
    """
    from rich.table import Table

    rows = KINDS[kind]()
    if as_json:
        click.echo(json.dumps([{"name": name, "about": about} for name, about in rows]))
        return
    table = Table("name", "what it is")
    for row in rows:
        table.add_row(*row)
    output_console().print(table)
