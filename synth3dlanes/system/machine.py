"""What this process may use of its machine: cores and memory, by affinity and by the control groups (cgroups) of
containers and schedulers, which may be nested.

Reads files of the system and changes nothing.
"""

import math
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import psutil

# Upper bounds of the memory of a process that computes with arrays, and of a process that renders.
PROCESS_BYTES, RENDERER_BYTES = 1 << 29, 1 << 30
# The group of this process by controller, and where controllers are mounted.
GROUPS, MOUNT = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")


def workers_here(bytes_each: int = PROCESS_BYTES, groups: Path = GROUPS, mount: Path = MOUNT) -> int:
    """The number of processes of this size for which there are cores and memory; at least one."""
    return max(1, min(usable_cores(groups, mount), usable_bytes(groups, mount) // bytes_each))


def renderers_here() -> int:
    """The number of processes that render for which there are cores and memory; at least one."""
    return workers_here(RENDERER_BYTES)


def usable_cores(groups: Path = GROUPS, mount: Path = MOUNT) -> int:
    """The number of cores that this process may keep busy: the cores of its affinity, at most the whole cores of its
    quota."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quotas = [
        *(_share(*text.split()[:2]) for text in _values(groups, mount, "", "cpu.max")),
        *(
            _share(quota, period)
            for quota, period in zip(
                _values(groups, mount, "cpu", "cpu.cfs_quota_us"),
                _values(groups, mount, "cpu", "cpu.cfs_period_us"),
                strict=False,
            )
        ),
    ]
    return max(1, min([cores, *(math.floor(quota) for quota in quotas if quota is not None)]))


def usable_bytes(groups: Path = GROUPS, mount: Path = MOUNT) -> int:
    """The memory that this process may use with others of its group: the machine's, or the lowest limit."""
    texts = [
        *_values(groups, mount, "", "memory.max"),
        *_values(groups, mount, "memory", "memory.limit_in_bytes"),
    ]
    return min([psutil.virtual_memory().total, *(int(text) for text in texts if text.isdecimal())])


def _share(quota: str, period: str = "100000") -> float | None:
    """Cores per second of a quota of CPU time in a period; None without a quota ("max", -1)."""
    return int(quota) / int(period) if quota.isdecimal() and period.isdecimal() and int(period) else None


def _values(groups: Path, mount: Path, controller: str, name: str) -> Iterator[str]:
    """The contents of the files with this name, from this process's group up to the outermost visible group.
    `controller` is "" in version 2 of cgroups, which has one tree."""
    try:
        lines = [line.split(":", 2) for line in groups.read_text().splitlines()]
    except OSError:
        return
    for _, controllers, path in filter(lambda line: len(line) == 3, lines):
        if controller not in controllers.split(","):
            continue
        # In a container the path may be the host's: the container may have only its last part, or nothing.
        root = next((found for found in (mount / controllers, mount / controller) if found.is_dir()), mount)
        folder = root / path.lstrip("/")
        for place in (folder, *folder.parents):
            with suppress(OSError):
                yield (place / name).read_text().strip()
            if place == root:
                break
