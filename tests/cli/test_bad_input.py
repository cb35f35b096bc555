"""Bad input of every kind: one clear line per problem on stderr, exit code 2, nothing half-written."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

Run = Callable[..., Result]


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("generate --n -3 --out d", "synth3dlanes generate: Invalid value for '--n': -3 is not in the range x>=1."),
        ("generate --out d", "synth3dlanes generate: Missing option '--n'."),
        ("generate --n 3 --out file/d", "--out file/d: cannot write to this folder"),
        ("generate --n 3 --out d --params no.yaml", "no.yaml: cannot read: No such file or directory"),
        ("generate --n 3 --out d --set road.lanes=3", "--set road.lanes: unknown key; did you mean n_lanes?"),
        ("generate --n 3 --out d --passes deth", "synth3dlanes generate: Invalid value for '--passes'"),
        ("generate --n 3 --out d --split ../up", "synth3dlanes generate: Invalid value for '--split'"),
        ("generate --n 3 --out d --workers -1", "synth3dlanes generate: Invalid value for '--workers'"),
        ("generate --n 3 --out d --part 3/2", "--part: expected i/n with 1 <= i <= n, got 3/2"),
        (
            "sample --set camera.pitch_deg=[5,0]",
            "--set camera.pitch_deg: expected [low, high] with low <= high, got [5,",
        ),
        ("sample --index -1", "synth3dlanes sample: Invalid value for '--index'"),
        ("render none.json", "none.json: No such file or directory"),
        ("render broken.json", "broken.json: expected JSON: "),
        ("inspect broken.json", "broken.json: expected JSON: "),
        ("inspect file/train:3", "file/train: expected a split of a data set, as DIR/train, got no "),
        ("inspect .", ".: expected a scene.json or a sample, as DIR/train:00000017, got a folder"),
        ("gallery none", "none: expected a data set"),
        ("params check tiny no.yaml", "no.yaml: cannot read: No such file or directory"),
        ("bench --against broken.json", "broken.json: expected JSON: "),
        ("sampel", "synth3dlanes: No such command 'sampel'."),
    ],
)
def test_one_line_and_exit_code_2(command: str, expected: str, run: Run, in_tmp_path: Path) -> None:
    (in_tmp_path / "file").touch()
    (in_tmp_path / "broken.json").write_text('{"format": "synth3dlanes.sc')
    result = run(*command.split())
    assert result.exit_code == 2
    assert result.stdout == ""
    assert expected in result.stderr
    assert result.stderr.count("\n") == 1
    assert {path.name for path in in_tmp_path.iterdir()} == {"file", "broken.json"}


def test_every_problem_has_a_line(run: Run) -> None:
    result = run("sample", "--set", "road.n_lanes=9", "--set", "light.exposure=0", "--set", "typo")
    assert result.exit_code == 2
    assert [line.split(":")[0] for line in sorted(result.stderr.splitlines())] == [
        "--set light.exposure",
        "--set road.n_lanes",
        "--set typo",
    ]


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
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == "assets mine: worker ended with 1: boom\n"
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for command, words in (
        (("generate", "--n", 1, "--params", "tiny", "--out", "d"), "Blender's module bpy is not installed"),
        (("train", "d", "--out", "e"), "PyTorch is not installed: pip install 'synth3dlanes[train]'"),
    ):
        result = run(*command)
        assert (result.exit_code, result.stderr.count("\n")) == (2, 1), result.output
        assert result.stderr.startswith(words)
    assert {path.name for path in in_tmp_path.iterdir()} == {"mine"}
