"""Messages say what was given, where, and what to do."""

import errno
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import click
import pytest
from click.testing import Result
from synth3dlanes_cli.main import main

from synth3dlanes.dataset.address import LocalFiles

Run = Callable[..., Result]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("inspect FOLDER/train:-1", "expected a split's folder, a colon and a key, as in DIR/train:00000017"),
        ("inspect FOLDER/train:x", "expected a split's folder, a colon and a key, as in DIR/train:00000017"),
        ("render FOLDER/train:", "expected a split's folder, a colon and a key, as in DIR/train:00000017"),
        ("sample --camera argoverse2", "or the path of a .yaml file; argoverse2 is for --rig"),
        ("sample --rig kitti", "or the path of a .yaml file; kitti is for --camera"),
        ("sample --params kitti", "or the path of a .yaml file; kitti is for --camera"),
        ("sample --frames 2 --fps inf", "'--fps': expected a finite number, got 'inf'"),
        ("drive mark d --cell nan", "'--cell': expected a finite number, got 'nan'"),
        ("lift d --out e --precision pose_m=1,pose_m=2", "'--precision': expected pose_m once, got it twice"),
        (
            "export FOLDER --format apollo --out memory://e",
            "--out memory:/e: expected a folder of this machine, got an",
        ),
        ("render s.json --lidar streets", "or the path of a .yaml file; streets is for --params"),
    ],
)
def test_a_wrong_name_is_answered_with_the_right_place(command: str, message: str, run: Run, folder: Path) -> None:
    Path("s.json").write_text(run("sample", "--params", "tiny").stdout)
    result = run(*command.replace("FOLDER", str(folder)).split())
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1), result.output
    assert message in result.stderr


def test_too_little_memory_for_a_library_is_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ImportError("libx.so: failed to map segment from shared object")

    monkeypatch.setattr("synth3dlanes.recorded.drives.open.open_drive", fails)
    result = run("drive", "check", "d")
    assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
    assert result.stderr.startswith("synth3dlanes drive: not enough memory")


def test_a_file_that_is_called_like_an_option_keeps_its_name(run: Run) -> None:
    names = sorted({param.name for param in main.commands["generate"].params if isinstance(param, click.Option)})
    assert {"split", "seed", "out", "n", "params"} < set(names)
    for name in names:
        for file in (f"{name}.yaml", f"{name}/{name}.yaml", f"{name}-2.yaml"):
            told = run("generate", "--n", 1, "--out", "d", "--params", file).stderr
            assert told == f"{file}: cannot read: No such file or directory\n"
        Path(name).write_text("")
    assert run("drive", "check", "lanes").stderr.startswith("lanes: ")
    # An argument is still called by its option.
    assert run("generate", "--n", 1, "--out", "e", "--part", "3/2").stderr.startswith("--part: expected i/n")


@pytest.mark.parametrize("words", [["info", ""], ["info", "d", "--json="], ["drive", "check", "d", "--lanes", ""]])
def test_an_empty_argument_stands_for_no_folder(words: list[str], run: Run) -> None:
    result = run(*words)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("synth3dlanes: expected no empty argument, got one after ")


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("predict nofile.jpg", "nofile.jpg: expected an image, got no such file"),
        ("predict none/at.PNG", "none/at.PNG: expected an image, got no such file"),
        ("train FOLDER --out e --set batc=3", "train.batc: unknown key; did you mean batch?"),
        ("train FOLDER --out e --set model.grid.row=3", "model.grid.row: unknown key; did you mean rows?"),
        ("onnx nano none/x.onnx", "'FILE.onnx': none/x.onnx: expected a file in a folder that exists"),
        ("onnx nano x.txt", "'FILE.onnx': x.txt: expected a name that ends in .onnx"),
        ("predict x.mp4 --smooth nan", "'--smooth': expected a finite number, got 'nan'"),
        ("predict x.png --threshold nan", "'--threshold': expected a finite number, got 'nan'"),
        ("predict d/train --video --overlays 0", "--video has no effect with --overlays 0."),
    ],
)
def test_the_baseline_too(command: str, message: str, run: Run, folder: Path) -> None:
    pytest.importorskip("torch")
    result = run(*command.replace("FOLDER", str(folder)).split())
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1), result.output
    assert message in result.stderr


def test_a_tar_that_cannot_be_read_is_not_called_changed(
    run: Run, folder: Path, in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As for users without permission; tests may run as root, whom nothing is forbidden."""
    shutil.copytree(folder, "d")

    def forbidden(files: LocalFiles, path: str, *more: object, **named: object) -> object:
        if str(path).endswith("00001.tar"):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)
        return opened(files, path, *more, **named)

    opened = LocalFiles.open
    monkeypatch.setattr(LocalFiles, "open", forbidden)
    told = json.loads(run("validate", "d", "--workers", 1, "--json", "--limit", 0).stdout)
    reasons = [problem["reason"] for problem in told["problems"]]
    assert any("cannot be read: Permission denied" in reason for reason in reasons)
    assert any("got one that cannot be read" in reason for reason in reasons)
    assert not any("cut or changed" in reason for reason in reasons)


def test_a_pose_that_no_network_predicts_is_not_nan() -> None:
    pytest.importorskip("torch")
    from synth3dlanes_baseline.metrics import Evaluation, MetricConfig
    from synth3dlanes_baseline.report import summary_line, to_text

    report = Evaluation(MetricConfig()).report()
    assert "pose: not predicted" in to_text(report)
    assert "pose" not in summary_line(report)
    assert not re.search(r"\bnan (deg|cm)", to_text(report) + summary_line(report))
