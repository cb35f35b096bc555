"""What samples of a split took in its last run, by the run's log. Reading logs is the only side effect."""

import json
import statistics
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synth3dlanes.system.errors import Synth3dlanesError
from synth3dlanes.system.files import read_bounded

# Least number of samples that say something, and the number of the last ones that are used.
LEAST_SAMPLES, MOST_SAMPLES = 5, 500
MAX_LOG_BYTES = 1 << 28


@dataclass(frozen=True)
class Measured:
    """Seconds that a worker took for a sample, and bytes of it, as medians."""

    seconds: float
    bytes: float


def measured(root: Path, split: str) -> Measured | None:
    """What the last run with enough samples has measured in a data set here; None where there is none."""
    for path in sorted((root / "logs").glob(f"{split}-*.jsonl"), reverse=True):
        samples = list(_samples(path))[-MOST_SAMPLES:]
        if len(samples) >= LEAST_SAMPLES:
            return Measured(*(statistics.median(sample[name] for sample in samples) for name in ("seconds", "bytes")))
    return None


def _samples(path: Path) -> Iterator[dict[str, Any]]:
    """The details of the samples in a log; a line that a killed run has left unfinished is none."""
    try:
        lines = read_bounded(path, MAX_LOG_BYTES).splitlines()
    except (OSError, Synth3dlanesError):
        return
    for line in lines:
        try:
            event = json.loads(line)
            details = event["details"] if event["kind"] == "sample" else {}
        except (ValueError, LookupError, TypeError):
            continue
        if all(isinstance(details.get(name), int | float) for name in ("seconds", "bytes")):
            yield details
