"""Messages say what was given, where, and what to do; an option without an effect is refused."""

import errno
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import click
import pytest
from click.testing import Result
from synth3dlanes_cli.main import main

from synth3dlanes.dataset.address import LocalFiles

Run = Callable[..., Result]


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


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ("light.sun_zenith_deg=120", "--set light.sun_zenith_deg: expected at most 114.592, got 120"),
        ("light.sun_zenith_rad=3", "--set light.sun_zenith_rad: expected at most 2, got 3"),
        ("light.sun_zenith_deg=true", "--set light.sun_zenith_deg: expected degrees, got True"),
        ("camera.width_px=20000", "--set camera.width_px: expected at most 8192, got 20000"),
        ("camera.width_px=wide", "--set camera.width_px: expected a whole number, got 'wide'"),
    ],
)
def test_a_changed_scene_is_refused_in_the_words_of_the_change(
    change: str, line: str, run: Run, in_tmp_path: Path
) -> None:
    (in_tmp_path / "a.json").write_text(run("sample", "--params", "tiny").stdout)
    result = run("render", "a.json", "--set", change)
    assert (result.exit_code, result.stdout, result.stderr) == (2, "", f"{line}\n")


@pytest.mark.parametrize(
    ("command", "there"),
    [
        ("inspect d", "d/train"),
        ("render d/train", "d/train"),
        ("inspect d/tran:3", "d/train"),
        ("info d/tran", "d/train"),
        ("stats d/tran", "d/train"),
        ("gallery d/train:3", "d/train"),
        ("info d/train:3", "d/train"),
        ("export d/tran --format apollo --out e", "d/train"),
        ("twins d/tran --vary light.exposure=1 --out e", "d/train"),
    ],
)
def test_a_place_that_is_not_there_is_answered_with_what_is(
    command: str, there: str, run: Run, folder: Path, in_tmp_path: Path
) -> None:
    (in_tmp_path / "d").symlink_to(folder)
    result = run(*command.split())
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.endswith(f"; there is {there}\n")
    assert result.stderr.count("\n") == 1


def test_info_and_validate_take_one_split(run: Run, folder: Path, in_tmp_path: Path) -> None:
    whole, part = (run("info", place, "--json").stdout for place in (folder, f"{folder}/train"))
    assert json.loads(whole)["splits"] == json.loads(part)["splits"]
    shutil.copytree(folder, "d")
    shutil.copytree("d/train", "d/val")
    Path("d/val/00001.tar").unlink()
    assert [split["name"] for split in json.loads(run("info", "d/train", "--json").stdout)["splits"]] == ["train"]
    of_one = run("validate", "d/train", "--limit", 0, "--workers", 1)
    of_all = run("validate", "d", "--limit", 0, "--workers", 1)
    assert (of_one.exit_code, of_all.exit_code) == (0, 1), of_one.output
    assert of_one.stdout.endswith("0 samples checked: the files are all right, labels and pixels were not looked at\n")
    assert "val/00001.tar" in of_all.stdout


def test_a_dry_run_says_what_would_be_made_and_makes_nothing(run: Run, in_tmp_path: Path) -> None:
    command = (
        "generate",
        "--n",
        1500,
        "--out",
        "d",
        "--params",
        "tiny",
        "--device",
        "cpu",
        "--seed",
        3,
        "--workers",
        2,
    )
    result = run(*command, "--dry-run", "--set", "light.exposure=2")
    assert result.exit_code == 0, result.output
    asked, expected = result.stdout.splitlines()
    for words in ("d/train: 1,500 samples", "seed 3", "96x72 px jpg", "device cpu", "tiny with light.exposure=2"):
        assert words in asked
    assert expected.startswith("1,500 samples to make with 2 workers: about ")
    assert not list(in_tmp_path.iterdir())


def test_a_scene_with_two_mistakes_names_both(run: Run, in_tmp_path: Path) -> None:
    text = run("sample").stdout.replace('"exposure":', '"exposur":').replace('"topology":', '"topology":1')
    (in_tmp_path / "scene.json").write_text(text)
    result = run("inspect", "scene.json")
    assert result.exit_code == 2
    lines = result.stderr.splitlines()
    assert all(line.startswith("scene.json: ") for line in lines)
    assert {line.split(": ")[1] for line in lines} == {"road.topology", "light.exposure", "light.exposur"}


@pytest.mark.parametrize("command", ["render", "inspect"])
@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("lane", "exit_7", "cars.0.lane: expected one of "),
        ("lane", "stem_1", "cars.0.lane: expected one of "),
        ("n_lanes", 2, "camera.lane: expected at most 2 "),
    ],
)
def test_a_lane_that_is_not_there_is_one_line(
    command: str, key: str, value: str | int, words: str, run: Run, in_tmp_path: Path
) -> None:
    changes = ["road.n_lanes=4", "road.topology=1", "camera.lane=4"]
    scene = json.loads(run("sample", *(word for change in changes for word in ("--set", change))).stdout)
    (scene["road"] if key == "n_lanes" else scene["cars"][0])[key] = value
    (in_tmp_path / "scene.json").write_text(json.dumps(scene))
    result = run(command, "scene.json")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(f"scene.json: {words}")
    assert result.stderr.count("\n") == 1
    assert [path.name for path in in_tmp_path.iterdir()] == ["scene.json"]


def test_render_will_not_overwrite_its_scene(run: Run, in_tmp_path: Path) -> None:
    scene = run("sample", "--params", "tiny").stdout
    (in_tmp_path / "a.scene.json").write_text(scene)
    result = run("render", "a.scene.json", "--set", "light.exposure=3")
    assert result.exit_code == 2
    assert "would overwrite a.scene.json" in result.stderr
    assert (in_tmp_path / "a.scene.json").read_text() == scene
    assert not (in_tmp_path / "a.png").exists()


def test_an_edited_description_is_named_by_every_command(run: Run, folder: Path, in_tmp_path: Path) -> None:
    shutil.copytree(folder, "d")
    path = Path("d/dataset.json")
    path.write_text(json.dumps({**json.loads(path.read_text()), "splits": {"train": 5}}))
    generate = ("generate", "--n", 1, "--params", "tiny", "--device", "cpu", "--out", "d")
    commands = [
        ("info", "d"),
        ("stats", "d"),
        ("split", "d/train", "--out", "e"),
        ("merge", "d", "--out", "e"),
        generate,
    ]
    for command in [*commands, ("inspect", "d/train:00000003"), ("evaluate", "d/train")]:
        result = run(*command)
        assert result.exit_code == 2, (command, result.output, result.exception)
        assert result.stderr.count("\n") == 1, result.stderr
        assert "dataset.json: splits.train: expected an object" in result.stderr
        assert result.stderr.endswith("got 5\n")
    result = run("validate", "d", "--workers", 1)
    assert result.exit_code == 1
    assert "dataset.json: splits.train: expected an object" in result.stdout


def test_a_missing_package_and_a_crashed_worker_are_one_line(
    run: Run, in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from synth3dlanes.production.workers import Outcome

    Path("mine").mkdir()
    crashed = Outcome("check", "failed", reason="worker ended with 1: boom", stderr="Traceback\nboom")
    monkeypatch.setattr("synth3dlanes.production.user_assets.require_blender", lambda: None)
    monkeypatch.setattr("synth3dlanes.production.user_assets.call", lambda *_: crashed)
    result = run("assets", "mine")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == "assets mine: worker ended with 1: boom\n"
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for command, words in (
        (("generate", "--n", 1, "--params", "tiny", "--out", "d"), "Blender's module bpy is not installed"),
        (("train", "d", "--out", "e"), "PyTorch is not installed: pip install '.[train]' in the folder of its source"),
    ):
        result = run(*command)
        assert (result.exit_code, result.stderr.count("\n")) == (2, 1), result.output
        assert result.stderr.startswith(words)
    assert {path.name for path in in_tmp_path.iterdir()} == {"mine"}


@pytest.mark.parametrize("key", ["lane", "y_m", "offset_m"])
def test_a_camera_of_ones_own_keeps_the_hosts_place(key: str, run: Run) -> None:
    value = {"lane": 2, "y_m": -20, "offset_m": 0.25}[key]
    scene = run("sample", "--camera", "kitti", "--set", f"camera.{key}={value}", "--set", "road.n_lanes=4")
    assert f'"{key}":{value}' in scene.stdout.replace(" ", "")


def test_every_other_key_of_the_camera_is_the_files(run: Run) -> None:
    from synth3dlanes.params.groups import CameraParams
    from synth3dlanes.production.job import KEYS_OF_CAMERA_FILES

    own = {f"camera.{name}" for name in CameraParams.model_fields} - set(KEYS_OF_CAMERA_FILES)
    assert own == {"camera.lane", "camera.y_m", "camera.offset_m"}


def test_predict_wants_no_intrinsics_of_labelled_images(run: Run, folder: Path) -> None:
    pytest.importorskip("torch")
    result = run("predict", f"{folder}/train", "--intrinsics", "400,400,240,180", "--out", "found")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == f"--intrinsics: expected none for {folder}/train, whose labels have them\n"


def test_a_dry_run_compares_the_recipe(run: Run, folder: Path) -> None:
    """Also for a cluster, whose device is not known here."""
    for more in ((), ("--executor", "ray"), ("--device", "cpu")):
        result = run("generate", "--n", 3, "--out", folder, "--dry-run", "--seed", 4, *more)
        assert (result.exit_code, result.stdout) == (2, ""), result.output
        assert "dataset.json: seed: expected 0 as in this dataset, got 4" in result.stderr
