"""Options that several commands share. Those that have no effect are refused: whoever gives one expects an effect."""

import math
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_origin

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from synth3dlanes.production.events import duration
from synth3dlanes.scene.settings import SPLIT_NAME
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import Folder

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from .console import OutputConsole


# Seconds between lines of progress where stderr is no terminal.
LINE_EVERY_S = 30.0


Command = TypeVar("Command", bound=Callable[..., Any])


class FileName(click.ParamType):
    """A name that can be a folder's: letters, digits, `_` and `-`."""

    name = "name"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if re.fullmatch(SPLIT_NAME, value) is None:
            self.fail(f"expected letters, digits, _ or -, got {value!r}", param, ctx)
        return str(value)


class CountRange(click.IntRange):
    """A whole number, also as 1e3 or 300_000."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        found = re.fullmatch(r"(\d{1,9})(?:\.0*)?e\+?(\d)", str(value), re.IGNORECASE)
        return int(super().convert(int(found[1]) * 10 ** int(found[2]) if found else value, param, ctx))


class Workers(click.ParamType):
    """A number of processes, or auto for one per core (0)."""

    name = "workers"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        if value == "auto":
            return 0
        if re.fullmatch("0*[1-9][0-9]{0,8}", str(value)):
            return int(value)
        self.fail(f"expected auto or a positive number, got {value!r}", param, ctx)


class FiniteRange(click.FloatRange):
    """A finite number in a range; click's own takes NaN."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
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


class FieldOption(click.Option):
    """Stands for the option that is made of a field of Job, until it is needed: Job takes half a second to load."""

    def __init__(self, names: Sequence[str], about: str = "") -> None:
        super().__init__(names)
        self.about = about

    def made(self) -> click.Option:
        """The option: its type, default and help are those of the field."""
        from synth3dlanes.production.job import Job, OptionForm

        name = str(self.name)
        field = Job.model_fields[name]
        flag = next((found for found in field.metadata if isinstance(found, OptionForm)), OptionForm())
        kinds = get_args(field.annotation)
        is_several = kinds[1:] == (...,) and get_origin(kinds[0]) is not Literal
        default = flag.default or field.get_default(call_default_factory=True)
        return click.Option(
            [*self.opts, name],
            metavar=flag.metavar,
            type=_click_type(field),
            multiple=is_several,
            default=None if default in ((), {}, "") else (default,) if is_several else default,
            callback=refuse_repeated if is_several else None,
            shell_complete=None if flag.presets is None else completing(flag.presets),
            help=self.about or field.description,
        )


def _click_type(field: "FieldInfo") -> click.ParamType:
    """The type of the values of a field; what is no number and no choice is text, which Job reads."""
    kinds = get_args(field.annotation) or (field.annotation,)
    bounds = {name: getattr(bound, name) for bound in field.metadata for name in ("ge", "gt") if hasattr(bound, name)}
    if field.annotation is float:
        return FiniteRange(min=bounds["gt"], min_open=True)
    if get_origin(field.annotation) is Literal:
        return click.Choice(kinds)
    is_count = int in kinds and "ge" in bounds
    return CountRange(min=bounds["ge"]) if is_count else click.STRING


class JobCommand(click.Command):
    """A command with options that are fields of Job."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """The parameters, with the options of Job's fields made."""
        self.params = [param.made() if isinstance(param, FieldOption) else param for param in self.params]
        return super().get_params(ctx)


def job_options(*fields: str, **abouts: str) -> Callable[[Command], Command]:
    """Options of these fields of Job, for a JobCommand; `abouts` has help of this command's own."""

    def decorated(command: Command) -> Command:
        for name in reversed(fields):
            flag = {"spreads": "spread"}.get(name, name).replace("_", "-")
            command = click.option(f"--{flag}", name, cls=FieldOption, about=abouts.get(name, ""))(command)
        return command

    return decorated


def given(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of Job that the user gave."""
    return {name: value for name, value in fields.items() if is_given(name)}


def refuse_idle(has_effect: object, names: Iterable[str], without: str) -> None:
    """Raise UsageError for each of these options that was given although it has no effect `without` something."""
    given = _given(names)
    if given and not has_effect:
        raise click.UsageError(f"{' and '.join(given)} {_verb(given)} no effect {without}.")


def refuse_together(*names: str) -> None:
    """Raise UsageError where two of these options were given: one would have no effect."""
    given = _given(names)
    if len(given) > 1:
        raise click.UsageError(f"{' and '.join(given)} exclude each other.")


def refuse_idle_keys(has_effect: object, changes: Iterable[str], keys: Iterable[str], without: str) -> None:
    """Raise UsageError for a change of a parameter that has no effect; of a group, all are meant by `group.`."""
    groups = tuple(key for key in keys if key.endswith("."))
    given = [change for change in changes if _key(change) in keys or (groups and _key(change).startswith(groups))]
    if given and not has_effect:
        raise click.UsageError(f"{', '.join(given)} {_verb(given)} no effect {without}.")


def refuse_repeated(context: click.Context, param: click.Parameter, changes: tuple[str, ...]) -> tuple[str, ...]:
    """The callback of an option that changes one value at a time: the first of two values would have no effect."""
    keys = [_key(change) for change in changes]
    for key in keys:
        if keys.count(key) > 1:
            raise click.BadParameter(f"expected one value for {key}, got {keys.count(key)}", context, param)
    return changes


def is_given(name: str) -> bool:
    """Whether the user gave this option of the command that runs."""
    source = click.get_current_context().get_parameter_source(name)
    return source not in (None, ParameterSource.DEFAULT, ParameterSource.DEFAULT_MAP)


def _given(names: Iterable[str]) -> list[str]:
    """The options among these that the user gave, as the user knows them."""
    params = click.get_current_context().command.params
    return [param.opts[0] for param in params if param.name in names and is_given(param.name)]


def _key(change: str) -> str:
    return change.partition("=")[0].strip()


def _verb(given: list[str]) -> str:
    return "have" if len(given) > 1 else "has"


def refuse_place(place: str) -> None:
    """Raise InputError for a place where nobody finds what is written there: a store in memory, which ends with the
    command, and a folder called ~, which a shell has not made the home folder."""
    if re.match(r"(\w+::)*memory://", place):
        raise InputError(f"{place}: expected a folder or a store that outlives the command, got one in its memory")
    if re.search(r"(^|/)~(/|$)", place):
        raise InputError(f"{place}: expected a path, got ~, which stands for the home folder in a shell alone")


def warn(line: str) -> None:
    """Tell on stderr what is usable but does not fit together."""
    click.echo(line, err=True)


set_option = click.option(
    "--set",
    "changes",
    metavar="GROUP.KEY=VALUE",
    multiple=True,
    callback=refuse_repeated,
    help="Change one parameter, such as light.exposure=3; repeatable.",
)
split_option = click.option(
    "--split",
    metavar="NAME",
    type=FileName(),
    default="train",
    help="Name of the split.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
RENDERERS = "Worker processes. auto: one per core and GB of memory that may be used, or up to four per GPU."
workers_option = click.option(
    "--workers",
    metavar="N|auto",
    type=Workers(),
    default="auto",
    help="Worker processes. auto: one per core, fewer for few samples.",
)


def output_console(*, stderr: bool = False, soft_wrap: bool = False) -> "OutputConsole":
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
