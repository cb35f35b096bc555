"""Shared worker processes: one that is killed ends the task in a line."""

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import click
import psutil
import pytest
from click.testing import CliRunner
from synth3dlanes_cli.main import main

import synth3dlanes
from synth3dlanes.system.errors import InputError, WorkerError
from synth3dlanes.system.machine import workers_here
from synth3dlanes.system.processes import n_workers, process_pool


def die(number: int) -> None:
    os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_a_killed_process_is_a_worker_error(number: int) -> None:
    with pytest.raises(WorkerError, match="a worker process was killed") as caught, process_pool(1) as pool:
        list(pool.map(die, [number]))
    assert "\n" not in str(caught.value)
    assert caught.value.__suppress_context__


def threads_of_algebra() -> int:
    """How many threads numpy starts in this process."""
    before = psutil.Process().num_threads()
    assert "numpy" not in sys.modules
    import numpy as np

    np.linalg.inv(np.ones((300, 300)) + np.eye(300))
    return psutil.Process().num_threads() - before


def test_a_process_computes_by_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """There is a process for each core."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    monkeypatch.delenv("OMP_NUM_THREADS")
    with process_pool(1) as pool:
        assert pool.submit(threads_of_algebra).result() == 0


def test_a_command_says_so_in_a_line_and_ends_with_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from synth3dlanes_cli.main import main

    def killed(*_: object, **__: object) -> None:
        with process_pool(1) as pool:
            pool.submit(die, signal.SIGKILL).result()

    monkeypatch.setattr("synth3dlanes.validate.run.validate", killed)
    result = CliRunner().invoke(main, ["validate", str(tmp_path)])
    assert (result.exit_code, len(result.stderr.splitlines())) == (1, 1), result.output
    assert "a worker process was killed" in result.stderr


def test_nothing_else_makes_pools() -> None:
    root = Path(__file__).parents[1]
    programs = [path for folder in ("synth3dlanes", "cli", "baseline_model") for path in (root / folder).rglob("*.py")]
    assert [path.name for path in programs if "ProcessPoolExecutor" in path.read_text()] == ["processes.py"]


def test_workers_mean_one_thing_everywhere(tmp_path: Path) -> None:
    """0 is one per core, fewer for few tasks; less is refused."""
    assert [n_workers(0, n_tasks) for n_tasks in (0, 1, 10_000)] == [1, 1, workers_here()]
    assert n_workers(3, 1) == 3
    refused: tuple[Callable[[], object], ...] = (
        lambda: synth3dlanes.export_dataset("none", tmp_path / "e", "tusimple", workers=-1),
        lambda: synth3dlanes.validate_dataset("none", workers=-1),
        lambda: synth3dlanes.generate_dataset(synth3dlanes.load_params("tiny"), tmp_path / "d", n=1, workers=-1),
    )
    for call in refused:
        with pytest.raises(InputError, match=r"workers: expected (0|auto) .*, got -1"):
            call()
    for command in ("export", "validate", "generate", "twins", "benchmark", "bench"):
        params = main.commands[command].get_params(click.Context(main.commands[command]))
        (option,) = (option for option in params if option.name == "workers")
        assert (option.default, option.metavar) == ("auto", "N|auto")
