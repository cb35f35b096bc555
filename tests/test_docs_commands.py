"""Every command and every Python example of the pages runs, in its page's order and folder, and prints what they say.

What is made smaller: `small` says. What is only parsed stands under `<!-- not run: why -->` in the page. Blocks under
`<!-- file NAME -->` are files of docs/, which test_docs.py runs; docs/loaders.md has tests/formats's own test.
Inline commands have placeholders, so there only names and options are looked up.
"""

import contextlib
import io
import re
import shlex
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from tests.thorough import first

ROOT = Path(__file__).parents[1]
GENERATED = ("cli.md", "params.md", "decisions.md")
PAGES = [ROOT / "README.md", *sorted(page for page in (ROOT / "docs").glob("*.md") if page.name not in GENERATED)]
# Those that `make test` runs. Of the others it looks up the commands and their options.
FIRST = [ROOT / "README.md"]
BLOCK = re.compile(r"(?:<!-- (not run|file)[ :]*(.*?) -->\n)?^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# Programs that prepare machines: of these lines only our own part is looked at.
FOREIGN = (".", "cd", "docker", "hf", "pip", "python", "torchrun")


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text, and how it is marked (with why, or the file)."""

    mark: str
    why: str
    language: str
    text: str

    def lines(self) -> list[list[str]]:
        """The words of every command, without comments."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [found for found in (shlex.split(line, comments=True) for line in lines) if found]


def name_of(page: Path) -> str:
    return page.name


def blocks(page: Path) -> list[Block]:
    return [Block(*found) for found in BLOCK.findall(page.read_text())]


def small(words: list[str]) -> list[str]:
    """The same command at a size for tests: two scenes of 96x72 pixels with little in them, rendered in draft;
    one pass of training.

    Shards hold one scene (`shards_of_one`), so that parts of so little have something to do.
    """
    words = [re.sub(r":0*(3|17)$", ":1", word) for word in words]
    for i, word in enumerate(words[:-1]):
        if word == "--n":
            words[i + 1] = "2"
        if word == "--model":
            words[i + 1] = "tiny"
    # A job file has its own parameters.
    is_of_job = words[2].endswith((".yaml", ".json")) if len(words) > 2 else False
    if words[1] == "generate" and not is_of_job:
        height_px = 54 if "apollo_camera" in words else 72
        size = {"camera.width_px": 96, "camera.height_px": height_px}
        changes = {**({} if {"--camera", "--rig"} & {*words} else size), "trees.n": 4, "cars.n": 1}
        given = {word.partition("=")[0] for word in words}
        words += [word for name, value in changes.items() if name not in given for word in ("--set", f"{name}={value}")]
    if words[1] in ("generate", "twins"):
        words += ["--workers", "1"]
    if words[1] in ("generate", "render") and "--quality" not in words and not is_of_job:
        words += ["--samples", "1"]
    if words[1] == "train":
        words += ["--epochs", "1", "--batch", "1"]
    return words


def run_command(words: list[str]) -> None:
    from synth3dlanes_cli.main import main

    if words[0] == "make":
        return parse(words)
    assert words[0] == "synth3dlanes", f"{shlex.join(words)}: neither ours nor marked as not run"
    words, out = redirected(words)
    result = CliRunner().invoke(main, small(words)[1:])
    assert result.exit_code == 0, f"{shlex.join(words)}\n{result.output}{result.exception!r}"
    if out is not None:
        Path(out).write_text(result.stdout)


def redirected(words: list[str]) -> tuple[list[str], str | None]:
    """The command without `> FILE`, and that file."""
    return (words[:-2], words[-1]) if words[-2:-1] == [">"] else (words, None)


def parse(words: list[str]) -> None:
    """Check a command without running it."""
    from synth3dlanes_cli.main import main

    words, _ = redirected(words)
    if words[0] == "make":
        subprocess.run(["make", "-n", *words[1:]], cwd=ROOT, check=True, capture_output=True)
    elif words[0] == "ray":
        look_up(pytest.importorskip("ray.scripts.scripts").cli, words)
        for inner in filter(lambda word: word.startswith("synth3dlanes "), words):
            parse(shlex.split(inner))
    elif words[0] == "synth3dlanes":
        command, name, rest = find(main, words)
        command.make_context(name, rest).close()
    else:
        assert words[0] in FOREIGN, words


def find(group: click.Group, words: list[str]) -> tuple[click.Command, str, list[str]]:
    """The command that words name, and its arguments."""
    command, i = group.commands[words[1]], 2
    while isinstance(command, click.Group):
        command, i = command.commands[words[i]], i + 1
    return command, words[i - 1], words[i:]


def look_up(group: click.Group, words: list[str]) -> None:
    """Check the names of a command and of its options, and that options have their values."""
    command, name, rest = find(group, words)
    command.make_parser(click.Context(command, info_name=name)).parse_args(rest)


@pytest.fixture(scope="module", autouse=True)
def shards_of_one() -> Iterator[None]:
    from synth3dlanes.production.plan import Plan

    make = Plan.__init__
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Plan, "__init__", lambda self, *args, **named: make(self, *args, **{"shard_size": 1, **named}))
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the pages call `data`: four scenes, made as the pages make them."""
    folder = tmp_path_factory.mktemp("made")
    with contextlib.chdir(folder):
        run_command(["synth3dlanes", "generate", "--n=4", "--out", "data"])
    return folder / "data"


@pytest.mark.render
@pytest.mark.timeout(600)
@pytest.mark.parametrize("page", first(len(FIRST), sorted(PAGES, key=lambda page: page not in FIRST)), ids=name_of)
def test_a_page_runs(page: Path, made: Path, in_tmp_path: Path) -> None:
    found = blocks(page)
    for name in ("data", "demo/data"):
        shutil.copytree(made, name)
    names: dict[str, Any] = {}
    printed = ""
    for block in found if page.name != "loaders.md" else []:
        if block.mark == "file":
            continue
        if block.language == "sh":
            for words in block.lines():
                parse(words) if block.mark else run_command(words)
        elif block.language == "python" and block.mark:
            compile(block.text, page.name, "exec")
        elif block.language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as caught:
                exec(block.text, names)  # noqa: S102 - our own page
            printed = caught.getvalue()
        elif block.language == "text" and printed:
            assert printed == block.text
            printed = ""
        elif block.language == "sql":
            from synth3dlanes.dataset.query import rows_where

            rows_where(names["Reader"]("data/train").index, block.text.split("where", 1)[1].strip())


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_blocks_and_inline_commands(page: Path) -> None:
    from synth3dlanes_cli.main import main

    for block in blocks(page):
        command = re.search(r"^(synth3dlanes|make|ray|python) ", block.text, re.MULTILINE)
        assert not command or block.language in ("sh", "yaml", "python"), f"mark this block as sh:\n{block.text}"
        assert block.mark != "not run" or block.why, "say why it is not run"
        for words in block.lines() if block.language == "sh" else []:
            if words[0] == "synth3dlanes":
                look_up(main, redirected(words)[0])
    prose = BLOCK.sub("", page.read_text())
    for line in re.findall(r"`(synth3dlanes [^`]+)`", prose):
        words = shlex.split(line)
        look_up(main, words)
    for word in re.findall(r"`make (\w+)`", prose):
        parse(["make", word])
    for module in re.findall(r"python -m (\S+?)`", prose):
        path = ROOT / module.replace(".", "/")
        assert path.with_suffix(".py").exists() or (path / "__main__.py").exists()
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for named in re.findall(r"(?<=\.)\[([a-z,]+)\]", page.read_text()):
        assert set(named.split(",")) <= set(extras)
