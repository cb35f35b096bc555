"""What the shell completes, near words, numbers as people write them, and lines of progress."""

from collections.abc import Callable
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import Result
from synth3dlanes_cli.generate import progress
from synth3dlanes_cli.main import main
from synth3dlanes_cli.options import CountRange

from synth3dlanes.production.events import Event
from synth3dlanes.system.schema import did_you_mean

Run = Callable[..., Result]


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
        ("render", ["people", "riders"], None),
        ("", ["exposure"], None),
        ("_", ["exposure"], None),
    ],
)
def test_the_word_that_was_meant(word: str, known: list[str], meant: str | None) -> None:
    assert did_you_mean(word, known) == (f"; did you mean {meant}?" if meant else "")


def test_it_is_asked_on_the_command_line(run: Run) -> None:
    assert "did you mean hdl_64e?" in run("generate", "--n", 1, "--out", "d", "--lidar", "hdl64e").stderr
    assert "did you mean streets?" in run("sample", "--params", "street").stderr


@pytest.mark.parametrize(("text", "number"), [("1e3", 1000), ("3E5", 300000), ("2.0e2", 200), ("7", 7), ("1e+2", 100)])
def test_counts_as_people_write_them(text: str, number: int) -> None:
    assert CountRange(1).convert(text, None, None) == number


@pytest.mark.parametrize("text", ["1.5e3", "1e-3", "0e3", "1e", "e3", "x", "-1e3", "1e99", "nan"])
def test_what_is_no_count_is_refused(text: str) -> None:
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
