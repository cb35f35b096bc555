"""The image-only variant: tuSimple's lines go onto the fixed plane and come back, and its model learns from them."""

import json

import numpy as np
import pytest
import torch
from PIL import Image
from synth3dlanes_baseline import checkpoint as checkpoints
from synth3dlanes_baseline.anchors import encode
from synth3dlanes_baseline.config import MODELS, TUSIMPLE, train_config
from synth3dlanes_baseline.curves import Pose, cam_from_road
from synth3dlanes_baseline.data import annotation_of, pack
from synth3dlanes_baseline.evaluate import evaluate_checkpoint, score_on
from synth3dlanes_baseline.lanes import Detection, Prediction
from synth3dlanes_baseline.model import LaneNet
from synth3dlanes_baseline.predict import PredictConfig, detector_for, predict
from synth3dlanes_baseline.projection import road_from_cam
from synth3dlanes_baseline.sources import open_split
from synth3dlanes_baseline.tusimple import POSE, TusimpleOnPlane

from synth3dlanes.geometry.frames import transform
from synth3dlanes.system.errors import InputError


@pytest.fixture
def tusimple(tmp_path):
    """Two straight lines and a bent one on the fixed plane, as their x at rows 160, 170, ..., 710."""
    rows = np.arange(160.0, 711.0, 10.0)
    y_m = np.arange(3.0, 105.0)
    lines = []
    for x_m in (-1.8 + 0 * y_m, 1.8 + 0 * y_m, 5.4 + 5e-4 * y_m**2):
        right_m, ahead_m, up_m = transform(cam_from_road(POSE), np.stack([x_m, y_m, 0 * y_m], axis=1)).T
        # f = 1000 px, c = (640, 400) in the whole image
        u_px, v_px = 640 + 1000 * right_m / ahead_m, 400 - 1000 * up_m / ahead_m
        columns = np.rint(np.interp(rows, v_px[::-1], u_px[::-1], left=-2, right=-2))
        lines.append(np.where((columns >= 0) & (columns < 1280), columns, -2).astype(int).tolist())
    frame = {"raw_file": "clips/1/20.jpg", "lanes": lines, "h_samples": rows.astype(int).tolist()}
    path = tmp_path / "label_data.json"
    path.write_text(json.dumps(frame) + "\n")
    picture = tmp_path / "clips/1/20.jpg"
    picture.parent.mkdir(parents=True)
    Image.new("RGB", (1280, 720), (90, 90, 90)).save(picture)
    return path


def test_tusimple_lines_go_to_the_plane_and_back(tusimple):
    split = open_split(tusimple)
    assert isinstance(split, TusimpleOnPlane)
    sample = split[0]
    assert sample.image.shape == (640, 1280, 3)
    lanes = tuple(Detection(lane.kind, 0.9, lane.xyz_cam) for lane in sample.labels.lanes)
    report = score_on(split, [(sample.labels, Prediction(sample.key, lanes, POSE))])
    accuracy, false_positive, false_negative = report.tusimple
    assert accuracy > 0.98
    assert (false_positive, false_negative) == (0.0, 0.0)
    nothing = score_on(split, [(sample.labels, Prediction(sample.key, (), None))])
    assert nothing.tusimple[2] == 1.0


@pytest.mark.parametrize("pose", [None, Pose(0.06, 1.66)])
def test_lanes_of_another_detector_need_the_camera(tusimple, pose):
    split = open_split(tusimple.parent)  # the folder of the only label file
    labels = split.labels(0)
    prediction = Prediction("clips/1/20.jpg", (Detection("delimiter", 0.9, labels.lanes[0].xyz_cam),), pose)
    with pytest.raises(InputError, match=r"label_data.json: expected --intrinsics"):
        score_on(split, [(labels, prediction)])


def test_tusimple_model_learns_only_delimiters_without_height(tusimple):
    config = MODELS["tusimple"]
    assert LaneNet(config).head.out.out_channels == 7, "K + 1 per anchor"
    pose = torch.tensor([[np.radians(config.fixed_pitch_deg), config.fixed_height_m]]).float()
    curves = pack([annotation_of("", open_split(tusimple)[0].labels, (360, 480), "plane")])
    targets, _ = encode(curves, road_from_cam(pose), config)
    assert targets.assigned.shape == (1, 1, 16)
    assert targets.assigned.sum() == 3
    assert targets.z_m[targets.assigned & True].abs().max() < 1e-3


def test_the_image_only_network_is_scored_without_a_camera(tusimple, tmp_path):
    config = train_config("nano", {f"model.{name}": value for name, value in TUSIMPLE.items()})
    weights = LaneNet(config.model).state_dict()
    checkpoints.save(tmp_path / "a.pt", checkpoints.Checkpoint(config, {}, weights, None))
    report = evaluate_checkpoint(tmp_path / "a.pt", tusimple, device="cpu")
    assert report.kinds["delimiter"].n_detections > 0
    accuracy, _, false_negative = report.tusimple
    assert 0 <= accuracy <= 1
    assert 0 <= false_negative <= 1
    detector = detector_for(tusimple, tmp_path / "a.pt", "cpu")
    assert predict(detector, tusimple, tmp_path / "found", PredictConfig(n_overlays=0)).n_images == 1
