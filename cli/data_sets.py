"""`synth3dlanes info`, `split` and `merge`: whole data sets."""

import json
import re
from dataclasses import asdict
from typing import Any

import click

from synth3dlanes.scene.settings import SPLIT_NAME
from synth3dlanes.system.words import counted

from .options import json_option, output_console

# Thirds may be written as 0.33.
SUM_TOLERANCE = 0.015


class Shares(click.ParamType):
    """Names of new splits and the share of each, as in train=0.8,val=0.2 or, by whole numbers, train=4,val=1."""

    name = "shares"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> dict[str, float]:
        shares: dict[str, float] = {}
        for part in str(value).split(","):
            found = re.fullmatch(rf"({SPLIT_NAME})=([0-9]*\.?[0-9]+)", part.strip())
            if found is None or found[1] in shares or float(found[2]) <= 0:
                self.fail(f"expected different NAME=SHARE with shares above 0, got {part!r}", param, ctx)
            shares[found[1]] = float(found[2])
        is_weights = all(share.is_integer() for share in shares.values())
        if not is_weights and abs(sum(shares.values()) - 1) > SUM_TOLERANCE:
            self.fail(f"expected shares whose sum is 1, got {sum(shares.values()):g}", param, ctx)
        return shares


@click.command()
@click.argument("folder", metavar="DIR")
@json_option
def info(folder: str, as_json: bool) -> None:
    """Summarise a data set (DIR) or one split (DIR/train).

    Prints the recipe with its preset, image sizes, cameras and frames, and for each split its samples, its size and
    whether it is complete.
    """
    from rich.table import Table

    from synth3dlanes.dataset.info import dataset_info

    found = dataset_info(folder)
    if as_json:
        click.echo(json.dumps(asdict(found)))
        return
    recipe = found.recipe
    passes = ", ".join(recipe["render"]["passes"]) or "none"
    click.echo(f"{folder}: synth3dlanes {recipe['generator']}, seed {recipe['seed']}, {recipe['image_format']}")
    click.echo(
        f"{counted(recipe['render']['samples'], 'sample')} per pixel on {recipe['render']['device']}, passes: {passes}"
    )
    is_clips = found.frames_per_scene > 1
    clip = (
        f"; {counted(found.frames_per_scene, 'frame')} per scene, {found.frames_per_second:g} per second"
        if is_clips
        else ""
    )
    cameras = f", cameras {', '.join(found.cameras)}" if found.cameras else ""
    sizes = f": {', '.join(found.image_sizes)} px" if found.image_sizes else ""
    click.echo(f"{found.preset}{sizes}{cameras}{clip}")
    if "where" in recipe:
        click.echo(f"where {recipe['where']}")
    if "derived" in recipe:
        click.echo(f"derived: {json.dumps(recipe['derived'])}")
    table = Table(box=None, padding=(0, 2, 0, 0))
    for name in ("split", "asked for", "there", "in progress", "set aside", "shards", "MB", ""):
        table.add_column(name, justify="left" if name in ("split", "") else "right")
    for split in found.splits:
        numbers = (split.asked, split.joined, split.waiting, split.set_aside, split.shards, f"{split.bytes / 1e6:.1f}")
        table.add_row(split.name, *map(str, numbers), "complete" if split.complete else "incomplete")
    output_console(soft_wrap=True).print(table)


@click.command()
@click.argument("folder", metavar="DIR[/SPLIT]")
@click.option("--out", metavar="DIR", required=True, help="The new data set: a folder or a URL such as s3://lanes/v1.")
@click.option(
    "--into",
    metavar="SHARES",
    type=Shares(),
    default="train=0.8,val=0.1,test=0.1",
    help="Names of the new splits and the share of samples in each.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Seed of the random assignment.")
def split(folder: str, out: str, into: dict[str, float], seed: int) -> None:
    """Divide an existing split at random into new splits.

    Samples are copied unchanged and renumbered from 0. Clips stay whole. To generate a validation or test split with
    new scenes, use `generate --split val` instead. Rerun to resume.
    """
    from synth3dlanes.api import split_dataset

    _tell(out, split_dataset(folder, out, into, seed=seed))


@click.command()
@click.argument("folders", metavar="DIR...", nargs=-1, required=True)
@click.option("--out", metavar="DIR", required=True, help="The new data set: a folder or a URL such as s3://lanes/v1.")
def merge(folders: tuple[str, ...], out: str) -> None:
    """Merge data sets that were made from the same recipe, such as parts made on several machines with --part.

    Samples keep their numbers, and no sample may occur in two of the data sets. Shards are hard-linked instead of
    copied where the file system allows it. Rerun to resume.
    """
    from synth3dlanes.api import merge_datasets

    _tell(out, merge_datasets(folders, out))


def _tell(out: str, counts: dict[str, int]) -> None:
    for name, count in counts.items():
        click.echo(f"{out}/{name}: {counted(count, 'sample')}")
