"""Fresh processes that share one task, such as checking or exporting samples."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context

from synth3dlanes.errors import WorkerError


@contextmanager
def process_pool(workers: int | None = None) -> Iterator[ProcessPoolExecutor]:
    """A pool of fresh processes, by default one per core; what is not begun when it is left is dropped. Raises
    WorkerError where somebody kills one of them."""
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        yield pool
    except BrokenProcessPool:
        raise WorkerError("a worker process was killed (the system may be short of memory); run again") from None
    finally:
        pool.shutdown(cancel_futures=True)
