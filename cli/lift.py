"""`synth3dlanes lift`: real drives in, 3D lanes out."""

import json
from dataclasses import asdict
from typing import Any

import click

from synth3dlanes.system.words import counted

from .options import json_option, progress_bar, split_option


class Precisions(click.ParamType):
    """Names and numbers, as in lanes_px=1,pose_m=0.05."""

    name = "name=number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> dict[str, float]:
        found: dict[str, float] = {}
        for part in filter(None, map(str.strip, str(value).split(","))):
            name, _, number = part.partition("=")
            if name in found:
                self.fail(f"expected {name} once, got it twice", param, ctx)
            try:
                found[name] = float(number)
            except ValueError:
                self.fail(f"expected NAME=NUMBER, got {part!r}", param, ctx)
        return found


@click.command()
@click.argument("drive", metavar="DRIVE")
@click.option(
    "--out", metavar="DIR", required=True, help="The data set to make: a folder or a URL such as s3://lanes/v1."
)
@split_option
@click.option("--camera", metavar="NAME", default="", help="Which camera of the drive. Default: its front camera.")
@click.option("--lanes", metavar="FILE", default="", help="2D lanes of its images (docs/drives.md).")
@click.option("--marked", metavar="FILE", default="", help="Lanes marked in its top view (docs/drives.md).")
@click.option("--review", metavar="FILE", default="", help="Verdicts on what was lifted before (docs/drives.md).")
@click.option(
    "--around",
    type=click.IntRange(1, 1000),
    default=50,
    help="Frames before and after each whose scans and lanes are used.",
)
@click.option(
    "--precision",
    metavar="NAME=NUMBER,...",
    type=Precisions(),
    default="",
    help="How exact the drive is, as standard deviations: lanes_px, pose_m, pose_deg, calibration_m, calibration_deg, "
    "marked_m.",
)
@click.option("--unchecked", is_flag=True, help="Lift the drive even if its times, poses, points or lanes look wrong.")
@json_option
def lift(
    drive: str,
    out: str,
    split: str,
    camera: str,
    lanes: str,
    marked: str,
    review: str,
    around: int,
    precision: dict[str, float],
    unchecked: bool,
    as_json: bool,
) -> None:
    """Lift the lanes of a real drive into 3D: a data set with its images and their measured lanes.

    DRIVE is a folder of KITTI (raw or odometry), a log of Argoverse 2, a file drive.yaml, or a clip of a data set with
    a lidar (DIR/train:0). Its lanes are lines in its images, or are marked once in its top view. Every point says how
    certain it is. Rerun to resume.
    """
    from synth3dlanes.api import check_drive, lift_drive, open_drive
    from synth3dlanes.system.errors import InputError

    opened = open_drive(drive, camera=camera, lanes=lanes, marked=marked, review=review)
    if not unchecked:
        try:
            check_drive(opened)
        except InputError as error:
            raise InputError(*error.problems, "--unchecked lifts the drive all the same") from None
    for note in opened.notes:
        click.echo(note, err=True)
    with progress_bar("frames") as move:
        report = lift_drive(opened, out, split=split, precision=precision, around=around, progress=move)
    for name in report.not_found:
        click.echo(f"{review}: no lane lies where {name} was rejected: the verdict is out of date", err=True)
    if as_json:
        click.echo(json.dumps(asdict(report)))
        return
    lost = f", {counted(report.frames_without_lanes, 'frame')} without any" * (report.frames_without_lanes > 0)
    click.echo(f"{out}/{split}: {counted(report.frames, 'frame')}, {counted(report.lanes, 'lane')}{lost}")
    if report.lateral_std_m is not None and report.height_std_m is not None:
        click.echo(
            f"up to 40 m ahead, standard deviations in the middle: {100 * report.lateral_std_m:.1f} cm across, "
            f"{100 * report.height_std_m:.1f} cm in height"
        )
