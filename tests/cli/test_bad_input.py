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
        ("generate --n -3 --out d", "synth3dlanes generate: Invalid value for '--n': -3 is not in the range x>=0."),
        ("generate --out d", "--n: expected the number of samples, got none"),
        ("generate --n 3", "--out: expected a folder or a URL, got none"),
        ("generate --n 3 --out file/d", "--out file/d: cannot write to this folder"),
        ("generate --n 3 --out d --params no.yaml", "no.yaml: cannot read: No such file or directory"),
        ("generate --n 3 --out d --set road.lanes=3", "--set road.lanes: unknown key; did you mean n_lanes?"),
        (
            "generate --n 3 --out d --passes deth",
            "--passes: expected one of depth, normal, semantic, instance, height, or all, got 'deth'",
        ),
        ("generate --n 3 --out d --split ../up", "--split: expected letters, digits, - and _, got '../up'"),
        ("generate --n 3 --out d --workers -1", "--workers: expected auto or a number of processes, got '-1'"),
        ("generate --n 3 --out d --part 3/2", "--part: expected i/n with 1 <= i <= n, such as 2/8, got '3/2'"),
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
        ("bench --against other.json", "other.json: expected a result of bench --json, got another document"),
        ("render other.json", "other.json: expected synth3dlanes.scene version 1, got another document"),
        ("inspect broken.json --out x.txt", "Invalid value for '--out': x.txt: expected a name that ends in .png"),
        ("inspect broken.json --out noext", "Invalid value for '--out': noext: expected a name that ends in .png"),
        ("gallery none --out x.svg", "Invalid value for '--out': x.svg: expected a name that ends in .png or .jpg"),
        ("stats none --out x.txt", "Invalid value for '--out': x.txt: expected a name that ends in .png"),
        ("report none --html none/x.html", "none/x.html: expected a file in a folder that exists"),
        ("inspect d/train:3 --image file", "--image file: expected none beside a sample, which has its own"),
        ("split d --out e --into train=0.5,val=0.6", "expected shares whose sum is 1, got 1.1"),
        ("generate --n 1000000000 --out d", "--n: expected at most 1e+08, got 1000000000"),
        ("generate --n 90000000 --out d --device cpu", "d: 90,000,000 samples need "),
        ("generate --n 90000000 --out d --device cpu --dry-run", "d: 90,000,000 samples need "),
        (
            "params check partial.yaml",
            "partial.yaml: 10 missing keys: terrain, road, markings, ...; a file that changes",
        ),
        ("sampel", "synth3dlanes: No such command 'sampel'."),
    ],
)
def test_one_line_and_exit_code_2(command: str, expected: str, run: Run, in_tmp_path: Path) -> None:
    (in_tmp_path / "file").touch()
    (in_tmp_path / "broken.json").write_text('{"format": "synth3dlanes.sc')
    (in_tmp_path / "other.json").write_text('{"a": 1}')
    (in_tmp_path / "partial.yaml").write_text("{}")
    result = run(*command.split())
    assert result.exit_code == 2
    assert result.stdout == ""
    assert expected in result.stderr
    assert result.stderr.count("\n") == 1
    assert {path.name for path in in_tmp_path.iterdir()} == {"file", "broken.json", "other.json", "partial.yaml"}


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
