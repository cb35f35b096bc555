"""`synth3dlanes export`: write a data set in the format of another data set."""

import re
from pathlib import Path

import click

from .options import progress_bar


def _size(text: str | None) -> tuple[int, int] | None:
    """`960x640` as width and height."""
    if text is None:
        return None
    found = re.fullmatch(r"([1-9]\d{1,4})x([1-9]\d{1,4})", text)
    if found is None:
        raise click.BadParameter(f"expected WIDTHxHEIGHT such as 960x640, got {text!r}")
    return int(found[1]), int(found[2])


@click.command()
@click.argument("source", metavar="DIR|DIR/SPLIT:KEY")
@click.option(
    "--format",
    "format_name",
    required=True,
    type=click.Choice(
        [
            "apollo",
            "openlane",
            "once",
            "tusimple",
            "culane",
            "curvelanes",
            "openlane_v2",
            "opendrive",
            "coco",
            "masks",
            "yolo",
        ]
    ),
    help="Format to write.",
)
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Output folder.")
@click.option(
    "--verify",
    "is_verified",
    is_flag=True,
    help="Score the exported ground truth; exit with 1 if the score is not perfect.",
)
@click.option(
    "--size",
    "size_px",
    metavar="WxH",
    callback=lambda ctx, param, text: _size(text),
    help="Image size for openlane, once and curvelanes; intrinsics are scaled with it.",
)
@click.option(
    "--cameras",
    metavar="NAMES",
    default="",
    help="Cameras of a rig, separated by commas. Default: those that look ahead; all for openlane_v2, coco, masks and "
    "yolo.",
)
@click.option("--workers", default=1, show_default=True, type=click.IntRange(min=1), help="Worker processes.")
def export(
    source: str,
    format_name: str,
    out: Path,
    is_verified: bool,
    size_px: tuple[int, int] | None,
    cameras: str,
    workers: int,
) -> None:
    """Convert a data set (DIR), one split (DIR/train) or one sample (DIR/train:00000017) to the format of Apollo
    Sim-3D, OpenLane, ONCE-3DLanes, tuSimple, CULane, CurveLanes, OpenLane-V2, COCO or YOLO, to plain masks, or to an
    OpenDRIVE map of each scene.

    Rerun to resume, or to add samples generated since. OUT/README.md describes how splits were mapped,
    and which frames and lanes were left out and why.
    """
    from synth3dlanes.formats.export import FORMATS
    from synth3dlanes.formats.export import export as export_dataset
    from synth3dlanes.formats.summary import warnings
    from synth3dlanes.formats.verify import verify
    from synth3dlanes.formats.writing import PARTS

    with progress_bar("frames") as move:
        names = [name for name in cameras.split(",") if name]
        summary = export_dataset(source, out, format_name, workers, move, size_px, names)
    frames = ", ".join(f"{summary.n_frames[part]} {part}" for part in PARTS)
    foreign = FORMATS[format_name]
    click.echo(f"{out}: {frames} frames, {summary.n_lines} {foreign.counted}")
    for reason, count in summary.left_out.items():
        click.echo(f"left out {count} frames: {reason}")
    for warning in warnings(out, foreign, summary):
        click.echo(f"warning: {warning}", err=True)
    if is_verified:
        results = verify(out, format_name, most_frames=500)
        for result in results:
            click.echo(f"{result.name}: {result.n_frames} frames, {result.n_lines} {foreign.counted}")
            for label, score in (("ground truth", result.perfect), ("moved", result.shifted)):
                if score:
                    click.echo(f"  {label}: " + "  ".join(f"{key} {value:.4f}" for key, value in score.items()))
        problems = [problem for result in results for problem in result.problems]
        if problems:
            raise click.ClickException("\n".join(problems))
