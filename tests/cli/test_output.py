"""What commands print: tables, progress, completion, numbers as people write them."""

import io
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import Result
from rich.console import Console
from synth3dlanes_cli.generate import generate, progress
from synth3dlanes_cli.main import main
from synth3dlanes_cli.options import CountRange, given

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.figures.stats import scene_statistics
from synth3dlanes.figures.stats_views import statistics_table
from synth3dlanes.params.params import load_params
from synth3dlanes.production.events import LEVEL_OF, Event, duration
from synth3dlanes.production.job import Job
from synth3dlanes.system.schema import did_you_mean

Run = Callable[..., Result]


def test_on_a_narrow_terminal_every_number_is_whole() -> None:
    params = load_params("streets")
    found = scene_statistics((sample_scene(Scenes(params), i) for i in range(3)), params)
    screen = io.StringIO()
    Console(file=screen, width=100).print(statistics_table(found, None))
    lines = screen.getvalue().splitlines()
    for row in found.parameters:
        (line,) = [line for line in lines if line.split()[:1] == [row.key]]
        assert all(f"{value:.4g}" in line.split() for value in (row.minimum, row.maximum, row.mean)), line


def test_a_reader_that_leaves_ends_a_command_as_it_ends_others() -> None:
    """With the code of SIGPIPE and no word, also where rich prints."""
    for words in (["sample", "--n", "2"], ["list", "presets"]):
        process = subprocess.Popen(
            [sys.executable, "-m", "synth3dlanes", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        process.stdout.close()
        _, stderr = process.communicate(timeout=120)
        assert (process.returncode, stderr) == (141, "")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("generate --params s", {"streets"}),
        ("sample --camera ki", {"kitti", "kitti_raw"}),
        ("generate --rig nu", {"nuscenes"}),
        ("render x --lidar hdl", {"hdl_32e", "hdl_64e"}),
        ("params show to", {"town"}),
        ("stats --params di", {"diverse"}),
        ("export d --format open", {"opendrive", "openlane", "openlane_v2"}),
    ],
)
def test_names_are_completed(words: str, expected: set[str]) -> None:
    *before, last = words.split()
    found = ShellComplete(main, {}, "synth3dlanes", "_COMPLETE").get_completions(before, last)
    assert {item.value for item in found} == expected


@pytest.mark.parametrize(
    ("word", "known", "meant"),
    [
        ("hdl64e", ["hdl_32e", "hdl_64e"], "hdl_64e"),
        ("HDL-64E", ["hdl_32e", "hdl_64e"], "hdl_64e"),
        ("lr", ["batch", "learning_rate"], "learning_rate"),
        ("exposur", ["exposure", "metering"], "exposure"),
        ("xyz", ["exposure", "metering"], None),
        ("", ["exposure"], None),
        ("_", ["exposure"], None),
    ],
)
def test_the_word_that_was_meant(word: str, known: list[str], meant: str | None) -> None:
    assert did_you_mean(word, known) == (f"; did you mean {meant}?" if meant else "")


def test_counts_as_people_write_them() -> None:
    written = {"1e3": 1000, "3E5": 300000, "2.0e2": 200, "7": 7, "1e+2": 100, "300_000": 300000}
    assert {text: CountRange(1).convert(text, None, None) for text in written} == written
    for text in ("1.5e3", "1e-3", "0e3", "1e", "e3", "x", "-1e3", "1e99", "nan"):
        with pytest.raises(click.BadParameter):
            CountRange(1).convert(text, None, None)


@pytest.mark.parametrize(("quiet", "lines"), [(False, ["1/2", "2/2"]), (True, [])])
def test_the_last_line_of_progress_comes_once(
    quiet: bool, lines: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("synth3dlanes_cli.generate.LINE_EVERY_S", -1.0)
    with progress(quiet=quiet) as notify:
        notify(Event("sample", "", 1, 2, 0, 1.0, None, None, {}))
        notify(Event("sample", "", 2, 2, 0, 1.0, None, None, {}))
        notify(Event("end", "", 2, 2, 0, 1.0, None, None, {}))
    assert capsys.readouterr().err.splitlines() == lines


def test_a_gallery_says_which_of_several_splits_it_shows(run: Run, folder: Path) -> None:
    assert run("split", folder, "--into", "a=1,b=1", "--out", "two").exit_code == 0
    told = run("gallery", "two").stdout
    assert told.startswith("Gallery: gallery.png, ")
    assert told.endswith(("samples of a\n", "samples of b\n"))
    assert run("gallery", "two/b").stdout == "Gallery: gallery.png\n"


@pytest.mark.parametrize(
    ("options", "samples"), [((), 4), (("--quality", "draft"), 2), (("--quality", "high"), 8), (("--samples", "7"), 7)]
)
def test_quality_is_a_name_for_a_number_of_samples(options, samples):
    with generate.make_context("generate", ["--n", "1", *options], **main.context_settings) as context:
        assert Job(**given(context.params)).settings.samples == samples


@pytest.mark.parametrize(
    ("level", "expected"),
    [
        ("debug", ["sample", "shard", "start", "resume", "restart", "pause", "stop", "set_aside"]),
        ("info", ["start", "resume", "restart", "pause", "stop", "set_aside"]),
        ("warning", ["restart", "pause", "stop", "set_aside"]),
        ("error", ["set_aside"]),
    ],
)
def test_the_log_level_decides_what_is_printed(level, expected, capsys):
    with progress(level) as notify:
        for kind in LEVEL_OF:
            notify(Event(kind, f"<{kind}>", 1, 2, 0, 1.0, 1.0, 1.0, {}))
    printed = capsys.readouterr().err
    assert [kind for kind in LEVEL_OF if f"<{kind}>" in printed] == expected
    assert "1/2  3,600 images/h, 0:00:01 left" in printed


def test_durations_are_read_as_clocks():
    assert [duration(seconds) for seconds in (0.4, 65, 3725.6)] == ["0:00:00", "0:01:05", "1:02:06"]
