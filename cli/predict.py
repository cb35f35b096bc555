"""`synth3dlanes predict`, `onnx`: use a trained network."""

from pathlib import Path

import click

from .networks import (
    INTRINSICS,
    SHIPPED,
    WEIGHTS,
    CheckpointPath,
    camera_intrinsics,
    device_option,
    need_torch,
    own_model_option,
)
from .options import FiniteRange, OutputFile, patience, progress_bar, refuse_idle


def is_checkpoint(what: str) -> bool:
    """Whether a word looks like a checkpoint."""
    return what in SHIPPED or what.endswith(".pt")


@click.command()
@click.argument(
    "what", metavar="[CHECKPOINT] DIR[/SPLIT[:KEY]]|IMAGE|FOLDER|VIDEO", nargs=-1, required=True, type=CheckpointPath()
)
@click.option(
    "--out",
    default="predictions",
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
    help="Least confidence of the lanes in the pictures; the file has all.",
)
@click.option(
    "--overlays",
    type=click.IntRange(min=0),
    default=16,
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
    if checkpoint is not None and is_checkpoint(source) and not is_checkpoint(checkpoint):
        raise click.UsageError(f"expected the checkpoint first; did you mean {source} {checkpoint}?")
    detector = detector_for(source, checkpoint, device, own_model)
    config = PredictConfig(camera_intrinsics(intrinsics), overlays, threshold, video, smooth)
    with progress_bar("images") as move:
        summary = run(detector, source, out, config, move)
    click.echo(summary.text())


@click.command()
@click.argument("checkpoint", metavar=f"CHECKPOINT|{WEIGHTS}", type=CheckpointPath())
@click.argument("path", metavar="FILE.onnx", type=OutputFile(".onnx"))
@click.option(
    "--int8",
    "calibration",
    metavar="DIR[/SPLIT]|FOLDER",
    help="Quantise the convolutions to int8, with ranges from the images of this split or folder.",
)
def onnx(checkpoint: str, path: Path, calibration: str | None) -> None:
    """Export the network of a checkpoint to ONNX: inputs image and intrinsics; outputs x_m, z_m, score and pose."""
    need_torch()
    from synth3dlanes_baseline.onnx_export import export_onnx

    with patience("exporting"):
        exported = export_onnx(checkpoint, path, calibration)
    click.echo(exported)
