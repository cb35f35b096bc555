"""`synth3dlanes benchmark`: make a named benchmark, check that it is the same for everybody, and score on it."""

import json
from pathlib import Path
from typing import Any

import click

from .generate import progress
from .networks import WEIGHTS, CheckpointPath, need_torch
from .options import RENDERERS, JobCommand, given, job_options, json_option, progress_bar, refuse_together


@click.command(cls=JobCommand)
@click.argument("source", metavar="NAME|FILE")
@click.option("--out", metavar="DIR", required=True, help="The data set: a folder or a URL such as s3://lanes/hills.")
@click.option("--train", "is_training", is_flag=True, help="Make the images for training and validation too.")
@click.option(
    "--checkpoint",
    metavar=f"FILE|{WEIGHTS}",
    type=CheckpointPath(),
    help="Trained network to score on the test images.",
)
@click.option(
    "--predictions",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Predictions to score, as written by predict (JSON lines).",
)
@job_options("workers", workers=RENDERERS)
@json_option
@click.pass_context
def benchmark(
    ctx: click.Context,
    /,
    source: str,
    out: str,
    is_training: bool,
    checkpoint: str | None,
    predictions: Path | None,
    as_json: bool,
    **fields: Any,
) -> None:
    """Make a benchmark (clips, exits, hills, weather, or a file of your own), check that its labels equal
    everybody else's, and score a network on its test images.

    Rerun to resume. docs/benchmarks.md has the benchmarks and the scores of the networks in this package.
    """
    from synth3dlanes.production.benchmarks import load_benchmark
    from synth3dlanes.production.job import make

    refuse_together("checkpoint", "predictions")
    found = load_benchmark(source)
    document: dict[str, Any] = {"benchmark": Path(source).stem, "splits": {}}
    for split in found.splits if is_training else ["test"]:
        with progress() as notify:
            report = make(found.job(split, out).changed(given(fields)), notify)
        problems = [report.problem] if report.exit_code else list(found.problems(split, out))
        if problems:
            click.echo("\n".join(problems), err=True)
            ctx.exit(report.exit_code or 1)
        document["splits"][split] = vars(found.splits[split])
        if not as_json:
            compared = "equal to everybody else's" if found.splits[split].labels else "not compared: it fixes no digest"
            click.echo(f"{out}/{split}: {report.done} samples, labels {compared}")
    if checkpoint is not None or predictions is not None:
        document["score"], text = _score(f"{out}/test", checkpoint, predictions)
        if not as_json:
            click.echo(text)
    if as_json:
        click.echo(json.dumps(document))


def _score(source: str, checkpoint: str | None, predictions: Path | None) -> tuple[dict[str, Any], str]:
    need_torch()
    from synth3dlanes_baseline import report as reporting
    from synth3dlanes_baseline.evaluate import evaluate_checkpoint, evaluate_predictions

    if predictions is not None:
        report = evaluate_predictions(predictions, source)
    else:
        assert checkpoint is not None
        with progress_bar("images") as move:
            report = evaluate_checkpoint(checkpoint, source, progress=move)
    return reporting.to_document(report), reporting.to_text(report)
