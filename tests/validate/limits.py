"""Measure anew, on clean data sets, every number that a check holds against limits, and say which limits no longer fit.

    python -m tests.validate.limits DIR DIR ...

A row a number: its limits, in how many values, from where to where they lie, the sample of the worst, and what is to
be done. A limit fits if no value of a clean sample is beyond it; it is tight if one uses up most of it.
"""

import argparse
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from synth3dlanes.dataset.read import Reader
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Bounded
from tests.validate.examining import evidence_of, examine

COLUMNS = ("number", "least", "most", "values", "from", "to", "worst sample", "")
# A value that uses up more than this share of a limit makes it tight.
TIGHT = 0.9


@dataclass
class Range:
    """What was found of one number, and the sample of each."""

    values: list[Bounded] = field(default_factory=list)
    samples: list[str] = field(default_factory=list)

    def verdict(self) -> str:
        """Whether its limits fit."""
        worst = max(map(use, self.values))
        return "no longer fits" if worst > 1 else "tight" if worst > TIGHT else ""

    def row(self, name: str) -> str:
        """A row of the table."""
        worst = int(np.argmax([use(value) for value in self.values]))
        ends = self.values[worst].least, self.values[worst].most
        found = min(value.value for value in self.values), max(value.value for value in self.values)
        numbers = [*(f"{value:.4g}" for value in ends), str(len(self.values)), *(f"{value:.4g}" for value in found)]
        return f"| {' | '.join([name, *numbers, self.samples[worst], self.verdict()])} |"


def use(number: Bounded) -> float:
    """The share of its limit that a value uses up; above 1 it is beyond."""
    value, least, most = number.value, number.least, number.most
    if np.isfinite(least) and np.isfinite(most):
        return abs(2 * value - least - most) / (most - least)
    if np.isfinite(most):
        return value / most if most > 0 else 1 + value - most
    return least / max(value, 1e-9) if least > 0 else 1 + least - value


def measured(folders: Iterable[Path]) -> dict[str, Range]:
    """All numbers of all samples, by name."""
    ranges: dict[str, Range] = {}
    for name, evidence in samples(folders):
        for result in examine(evidence):
            if isinstance(result, Bounded):
                found = ranges.setdefault(result.name, Range())
                found.values.append(result)
                found.samples.append(name)
    return ranges


def samples(folders: Iterable[Path]) -> Iterator[tuple[str, Evidence]]:
    """The evidence of every sample."""
    for folder in folders:
        for split in sorted({path.parent for path in folder.glob("*/*.parquet")}):
            reader = Reader(str(split))
            for i in range(len(reader)):
                yield f"{folder.name}:{reader.key(i)}", evidence_of(reader.raw(i))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 1 if a limit no longer fits."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR")
    ranges = measured(parser.parse_args(arguments).folders)
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")  # noqa: T201
    for name, found in sorted(ranges.items()):
        print(found.row(name))  # noqa: T201
    return int(any(value.is_beyond for found in ranges.values() for value in found.values))


if __name__ == "__main__":
    raise SystemExit(main())
