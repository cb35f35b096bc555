"""What the commands of the bundled baseline share: its options, and torch loaded or asked for."""

import gc
import importlib
import importlib.util
import os
import sys
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from synth3dlanes.system.errors import InputError, MissingPackageError, how_to_install

own_model_option = click.option(
    "--model",
    "own_model",
    metavar="MODULE:FUNCTION",
    help="The network of your own that the checkpoint was trained with.",
)
# The weights in the package, and what each is for.
SHIPPED = {
    "nano": "scenes of the paper's ranges, on a CPU, and as a start for training",
    "compact": "scenes of the paper's ranges, where five times the cost of nano is no hindrance",
    "streets": "photographs; predict takes it for image files",
}
WEIGHTS = "|".join(SHIPPED)
INTRINSICS = "FX,FY,CX,CY|FILE"
device_option = click.option("--device", default="auto", help="Device to run on: auto, cpu or cuda.")


class CheckpointPath(click.ParamType):
    """A file, or the name of weights in the package; the library looks for it."""

    name = "checkpoint"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        names = [CompletionItem(name) for name in SHIPPED if name.startswith(incomplete)]
        return [*names, CompletionItem(incomplete, type="file")]


def need_torch() -> None:
    """Load torch, or say how to install it."""
    # OpenMP's threads spin while they wait for each other. On cores that others use as well, a training step took
    # 4.8 s with spinning and 0.4 s without; on idle cores it makes no difference. Read when torch is first loaded.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    if importlib.util.find_spec("torch") is None:
        raise MissingPackageError(f"PyTorch is not installed: {how_to_install('train')}")
    if "torch" not in sys.modules:
        # Nothing that an import makes is garbage: looking for some takes a tenth of the time that torch takes.
        gc.disable()
        importlib.import_module("torch")
        gc.freeze()
        gc.enable()


def camera_intrinsics(text: str | None) -> tuple[float, float, float, float] | None:
    """Numbers as FX,FY,CX,CY, or those of a calibration file."""
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
