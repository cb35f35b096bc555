"""The weights in the package: small, and good enough that the first picture a user tries shows lanes."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from synth3dlanes_baseline.checkpoint import load, place
from synth3dlanes_cli.main import main

import synth3dlanes as s3d

SCENE = Path(__file__).parents[1] / "golden/plain.scene.json"


@pytest.fixture(scope="module")
def rendered():
    return s3d.render(s3d.load_scene(SCENE))


@pytest.mark.parametrize(("name", "most_bytes"), [("nano", 2e6), ("streets", 2e6), ("compact", 8e6)])
def test_the_weights_take_little_room(name, most_bytes):
    assert place(name).stat().st_size < most_bytes
    found = load(place(name))
    assert found.resume is None
    assert found.about["train"]["n_images"] >= 900
    assert "/" not in json.dumps(found.about), "no path of the machine that made them"


def test_predict_finds_the_hosts_lane_in_a_picture_without_further_words(rendered, tmp_path):
    Image.fromarray(rendered.image).save(tmp_path / "photo.jpg", quality=95)
    result = CliRunner().invoke(main, ["predict", str(tmp_path / "photo.jpg"), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert "lanes in 1 image;" in result.output
    (line,) = (tmp_path / "out/predictions.jsonl").read_text().splitlines()
    lanes = [lane for lane in json.loads(line)["lanes"] if lane["score"] >= 0.5 and lane["kind"] == "centerline"]
    at_15_m = [_x_at(np.array(lane["xyz_cam"]), 15.0) for lane in lanes]
    true_m = [_x_at(lane.xyz_cam, 15.0) for lane in rendered.labels.lanes if lane.kind == "centerline"]
    host_m = min(true_m, key=abs)
    assert min(abs(x_m - host_m) for x_m in at_15_m) < 0.6
    assert (tmp_path / "out/photo.png").is_file()


HEAVY = {"scipy", "matplotlib", "pyarrow", "fsspec", "pandas", "tensorboard", "synth3dlanes.dataset.read"}
PROBE = """
import sys
from synth3dlanes_cli.main import main
try:
    main(["predict", sys.argv[1], "--out", sys.argv[2]])
finally:
    print(*sys.modules, sep="\\n")
"""


@pytest.mark.thorough
def test_a_photograph_loads_nothing_heavy_but_torch(tmp_path):
    """It takes less than two seconds of a core; scipy and matplotlib alone would take one more."""
    Image.new("RGB", (480, 360), (90, 100, 110)).save(tmp_path / "photo.png")
    command = [sys.executable, "-c", PROBE, str(tmp_path / "photo.png"), str(tmp_path / "out")]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout.split("\n")
    assert (tmp_path / "out/photo.overlay.jpg").is_file()
    assert "torch" in loaded
    assert not HEAVY & set(loaded)


def _x_at(xyz_cam, y_m):
    return float(np.interp(y_m, xyz_cam[:, 1], xyz_cam[:, 0]))
