"""Cores and memory follow affinity and control groups, in containers and outside, of both versions."""

from pathlib import Path

import psutil
import pytest

from synth3dlanes.system import machine
from synth3dlanes.system.machine import PROCESS_BYTES, RENDERER_BYTES, usable_bytes, usable_cores, workers_here

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
            "cpu/a/cpu.cfs_quota_us": "600000",
            "cpu/a/cpu.cfs_period_us": "100000",
            "cpu/a/b/cpu.cfs_quota_us": "-1",
            "cpu/a/b/cpu.cfs_period_us": "100000",
            "memory/a/memory.limit_in_bytes": str(5 * GIB),
            "memory/a/b/memory.limit_in_bytes": "9223372036854771712",
        },
        6,
        5,
    ),
    "both": ("1:name=systemd:/x\n0::/x\n4:cpu:/y", {"x/cpu.max": "700000 100000"}, 7, 64),
    "nonsense": ("0::/a\nx\n:::", {"a/cpu.max": "some words", "a/memory.max": "", "cpu.max": "5 0"}, 16, 64),
}


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
    root = Path(__file__).parents[1]
    allowed = {"synth3dlanes/system/machine.py", "synth3dlanes/production/workers.py"}
    asking = {
        str(path.relative_to(root))
        for folder in ("synth3dlanes", "cli", "baseline_model")
        for path in (root / folder).rglob("*.py")
        if any(words in path.read_text() for words in ("cpu_count", "sched_getaffinity"))
    }
    assert asking == allowed
