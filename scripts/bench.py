"""Measure every row of docs/bench.json on a quiet machine: `python -m scripts.bench`. Takes some twenty minutes."""

import json
import sys
from pathlib import Path

from synth3dlanes.production.bench import bench
from synth3dlanes.production.job import Job
from synth3dlanes.system.files import write

# Parameters, samples per pixel, frames of a clip.
ROWS = (("appendix_i", 4, 1), ("appendix_i", 1, 1), ("streets", 4, 1), ("streets", 1, 1), ("streets", 1, 12))
N, WORKERS, FPS = 40, 2, 10.0


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")


def main() -> None:
    """Measure the rows and write them."""
    found = []
    for params, samples, frames in ROWS:
        clip = {"frames": frames, "fps": FPS} if frames > 1 else {}
        recipe = Job(params=params, split="bench", samples=samples, device="cpu", **clip).recipe()
        found.append(bench(params, recipe, N, WORKERS, [{}], _say).document())
    path = Path(__file__).parents[1] / "docs" / "bench.json"
    write(path, f"{json.dumps({'rows': found}, indent=1)}\n".encode())


if __name__ == "__main__":
    main()
