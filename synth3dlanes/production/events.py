"""What a run reports while it works. Plain data; quick to import."""

import json
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

# All kinds of events, and the severity of each, named as in `logging`.
LEVELS = ("debug", "info", "warning", "error")
LEVEL_OF = {
    **dict.fromkeys(("sample", "shard"), "debug"),
    **dict.fromkeys(("start", "resume", "end"), "info"),
    **dict.fromkeys(("restart", "pause", "stop"), "warning"),
    "set_aside": "error",
}


@dataclass(frozen=True)
class Event:
    """One event, and the state of the run at that time. `eta_s` is None until there is a rate. LEVEL_OF has the
    kinds."""

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
        """Whether the event is of this level or a more severe one."""
        return LEVELS.index(LEVEL_OF[self.kind]) >= LEVELS.index(level)

    def line(self) -> str:
        """The event as a line of the log."""
        return json.dumps({"time": datetime.now(UTC).isoformat(timespec="milliseconds"), **vars(self)}) + "\n"


def duration(seconds: float) -> str:
    """Seconds as hours, minutes and seconds, such as 0:01:05."""
    return str(timedelta(seconds=round(seconds)))
