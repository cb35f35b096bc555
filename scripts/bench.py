"""Measure rows of docs/bench.json on a quiet machine: `python -m scripts.bench [NUMBER ...]`, by their places in ROWS.
All of them, without numbers, take about ten minutes on two idle cores."""

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

from synth3dlanes.formats.opendrive import opendrive
from synth3dlanes.production.bench import bench
from synth3dlanes.production.job import Job
from synth3dlanes.system.files import write
from synth3dlanes.system.scratch import scratch


class Row(NamedTuple):
    """What a row measures: parameters, samples per pixel, frames of a clip, views of a world, whether on a map, which
    is a drawn town as we export it; by how many workers, and of how many images."""

    params: str
    samples: int
    frames: int = 1
    views: int = 1
    on_map: bool = False
    workers: int = 2
    n: int = 20


ROWS = (
    *(Row(params, samples) for params in ("appendix_i", "streets") for samples in (4, 1)),
    Row("streets", 1, frames=12, n=24),
    *(Row("town", samples, n=16) for samples in (4, 1)),
    *(Row("appendix_i", samples, on_map=True, n=16) for samples in (4, 1)),
    # Workers draw the worlds of the samples that they get, so one has all views of a world.
    *(Row(params, 1, views=k, workers=1, n=16) for params in ("appendix_i", "town") for k in (1, 2, 4, 8)),
)
FPS, MAP = 10.0, "town.xodr"
PATH = Path(__file__).parents[1] / "docs" / "bench.json"


def measured(row: Row, folder: Path) -> dict[str, Any]:
    """The result of a row. The map is written to a folder."""
    fields: dict[str, Any] = {"frames": row.frames, "fps": FPS} if row.frames > 1 else {}
    if row.views > 1:
        fields["views_per_scene"] = row.views
    if row.on_map:
        fields["map"] = str(folder / MAP)
        write(folder / MAP, opendrive(Job(params="town").recipe().world(0), "town").encode())
    recipe = Job(params=row.params, split="bench", samples=row.samples, device="cpu", **fields).recipe()
    return bench(row.params, recipe, row.n, row.workers, [{}], _say).document()


def main(numbers: list[int]) -> None:
    """Measure rows and put them in their places."""
    rows = json.loads(PATH.read_text())["rows"]
    found = dict(enumerate(rows))
    with scratch() as folder:
        for number in numbers:
            _say(f"{number}: {ROWS[number]}")
            found[number] = measured(ROWS[number], folder)
            write(PATH, f"{json.dumps({'rows': [found[i] for i in sorted(found)]}, indent=1)}\n".encode())


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")


if __name__ == "__main__":
    main([int(number) for number in sys.argv[1:]] or list(range(len(ROWS))))
