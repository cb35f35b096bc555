"""What the networks' commands say: on a terminal, in a log, of names of weights and of arguments."""

import re
import time
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner
from PIL import Image
from synth3dlanes_baseline import evaluate, onnx_export, progress, sources
from synth3dlanes_cli import options
from synth3dlanes_cli.main import main


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


def test_a_log_file_gets_a_line_now_and_then_with_what_is_left(capsys, monkeypatch):
    clock = 0.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock)
    with progress.ProgressLine("step", 100, is_shown=True) as line:
        for step in range(1, 101):
            clock = step * 2.0
            line.update(step, 100, "8.0 samples/s")
    told = capsys.readouterr().err.splitlines()
    assert [text.split()[1] for text in told] == ["16/100", "32/100", "48/100", "64/100", "80/100", "96/100"]
    assert told[0] == "step 16/100  8.0 samples/s  0:02:48 left"


def test_an_epoch_is_one_line_with_loss_validation_speed_and_time_left(capsys, monkeypatch, tmp_path):
    """As trainers print it: the mean loss since the line before, also where a validation comes within an epoch."""
    from synth3dlanes_baseline.metrics import Evaluation, MetricConfig

    clock = 100.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock)
    report = Evaluation(MetricConfig()).report()
    with progress.TrainingLog(tmp_path, 20, 10, 0, 4, is_shown=True) as log:
        for step in range(1, 21):
            clock += 0.5
            log.step(step, 1e-3, {"total": torch.tensor(float(step))})
            if step in (5, 20):
                log.validation(step, report)
            if step in (5, 10, 20):
                log.epoch(step, report if step in (5, 20) else None)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("epoch")]
    assert [line.split(":")[0] for line in lines] == ["epoch 0.5/2", "epoch 1/2", "epoch 2/2"]
    assert [line.split(", ")[0].split(": ")[1] for line in lines] == ["loss 3", "loss 8", "loss 15.5"]
    assert lines[1] == "epoch 1/2: loss 8, 8.0 images/s, 0:00:05 left"
    assert lines[2].endswith("8.0 images/s")
    assert "centerline AP" in lines[0]
    assert "reaches confidence" not in "".join(lines)
