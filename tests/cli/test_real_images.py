"""`evaluate` on folders as tuSimple's: our own scenes, exported, whose lanes in space are known exactly."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.figures.colors import KINDS

FOCAL_PX = 2015 * 2 / 3  # of our tuSimple exports (docs/exports.md), 1280x720


def documents(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


@pytest.fixture(scope="module")
def exported(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set in tuSimple's layout, and its lanes in 3D as predictions; frames with up to five lines."""
    from click.testing import CliRunner
    from synth3dlanes_baseline.lanes import Detection, Prediction, write_predictions
    from synth3dlanes_cli.main import main

    from synth3dlanes import Reader

    out = tmp_path_factory.mktemp("tusimple") / "t"
    assert CliRunner().invoke(main, ["export", str(folder), "--format", "tusimple", "--out", str(out)]).exit_code == 0
    frames = [frame for path in sorted(out.glob("*label*.json")) for frame in documents(path)]
    sidecars = {sidecar["image"]: sidecar for sidecar in documents(out / "sidecar.jsonl")}
    reader = Reader(str(folder / "train"))
    labels = {f"clips/train/{reader[i].key}/20.jpg": reader[i].labels for i in range(len(reader))}
    predictions = []
    for frame in frames:
        kept = sidecars[frame["raw_file"]]["lines_ids"]
        lanes = [lane for lane in labels[frame["raw_file"]].lanes if lane.id in kept]
        assert 1 <= len(lanes) == len(frame["lanes"]) <= 5
        found = (Detection(lane.kind, 0.9, lane.xyz_cam, lane.terrain_visible.astype(float)) for lane in lanes)
        predictions.append(Prediction(frame["raw_file"], tuple(found), None))
    assert len(frames) >= 8
    for path in out.glob("*.json"):
        path.unlink()
    (out / "labels.json").write_text("".join(json.dumps(frame) + "\n" for frame in frames))
    write_predictions(out / "p.jsonl", predictions)
    return out


def figures(run, exported, *intrinsics):
    """Accuracy, FP and FN of the lanes, as seen by a camera with these intrinsics."""
    given = ",".join(map(str, intrinsics))
    result = run("evaluate", exported, "--predictions", exported / "p.jsonl", "--intrinsics", given, "--json")
    assert result.exit_code == 0, result.output
    return tuple(json.loads(result.output)["tusimple"].values())


def test_the_true_lanes_score_perfectly_and_only_with_the_true_camera(run, exported):
    assert figures(run, exported, FOCAL_PX, FOCAL_PX, 640, 360) == (1.0, 0.0, 0.0)
    # All lines 15 px aside are within the 20 px that tuSimple allows; 60 px aside none is, but for slanted ones.
    accuracy, false_positive, false_negative = figures(run, exported, FOCAL_PX, FOCAL_PX, 655, 360)
    assert (false_positive, false_negative) == (0.0, 0.0)
    assert accuracy > 0.97
    moved = figures(run, exported, FOCAL_PX, FOCAL_PX, 700, 360)
    assert moved[0] < 0.6
    assert moved[2] > 0.7
    for wrong in ((1.3 * FOCAL_PX, 1.3 * FOCAL_PX, 640, 360), (FOCAL_PX, FOCAL_PX, 640, 400)):
        found = figures(run, exported, *wrong)
        assert found[0] < 0.9
        assert min(found[1:]) > 0.2


def test_predict_and_evaluate_take_the_same_camera(run, exported):
    """The file that `predict` writes scores as the checkpoint does, on pictures without any road."""
    options = ("--intrinsics", f"{FOCAL_PX},{FOCAL_PX},640,360", "--threshold", "0.01")
    result = run("predict", "nano", exported, *options, "--out", "found", "--overlays", 1)
    assert result.exit_code == 0, result.output
    (picture,) = Path("found").glob("*.png")
    shown = np.array(Image.open(picture).convert("RGB"))[:300].astype(int)
    is_delimiter = (np.abs(shown - KINDS["delimiter"]) < 40).all(axis=2)
    assert np.count_nonzero(is_delimiter) > 50, "the labelled lines, above the legend"
    keys = [prediction["key"] for prediction in documents(Path("found/predictions.jsonl"))]
    assert keys == [frame["raw_file"] for frame in documents(exported / "labels.json")]
    of_file = run("evaluate", exported, "--predictions", "found/predictions.jsonl", *options, "--json")
    of_checkpoint = run("evaluate", exported, "--checkpoint", "nano", *options, "--json")
    assert of_file.exit_code == of_checkpoint.exit_code == 0, of_file.output + of_checkpoint.output
    a, b = (list(json.loads(result.output)["tusimple"].values()) for result in (of_file, of_checkpoint))
    np.testing.assert_allclose(a, b, atol=0.02)


def test_a_folder_with_several_label_files_is_asked_which(run, tmp_path):
    frame = {"raw_file": "1.jpg", "lanes": [[1, 2]], "h_samples": [400, 410]}
    for name in ("a.json", "b.json"):
        (tmp_path / name).write_text(json.dumps(frame) + "\n")
    result = run("evaluate", tmp_path, "--checkpoint", "nano", "--intrinsics", "1,1,1,1")
    assert result.exit_code == 2
    assert "expected one of its label files, a.json, b.json" in result.output
