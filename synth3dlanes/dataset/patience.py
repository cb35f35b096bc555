"""What to do while a store cannot be reached: wait with growing pauses, report it, and give up in the end."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from threading import Thread
from typing import TypeVar

from synth3dlanes.system.errors import OutageError

FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 60.0
LIMIT_S = 1800.0
POLL_S = 0.2
# How long a run that is to end goes on with what it is just sending.
STOPPING_S = 60.0

Result = TypeVar("Result")


def _silent(kind: str, message: str, /) -> None:
    """Tell nobody."""


@dataclass(frozen=True)
class Patience:
    """How long to wait for an outage to end (0: not at all); the function that is told, with "pause" or "resume" and a
    message; and the function that says whether the run shall end."""

    limit_s: float = 0.0
    tell: Callable[[str, str], None] = _silent
    is_stopping: Callable[[], bool] = bool

    def insist(self, place: str, call: Callable[[], Result], kept: str) -> Result:
        """The result of `call`, repeated while the store cannot be reached. `kept` says where samples are meanwhile.

        Raises OutageError after the limit, or at once if the run is to end; passes on all other errors of `call`.
        """
        began, stop_by, pause_s, is_waiting = time.monotonic(), math.inf, FIRST_PAUSE_S, False

        def gives_up() -> bool:
            nonlocal stop_by
            if self.is_stopping():
                stop_by = min(stop_by, time.monotonic() + (0.0 if is_waiting else STOPPING_S))
            return time.monotonic() > stop_by

        while True:
            try:
                result = attempt(place, call, gives_up)
                break
            except OutageError as error:
                left_s = began + self.limit_s - time.monotonic()
                if left_s <= 0 or self.is_stopping():
                    raise
                if not is_waiting:
                    is_waiting = True
                    limit = f"at most {self.limit_s / 60:.0f} min"
                    self.tell(
                        "pause", f"{error}; waiting for the store {since(began)}, {limit}; {kept}; Ctrl-C ends the run"
                    )
            self._pause(min(pause_s, left_s))
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
        if is_waiting:
            self.tell("resume", f"the store answers again after {time.monotonic() - began:.0f} s")
        return result

    def _pause(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until and not self.is_stopping():
            time.sleep(min(POLL_S, max(0.0, until - time.monotonic())))


def since(began: float) -> str:
    """The time since `began` (of `time.monotonic`), as text."""
    return f"since {datetime.now(UTC) - timedelta(seconds=time.monotonic() - began):%H:%M:%S} UTC"


def attempt(place: str, call: Callable[[], Result], gives_up: Callable[[], bool]) -> Result:
    """The result of `call`. Raises OutageError for this place once waiting is over. A silent store can block a call for
    minutes, so the call runs in a thread that this process can abandon."""
    results: list[Result] = []
    errors: list[BaseException] = []

    def go() -> None:
        try:
            results.append(call())
        except BaseException as error:  # noqa: BLE001 - it is raised by the thread that waits
            errors.append(error)

    thread = Thread(target=go, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(POLL_S)
        if thread.is_alive() and gives_up():
            raise OutageError(f"{place}: has not answered yet")
    if errors:
        raise errors[0]
    return results[0]
