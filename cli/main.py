"""The group of all commands, and how errors are shown: one line per problem; exit code 2 where the user has to change
something first, 1 where running the same again later can help.

Imports nothing heavy: every command imports what it needs when it runs.
"""

import os
import re
import signal
import sys
from typing import IO, Any

import click
from click.exceptions import NoArgsIsHelpError

from synth3dlanes import __version__
from synth3dlanes.production.signals import StopSignal, handle, stop
from synth3dlanes.system.errors import (
    ClaimedError,
    InputError,
    OutageError,
    Synth3dlanesError,
    WorkerError,
    is_of_environment,
    told,
)

from .assets import assets
from .bench import bench
from .benchmark import benchmark
from .data_sets import info, merge, split
from .drive import drive
from .entry import NO_MEMORY, is_lack_of_memory
from .evaluate import evaluate
from .export import export
from .generate import generate
from .lift import lift
from .listing import list_names
from .look import clip, gallery, inspect, report
from .options import refuse_place
from .params import params
from .predict import onnx, predict
from .scenes import render, sample
from .stats import stats
from .train import ablation, train
from .twins import twins
from .validate import validate

# Commands that continue from what they have written.
RESUMED = ("generate", "twins", "split", "merge", "export", "lift", "benchmark", "train", "ablation")

# Where the words of the command line are kept.
WORDS = "synth3dlanes.words"

# Characters of a line.
MOST_SHOWN = 400


class BadInput(click.ClickException):
    """Problems that the user can fix, one per line."""

    exit_code = 2

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the problems and nothing else on stderr; what was given may be of any length."""
        click.echo("\n".join(map(_shortened, self.message.splitlines())), file=file, err=True)


class WorkFailure(BadInput):
    """Work that failed through no fault of the input; it may help to run it again."""

    exit_code = 1


class Commands(click.Group):
    """A group whose commands may raise the library's errors."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; bad input of any kind becomes BadInput."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stopped:
            command = f"{ctx.command_path} {ctx.invoked_subcommand}"
            click.echo(f"{command}: interrupted{'; rerun to resume' * (ctx.invoked_subcommand in RESUMED)}", err=True)
            ctx.exit(128 + (stopped.number if isinstance(stopped, StopSignal) else signal.SIGINT))
        except NoArgsIsHelpError:
            raise
        except click.UsageError as error:
            command = error.ctx.command_path if error.ctx else ctx.command_path
            raise BadInput(f"{command}: {error.format_message()}") from error
        except (InputError, OutageError) as error:
            flags, problems = self._flags(ctx), str(error).split("\n")
            raise _failure(error, "\n".join(_naming_flags(problem, flags) for problem in problems)) from error
        except Synth3dlanesError as error:
            raise _failure(error, str(error)) from error
        except (MemoryError, RuntimeError, ImportError) as error:
            if not is_lack_of_memory(error):
                raise
            raise WorkFailure(f"{ctx.command_path} {ctx.invoked_subcommand}: {NO_MEMORY}") from error
        except BrokenPipeError:
            # The program that reads the output, such as `head`, has closed it: what is still buffered is discarded.
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            ctx.exit(128 + signal.SIGPIPE)
        except OSError as error:
            raise _failure(error, told(error) if error.strerror else str(error)) from error

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; refuse empty arguments, which would stand for the working directory or for no file, and
        places that end with the command, or are not the home folder."""
        ctx.meta[WORDS] = {part for word in args for part in (word, word.partition("=")[2])}
        for before, word in zip(["", *args], args, strict=False):
            if not word or re.fullmatch("--[a-z0-9-]+=", word):
                after = (word or before).removesuffix("=")
                raise click.UsageError(f"expected no empty argument, got one after {after}: is a variable not set?")
            refuse_place(re.sub("^--[a-z0-9-]+=", "", word))
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands, each with the whole first sentence of its help."""
        with formatter.section("Commands"):
            names = self.list_commands(ctx)
            formatter.write_dl([(name, self.commands[name].get_short_help_str(limit=1000)) for name in names])

    def _flags(self, ctx: click.Context) -> dict[str, str]:
        """The flag for each value that the invoked command hands to the library."""
        command = self.commands.get(ctx.invoked_subcommand or "", self)
        flags = {param.name or "": param.opts[0] for param in command.params if isinstance(param, click.Option)}
        flags["overrides"] = "--set"
        # Where the user named a file so, a message may be about the file.
        return {name: flag for name, flag in flags.items() if name not in ctx.meta.get(WORDS, ())}


def _failure(error: Exception, text: str) -> BadInput:
    """How a command ends after an error."""
    can_pass = isinstance(error, (ClaimedError, OutageError, WorkerError)) or is_of_environment(error)
    return (WorkFailure if can_pass else BadInput)(text)


def _shortened(line: str) -> str:
    return line if len(line) <= MOST_SHOWN else f"{line[: MOST_SHOWN // 2]}[...]{line[-MOST_SHOWN // 4 :]}"


def _naming_flags(problem: str, flags: dict[str, str]) -> str:
    """A library's message may begin with the name of an argument, alone or before a value, or say what another one is
    of no use with; the user knows them as flags."""
    found = re.match(r"(?:\w+: expected none|[^:]*: no effect) (?:with|without|beside) (\w+)", problem)
    if found and found[1] in flags:
        problem = f"{problem[: found.start(1)]}{flags[found[1]]}{problem[found.end(1) :]}"
    name, rest = re.fullmatch(r"(\w*)(.*)", problem, re.DOTALL).groups()  # type: ignore[union-attr]
    return flags.get(name, name) + rest if rest[:1] in (":", " ", "") else problem


@click.group(
    "synth3dlanes", cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "show_default": True}
)
@click.version_option(__version__)
def main() -> None:
    """Generate synthetic road images with exact 3D lane labels; check, export and train on them."""


for command in (
    *(generate, sample, render, twins, inspect, gallery, clip, report, stats, info, split, merge, params, list_names),
    *(assets, export, lift, validate, bench, drive, benchmark, train, predict, evaluate, ablation, onnx),
):
    main.add_command(command)


def run() -> None:
    """The program: `main`, and an exit that does not wait for Blender, which may hang or crash in an orderly one."""
    handle(stop)
    try:
        main()
    except SystemExit as leaving:
        # Python, as it exits, would let a signal kill the process and replace its exit code.
        handle(signal.SIG_IGN)
        if "bpy" not in sys.modules or not isinstance(leaving.code, int):
            raise
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(leaving.code)


if __name__ == "__main__":
    run()
