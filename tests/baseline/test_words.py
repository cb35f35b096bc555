"""What the commands of the networks say: progress without a terminal, names of weights, the order of arguments."""

import re
import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from PIL import Image
from synth3dlanes_baseline import evaluate, onnx_export, sources
from synth3dlanes_cli import options
from synth3dlanes_cli.main import main
from synth3dlanes_cli.networks import WEIGHTS


@pytest.fixture
def folder(in_tmp_path, roads, monkeypatch):
    """Three photographs, and five drawn samples behind every split."""
    import numpy as np

    samples = roads.samples(np.random.default_rng(4), 5, (160, 120))
    for module in (evaluate, sources):
        monkeypatch.setattr(module, "open_split", lambda path: samples)
    (in_tmp_path / "photos").mkdir()
    for name in "abc":
        Image.new("RGB", (160, 120)).save(in_tmp_path / f"photos/{name}.jpg")
    return in_tmp_path


def test_without_a_terminal_a_line_comes_now_and_then(folder, monkeypatch):
    commands = {
        ("predict", "photos", "--overlays", "0"): ["1/3 images", "2/3 images"],
        ("evaluate", "DIR/test", "--checkpoint", "nano"): [f"{n}/5 images" for n in range(1, 5)],
    }
    for words in commands:
        assert CliRunner().invoke(main, words).stderr == "", "nothing of what takes a moment"
    monkeypatch.setattr(options, "LINE_EVERY_S", -1.0)
    for words, expected in commands.items():
        told = CliRunner().invoke(main, words)
        assert told.exit_code == 0, told.output
        assert [line.partition(",")[0] for line in told.stderr.splitlines()] == expected


def test_an_export_to_onnx_tells_that_it_goes_on(in_tmp_path, monkeypatch):
    monkeypatch.setattr(options, "LINE_EVERY_S", 0.1)
    monkeypatch.setattr(onnx_export, "export_onnx", lambda *_: time.sleep(0.35) or Path("x.onnx"))
    told = CliRunner().invoke(main, ["onnx", "nano", "x.onnx"])
    assert told.exit_code == 0
    assert told.stdout == "x.onnx\n"
    assert len(told.stderr.splitlines()) in (2, 3)
    assert all(re.fullmatch(r"exporting, .* so far", line) for line in told.stderr.splitlines())


@pytest.mark.parametrize(
    "words",
    [
        ("predict", "nanoo", "photos"),
        ("evaluate", "DIR/test", "--checkpoint", "nanoo"),
        ("train", "DIR", "--init", "nanoo", "--out", "out"),
        ("train", "DIR", "--model", "tiny", "--init", "nanoo", "--out", "out"),
        ("onnx", "nanoo", "x.onnx"),
    ],
)
def test_a_name_of_no_weights_names_those_there_are(folder, monkeypatch, words):
    from synth3dlanes_baseline import train

    samples = sources.open_split("DIR/test")
    monkeypatch.setattr(train, "_splits", lambda config, dirs: (samples, samples))
    told = CliRunner().invoke(main, words)
    line = "nanoo: expected a checkpoint or one of nano, compact, streets, got no such file; did you mean nano?\n"
    assert (told.exit_code, told.stderr) == (2, line)


def test_arguments_in_the_wrong_order_are_suspected(folder):
    for words in (("photos/a.jpg", "streets"), ("photos", "run/best.pt")):
        told = CliRunner().invoke(main, ["predict", *words])
        expected = f"expected the checkpoint first; did you mean {words[1]} {words[0]}?"
        assert (told.exit_code, told.stderr) == (2, f"synth3dlanes predict: {expected}\n")


def test_the_shell_completes_names_of_weights(in_tmp_path):
    for words in ("predict", "onnx", "evaluate DIR --checkpoint", "train DIR --init", "benchmark hills --checkpoint"):
        environment = {"_SYNTH3DLANES_COMPLETE": "bash_complete", "COMP_WORDS": f"synth3dlanes {words} "}
        environment["COMP_CWORD"] = str(len(words.split()) + 1)
        told = CliRunner().invoke(main, [], prog_name="synth3dlanes", env=environment)
        names = [line.partition(",")[2] for line in told.output.splitlines()]
        assert names[:3] == WEIGHTS.split("|"), (words, told.output)
