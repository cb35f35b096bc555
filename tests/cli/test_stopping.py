"""How commands start and end: signals, closed streams, little memory, and what the machine does to them."""

import errno
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from click.testing import CliRunner, Result
from synth3dlanes_cli.main import main

from synth3dlanes.production.signals import StopSignal
from synth3dlanes.system import files
from tests.small_files import withstands
from tests.thorough import first


@pytest.mark.parametrize(
    ("error", "code"), [(KeyboardInterrupt(), 130), (StopSignal(signal.SIGTERM), 143), (StopSignal(signal.SIGHUP), 129)]
)
@pytest.mark.parametrize(
    ("arguments", "function", "line"),
    [
        (
            ["export", "d", "--format", "apollo", "--out", "e"],
            "synth3dlanes.formats.export.Export.write",
            "; rerun to resume",
        ),
        (["validate", "d"], "synth3dlanes.validate.run.validate", ""),
        (["sample"], "synth3dlanes.draw.sample.scene_texts", ""),
    ],
)
def test_a_signal_ends_a_command_in_one_line(monkeypatch, error, code, arguments, function, line):
    def stop(*_, **__):
        raise error

    monkeypatch.setattr(function, stop)
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == code
    # A progress bar may stand before it.
    assert result.stderr.splitlines()[-1] == f"synth3dlanes {arguments[0]}: interrupted{line}"
    assert "Aborted" not in result.output


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("signals", "code"),
    first(1, [((signal.SIGTERM, signal.SIGINT), 130), ((signal.SIGINT, signal.SIGINT), 130), ((signal.SIGHUP,), 129)]),
)
def test_a_second_signal_ends_a_run_at_once_in_one_line(tmp_path, signals, code):
    command = [sys.executable, "-m", "tests.fake_cli", "generate", "--n", "200", "--out", str(tmp_path / "d")]
    command += ["--params", "tiny", "--workers", "2", "--device", "cpu", "--log-level", "debug"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert next(line for line in process.stderr if line.startswith("0000"))
    if len(signals) > 1:
        # Their samples are not finished, so the run cannot end by the first signal alone, however late the second is.
        for worker in psutil.Process(process.pid).children():
            worker.suspend()
    process.send_signal(signals[0])
    for second in signals[1:]:
        assert next(line for line in process.stderr if "Ctrl-C again stops at once" in line)
        process.send_signal(second)
    stdout, stderr = process.communicate(timeout=240)
    assert process.returncode == code
    assert "Traceback" not in stderr
    if len(signals) > 1:
        assert stderr.splitlines()[-1].endswith("generate: interrupted; rerun to resume")
    else:
        assert "samples" in stdout


def is_shared_process(process: psutil.Process) -> bool:
    with suppress(psutil.Error):
        return "spawn_main" in " ".join(process.cmdline())
    return False


@pytest.mark.parametrize(
    ("command", "is_early"),
    first(
        1,
        [
            (["sample", "--n", "3000"], True),
            (["validate", "FOLDER", "--workers", "2"], True),
            (["sample", "--n", "3000"], False),
        ],
    ),
)
def test_ctrl_c_in_a_terminal_ends_shared_processes_without_a_word(command, is_early, folder):
    """The terminal sends it to every process, also to those that have just begun."""
    words = [word.replace("FOLDER", str(folder)) for word in command]
    words = [sys.executable, "-m", "synth3dlanes", *words]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    parent = psutil.Process(process.pid)
    if is_early:
        while not any(map(is_shared_process, parent.children())):
            assert process.poll() is None
            time.sleep(0.02)
    else:
        assert process.stdout.readline()
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=240)
    assert process.returncode == 130, stderr
    assert stderr.splitlines()[-1] == f"python -m synth3dlanes {command[0]}: interrupted"
    assert "Traceback" not in stderr


def test_ctrl_c_while_the_commands_are_imported_ends_in_one_line():
    """The finder stands for a user who presses Ctrl-C as the command line's main module is looked up."""
    code = """
import sys

class Pressed:
    def find_spec(self, name, path=None, target=None):
        if name == "synth3dlanes_cli.main":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Pressed())
from synth3dlanes_cli.entry import run
run()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "synth3dlanes: interrupted\n")


def test_a_signal_while_the_program_leaves_changes_nothing():
    code = """
import atexit, os, signal, sys
from synth3dlanes_cli.main import run

atexit.register(os.kill, os.getpid(), signal.SIGINT)
sys.argv = ["synth3dlanes", "params", "show", "nothing"]
run()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("nothing: expected one of ")
    assert len(done.stderr.splitlines()) == 1


COMMAND = f"{sys.executable} -m synth3dlanes"


def shell(line: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=240)


@pytest.mark.parametrize("closed", first(1, ["<&- 2>&-", "2>&-", "<&-"]))
def test_a_closed_stream_is_like_any_other(closed: str) -> None:
    done = shell(f"{COMMAND} params show tiny --json {closed}")
    assert (done.returncode, done.stdout[:1], done.stderr) == (0, "{", "")


@pytest.mark.parametrize("closed", first(1, [">&- 2>&-", ">&-"]))
def test_without_an_output_a_command_still_works(closed: str) -> None:
    done = shell(f"{COMMAND} params show tiny {closed}; echo $?; {COMMAND} sample --params none.yaml {closed}; echo $?")
    said = "none.yaml: cannot read: No such file or directory\n" if closed == ">&-" else ""
    assert (done.stdout, done.stderr) == ("0\n2\n", said)


def test_a_name_of_any_bytes_is_printed(tmp_path: Path, folder: Path) -> None:
    done = shell(f"cd {tmp_path}; {COMMAND} merge {folder} --out $'\\xff'")
    assert (done.returncode, done.stdout, done.stderr) == (0, "\\udcff/train: 12 samples\n", "")


def test_too_little_memory_is_one_line() -> None:
    """Where a library asks for more than a limit allows."""
    from synth3dlanes_cli.entry import NO_MEMORY

    script = "import sys, resource, synth3dlanes_cli.main as main; import synth3dlanes.draw.sample, numpy\n"
    script += "room = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize() + (1 << 28)\n"
    script += "resource.setrlimit(resource.RLIMIT_AS, (room, room))\n"
    script += "synth3dlanes.draw.sample.scene_texts = lambda *_: [numpy.ones(1 << 30)]\n"
    script += "main.main(['sample'], prog_name='synth3dlanes')"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=240)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", f"synth3dlanes sample: {NO_MEMORY}\n")


@pytest.mark.parametrize("kib", [100_000, 300_000, 524_287])
def test_a_limit_in_which_no_library_can_be_loaded_is_named(kib: int) -> None:
    done = shell(f"ulimit -v {kib}; {COMMAND} sample --params tiny")
    line = f"synth3dlanes: expected an address space of at least 524288 KiB (ulimit -v), got {kib}\n"
    assert (done.returncode, done.stdout, done.stderr) == (1, "", line)


def test_what_libraries_say_of_too_little_memory_is_known() -> None:
    from synth3dlanes_cli.entry import is_lack_of_memory

    assert is_lack_of_memory(MemoryError())
    assert is_lack_of_memory(RuntimeError("can't start new thread"))
    assert is_lack_of_memory(ImportError("libx.so: failed to map segment from shared object"))
    assert not is_lack_of_memory(RuntimeError("shape mismatch"))


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
