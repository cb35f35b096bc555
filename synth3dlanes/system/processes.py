"""Fresh processes that share one task, such as checking or exporting samples."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from threading import Lock, current_thread, main_thread
from typing import Any

from synth3dlanes.system.errors import WorkerError
from synth3dlanes.system.machine import workers_here

STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Linear algebra in numpy and scipy has a thread for each core, in each process, which wait for each other.
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
# The program is hidden by one thread at a time: a second one would find, and put back, what is hidden.
_PROGRAM = Lock()


def n_workers(asked: int, n_tasks: int) -> int:
    """The number of processes for some tasks: as many as asked for; 0 is as many as there is room for, or one per task
    where these are fewer."""
    return asked or max(1, min(workers_here(), n_tasks))


class QuietPool(ProcessPoolExecutor):
    """A pool whose processes end without a word when Ctrl-C is pressed, also while they start.

    The terminal sends the signal to all processes. Python would show a traceback of each, so they start with the signal
    blocked, and die of it as soon as they have taken back Python's handler; the process that has the pool tells.
    """

    def submit(self, task: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a task; processes that start for it inherit what is blocked here."""
        with _held_back(), _program_hidden():
            blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                return super().submit(task, *args, **kwargs)
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


@contextmanager
def _held_back() -> Iterator[None]:
    """Heed signals only afterwards: a process whose start is cut off shows a traceback of its own."""
    if current_thread() is not main_thread():
        yield
        return
    came: list[int] = []
    handlers = {number: handler for number in STOPPING if callable(handler := signal.getsignal(number))}
    for stopping in handlers:
        signal.signal(stopping, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for stopping, handler in handlers.items():
            signal.signal(stopping, handler)
        # Also where the processes died of it first, which breaks the pool.
        for number in came[:1]:
            handlers[signal.Signals(number)](number, None)


@contextmanager
def _program_hidden() -> Iterator[None]:
    """Processes that start here do not run the user's program again, as Python's do for functions that it defines: all
    tasks are functions of modules, and a program without `if __name__ == "__main__"` would begin anew in each."""
    with _PROGRAM:
        program = vars(sys.modules["__main__"])
        hidden = {name: program[name] for name in program.keys() & {"__spec__", "__file__"}}
        program |= dict.fromkeys(hidden)
        try:
            yield
        finally:
            program |= hidden


def _begin() -> None:
    """What a process does before it imports anything large."""
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def process_pool(workers: int | None = None) -> Iterator[ProcessPoolExecutor]:
    """A pool of fresh processes, by default as many as there are cores and memory for. Tasks that have not begun when
    the pool closes are dropped. Raises WorkerError if one of the processes is killed."""
    pool = QuietPool(workers or workers_here(), mp_context=get_context("spawn"), initializer=_begin)
    try:
        yield pool
    except BrokenProcessPool:
        raise WorkerError("a worker process was killed (the system may be short of memory); run again") from None
    finally:
        pool.shutdown(cancel_futures=True)
