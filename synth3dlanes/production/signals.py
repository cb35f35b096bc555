"""SIGINT, SIGTERM and SIGHUP as requests to stop in order."""

import os
import signal
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import current_thread, main_thread
from types import FrameType
from typing import Any

STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignal(KeyboardInterrupt):
    """A signal asks to stop at once; `number` is its number."""

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__()
        self.number = number


def stop(number: int, _: FrameType | None = None) -> None:
    """A signal handler that raises StopSignal."""
    leave_closed_terminal(number)
    raise StopSignal(number)


def handle(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> dict[int, Any]:
    """Install a handler for all stopping signals but the ignored ones (nohup ignores SIGHUP). Returns the previous
    handlers."""
    before: dict[int, Any] = {number: signal.getsignal(number) for number in STOPPING}
    for number, old in before.items():
        if old is not signal.SIG_IGN:
            signal.signal(number, handler)
    return before


@contextmanager
def stopping_on_signals(request: Callable[[int], None]) -> Iterator[None]:
    """Call `request` with the number of the first stopping signal. The second one raises StopSignal."""
    stopped = False

    def handler(number: int, _: FrameType | None) -> None:
        nonlocal stopped
        if stopped:
            stop(number)
        stopped = True
        leave_closed_terminal(number)
        request(number)

    if current_thread() is not main_thread():
        yield
        return
    before = handle(handler)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def leave_closed_terminal(number: int) -> None:
    """After SIGHUP, discard output to the terminal that was closed, because writing to it fails."""
    if number != signal.SIGHUP:
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        with suppress(OSError):
            if stat.S_ISCHR(os.fstat(stream).st_mode) and not os.isatty(stream):
                os.dup2(nowhere, stream)
    os.close(nowhere)
