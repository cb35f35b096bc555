"""`synth3dlanes export`: write a data set in the format of another data set."""

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from synth3dlanes.system.errors import InputError

from .options import json_option, progress_bar, workers_option

if TYPE_CHECKING:
    from synth3dlanes.formats.export import ExportSummary
    from synth3dlanes.formats.verify import Verification


def _size(text: str | None) -> tuple[int, int] | None:
    """`960x640` as width and height."""
    if text is None:
        return None
    found = re.fullmatch(r"([1-9]\d{1,4})x([1-9]\d{1,4})", text)
    if found is None:
        raise click.BadParameter(f"expected WIDTHxHEIGHT such as 960x640, got {text!r}")
    return int(found[1]), int(found[2])


def _formats(incomplete: str) -> list[str]:
    from synth3dlanes.formats.format import format_names

    return [name for name in format_names() if name.startswith(incomplete)]


@click.command()
@click.argument("source", metavar="DIR|DIR/SPLIT:KEY")
@click.option(
    "--format",
    "format_name",
    metavar="NAME",
    required=True,
    shell_complete=lambda ctx, param, incomplete: _formats(incomplete),
    help="Format to write; `synth3dlanes list formats` names them.",
)
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Output folder.")
@click.option(
    "--verify",
    "is_verified",
    is_flag=True,
    help="Read the export back and compare it with the labels; exit with 1 if a line is farther from them than the "
    "format's own rounding allows.",
)
@click.option(
    "--size",
    "size_px",
    metavar="WxH",
    callback=lambda ctx, param, text: _size(text),
    help="Image size, for formats of any size; intrinsics are scaled with it.",
)
@click.option(
    "--cameras",
    metavar="NAMES",
    default="",
    help="Cameras of a rig, separated by commas. Default: those that look ahead; all for formats that take images as "
    "they are.",
)
@workers_option
@json_option
def export(
    source: str,
    format_name: str,
    out: Path,
    is_verified: bool,
    size_px: tuple[int, int] | None,
    cameras: str,
    workers: int,
    as_json: bool,
) -> None:
    """Convert a data set (DIR), one split (DIR/train) or one sample (DIR/train:00000017) to another format: that of a
    benchmark, masks, or a map of each scene. Other packages may add formats (docs/exports.md).

    Rerun to resume, or to add samples generated since. OUT/README.md describes how splits were mapped,
    and which frames and lanes were left out and why.
    """
    from synth3dlanes import Export, verify_export
    from synth3dlanes.formats.one_frame import NARROW

    job = Export(source, out, format_name, size_px, tuple(name for name in cameras.split(",") if name))
    with progress_bar("frames") as move:
        summary = job.write(workers, move)
    if not any(summary.n_frames.values()):
        reasons = "; ".join(f"{count} {reason}" for reason, count in summary.left_out.items()) or "there are none"
        hint = "; generate with a wider camera (--camera, docs/camera.md)" if NARROW in summary.left_out else ""
        raise InputError(f"{out}: expected a frame to export, got none: {reasons}{hint} (docs/exports.md)")
    verified = verify_export(job) if is_verified else ()
    warnings = job.warnings(summary)
    for warning in warnings:
        click.echo(f"warning: {warning}", err=True)
    if as_json:
        click.echo(json.dumps(_document(summary, warnings, verified)))
    else:
        click.echo("\n".join([f"{out}: {summary.text(job.format.counted)}", *(result.text() for result in verified)]))
    problems = [problem for result in verified for problem in result.problems]
    if problems:
        raise click.ClickException("\n".join(problems))


def _document(
    summary: "ExportSummary", warnings: tuple[str, ...], verified: "tuple[Verification, ...]"
) -> dict[str, Any]:
    lists = [result.document() for result in verified]
    return {**summary.document(), "warnings": list(warnings), "verified": lists}
