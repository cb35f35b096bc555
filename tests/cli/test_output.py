"""Tables keep their numbers: at full width in pipes and files, in several lines on narrow terminals."""

import io
import subprocess
import sys
from collections.abc import Callable

import pytest
from click.testing import Result
from rich.console import Console

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.figures.stats import scene_statistics
from synth3dlanes.figures.stats_views import statistics_table
from synth3dlanes.params.params import load_params

Run = Callable[..., Result]


@pytest.mark.thorough
def test_nothing_is_cut_where_nobody_draws_a_screen(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    scene = run("sample").stdout
    with open("s.json", "w") as file:
        file.write(scene)
    for command in (("stats", "--params", "streets", "--n", 3), ("inspect", "s.json")):
        told = run(*command)
        assert told.exit_code == 0, told.output
        assert "…" not in told.stdout
        assert max(map(len, told.stdout.splitlines())) > 80


@pytest.mark.parametrize("width", [100, 120])
def test_on_a_narrow_terminal_every_number_is_whole(width: int) -> None:
    params = load_params("streets")
    found = scene_statistics((sample_scene(Scenes(params), i) for i in range(3)), params)
    screen = io.StringIO()
    Console(file=screen, width=width).print(statistics_table(found, None))
    lines = screen.getvalue().splitlines()
    for row in found.parameters:
        (line,) = [line for line in lines if line.split()[:1] == [row.key]]
        assert all(f"{value:.4g}" in line.split() for value in (row.minimum, row.maximum, row.mean)), line


def test_a_reader_that_leaves_ends_a_command_as_it_ends_others() -> None:
    """With the code of SIGPIPE and no word, also where rich prints."""
    for words in (["sample", "--n", "2"], ["stats", "--params", "tiny", "--n", "5"]):
        process = subprocess.Popen(
            [sys.executable, "-m", "synth3dlanes", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        process.stdout.close()
        _, stderr = process.communicate(timeout=120)
        assert (process.returncode, stderr) == (141, "")
