"""Whatever a command writes, replaces or removes below the folder that it was given: where a link lies in the way, what
the link points to stays as it is.

Each command runs once undisturbed; every path that it touched is noted, also those that are gone in the end. Then each
of them is a link to somebody's files when the command runs: in a new folder, and in one that it has written before.
"""

import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

import pytest
from click.testing import CliRunner, Result
from matplotlib.figure import Figure

from synth3dlanes.production import local, plan, render_file
from synth3dlanes.production.run import generate
from synth3dlanes.production.workers import Outcome, Pool
from synth3dlanes.system.errors import LinkError
from tests import fake_samples
from tests.thorough import first

REFUSING = ("expected", "cannot", "missing", "Is a directory")
RANDOM = 16  # hexadecimal digits of a name that nobody can foresee


@dataclass(frozen=True)
class Command:
    """Arguments of a first run and of one that follows it; `is_inside` where it writes into the data set itself."""

    first: str
    again: str = ""
    maker: Callable[..., Any] = fake_samples.make
    is_inside: bool = False


COMMANDS = {
    "generate": Command(
        "generate --n 1 --out OUT --params tiny --device cpu --log-level error",
        "generate --n 2 --out OUT --params tiny --device cpu --log-level error",
    ),
    "generate with a failure": Command(
        "generate --n 4 --out OUT --params tiny --device cpu --log-level error", maker=fake_samples.crash_on_bad
    ),
    "twins": Command("twins DATA/train --vary light.exposure=1 --n 1 --out OUT --device cpu"),
    "split": Command("split DATA/train --into a=1,b=1 --out OUT"),
    "merge": Command("merge DATA --out OUT"),
    "apollo": Command("export DATA --format apollo --out OUT --workers 1"),
    "openlane_v2": Command("export DATA --format openlane_v2 --out OUT --workers 1"),
    "argoverse2": Command("export DATA --format argoverse2 --out OUT --workers 1"),
    "nuscenes": Command("export DATA --format nuscenes --out OUT --workers 1"),
    "kitti": Command("export DATA --format kitti --out OUT --workers 1"),
    "opendrive": Command("export DATA --format opendrive --out OUT --workers 1"),
    "lanelet2": Command("export DATA --format lanelet2 --out OUT --workers 1"),
    "drive review": Command("drive review DATA/train --out OUT/a.html"),
    "validate": Command("validate OUT --workers 1", is_inside=True),
    "render": Command("render DATA/train:00000001 --out OUT/a.png --set light.exposure=2"),
    "inspect": Command("inspect DATA/train:00000001 --out OUT/a.png --html OUT/a.html"),
    "gallery": Command("gallery DATA --out OUT/a.jpg"),
    "clip": Command("clip DATA/train:00000001 --out OUT/a.webp"),
    "report": Command("report DATA --html OUT/a.html"),
    "stats": Command("stats DATA --out OUT/a.png"),
}


QUICK = ("generate",)


class InlinePool(Pool):
    """Workers that do their tasks in this process, where what they write is seen."""

    def __enter__(self) -> "InlinePool":
        self.outcomes: list[Outcome] = []
        return self

    def __exit__(self, *_: object) -> None:
        pass

    @property
    def busy(self) -> int:
        return len(self.outcomes)

    @property
    def idle(self) -> list[int]:
        return [] if self.outcomes else [0]

    def start(self, task: Any, function: Callable[..., Any], *args: Any, slot: int | None = None) -> None:
        try:
            self.outcomes.append(Outcome(task, "done", function(*args)))
        except OSError as error:
            self.outcomes.append(Outcome(task, "broken", reason=str(error)))
        except ValueError as error:
            self.outcomes.append(Outcome(task, "failed", reason=str(error)))

    def wait(self, seconds: float) -> Iterator[Outcome]:
        outcomes, self.outcomes = self.outcomes, []
        yield from outcomes


_seen: list[Path] | None = None


def _note(event: str, args: tuple[Any, ...]) -> None:
    """An audit hook; one cannot be removed, so this one notes only while there is a list."""
    if _seen is None:
        return
    places = {"os.remove": [(0, 1)], "os.rmdir": [(0, 1)], "os.mkdir": [(0, 2)], "os.rename": [(0, 2), (1, 3)]}
    places |= {"os.link": [(1, 3)], "os.symlink": [(1, 2)], "open": [(0, -1)]}
    if event == "open" and not (isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR)):
        return
    for at, folder in places.get(event, ()):
        path, descriptor = args[at], args[folder] if folder >= 0 else -1
        if isinstance(path, str | bytes | os.PathLike):
            above = os.readlink(f"/proc/self/fd/{descriptor}") if descriptor not in (-1, None) else os.getcwd()
            _seen.append(Path(above, os.fsdecode(path)))


@contextmanager
def noting() -> Iterator[list[Path]]:
    global _seen
    _seen = []
    try:
        yield _seen
    finally:
        _seen = None


sys.addaudithook(_note)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """A command in this process, workers and all, with a sample maker that needs no Blender."""
    from synth3dlanes_cli.main import main

    monkeypatch.setattr(local, "Pool", InlinePool)
    monkeypatch.setattr(render_file, "require_blender", lambda: None)
    monkeypatch.setattr(
        render_file, "render_members", lambda *_: {"png": b"1", "labels.json": b"2", "scene.json": b"3"}
    )
    for place in ("inspect.draw_inspect", "stats_views.draw_statistics"):
        monkeypatch.setattr(f"synth3dlanes.figures.{place}", lambda *_: Figure((1, 1)))
    make = plan.Plan.__init__

    def go(command: Command, arguments: str, data: Path, out: Path) -> Result:
        given = {"maker": command.maker, "shard_size": 4}
        monkeypatch.setattr(plan.Plan, "__init__", lambda self, *args, **named: make(self, *args, **given, **named))
        words = arguments.replace("DATA", str(data)).replace("OUT", str(out)).split()
        return CliRunner().invoke(main, words)

    return go


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four samples of clips, true labels on black images."""
    from synth3dlanes.params.shots import Shots

    out = tmp_path_factory.mktemp("links") / "data"
    recipe = fake_samples.recipe(shots=Shots(frames=2, fps=10.0))
    made = plan.Plan(out, 4, recipe, workers=1, shard_size=4, maker=fake_samples.make_labelled)
    assert generate(made, lambda _: None).exit_code == 0
    return out


def contents(root: Path) -> dict[str, bytes | str]:
    """All below a folder: the bytes of files, the targets of links, "" for folders."""

    def content(path: Path) -> bytes | str:
        return os.readlink(path) if path.is_symlink() else "" if path.is_dir() else path.read_bytes()

    return {str(path.relative_to(root)): content(path) for path in sorted(root.rglob("*"))}


def can_be_foreseen(path: PurePath) -> bool:
    return not any(len(part) >= RANDOM and not set(part) - set("0123456789abcdef") for part in str(path).split("."))


def of_each_kind(paths: list[PurePath]) -> list[PurePath]:
    """One of those that differ in numbers alone: shards, splits of twins and samples are written alike."""
    return list({re.sub(r"\d+", "0", str(path)): path for path in paths if can_be_foreseen(path)}.values())


def plant(place: Path, elsewhere: Path, kind: str) -> None:
    """A link at `place`, in the stead of what is there, to a copy of it or to somebody's own files."""
    if place.is_symlink():
        elsewhere.mkdir()
        place.unlink()
    elif place.is_file():
        shutil.copyfile(place, elsewhere)
        place.unlink()
    elif place.is_dir():
        shutil.copytree(place, elsewhere, symlinks=True)
        shutil.rmtree(place)
    elif kind == "folder":
        elsewhere.mkdir()
    else:
        elsewhere.write_text("years of work")
    if elsewhere.is_dir():
        for name in ("thesis.tex", "00000000.tar", "a.png", "00000.parquet", "4711.run", "a.tmp"):
            (elsewhere / name).write_text("years of work")
    place.parent.mkdir(parents=True, exist_ok=True)
    if kind == "hard link":
        os.link(elsewhere, place)
    else:
        place.symlink_to(elsewhere)


# Folders, splits, exports and reports first; the other commands write single files.
@pytest.mark.parametrize("name", first(len(QUICK), sorted(COMMANDS, key=lambda name: name not in QUICK)))
def test_what_links_in_a_given_folder_point_to_stays(tmp_path, run, data, name):
    command = COMMANDS[name]
    out, clean, documents = tmp_path / "out", tmp_path / "clean", tmp_path / "documents"
    documents.mkdir()

    def begin(state: Path | None) -> None:
        shutil.rmtree(out, ignore_errors=True)
        if state is None:
            out.mkdir()
        else:
            shutil.copytree(state, out, symlinks=True)

    first = data if command.is_inside else None
    begin(first)
    with noting() as seen:
        expected = run(command, command.first, data, out)
        assert isinstance(expected.exception, SystemExit | None), repr(expected.exception)
        assert expected.exit_code in (0, 1), expected.output
        shutil.copytree(out, clean, symlinks=True)
        again = run(command, command.again or command.first, data, out)
        assert again.exit_code == expected.exit_code, again.output
    found = {path.relative_to(out) for path in [*seen, *clean.rglob("*")] if out in path.parents}
    found |= {path.relative_to(clean) for path in clean.rglob("*")}
    assert found, expected.output
    for number, path in enumerate(of_each_kind(sorted(found))):
        for kind in ("file", "folder", "hard link"):
            for state, arguments in ((first, command.first), (clean, command.again or command.first)):
                was_there = state is not None and (state / path).exists()
                if kind == "hard link" and not (was_there and (state / path).is_file()):
                    continue
                if kind == "folder" and was_there:
                    continue
                begin(state)
                elsewhere = documents / f"{number} {kind} {state is first}"
                plant(out / path, elsewhere, kind)
                before = contents(documents)
                result = run(command, arguments, data, out)
                where = f"{kind} at {path}: {result.output[-300:]}"
                assert contents(documents) == before, where
                assert result.exit_code in (0, 1, 2), where
                assert isinstance(result.exception, SystemExit | None), f"{where}{result.exception!r}"
                if result.exit_code == 2:
                    lines = result.stderr.splitlines()
                    assert sum(any(word in line for word in REFUSING) for line in lines) == 1, where


@pytest.mark.parametrize("place", ["train/00000.parts", "failed"])
def test_a_link_that_comes_while_workers_write_ends_the_run_in_a_line(tmp_path, place):
    documents = tmp_path / "documents"
    documents.mkdir()
    (documents / "thesis.tex").write_text("years of work")

    def tell(event: Any) -> None:
        if event.kind == "sample" and event.done == 1:
            with_parts = tmp_path / "out" / place
            if with_parts.exists():
                with_parts.rename(tmp_path / "moved")
            with_parts.symlink_to(documents)

    maker = fake_samples.make_slowly
    going = plan.Plan(tmp_path / "out", 4, fake_samples.recipe(), workers=2, shard_size=4, maker=maker)
    with pytest.raises(LinkError, match=f"{place}: expected no link below .*out, got one to .*documents; remove the"):
        generate(going, tell)
    assert contents(documents) == {"thesis.tex": b"years of work"}
