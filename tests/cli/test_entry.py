"""The program as it starts: with closed streams, and with little memory."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.thorough import first

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
