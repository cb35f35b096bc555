"""Options that several commands share."""

import math
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from synth3dlanes.production.events import duration
from synth3dlanes.scene.settings import DEVICES, MAX_SEED, PASSES, QUALITY_SAMPLES, SPLIT_NAME
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import Folder

from .idle import refuse_idle, refuse_idle_keys, refuse_repeated

if TYPE_CHECKING:
    from synth3dlanes.params.params import Params
    from synth3dlanes.params.shots import Shots
    from synth3dlanes.scene.assets.catalogue import Library

    from .console import OutputConsole


# Seconds between lines of progress where stderr is no terminal.
LINE_EVERY_S = 30.0


class Names(click.ParamType):
    """A comma-separated choice of names, or `all`."""

    name = "names"

    def __init__(self, known: tuple[str, ...]) -> None:
        self.known = known

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Split and check, in the order of the known names."""
        if isinstance(value, tuple):
            return value
        if value.strip() == "all":
            return self.known
        names = [name.strip() for name in value.split(",") if name.strip()]
        for name in names:
            if name not in self.known:
                self.fail(f"{name!r} is not one of {', '.join(self.known)}.", param, ctx)
        return tuple(name for name in self.known if name in names)


class FileName(click.ParamType):
    """A name that can be a folder's: letters, digits, `_` and `-`."""

    name = "name"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Check it."""
        if re.fullmatch(SPLIT_NAME, value) is None:
            self.fail(f"expected letters, digits, _ or -, got {value!r}", param, ctx)
        return str(value)


class CountRange(click.IntRange):
    """A whole number, also as 1e3 or 300_000."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Read it."""
        found = re.fullmatch(r"(\d{1,9})(?:\.0*)?e\+?(\d)", str(value), re.IGNORECASE)
        return int(super().convert(int(found[1]) * 10 ** int(found[2]) if found else value, param, ctx))


class Workers(click.ParamType):
    """A number of processes, or auto for one per core (0)."""

    name = "workers"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Read it."""
        if value == "auto":
            return 0
        if re.fullmatch("0*[1-9][0-9]{0,8}", str(value)):
            return int(value)
        self.fail(f"expected auto or a positive number, got {value!r}", param, ctx)


class FiniteRange(click.FloatRange):
    """A finite number in a range; click's own takes NaN."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Check it."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"expected a finite number, got {value!r}", param, ctx)
        return number


class OutputFile(click.ParamType):
    """A file to write, in a folder that exists, with one of these suffixes."""

    name = "path"

    def __init__(self, *suffixes: str) -> None:
        self.suffixes = suffixes

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Check it, before any work."""
        path = Path(value)
        if path.suffix.lower() not in self.suffixes:
            self.fail(f"{value}: expected a name that ends in {' or '.join(self.suffixes)}", param, ctx)
        if path.is_dir() or not path.absolute().parent.is_dir():
            self.fail(f"{value}: expected a file in a folder that exists", param, ctx)
        try:
            Folder(path.parent).expect_file(path.name)
        except InputError as error:
            self.fail(str(error), param, ctx)
        if not os.access(path if path.exists() else path.absolute().parent, os.W_OK):
            self.fail(f"{value}: cannot be written", param, ctx)
        return path


Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def completing(kind: str = "") -> Completer:
    """Completion by the names of presets of a kind, and by files."""

    def complete(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
        from synth3dlanes.params.params import preset_names

        names = [name for name in preset_names(kind) if name.startswith(incomplete)]
        return [
            *map(CompletionItem, names),
            *([] if names and incomplete else [CompletionItem(incomplete, type="file")]),
        ]

    return complete


params_option = click.option(
    "--params",
    "source",
    metavar="FILE",
    default="appendix_i",
    shell_complete=completing(),
    help="Parameters: a YAML file or the name of a preset (`list presets`).",
)
set_option = click.option(
    "--set",
    "changes",
    metavar="GROUP.KEY=VALUE",
    multiple=True,
    callback=refuse_repeated,
    help="Change one parameter, such as light.exposure=3; repeatable.",
)


def _checked_seed(_: click.Context, __: click.Parameter, seed: int) -> int:
    if seed > MAX_SEED:
        raise click.BadParameter("expected at most 2**128")
    return seed


seed_option = click.option(
    "--seed", type=click.IntRange(min=0), default=0, callback=_checked_seed, help="Random seed of the data set."
)
split_option = click.option(
    "--split",
    metavar="NAME",
    type=FileName(),
    default="train",
    help="Name of the split. Splits of other names have other scenes.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
QUALITY = "synth3dlanes.quality"
# Parameters that a file of --camera or --rig has in place of those of the scene: all but the host's place on the road.
KEYS_OF_CAMERA_FILES = (
    *("camera.height_m", "camera.pitch_deg", "camera.width_px", "camera.height_px", "camera.horizontal_fov_deg"),
    *("camera.roll_deg", "camera.principal_offset_px"),
)
# Parameters of what a given map has itself.
KEYS_OF_ROADS = (
    *("road.", "town.", "town_streets.", "mountain.", "symbols.", "roadside.", "structures."),
    *("camera.lane", "camera.y_m", "cars.parked"),
)
Command = TypeVar("Command", bound=Callable[..., Any])


def _number_of_samples(context: click.Context, param: click.Parameter, value: int | None) -> int:
    quality = context.meta[QUALITY]
    if value is not None and context.get_parameter_source("quality") is not ParameterSource.DEFAULT:
        raise click.BadParameter(f"--samples {value} and --quality {quality} exclude each other", context, param)
    return value or QUALITY_SAMPLES[quality]


def samples_option(command: Command) -> Command:
    """`--quality`, and `--samples` for any other number; the command gets the number as `samples`."""
    levels = ", ".join(f"{name} {samples}" for name, samples in QUALITY_SAMPLES.items())
    number = click.option(
        "--samples",
        metavar="K",
        type=click.IntRange(min=1),
        callback=_number_of_samples,
        help="Samples per pixel, in place of --quality.",
    )
    level = click.option(
        "--quality",
        type=click.Choice(list(QUALITY_SAMPLES)),
        default="standard",
        is_eager=True,
        expose_value=False,
        callback=lambda ctx, _, value: ctx.meta.__setitem__(QUALITY, value),
        help=f"Samples per pixel: {levels}.",
    )
    return level(number(command))


RENDERERS = "one per core and GB of memory that may be used, or up to four per GPU."
READERS = "one per core, fewer for few samples."


def workers_option(auto: str) -> Callable[[Command], Command]:
    """`--workers`, with what it is by default in words."""
    return click.option(
        "--workers", metavar="N|auto", type=Workers(), default="auto", help=f"Worker processes. auto: {auto}"
    )


passes_option = click.option(
    "--passes",
    type=Names(PASSES),
    default="",
    metavar="NAMES",
    help=f"Extra images to write as OpenEXR, separated by commas, or all: {', '.join(PASSES)}.",
)
lidar_option = click.option(
    "--lidar",
    metavar="FILE",
    shell_complete=completing("lidars"),
    help="Lidar on the host: a YAML file or the name of a ready one (`list lidars`, docs/lidar.md).",
)


def clip_options(command: Command) -> Command:
    """`--frames` and `--fps`."""
    frames = click.option(
        "--frames",
        type=click.IntRange(min=1),
        default=1,
        help="Frames of each scene: with 20, samples 0 to 19 are a clip of scene 0 (docs/clips.md).",
    )
    fps = click.option(
        "--fps", type=FiniteRange(min=0, min_open=True), default=10.0, help="Frames per second of clips."
    )
    return frames(fps(command))


device_option = click.option("--device", type=click.Choice(DEVICES), default="auto", help="Device to render on.")
camera_option = click.option(
    "--camera",
    metavar="FILE|NAME",
    shell_complete=completing("cameras"),
    help="Your camera instead of that of the parameters: a YAML file, also of OpenCV or Kalibr, or the name of a "
    "ready one (`list cameras`, docs/camera.md).",
)
rig_option = click.option(
    "--rig",
    metavar="FILE|NAME",
    shell_complete=completing("rigs"),
    help="Several cameras that see every scene: a YAML file, or the name of a ready rig (`list rigs`, docs/camera.md).",
)
assets_option = click.option(
    "--assets",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Folder of your own cars, trees, textures and skies (docs/assets.md).",
)


def output_console(*, stderr: bool = False, soft_wrap: bool = False) -> "OutputConsole":
    """Where tables are printed."""
    from .console import OutputConsole

    return OutputConsole(stderr=stderr, soft_wrap=soft_wrap)


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[int, int | None], None]]:
    """A function of (done, total) that moves a bar on stderr, or prints a line there now and then where it is no
    terminal; a command that is refused before shows none. A total that is not known is None."""
    if not sys.stderr.isatty():
        yield _lines(label)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    bar = Progress(label, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=Console(stderr=True))
    task = bar.add_task("", total=None)
    with ExitStack() as stack:

        def move(done: int, total: int | None) -> None:
            if not bar.live.is_started:
                stack.enter_context(bar)
            bar.update(task, completed=done, total=total)

        yield move


def _lines(label: str) -> Callable[[int, int | None], None]:
    began = printed = time.monotonic()

    def move(done: int, total: int | None) -> None:
        nonlocal printed
        now = time.monotonic()
        if now - printed > LINE_EVERY_S and done != total:
            printed = now
            of = "" if total is None else f"/{total}"
            left = f", {duration((now - began) * (total - done) / done)} left" if total and done else ""
            click.echo(f"{done}{of} {label}{left}", err=True)

    return move


@contextmanager
def patience(what: str) -> Iterator[None]:
    """Print a line on stderr now and then, for work that cannot tell how far it is."""
    over, began = threading.Event(), time.monotonic()

    def tell() -> None:
        while not over.wait(LINE_EVERY_S):
            click.echo(f"{what}, {duration(time.monotonic() - began)} so far", err=True)

    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def open_assets(folder: Path | None) -> "Library":
    """Check the folder of `--assets`; warnings go to stderr."""
    from synth3dlanes.production.user_assets import open_library

    library, warnings = open_library(folder)
    for warning in warnings:
        click.echo(f"--assets {folder}: {warning}", err=True)
    return library


def open_params(source: str, changes: Sequence[str], library: "Library") -> "Params":
    """What `--params` and `--set` say; what does not fit each other is said on stderr."""
    from synth3dlanes.params.params import load_params
    from synth3dlanes.params.params_text import contradictions

    params = load_params(source, changes, library.assets)
    for line in contradictions(params):
        click.echo(line, err=True)
    return params


def open_shots(camera: str | None, rig: str | None, frames: int, fps: float, lidar: str | None = None) -> "Shots":
    """What `--camera` or `--rig`, `--frames` and `--fps`, and `--lidar` say."""
    from synth3dlanes.params.camera_files import load_camera
    from synth3dlanes.params.lidar_files import load_lidar
    from synth3dlanes.params.rig_files import load_rig
    from synth3dlanes.params.shots import clips

    if camera is not None and rig is not None:
        raise click.UsageError("--camera and --rig exclude each other; a rig's file names its cameras.")
    refuse_idle(frames > 1, ["fps"], "without --frames of 2 or more")
    cameras = load_rig(rig) if rig is not None else () if camera is None else (load_camera(camera),)
    return clips(frames, fps, cameras).model_copy(update={"lidar": load_lidar(lidar) if lidar else None})


def refuse_idle_changes(changes: Sequence[str], shots: "Shots") -> None:
    """Refuse changes of parameters that these shots do not use."""
    refuse_idle_keys(not shots.cameras, changes, KEYS_OF_CAMERA_FILES, "with --camera or --rig, whose files have it")
    refuse_idle_keys(shots.frames > 1, changes, ["motion."], "without --frames of 2 or more")
