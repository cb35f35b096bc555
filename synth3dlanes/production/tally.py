"""Count, log and report what a run has done; every kind of run uses this."""

import math
import os
import signal
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from synth3dlanes.dataset.destination import RunLog
from synth3dlanes.production.events import Event, duration
from synth3dlanes.system.words import counted

# Seconds that samples in progress may take once a run is to stop.
GRACE_S = 20.0


@dataclass(frozen=True)
class RunReport:
    """The result of a run: the samples that it made, the samples that are there of those asked for, and what went
    wrong. `restarts` counts workers that were replaced after a fault. `stop_signal` is the number of the signal that
    ended the run, 0 for none."""

    made: int
    done: int
    asked: int
    set_aside: tuple[int, ...]
    stop_signal: int
    problem: str
    restarts: int
    seconds: float

    def text(self) -> str:
        """The report as one line of text."""
        pace = f" in {duration(self.seconds)} ({3600 * self.made / self.seconds:,.0f} images/h)" if self.made else ""
        faults = {"restarts of workers": self.restarts, "samples set aside": len(self.set_aside)}
        told = "".join(f", {count} {what}" for what, count in faults.items() if count)
        return f"{self.done:,} of {counted(self.asked, 'sample')}, {self.made:,} made now{pace}{told}"

    @property
    def exit_code(self) -> int:
        """0 if all samples are there; 1 if some are missing; 128 plus the number of the signal that stopped the run:
        129 SIGHUP, 130 SIGINT, 143 SIGTERM."""
        if self.problem or self.set_aside:
            return 1
        return 128 + self.stop_signal if self.stop_signal else 0


def total(reports: Sequence[RunReport]) -> RunReport:
    """The report of several runs after each other."""
    return RunReport(
        sum(report.made for report in reports),
        sum(report.done for report in reports),
        sum(report.asked for report in reports),
        tuple(index for report in reports for index in report.set_aside),
        max((report.stop_signal for report in reports), default=0),
        next((report.problem for report in reports if report.problem), ""),
        sum(report.restarts for report in reports),
        sum(report.seconds for report in reports),
    )


class RunTally:
    """Counts the events of a run, passes each to `notify`, and writes it to the log.

    `missing` are the indices of the samples to be made, out of `asked`. The code that makes samples calls `tell`, sets
    `problem` if the run cannot go on, and ends once `is_stopping` is true, at the latest at `stop_by`.
    """

    def __init__(
        self, asked: int, missing: Iterable[int], notify: Callable[[Event], None], log: RunLog | None = None
    ) -> None:
        self.asked, self.missing = asked, set(missing)
        self.problem, self.stop_signal, self.stop_by = "", 0, math.inf
        self._is_acknowledged = False
        self._missing_before = frozenset(self.missing)
        self._made, self._set_aside, self._restarts = set[int](), set[int](), 0
        self._notify, self._log, self._log_problem = notify, log, ""
        self._began, self._first = time.monotonic(), 0.0

    @property
    def is_stopping(self) -> bool:
        """Whether no further sample shall be begun."""
        return bool(self.stop_signal or self.problem)

    def interrupt(self, number: int = signal.SIGINT) -> None:
        """Ask the run to end, because of a signal. Safe in a signal handler."""
        self.stop_signal = number
        self.stop_by = time.monotonic() + GRACE_S

    def acknowledge(self) -> None:
        """Report once that the run is about to end, if it was interrupted. The code that makes samples calls it."""
        if self.stop_signal and not self._is_acknowledged:
            self._is_acknowledged = True
            self.tell("stop", "interrupted: finishing the samples in progress; Ctrl-C again stops at once")

    def tell(self, kind: str, message: str, /, **details: Any) -> None:
        """Record an event. Details that are counted: `index` of a "sample" or "set_aside"; `lost`, the indices that a
        "shard" proved to lack; `found`, the indices that a "resume" has from an earlier run."""
        self._count(kind, details)
        event = self._event(kind, message, details)
        # A full disk may cost lines of the log, not the run.
        with suppress(OSError):
            if self._log:
                self._log.write(event.line().encode())
        self._notify(event)
        if self._log and (kind == "end" or (kind == "shard" and not self._log_problem)):
            self._log_problem = self._log.save(is_last=kind == "end")
            if kind == "end" and self._log_problem:
                self._notify(self._event("pause", f"the log is not in the store: {self._log_problem}", {}))

    def recount(self, missing: Iterable[int]) -> None:
        """Count the samples at the destination, because events may have been lost."""
        self.missing = set(missing)
        self._made = set(self._missing_before - self.missing)

    def report(self) -> RunReport:
        """The report of the run up to now."""
        return RunReport(
            len(self._made),
            self.asked - len(self.missing),
            self.asked,
            tuple(sorted(self._set_aside)),
            self.stop_signal,
            self.problem,
            self._restarts,
            time.monotonic() - self._began,
        )

    def _count(self, kind: str, details: dict[str, Any]) -> None:
        if kind == "sample":
            self._first = self._first or time.monotonic()
            self._made.add(details["index"])
            self.missing.discard(details["index"])
            self._set_aside.discard(details["index"])
        elif kind == "set_aside":
            self._set_aside.add(details["index"])
        elif kind == "restart":
            self._restarts += 1
        elif kind == "shard":
            self.missing.update(details["lost"])
        elif kind == "resume":
            self.missing.difference_update(details.get("found", ()))

    def _event(self, kind: str, message: str, details: dict[str, Any]) -> Event:
        """An event with the rate, which counts from the first sample on, so that the start of workers does not lower
        it."""
        made, now = len(self._made), time.monotonic()
        rate = (made - 1) / (now - self._first) if made > 1 else None
        eta_s = (len(self.missing) - len(self._set_aside)) / rate if rate else None
        done, seconds = self.asked - len(self.missing), round(now - self._began, 3)
        return Event(kind, message, done, self.asked, len(self._set_aside), seconds, rate, eta_s, details)


def log_name(split: str) -> str:
    """The name of a new log: the split, the time and the process."""
    return f"{split}-{datetime.now(UTC):%Y%m%dT%H%M%S}-{os.uname().nodename}-{os.getpid()}.jsonl"
