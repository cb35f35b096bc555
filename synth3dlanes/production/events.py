"""What a run tells while it goes. Plain data, quick to import."""

import json
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

# How much it matters that something happened, as the levels of `logging` are called; these are all kinds of events.
LEVELS = ("debug", "info", "warning", "error")
LEVEL_OF = {
    **dict.fromkeys(("sample", "shard"), "debug"),
    **dict.fromkeys(("start", "resume", "end"), "info"),
    **dict.fromkeys(("restart", "pause", "stop"), "warning"),
    "set_aside": "error",
}


@dataclass(frozen=True)
class Event:
    """One thing that happened, and where the run stands; `eta_s` is None until there is something to go by.

    Kinds are those of LEVEL_OF.
    """

    kind: str
    message: str
    done: int
    asked: int
    set_aside: int
    seconds: float
    rate_per_s: float | None
    eta_s: float | None
    details: dict[str, Any]

    def matters(self, level: str) -> bool:
        """Whether it is of this level or a graver one."""
        return LEVELS.index(LEVEL_OF[self.kind]) >= LEVELS.index(level)

    def line(self) -> str:
        """The event as a line of the log."""
        return json.dumps({"time": datetime.now(UTC).isoformat(timespec="milliseconds"), **vars(self)}) + "\n"


def duration(seconds: float) -> str:
    """Hours, minutes and seconds, as 0:01:05."""
    return str(timedelta(seconds=round(seconds)))
