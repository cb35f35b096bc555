"""Work ahead of the one that uses it, by a thread or by processes, each behind a pipe of its own.

Batch i is made by worker i modulo their number, and batches are read in order. So workers share nothing: no memory that
the system bounds (`/dev/shm`), and no lock that a killed one could hold. The end of a pipe tells of a worker's end.
"""

import io
import multiprocessing
import os
import pickle
import signal
import struct
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing.context import ForkProcess
from typing import Any, BinaryIO, TypeVar, cast

import numpy as np
import torch
from jaxtyping import Shaped
from torch import Tensor

from synth3dlanes.system.errors import Synth3dlanesError, WorkerError

PREFETCHED_BATCHES = 2
"""Batches that wait in this process; each worker has one more."""
SIZE = struct.Struct("<Q")
IN_LINE_BYTES = 1 << 16
"""Smaller arrays are pickled; larger ones follow the pickle, to be read to where they stay."""
ADVICE = "rerun to resume; if it happens again, use fewer workers (--set workers=1) or a smaller batch"
T = TypeVar("T")
ImageProgress = Callable[[int, int | None], None]
"""Gets how many are done, and how many there are, None if that is not known."""


def told(items: Iterable[T], total: int | None, progress: ImageProgress | None) -> Iterator[T]:
    """The items; `progress` gets how many were taken, and how many there are in all."""
    for done, item in enumerate(items, start=1):
        yield item
        if progress is not None:
            progress(done, total)


def ahead(items: Iterable[T], n: int = 1) -> Iterator[T]:
    """The same items, of which a thread makes up to `n` before they are asked for. An error is raised where its item
    would come."""
    end, rest = object(), iter(items)
    with ThreadPoolExecutor(1) as thread:
        made = deque(thread.submit(next, rest, end) for _ in range(n))
        try:
            while (item := made.popleft().result()) is not end:
                made.append(thread.submit(next, rest, end))
                yield cast(T, item)
        finally:
            for waiting in made:
                waiting.cancel()


@dataclass(frozen=True, eq=False)
class _Worker:
    process: ForkProcess
    pipe: BinaryIO

    def receive(self, is_gpu: bool) -> Any:
        """What the worker makes next; raise what it raised, or WorkerError if it is gone."""
        try:
            made = _read(self.pipe)
        except EOFError:
            self.process.join()
            code = self.process.exitcode or 0
            how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
            cause = ", perhaps because memory ran out" if code == -signal.SIGKILL else ""
            raise WorkerError(f"workers: a loader's worker {how}{cause}; {ADVICE}") from None
        if isinstance(made, (Synth3dlanesError, OSError)):
            raise made
        return _pinned(made) if is_gpu else made


def made_ahead(make: Callable[[int], Any], n: int, n_workers: int, device: torch.device) -> Iterator[Any]:
    """`make` of each number below `n`, in order, by `n_workers` processes, or by this one if that is 0. Tensors in
    named tuples come in page-locked memory if the device is a GPU.

    Raises the errors of ours and of the system that `make` raises, and WorkerError where a worker ends before its work
    is done.
    """
    if not n_workers:
        yield from map(make, range(n))
        return
    with ExitStack() as ending:
        workers: list[_Worker] = []
        for number in range(n_workers):
            workers.append(_start(make, range(number, n, n_workers), workers))
            ending.callback(workers[-1].pipe.close)
        reader = ThreadPoolExecutor(1, initializer=_use, initargs=(device,))
        ending.callback(reader.shutdown, cancel_futures=True)
        # Runs first: without its worker, a thread that reads from it comes to an end.
        ending.callback(_end, [worker.process for worker in workers])
        read = deque[Future[Any]]()
        for number in range(n):
            read.append(reader.submit(workers[number % n_workers].receive, device.type == "cuda"))
            if len(read) == PREFETCHED_BATCHES:
                yield read.popleft().result()
        while read:
            yield read.popleft().result()


def _start(make: Callable[[int], Any], numbers: range, before: list[_Worker]) -> _Worker:
    reading, writing = os.pipe()
    pipes = [reading, *(worker.pipe.fileno() for worker in before)]
    process = multiprocessing.get_context("fork").Process(
        target=_work, args=(make, numbers, writing, pipes), name=f"loader {numbers.start}", daemon=True
    )
    process.start()
    os.close(writing)
    return _Worker(process, open(reading, "rb"))


def _work(make: Callable[[int], Any], numbers: range, writing: int, pipes: list[int]) -> None:
    """The life of a worker. It ends with the run, whose end of the pipe is then the last one to be closed."""
    for pipe in pipes:
        os.close(pipe)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    torch.set_num_threads(1)
    with suppress(BrokenPipeError), os.fdopen(writing, "wb") as stream:
        for number in numbers:
            try:
                _write(stream, make(number))
            except (Synth3dlanesError, OSError) as error:
                _write(stream, error)
            except MemoryError:
                _write(stream, WorkerError(f"workers: a loader's worker found no memory; {ADVICE}"))


def _end(processes: list[ForkProcess]) -> None:
    for process in processes:
        process.kill()
    for process in processes:
        process.join()


def _use(device: torch.device) -> None:
    """Page-locked memory belongs to the device of the thread that asks for it."""
    if device.type == "cuda" and device.index is not None:
        torch.cuda.set_device(device)


def _pinned(value: Any) -> Any:
    """A tensor, or a named tuple with such, in page-locked memory, from which copies to a GPU run beside its work."""
    if isinstance(value, Tensor):
        return value.pin_memory()
    return type(value)(*map(_pinned, value)) if hasattr(value, "_fields") else value


class _Pickler(pickle.Pickler):
    """Tensors as numpy arrays in the order of their memory, which pickle can leave to be sent as they are."""

    def reducer_override(self, value: Any) -> Any:
        if not isinstance(value, Tensor):
            return NotImplemented
        axes = np.argsort([-step for step in value.stride()], kind="stable").tolist()
        return _tensor, (value.permute(axes).numpy(), tuple(np.argsort(axes).tolist()))


def _tensor(array: Shaped[np.ndarray, "..."], axes: tuple[int, ...]) -> Tensor:
    return torch.from_numpy(array).permute(axes)


def _write(stream: BinaryIO, value: Any) -> None:
    arrays: list[memoryview] = []

    def is_in_line(buffer: pickle.PickleBuffer) -> bool:
        is_small = buffer.raw().nbytes < IN_LINE_BYTES
        if not is_small:
            arrays.append(buffer.raw())
        return is_small

    pickled = io.BytesIO()
    _Pickler(pickled, protocol=5, buffer_callback=is_in_line).dump(value)
    parts = [pickled.getbuffer(), *arrays]
    stream.write(SIZE.pack(len(parts)) + b"".join(SIZE.pack(part.nbytes) for part in parts))
    for part in parts:
        stream.write(part)
    stream.flush()


def _read(stream: BinaryIO) -> Any:
    """What `_write` wrote; raise EOFError where there is no more, or less."""
    (n_parts,) = SIZE.unpack(_filled(stream, SIZE.size))
    sizes = [size for (size,) in SIZE.iter_unpack(_filled(stream, n_parts * SIZE.size))]
    pickled, *arrays = [_filled(stream, size) for size in sizes]
    return pickle.loads(pickled, buffers=arrays)


def _filled(stream: BinaryIO, size: int) -> Any:
    room = np.zeros(size, np.uint8)
    if stream.readinto(room) < size:  # type: ignore[attr-defined]
        raise EOFError
    return room.data
