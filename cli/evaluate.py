"""`synth3dlanes evaluate`: score a network, or what it predicted."""

import json
from pathlib import Path
from typing import Literal

import click

from synth3dlanes.system.errors import InputError

from .networks import (
    INTRINSICS,
    WEIGHTS,
    CheckpointPath,
    camera_intrinsics,
    device_option,
    need_torch,
    own_model_option,
)
from .options import FiniteRange, json_option, progress_bar, refuse_idle, refuse_together

OF_NETWORKS = ("checkpoint", "own_model", "device", "threshold", "frame", "plots", "intrinsics", "lane_masks")


@click.command()
@click.argument("source", metavar="DIR[/SPLIT[:KEY]]|FOLDER|EXPORT")
@click.option(
    "--checkpoint",
    metavar=f"FILE|{WEIGHTS}",
    type=CheckpointPath(),
    help="Trained network to score; nano, compact and streets are in this package (docs/models.md).",
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
    help="Confidence at which errors are measured; AP does not depend on it.",
)
@click.option(
    "--frame",
    type=click.Choice(["camera", "road_raw"]),
    default="camera",
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

        photographs, camera = images.open_photographs(source, lane_masks), camera_intrinsics(intrinsics)
        if camera is None:
            raise InputError(f"{source}: expected --intrinsics FX,FY,CX,CY of its camera, got none")
        if predictions is not None:
            found = images.evaluate_predictions(predictions, photographs, camera, threshold)
        elif checkpoint is not None:
            from synth3dlanes_baseline.checkpoint import detector
            from synth3dlanes_baseline.devices import choose_device

            network = detector(checkpoint, choose_device(device), own_model)
            with progress_bar("images") as move:
                found = images.evaluate_detector(network, photographs, camera, threshold, move)
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
        with progress_bar("images") as move:
            report = scoring.evaluate_checkpoint(checkpoint, source, config, device, own_model, move)
    if plots is not None:
        reporting.save_plots(report, plots)
    samples = reporting.samples_document(report)
    document = {"source": split_of(source), **reporting.to_document(report), "samples": samples}
    click.echo(json.dumps(document) if as_json else reporting.to_text(report))
