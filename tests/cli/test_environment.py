"""What a disk or the limits of a process do to a command is one line, with 1, whatever the command."""

import errno
import os
import resource
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

from synth3dlanes.system import files
from tests.small_files import withstands
from tests.thorough import first

ERRORS = ("ENOSPC", "EIO", "EROFS", "EBUSY", "EDQUOT", "EMFILE")
WRITING = [
    "gallery DIR --n 2 --out OUT/it.jpg",
    "merge DIR --out OUT/d",
    "export DIR --format tusimple --out OUT/e",
    "split DIR/train --into train=0.5,val=0.5 --out OUT/s",
    "inspect DIR/train:0 --html OUT/i.html",
    "report DIR --html OUT/r.html",
]
READING = [
    "gallery DIR --n 2 --out OUT/it.jpg",
    "info DIR",
    "stats DIR",
    "params check OUT/given.yaml",
    "drive check OUT/given.yaml",
    "inspect OUT/given.json",
    "validate DIR",
    "export DIR --format tusimple --out OUT/e",
]


@pytest.mark.parametrize(("name", "command"), first(3, [(name, line) for line in WRITING for name in ERRORS]))
def test_the_environment_is_told_with_exit_code_1(
    name: str,
    command: str,
    run: Callable[..., Result],
    folder: Path,
    in_tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    number = getattr(errno, name)

    def fail(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(files, "_created", fail)
    done = run(*command.replace("DIR", str(folder)).replace("OUT", str(in_tmp_path)).split())
    assert done.exit_code == 1, done.output
    assert os.strerror(number) in done.stderr
    assert "Traceback" not in done.output


@pytest.mark.parametrize(("command", "spare"), first(2, [(line, spare) for spare in (0, 1, 3) for line in READING]))
def test_too_many_open_files_are_told_with_exit_code_1(
    command: str, spare: int, run: Callable[..., Result], folder: Path, in_tmp_path: Path
) -> None:
    (in_tmp_path / "given.yaml").write_text("name: x")
    (in_tmp_path / "given.json").write_text("{}")
    words = command.replace("DIR", str(folder)).replace("OUT", str(in_tmp_path)).split()
    run(*words)  # loads what it imports
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    free = os.open(os.devnull, os.O_RDONLY)
    os.close(free)
    resource.setrlimit(resource.RLIMIT_NOFILE, (free + spare, before[1]))
    try:
        done = run(*words)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    assert "Traceback" not in done.output
    if os.strerror(errno.EMFILE) in done.output:
        assert done.exit_code == 1, done.output
    else:
        assert spare, done.output


COMMANDS = [
    "gallery DIR --n 4 --out OUT/it.jpg",
    "inspect DIR/train:3 --out OUT/it.png",
    "split DIR/train --into train=0.5,val=0.5 --out OUT",
    "gallery DIR --n 4 --out OUT/it.png",
    "inspect DIR/train:3 --html OUT/it.html",
    "stats DIR --out OUT/it.png",
    "report DIR --n 4 --html OUT/it.html",
    "merge DIR --out OUT",
]


@pytest.mark.parametrize("command", first(1, COMMANDS))
def test_a_full_disk(command: str, run: Callable[..., Result], folder: Path, in_tmp_path: Path) -> None:
    (in_tmp_path / "out").mkdir()
    words = command.replace("DIR", str(folder)).replace("OUT", str(in_tmp_path / "out")).split()
    withstands(lambda: run(*words), in_tmp_path / "out")
