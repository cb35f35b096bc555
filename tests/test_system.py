"""Cores, memory, processes, temporary folders and libraries of the machine that commands run on."""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import click
import psutil
import pytest
from click.testing import CliRunner
from synth3dlanes_cli.main import main

import synth3dlanes
from synth3dlanes.production.workers import Limits, call
from synth3dlanes.system import machine, system_libraries
from synth3dlanes.system.errors import InputError, WorkerError
from synth3dlanes.system.machine import PROCESS_BYTES, RENDERER_BYTES, usable_bytes, usable_cores, workers_here
from synth3dlanes.system.processes import n_workers, process_pool
from synth3dlanes.system.scratch import OWNER, PREFIX, scratch
from synth3dlanes.system.system_libraries import PACKAGES, install_hint, missing_packages

ROOT = Path(__file__).parents[1]
GIB = 1 << 30
# The lines of /proc/self/cgroup, files below /sys/fs/cgroup, and of 16 cores and 64 GiB what may be used.
MACHINES = {
    "no groups": ("", {}, 16, 64),
    "version 2, no limit": ("0::/user.slice/x", {"user.slice/x/cpu.max": "max 100000"}, 16, 64),
    "version 2, a container": ("0::/", {"cpu.max": "400000 100000", "memory.max": str(8 * GIB)}, 4, 8),
    "version 2, nested: the outer one": (
        "0::/a/b",
        {"a/cpu.max": "200000 100000", "a/b/cpu.max": "800000 100000", "a/memory.max": str(3 * GIB)},
        2,
        3,
    ),
    "version 2, nested: the inner one": (
        "0::/a/b",
        {"a/cpu.max": "800000 100000", "a/b/cpu.max": "250000 50000", "a/b/memory.max": "max"},
        5,
        64,
    ),
    "version 2, less than a core": ("0::/a", {"a/cpu.max": "50000 100000"}, 1, 64),
    "version 2, not whole": ("0::/a", {"a/cpu.max": "350000 100000"}, 3, 64),
    "version 2, the host's path": ("0::/../../kubepods/pod1", {"cpu.max": "200000 100000"}, 2, 64),
    "version 2, more than there is": ("0::/a", {"a/cpu.max": "9900000 100000", "a/memory.max": str(2**62)}, 16, 64),
    "version 1, a container": (
        "5:memory:/docker/1\n4:cpu,cpuacct:/docker/1",
        {
            "cpu,cpuacct/cpu.cfs_quota_us": "300000",
            "cpu,cpuacct/cpu.cfs_period_us": "100000",
            "memory/memory.limit_in_bytes": str(4 * GIB),
        },
        3,
        4,
    ),
    "version 1, nested": (
        "5:memory:/a/b\n4:cpu:/a/b",
        {
            "cpu/a/cpu.cfs_quota_us": "600000", "cpu/a/cpu.cfs_period_us": "100000",
            "cpu/a/b/cpu.cfs_quota_us": "-1", "cpu/a/b/cpu.cfs_period_us": "100000",
            "memory/a/memory.limit_in_bytes": str(5 * GIB),
            "memory/a/b/memory.limit_in_bytes": "9223372036854771712",
        },
        6,
        5,
    ),
    "both": ("1:name=systemd:/x\n0::/x\n4:cpu:/y", {"x/cpu.max": "700000 100000"}, 7, 64),
    "nonsense": ("0::/a\nx\n:::", {"a/cpu.max": "some words", "a/memory.max": "", "cpu.max": "5 0"}, 16, 64),
}  # fmt: skip


@pytest.mark.parametrize("name", MACHINES)
def test_quotas_and_limits_are_followed(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines, files, cores, gib = MACHINES[name]
    groups, mount = tmp_path / "cgroup", tmp_path / "mount"
    groups.write_text(lines)
    for path, text in files.items():
        (mount / path).parent.mkdir(parents=True, exist_ok=True)
        (mount / path).write_text(f"{text}\n")
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(16)))
    monkeypatch.setattr(machine.psutil, "virtual_memory", lambda: type("Memory", (), {"total": 64 * GIB}))
    assert (usable_cores(groups, mount), usable_bytes(groups, mount)) == (cores, gib * GIB)
    assert workers_here(RENDERER_BYTES, groups, mount) == min(cores, gib)
    assert workers_here(PROCESS_BYTES, groups, mount) == min(cores, 2 * gib)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {3})
    assert workers_here(PROCESS_BYTES, groups, mount) == 1
    assert workers_here(1000 * GIB, groups, mount) == 1


def test_without_files_the_machine_counts(tmp_path: Path) -> None:
    assert usable_bytes(tmp_path / "none", tmp_path) == psutil.virtual_memory().total


def test_one_module_asks_how_many_cores_there_are() -> None:
    """Others would miss what a container allows. Workers are pinned to cores of their affinity."""
    allowed = {"synth3dlanes/system/machine.py", "synth3dlanes/production/workers.py"}
    asking = {
        str(path.relative_to(ROOT))
        for folder in ("synth3dlanes", "cli", "baseline_model")
        for path in (ROOT / folder).rglob("*.py")
        if any(words in path.read_text() for words in ("cpu_count", "sched_getaffinity"))
    }
    assert asking == allowed


def die(number: int) -> None:
    os.kill(os.getpid(), number)


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


def test_a_program_without_a_guard_is_not_run_again_by_a_process(tmp_path: Path) -> None:
    """`if __name__ == "__main__"`, which Python's own pools need. Its threads ask at once."""
    program = tmp_path / "program.py"
    program.write_text("""
from concurrent.futures import ThreadPoolExecutor
from synth3dlanes.system.processes import process_pool
print("once", flush=True)
def ask(number):
    with process_pool(1) as pool:
        return pool.submit(abs, number).result()
with ThreadPoolExecutor() as threads:
    print(*threads.map(ask, [-2, -3, -4]), __file__)
""")
    ran = subprocess.run([sys.executable, program], capture_output=True, text=True, check=True)
    assert ran.stdout == f"once\n2 3 4 {program}\n", ran.stderr


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_a_command_says_so_in_a_line_and_ends_with_1(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That one of its processes was killed."""

    def killed(*_: object, **__: object) -> None:
        with process_pool(1) as pool:
            list(pool.map(die, [number]))

    monkeypatch.setattr("synth3dlanes.validate.run.validate", killed)
    result = CliRunner().invoke(main, ["validate", str(tmp_path)])
    assert (result.exit_code, len(result.stderr.splitlines())) == (1, 1), result.output
    assert "a worker process was killed" in result.stderr


def test_nothing_else_makes_pools() -> None:
    programs = [path for folder in ("synth3dlanes", "cli", "baseline_model") for path in (ROOT / folder).rglob("*.py")]
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
    for make in refused:
        with pytest.raises(InputError, match=r"workers: expected (0|auto) .*, got -1"):
            make()
    for command in ("export", "validate", "generate", "twins", "benchmark", "bench"):
        params = main.commands[command].get_params(click.Context(main.commands[command]))
        (option,) = (option for option in params if option.name == "workers")
        assert (option.default, option.metavar) == ("auto", "N|auto")


HOLDER = """
import sys
from synth3dlanes.system.scratch import scratch
with scratch() as folder:
    (folder / "texture.tif").write_bytes(bytes(1 << 20))
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def hold() -> tuple[subprocess.Popen[str], Path]:
    process = subprocess.Popen([sys.executable, "-c", HOLDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def test_only_folders_of_dead_processes_go(temporary: Path) -> None:
    documents = temporary / "documents"
    documents.mkdir()
    (documents / OWNER).touch()
    (documents / "thesis.tex").write_text("years of work")
    (temporary / f"{PREFIX}link").symlink_to(documents)
    (temporary / f"{PREFIX}unknown").mkdir()
    living, of_living = hold()
    dead, of_dead = hold()
    (of_dead / "link").symlink_to(documents)
    dead.kill()
    dead.communicate()
    with scratch() as mine:
        assert mine.is_dir()
        assert not of_dead.exists()
        assert (of_living / "texture.tif").exists()
    assert not mine.exists()
    living.communicate("")
    assert not of_living.exists()
    assert sorted(os.listdir(temporary)) == ["documents", f"{PREFIX}link", f"{PREFIX}unknown"]
    assert sorted(os.listdir(documents)) == [OWNER, "thesis.tex"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_folders_of_other_users_stay(temporary: Path) -> None:
    dead, of_dead = hold()
    dead.kill()
    dead.communicate()
    os.chown(of_dead, 4711, 4711)
    with scratch():
        assert of_dead.exists()


@pytest.mark.thorough
def test_a_killed_run_leaves_nothing_to_the_next(temporary: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """What its workers keep in the temporary folder is in the run's own."""
    out = tmp_path_factory.mktemp("out")
    command = [sys.executable, "-m", "tests.fake_samples", str(out), "12", "1"]
    killed = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert killed.stdout is not None
    assert next(line for line in killed.stdout if "kind='sample'" in line)
    killed.kill()
    killed.communicate()
    assert list(temporary.glob(f"{PREFIX}*"))
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    assert [name for name in os.listdir(temporary) if "-core-" not in name] == []


NO_LIBRARY = "libXrender.so.1: cannot open shared object file: No such file or directory"


def import_without_library() -> None:
    raise ImportError(NO_LIBRARY)


def test_a_worker_that_misses_a_library_says_what_to_install() -> None:
    expected = (
        r"^Blender: ImportError: libXrender\.so\.1: cannot open .*; install it: sudo apt-get install -y libxrender1"
    )
    with pytest.raises(WorkerError, match=expected):
        call(Limits(), import_without_library).result("Blender")


def test_all_that_is_missing_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system_libraries, "_is_missing", lambda library: library in ("libXi.so.6", "libGL.so.1"))
    assert missing_packages() == ["libxi6", "libgl1"]
    assert install_hint(NO_LIBRARY) == "; install it: sudo apt-get install -y libxrender1 libxi6 libgl1"
    assert install_hint("libfoo.so.3: cannot open shared object file") == (
        "; install the package of your system that has it"
    )
    assert install_hint("No module named 'bpy'") == ""
    for library, package in PACKAGES.items():
        assert install_hint(f"{library}: cannot open shared object file").startswith(
            f"; install it: sudo apt-get install -y {package} "
        )


def test_setup_asks_it_before_anything_is_installed() -> None:
    command = [sys.executable, "-P", "-S", str(ROOT / "synth3dlanes" / "system" / "system_libraries.py")]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    assert told.split() == missing_packages()
    assert "synth3dlanes/system/system_libraries.py" in (ROOT / "scripts" / "setup").read_text()
