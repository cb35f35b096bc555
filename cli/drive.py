"""`synth3dlanes drive`: check the files of a real drive; pages to mark lanes in its top view and to review frames."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import write
from synth3dlanes.system.words import counted

from .options import FiniteRange, OutputFile, json_option

if TYPE_CHECKING:
    from collections.abc import Iterator

    from synth3dlanes.dataset.read import Reader
    from synth3dlanes.recorded.drives.pages import ReviewedFrame, ReviewedSplit

camera_option = click.option(
    "--camera", metavar="NAME", default="", help="Which camera of the drive. Default: its front camera."
)
marked_option = click.option(
    "--marked", metavar="FILE", default="", help="Lanes marked in its top view: a GeoJSON file."
)


class FrameRange(click.ParamType):
    """First and last frame, as in 0:200; the last is left out."""

    name = "first:end"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> slice:
        first, colon, end = str(value).partition(":")
        if not colon or not all(part.isdecimal() and len(part) < 10 for part in (first or "0", end or "0")):
            self.fail(f"expected FIRST:END, as in 0:200, got {value!r}", param, ctx)
        return slice(int(first or 0), int(end) if end else None)


@click.group()
def drive() -> None:
    """Check real drives, mark lanes in their top views, review frames."""


@drive.command()
@click.argument("source", metavar="DRIVE")
@camera_option
@click.option("--lanes", metavar="FILE", default="", help="2D lanes of its images: tuSimple, CULane or our JSON.")
@marked_option
@json_option
@click.pass_context
def check(ctx: click.Context, source: str, camera: str, lanes: str, marked: str, as_json: bool) -> None:
    """List what a drive contains and what looks wrong in it; exits with 1 if anything does.

    DRIVE is a folder of KITTI (raw or odometry), a log of Argoverse 2, a file drive.yaml, or a clip of a data set with
    a lidar (DIR/train:0). Checked are its times, speed and heading, where the ground is, whether scans fit together,
    and whether lanes are on the ground ahead (docs/drives.md).
    """
    from synth3dlanes.recorded.drives.checks import drive_findings
    from synth3dlanes.recorded.drives.open import open_drive

    opened = open_drive(source, camera, lanes, marked)
    findings = drive_findings(opened)
    first, last = opened.frames[0], opened.frames[-1]
    held = {
        "name": opened.name,
        "frames": len(opened.frames),
        "seconds": round(last.time_s - first.time_s, 3),
        "camera": opened.camera.name,
        "image_px": [opened.camera.width_px, opened.camera.height_px],
        "marked_lanes": len(opened.marked),
        "notes": list(opened.notes),
        "findings": findings,
    }
    if as_json:
        click.echo(json.dumps(held))
    else:
        size = f"{opened.camera.width_px}x{opened.camera.height_px}"
        seen = f"camera {opened.camera.name or 'without a name'} of {size}"
        click.echo(f"{opened.name}: {counted(len(opened.frames), 'frame')} in {held['seconds']:g} s, {seen}")
        for line in (*opened.notes, *findings):
            click.echo(line)
        click.echo("nothing looks wrong" if not findings else f"{counted(len(findings), 'finding')}")
    ctx.exit(1 if findings else 0)


@drive.command()
@click.argument("source", metavar="DRIVE")
@click.option("--out", type=OutputFile(".html"), default="marking.html", help="HTML page to write.")
@camera_option
@marked_option
@click.option("--lifted", metavar="DIR/SPLIT", default="", help="Begin with the lanes that were lifted of it, too.")
@click.option("--frames", type=FrameRange(), default=":", help="Show what these frames saw.", show_default="all")
@click.option("--cell", "cell_m", metavar="METRES", type=FiniteRange(0.02, 2), default=0.1, help="Size of a pixel.")
def mark(source: str, out: Path, camera: str, marked: str, lifted: str, frames: slice, cell_m: float) -> None:
    """Write a page on which lanes are marked in the drive's top view.

    Open it in a browser, draw lines, and save them as a file; `lift --marked FILE` and `drive mark --marked FILE` read
    it. The page is one file that loads nothing. To correct lifted lanes, begin with them (`--lifted`).
    """
    from dataclasses import replace

    from synth3dlanes.dataset.read import Reader
    from synth3dlanes.recorded.drives.marks import lifted_marks
    from synth3dlanes.recorded.drives.open import open_drive
    from synth3dlanes.recorded.drives.pages import marking_page, top_view

    opened = open_drive(source, camera, marked=marked)
    if lifted:
        known = {lane.id for lane in opened.marked}
        more = (lane for lane in lifted_marks(Reader(lifted), opened) if lane.id not in known)
        opened = replace(opened, marked=(*opened.marked, *more))
    shown = opened.frames[frames]
    if not len(shown):
        raise InputError(f"frames: expected some of 0:{len(opened.frames)}, got none")
    view = top_view(opened, shown, cell_m)
    write(out, marking_page(opened, view).encode())
    click.echo(f"Page: {out}, {len(view.tiles) * view.tile_m**2:,.0f} m2 of ground")


@drive.command()
@click.argument("split", metavar="DIR/SPLIT")
@click.option("--out", type=OutputFile(".html"), default="review.html", help="HTML page to write.")
@click.option("--every", type=click.IntRange(min=1), default=1, help="Show every Nth frame.")
@click.option("--limit", type=click.IntRange(min=1), default=300, help="Most frames on the page.")
@click.option("--review", "before", metavar="FILE", default="", help="Verdicts to begin with.")
def review(split: str, out: Path, every: int, limit: int, before: str) -> None:
    """Write a page on which the frames of a split, and the lanes of a lifted drive, are accepted or rejected.

    Open it in a browser and save the verdicts as a file; `lift --review FILE` leaves out what was rejected, and `drive
    review --review FILE` goes on (docs/drives.md).
    """
    from synth3dlanes.dataset.read import Reader
    from synth3dlanes.recorded.drives.marks import read_review
    from synth3dlanes.recorded.drives.pages import review_page

    reader = Reader(split)
    known = read_review(Path(before)) if before else None
    chosen = range(0, len(reader), every)[:limit]
    write(out, review_page(_split_of(reader), _reviewed(reader, chosen), known).encode())
    click.echo(f"Page: {out}, {counted(len(chosen), 'frame')} of {len(reader)}")


def _split_of(reader: "Reader") -> "ReviewedSplit":
    from synth3dlanes.recorded.drives.pages import ReviewedSplit

    derived = reader.description.get("derived") or {}
    x, y, z = derived.get("origin_m", (0.0, 0.0, 0.0))
    return ReviewedSplit(reader.url, str(derived.get("lifted", "")), (float(x), float(y), float(z)))


def _reviewed(reader: "Reader", chosen: range) -> "Iterator[ReviewedFrame]":
    from synth3dlanes.recorded.drives.pages import ReviewedFrame

    for i in chosen:
        labels = reader.labels(i)
        yield ReviewedFrame(reader.key(i), counted(len(labels.lanes), "lane"), labels, reader.image(i))
