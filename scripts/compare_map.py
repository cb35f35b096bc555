"""Draw scenes on OpenDRIVE files, and compare their labels with a second reading of the files: a table.

    python -m scripts.compare_map maps/*.xodr --scenes 4 [--render 2]

For every file: its roads, how many of them are read, what is left out, how many scenes cannot be drawn, the farthest
that a point of the labels, or of any lane of the file, is from the file's own lines (tests/maps/standard.py, which
shares nothing with the package) from above and in height, and the processor time of a scene before its picture. With
--render, that many scenes are rendered and checked by `validate`, whose problems are counted.
"""

import argparse
import json
import multiprocessing
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.maps.read import read_map
from synth3dlanes.truth.ground_truth import label
from tests.maps.comparing import Apart, apart, everywhere
from tests.maps.standard import read

PRESET = "realistic"
COLUMNS = ("file", "roads", "read", "left out", "scenes that fail", "alarms", "cm aside", "cm in height", "CPU s")


class Drawn(NamedTuple):
    """A scene: how far its labels are from the file, and the processor time before its picture."""

    apart: Apart
    cpu_s: float


def whole(path: Path) -> tuple[Apart, tuple[int, int, str]]:
    """How far all lanes of a file are from it; its roads, those that are read, and what is left out."""
    given, roads = read_map(path), read(path.read_bytes())
    return everywhere(given, roads), (len(roads), len(given.roads), given.text().partition("left out: ")[2])


def drawn(path: Path, index: int) -> Drawn:
    """One scene on a file."""
    given = read_map(path)
    start = time.process_time()
    world = sample_world(Scenes(load_params(PRESET), 1, "train", map=MapPlace(given)), index)
    site, view = world.site, world.view
    labels = label(world, view)
    _ = (
        (site.surfaces.pavement, site.surfaces.terrain, site.structures),
        (world.paint(view), world.symbols(view), world.tar(view), world.ghost_lines(view), world.grass(view)),
    )
    seconds = time.process_time() - start
    return Drawn(apart(world, labels, given, read(path.read_bytes())), seconds)


def row(pool: ProcessPoolExecutor, path: Path, scenes: int, rendered: int) -> dict[str, object]:
    """What holds for one file, found in another process."""
    read_first = pool.submit(whole, path)
    if failed := read_first.exception():
        return {"file": path.name, "read": 0, "left out": f"refused: {_line(failed).replace(str(path), path.name)}"}
    lanes, told = read_first.result()
    found: dict[str, object] = dict(zip(COLUMNS, (path.name, *told), strict=False))
    tried = [pool.submit(drawn, path, index) for index in range(scenes)]
    problems = [_line(error) for error in (at.exception() for at in tried) if error]
    made = [at.result() for at in tried if not at.exception()]
    found["scenes that fail"] = f"{len(problems)} of {scenes}" + (f" ({problems[0]})" if problems else "")
    if made:
        aside_m, height_m, *_ = np.fmax.reduce(np.array([lanes, *(at.apart for at in made)]))
        found["cm aside"] = f"{100 * aside_m:.2f}"
        found["cm in height"] = "on hills" if np.isnan(height_m) else f"{100 * height_m:.2f}"
        found["CPU s"] = f"{np.median([at.cpu_s for at in made]):.1f}"
        found["alarms"] = _alarms(path, rendered) if rendered else ""
    return found


def _line(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}".splitlines()[0][:200]


def _alarms(path: Path, rendered: int) -> str:
    """The problems that `validate` finds in rendered scenes."""
    program = [sys.executable, "-m", "synth3dlanes"]
    with tempfile.TemporaryDirectory() as folder:
        made = ["generate", f"--n={rendered}", f"--out={folder}", f"--params={PRESET}", f"--map={path}", "--passes=all"]
        subprocess.run([*program, *made, "--workers=1", "--quality=draft"], capture_output=True, check=False)
        checked = [*program, "validate", folder, "--workers=1", "--json"]
        told = subprocess.run(checked, capture_output=True, check=False, text=True).stdout
    try:
        problems = [" ".join(str(part) for part in problem.values()) for problem in json.loads(told)["problems"]]
    except (ValueError, KeyError):
        return "no pictures"
    return f"{len(problems)}" + (f" ({problems[0][:160]})" if problems else "")


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--scenes", type=int, default=4)
    parser.add_argument("--render", type=int, default=0)
    given = parser.parse_args()
    sys.stdout.write(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}\n")
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        for path in given.files:
            found = row(pool, path, given.scenes, given.render)
            sys.stdout.write(f"| {' | '.join(str(found.get(column, '')) for column in COLUMNS)} |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
