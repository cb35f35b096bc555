"""Ctrl-C, SIGTERM and SIGHUP end every command with the exit code of a shell and one line, never "Aborted!"."""

import os
import signal
import subprocess
import sys
from contextlib import suppress

import psutil
import pytest
from click.testing import CliRunner
from synth3dlanes_cli.main import main

from synth3dlanes.production.signals import StopSignal
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
            (["validate", "FOLDER", "--workers", "2"], True),
            (["sample", "--n", "3000"], True),
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
