"""What the networks' commands say while they work, where there is no terminal."""

import re
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from synth3dlanes_baseline import onnx_export
from synth3dlanes_cli import options
from synth3dlanes_cli.main import main

from tests.baseline import roads


@pytest.fixture
def folder(in_tmp_path, behind_splits):
    """Three photographs, and five drawn samples behind every split."""
    behind_splits(roads.samples(np.random.default_rng(4), 5, (160, 120)))
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
