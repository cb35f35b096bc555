"""Supervised worker processes, each with one task at a time. This file is also the program that a worker runs.

A worker is a fresh process (never a fork, which Blender would not survive) with a pipe of its own. So killing a worker,
at any time, affects its own task alone. (Workers of Pebble and concurrent.futures share one pipe and its locks: a
worker that is killed while it holds them stops all others.) A task that fails ends its worker, with the traceback on
its stderr; the next task starts a fresh worker. A worker is pinned to one core before it imports anything. It ends with
its parent, and ignores the signals that stop a run.
"""

import ctypes
import errno
import fcntl
import gc
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import cache
from multiprocessing.connection import Connection, Pipe, wait
from pathlib import Path
from queue import SimpleQueue
from threading import Thread, current_thread, main_thread
from types import TracebackType
from typing import Any, Literal

import psutil

STDERR_TAIL = 8000
# Share of the seconds allowed that a worker must get as CPU time to make progress; on a busy machine it may get little.
PROGRESS = 0.01
DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
PR_SET_PDEATHSIG = 1
# Environment variable with the id of the process that a worker works for.
PARENT = "SYNTH3DLANES_PARENT"
# For the C library: a worker keeps the memory that a picture frees, in huge pages, for the next one. Without the second
# value, which is as large as the third, large blocks would go back to the system at once; without the last one, those
# of threads other than the main one, in which Blender renders.
MEMORY = {
    "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1:glibc.malloc.mmap_threshold=4294967296"
    ":glibc.malloc.trim_threshold=4294967296:glibc.malloc.arena_max=1"
}
# Objects between two collections of garbage, each of which may look through the whole map that a worker keeps.
OBJECTS_BETWEEN = 20_000
# Folders that Blender adds to sys.path when it is loaded. With them, a worker would import only a part of bpy.
BLENDERS_PATH = re.compile(r"/bpy/\d+\.\d+/scripts")


@dataclass(frozen=True)
class Limits:
    """When a worker is replaced: after a task that takes more CPU seconds, or makes no progress for as long; above a
    memory limit; after a number of tasks."""

    seconds: float = 120.0
    rss_bytes: int = 4 << 30
    tasks: int = 5000


@dataclass(frozen=True)
class Outcome:
    """How a task ended. "done": `value` is its result. "full": the disk is full. "broken": this machine cannot do it,
    because a file or a library is missing. "killed": the worker was killed from outside. "failed": it crashed, hung or
    took too much memory."""

    task: Any
    status: Literal["done", "full", "broken", "killed", "failed"]
    value: Any = None
    reason: str = ""
    stderr: str = ""

    def result(self, what: str) -> Any:
        """The result of the task. Raises DiskFullError or WorkerError if there is none; the message begins with `what`,
        and the worker's output is a note of the error."""
        if self.status == "done":
            return self.value
        # Not at the top: the worker's program imports nothing of ours before it is pinned.
        from synth3dlanes.system.errors import DiskFullError, WorkerError

        is_full = self.status == "full"
        error = (DiskFullError if is_full else WorkerError)(f"{what}: {self.reason}")
        error.add_note(self.stderr)
        raise error from OSError(errno.ENOSPC, self.reason) if is_full else None


@dataclass
class Worker:
    """A process, its pipe, and its task, which began at CPU second `started` of the process. `moved` is the time of its
    latest progress, by the clock and in CPU seconds."""

    process: subprocess.Popen[bytes]
    pipe: Connection
    stderr: Path
    task: Any = None
    started: float = 0.0
    moved: tuple[float, float] = (0.0, 0.0)
    n_tasks: int = 0

    @property
    def rss_bytes(self) -> int:
        """The resident memory of the worker; 0 once it has ended."""
        with suppress(psutil.Error):
            return int(psutil.Process(self.process.pid).memory_info().rss)
        return 0

    @property
    def cpu_s(self) -> float:
        """The CPU seconds of the worker; after its end, the last reading."""
        with suppress(psutil.Error):
            used = psutil.Process(self.process.pid).cpu_times()
            return float(used.user + used.system)
        return self.moved[1]

    def begin(self, task: Any) -> None:
        self.task, self.started = task, self.cpu_s
        self.moved = time.monotonic(), self.started

    def endless(self, seconds: float) -> str:
        """Why the task is taken to be endless, or "". Time by the clock says little on a busy machine."""
        now, used = time.monotonic(), self.cpu_s
        if used - self.started > seconds:
            return f"no end after {seconds:g} s of CPU time"
        if used - self.moved[1] > PROGRESS * seconds:
            self.moved = now, used
        return f"no progress for {seconds:g} s" if now - self.moved[0] > seconds else ""


@dataclass
class Pool:
    """Up to `n` workers, as a context manager that kills them at the end. `masks` are environment variables that
    workers get in turn; each shows a worker one GPU alone."""

    n: int
    limits: Limits
    pinned: bool = True
    masks: Sequence[Mapping[str, str]] = ({},)
    _workers: list[Worker | None] = field(default_factory=list)

    def __enter__(self) -> "Pool":
        # Not at the top: the worker's program imports nothing of ours before it is pinned.
        from synth3dlanes.system.scratch import scratch

        self._stack = ExitStack()
        self._scratch = self._stack.enter_context(scratch())
        is_pinned = self.pinned and hasattr(os, "sched_getaffinity")
        self._leases, self._cores = _lease(self.n, sorted(os.sched_getaffinity(0))) if is_pinned else ([], [-1])
        self._workers = [None] * self.n
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for slot in range(self.n):
            self._retire(slot)
        for lease in self._leases:
            os.close(lease)
        self._stack.close()

    @property
    def busy(self) -> int:
        return len(self._busy())

    @property
    def pids(self) -> list[int]:
        """The processes that there are now."""
        return [worker.process.pid for worker in self._workers if worker]

    @property
    def idle(self) -> list[int]:
        """The workers that have nothing to do, by number."""
        return [slot for slot, worker in enumerate(self._workers) if worker is None or worker.task is None]

    def start(self, task: Any, function: Callable[..., Any], *args: Any, slot: int | None = None) -> None:
        """Give `function(*args)` to worker `slot`, or any that has nothing to do; `task` names it in its Outcome."""
        slot = self.idle[0] if slot is None else slot
        worker = self._workers[slot]
        if worker is not None and worker.process.poll() is not None:
            self._retire(slot)
            worker = None
        if worker is None:
            worker = self._workers[slot] = self._launch(slot)
        with suppress(FileNotFoundError):
            os.truncate(worker.stderr, 0)
        worker.begin(task)
        # `wait` notices a worker that has died meanwhile.
        with suppress(BrokenPipeError, ConnectionResetError):
            worker.pipe.send((function, args))

    def wait(self, seconds: float) -> Iterator[Outcome]:
        """The tasks that came to an end, after at most this many seconds."""
        busy = self._busy()
        ready = wait([worker.pipe for _, worker in busy], seconds)
        for slot, worker in busy:
            if worker.pipe in ready:
                yield self._receive(slot, worker)
            elif reason := worker.endless(self.limits.seconds):
                yield self._stop(slot, worker, reason)
            elif worker.rss_bytes > self.limits.rss_bytes:
                yield self._stop(slot, worker, f"more than {self.limits.rss_bytes >> 20} MiB of memory")

    def _busy(self) -> list[tuple[int, Worker]]:
        return [(slot, worker) for slot, worker in enumerate(self._workers) if worker and worker.task is not None]

    def _launch(self, slot: int) -> Worker:
        # Not at the top: the worker's program imports nothing of ours before it is pinned.
        from synth3dlanes.scene.settings import SCRATCH

        ours, theirs = Pipe()
        stderr = self._scratch / f"{slot}.txt"
        core = self._cores[slot % len(self._cores)]
        with stderr.open("ab") as stream:
            process = _of_lasting_thread(
                lambda: subprocess.Popen(
                    [sys.executable, "-P", __file__, str(theirs.fileno()), str(core)],
                    stdin=subprocess.DEVNULL,
                    stdout=stream,
                    stderr=stream,
                    pass_fds=[theirs.fileno()],
                    env={
                        **MEMORY,
                        **os.environ,
                        PARENT: str(os.getpid()),
                        # What a killed worker leaves goes with the rest.
                        **dict.fromkeys((SCRATCH, "TMPDIR"), str(self._scratch)),
                        **self.masks[slot % len(self.masks)],
                    },
                    start_new_session=True,
                )
            )
        theirs.close()
        with suppress(BrokenPipeError):
            ours.send([path for path in sys.path if not BLENDERS_PATH.search(path)])
        return Worker(process, ours, stderr)

    def _receive(self, slot: int, worker: Worker) -> Outcome:
        task = worker.task
        try:
            status, value, reason = worker.pipe.recv()
        except (EOFError, ConnectionResetError, pickle.UnpicklingError):
            code = worker.process.wait()
            killed = code in (-signal.SIGKILL, -signal.SIGTERM)
            return self._stop(slot, worker, f"worker ended with {code}", "killed" if killed else "failed")
        worker.task, worker.n_tasks = None, worker.n_tasks + 1
        if worker.n_tasks >= self.limits.tasks or worker.rss_bytes > self.limits.rss_bytes:
            self._retire(slot)
        return Outcome(task, status, value, reason)

    def _stop(self, slot: int, worker: Worker, reason: str, status: Literal["killed", "failed"] = "failed") -> Outcome:
        self._retire(slot)
        stderr = worker.stderr.read_bytes()[-STDERR_TAIL:].decode("utf-8", "replace")
        last_words = "".join(f": {line}" for line in stderr.strip().splitlines()[-1:])
        return Outcome(worker.task, status, reason=reason + last_words, stderr=stderr)

    def _retire(self, slot: int) -> None:
        worker, self._workers[slot] = self._workers[slot], None
        if worker:
            worker.process.kill()
            worker.process.wait()
            worker.pipe.close()


def _of_lasting_thread(start: Callable[[], subprocess.Popen[bytes]]) -> subprocess.Popen[bytes]:
    """Start a process from a thread that lasts as long as this process: Linux ends a worker with the thread, not the
    process, that started it (`PR_SET_PDEATHSIG`)."""
    if current_thread() is main_thread():
        return start()
    started: SimpleQueue[subprocess.Popen[bytes] | OSError] = SimpleQueue()
    _starts(os.getpid()).put((start, started))
    found = started.get()
    if isinstance(found, OSError):
        raise found
    return found


@cache
def _starts(pid: int) -> SimpleQueue[tuple[Callable[[], Any], SimpleQueue[Any]]]:
    """What a thread of the process of this number is to start, each with the queue for the answer. A fork has no thread
    of its parent's."""
    asked: SimpleQueue[tuple[Callable[[], Any], SimpleQueue[Any]]] = SimpleQueue()

    def serve() -> None:
        while True:
            start, started = asked.get()
            try:
                started.put(start())
            except OSError as error:
                started.put(error)

    Thread(target=serve, name=f"starts of {pid}", daemon=True).start()
    return asked


def call(limits: Limits, function: Callable[..., Any], *args: Any, pinned: bool = False) -> Outcome:
    """Run `function(*args)` in a worker process, so that this process does not load Blender."""
    with Pool(1, limits, pinned) as pool:
        return ask(pool, function, *args)


def ask(pool: Pool, function: Callable[..., Any], *args: Any) -> Outcome:
    """Run `function(*args)` in a free worker of a pool, and wait for it alone."""
    pool.start(function.__name__, function, *args)
    while True:
        for outcome in pool.wait(1.0):
            return outcome


def _lease(n: int, cores: Sequence[int]) -> tuple[list[int], list[int]]:
    """Locks (descriptors) on up to `n` cores that no other pool on this machine has, and all cores in the order to pin
    workers to."""
    leases: dict[int, int] = {}
    for core in cores:
        path = Path(tempfile.gettempdir(), f"synth3dlanes-{os.getuid()}-core-{core}")
        # Other users may write there: a link, or a file of theirs, counts as a core in use.
        with suppress(OSError):
            lease = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
            try:
                fcntl.flock(lease, fcntl.LOCK_EX | fcntl.LOCK_NB)
                leases[core] = lease
            except OSError:
                os.close(lease)
        if len(leases) == n:
            break
    return list(leases.values()), [*leases, *(core for core in cores if core not in leases)]


def _work(pipe: Connection) -> None:
    """Do tasks until the parent hangs up."""
    sys.path[:] = pipe.recv()
    while True:
        try:
            function, args = pipe.recv()
        except EOFError:
            return
        try:
            reply = ("done", function(*args), "")
        except (OSError, ImportError) as error:
            full = isinstance(error, OSError) and error.errno in DISK_FULL
            # Not at the top: the worker's program imports nothing of ours before it is pinned.
            from synth3dlanes.system.errors import told
            from synth3dlanes.system.system_libraries import install_hint

            reason = f"{told(error)}{install_hint(str(error))}"
            reply = ("full" if full else "broken", None, reason)
        pipe.send(reply)


def _crash(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print what happened and exit at once: Blender may crash or hang in an orderly exit."""
    traceback.print_exception(kind, error, trace)
    sys.stderr.flush()
    os._exit(1)


def _main() -> None:
    descriptor, core = map(int, sys.argv[1:])
    if core >= 0:
        os.sched_setaffinity(0, {core})
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    # For a parent that was killed before, the death signal comes too late.
    if os.environ.get(PARENT, str(os.getppid())) != str(os.getppid()):
        os._exit(1)
    sys.excepthook = _crash
    gc.set_threshold(OBJECTS_BETWEEN)
    _work(Connection(descriptor))
    os._exit(0)


if __name__ == "__main__":
    _main()
