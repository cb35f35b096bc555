"""Other people's folders, written here from our labels, give the same lanes back; tuSimple's accuracy; weights."""

import itertools
import json

import numpy as np
import pytest
import torch
from PIL import Image


@pytest.fixture
def labels(roads):
    return roads.labels(
        [lambda y: (0.001 * y**2, 0.01 * y)], [lambda y: (-1.8 + 0.001 * y**2, 0.01 * y), lambda y: (1.8, 0.01 * y)]
    )


def _blank(path, size):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, (90, 90, 90)).save(path)


def test_apollo_round_trip(labels, tmp_path):
    from synth3dlanes_baseline.foreign import ApolloSplit
    from synth3dlanes_baseline.sources import open_split

    pitch, height = labels.camera.pitch_rad, labels.camera.height_m / np.cos(labels.camera.pitch_rad)
    cos, sin = np.cos(pitch), np.sin(pitch)

    def ground(xyz_cam):
        # The format's own formula, from its standard camera (x right, y down, z forward).
        x, y, z = xyz_cam[:, 0], -xyz_cam[:, 2], xyz_cam[:, 1]
        return np.stack([x, -sin * (y - height) + cos * z, -cos * (y - height) - sin * z], axis=1).tolist()

    frame = {"raw_file": "images/00/0001.jpg", "cam_height": height, "cam_pitch": pitch}
    for name, kind in (("laneLines", "delimiter"), ("centerLines", "centerline")):
        lanes = [lane for lane in labels.lanes if lane.kind == kind]
        frame[name] = [ground(lane.xyz_cam) for lane in lanes]
        frame[f"{name}_visibility"] = [[1.0] * 50 + [0.0] * (len(lane.xyz_cam) - 50) for lane in lanes]
    path = tmp_path / "data_splits" / "standard" / "train.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(frame) + "\n")
    _blank(tmp_path / frame["raw_file"], (1920, 1080))
    split = open_split(path)
    assert isinstance(split, ApolloSplit)
    sample = split[0]
    assert sample.image.shape == (1080, 1920, 3)
    _same_lanes(sample.labels, labels)
    assert sample.labels.lanes[0].terrain_visible.sum() == 50


def test_openlane_round_trip(labels, tmp_path):
    from synth3dlanes_baseline.foreign import OpenLaneSplit
    from synth3dlanes_baseline.sources import open_split

    cos, sin = np.cos(labels.camera.pitch_rad), np.sin(labels.camera.pitch_rad)
    key = "validation/segment-1/100.jpg"
    frame = {
        "intrinsic": [[415.7, 0, 240], [0, 415.7, 180], [0, 0, 1]],
        "extrinsic": [[cos, 0, sin, 1.5], [0, 1, 0, 0.1], [-sin, 0, cos, labels.camera.height_m], [0, 0, 0, 1]],
        "file_path": key,
        "lane_lines": [
            {
                "xyz": np.stack([lane.xyz_cam[:, 1], -lane.xyz_cam[:, 0], lane.xyz_cam[:, 2]]).tolist(),
                "visibility": [1.0] * len(lane.xyz_cam),
                "category": 1,
            }
            for lane in labels.lanes
            if lane.kind == "delimiter"
        ],
    }
    folder = tmp_path / "lane3d_1000" / "validation"
    (folder / "segment-1").mkdir(parents=True)
    (folder / "segment-1" / "100.json").write_text(json.dumps(frame))
    _blank(tmp_path / "images" / key, (480, 360))
    split = open_split(folder)
    assert isinstance(split, OpenLaneSplit)
    assert split[0].key == key
    _same_lanes(split[0].labels, labels)


def test_foreign_frames_that_are_broken_are_refused(tmp_path):
    from synth3dlanes_baseline.sources import open_split

    from synth3dlanes.errors import FormatError

    path = tmp_path / "train.json"
    path.write_text('{"raw_file": "images/00/1.jpg", "cam_height": 1.5}\n')
    with pytest.raises(FormatError, match=r"train\.json:1: not an Apollo frame: KeyError: 'cam_pitch'"):
        open_split(path).labels(0)
    with pytest.raises(FormatError, match=r"expected an image images/00/1\.jpg"):
        open_split(path)[0]


@pytest.fixture
def tusimple(roads, tmp_path):
    """Two straight lines and a bent one on the fixed plane, as their x at rows 160, 170, ..., 710."""
    from synth3dlanes_baseline.lanes import Detection
    from synth3dlanes_baseline.poses import cam_from_road
    from synth3dlanes_baseline.tusimple import POSE, image_line

    from synth3dlanes.frames import transform

    rows = np.arange(160.0, 711.0, 10.0)
    y_m = np.arange(3.0, 105.0)
    lines = []
    for x_m in (-1.8 + 0 * y_m, 1.8 + 0 * y_m, 5.4 + 5e-4 * y_m**2):
        xyz_cam = transform(cam_from_road(POSE), np.stack([x_m, y_m, 0 * y_m], axis=1))
        lines.append(image_line(Detection("delimiter", 1.0, xyz_cam), rows))
    frame = {"raw_file": "clips/1/20.jpg", "lanes": lines, "h_samples": rows.astype(int).tolist()}
    path = tmp_path / "label_data.json"
    path.write_text(json.dumps(frame) + "\n")
    _blank(tmp_path / "clips/1/20.jpg", (1280, 720))
    return path


def test_tusimple_lines_go_to_the_plane_and_back(tusimple):
    from synth3dlanes_baseline.lanes import Detection, Prediction
    from synth3dlanes_baseline.sources import open_split
    from synth3dlanes_baseline.tusimple import TusimpleSplit, mean_accuracy

    split = open_split(tusimple)
    assert isinstance(split, TusimpleSplit)
    sample = split[0]
    assert sample.image.shape == (640, 1280, 3)
    lanes = tuple(Detection(lane.kind, 0.9, lane.xyz_cam) for lane in sample.labels.lanes)
    accuracy, false_positive, false_negative = mean_accuracy([Prediction(sample.key, lanes, None)], split)
    assert accuracy > 0.98
    assert (false_positive, false_negative) == (0.0, 0.0)


def test_tusimple_model_learns_only_delimiters_without_height(tusimple):
    from synth3dlanes_baseline.anchors import encode
    from synth3dlanes_baseline.config import MODELS
    from synth3dlanes_baseline.curves import road_curves
    from synth3dlanes_baseline.data import pack
    from synth3dlanes_baseline.model import LaneNet
    from synth3dlanes_baseline.projection import road_from_cam
    from synth3dlanes_baseline.sources import open_split

    config = MODELS["tusimple"]
    assert LaneNet(config).head.out.out_channels == 7, "K + 1 per anchor"
    pose = torch.tensor([[np.radians(config.fixed_pitch_deg), config.fixed_height_m]]).float()
    curves = pack([road_curves(open_split(tusimple)[0].labels)])
    targets, _ = encode(curves, road_from_cam(pose), config)
    assert targets.assigned.shape == (1, 1, 16)
    assert targets.assigned.sum() == 3
    assert targets.z_m[targets.assigned & True].abs().max() < 1e-3


def test_tusimple_accuracy_by_hand():
    from synth3dlanes_baseline.tusimple import accuracy

    rows = list(range(160, 711, 50))
    upright = [600.0] * len(rows)
    assert accuracy([upright], [upright], rows, 10.0) == (1.0, 0.0, 0.0)
    assert accuracy([[619.0] * len(rows)], [upright], rows, 10.0)[0] == 1.0
    assert accuracy([[621.0] * len(rows)], [upright], rows, 10.0) == (0.0, 1.0, 1.0)
    leaning = [400.0 + row for row in rows]
    assert accuracy([[x + 27.0 for x in leaning]], [leaning], rows, 10.0)[0] == 1.0, "20 px across is 28 along the row"
    assert accuracy([upright], [upright], rows, 300.0) == (0.0, 0.0, 1.0)
    assert accuracy([upright] * 4, [upright], rows, 10.0) == (0.0, 0.0, 1.0)
    assert accuracy([], [upright], rows, 10.0) == (0.0, 0.0, 1.0)
    absent = [-2.0] * (len(rows) // 2) + upright[len(rows) // 2 :]
    assert accuracy([absent], [absent], rows, 10.0)[0] == 1.0, "absent on both sides is right"
    five = [[100.0 * i] * len(rows) for i in range(1, 6)]
    assert accuracy(five[:4], five, rows, 10.0) == (1.0, 0.0, 0.0), "the worst of five does not count"


def test_vgg16_weights_from_files(tmp_path):
    import h5py
    from synth3dlanes_baseline.backbone import IMAGE_STD, ImagePathway
    from synth3dlanes_baseline.config import PAPER
    from synth3dlanes_baseline.pretrained import load_vgg16

    from synth3dlanes.errors import FormatError, InputError

    channels = [3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512]
    generator = torch.Generator().manual_seed(0)
    layers = [
        (torch.randn(o, i, 3, 3, generator=generator), torch.randn(o, generator=generator))
        for i, o in itertools.pairwise(channels)
    ]
    state = {f"features.{2 * n}.{part}": value for n, layer in enumerate(layers)
             for part, value in zip(("weight", "bias"), layer, strict=True)}  # fmt: skip
    torch.save(state, tmp_path / "vgg16.pth")
    for batch_norm in (False, True):
        image = ImagePathway(PAPER.model_copy(update={"batch_norm": batch_norm}))
        assert load_vgg16(image, str(tmp_path / "vgg16.pth")) == "13 convolutions from vgg16.pth"
        convolutions = [layer for layer in image.modules() if isinstance(layer, torch.nn.Conv2d)]
        assert all(layer.weight.equal(weight) for layer, (weight, _) in zip(convolutions, layers, strict=True))
        if not batch_norm:
            assert convolutions[5].bias.equal(layers[5][1])
    names = [f"block{b}/layers/conv2d{f'_{i}' if i else ''}/vars" for b, n in enumerate((2, 2, 3, 3, 3), 1)
             for i in range(n)]  # fmt: skip
    with h5py.File(tmp_path / "hed.h5", "w") as file:
        for name, (weight, bias) in zip(names, layers, strict=True):
            file[f"{name}/0"], file[f"{name}/1"] = weight.permute(2, 3, 1, 0).numpy(), bias.numpy()
    load_vgg16(image, str(tmp_path / "hed.h5"))
    # The file's first kernel is for BGR in 0..255; ours for RGB in 0..1 divided by the spread: equal responses.
    kernel = convolutions[0].weight
    blue_255 = layers[0][0][:, 0] * 255 * IMAGE_STD[2]
    assert torch.allclose(kernel[:, 2], blue_255)
    assert convolutions[7].weight.equal(layers[7][0])
    with pytest.raises(InputError, match="no such file"):
        load_vgg16(image, str(tmp_path / "none.pth"))
    (tmp_path / "bad.pth").write_bytes(b"x")
    with pytest.raises(FormatError, match=r"bad\.pth: expected a state dict"):
        load_vgg16(image, str(tmp_path / "bad.pth"))


def _same_lanes(found, wanted):
    assert found.camera.pitch_rad == pytest.approx(wanted.camera.pitch_rad)
    assert found.camera.height_m == pytest.approx(wanted.camera.height_m)
    for kind in {lane.kind for lane in found.lanes}:
        mine, its = ([lane for lane in labels.lanes if lane.kind == kind] for labels in (found, wanted))
        assert len(mine) == len(its)
        for a, b in zip(mine, its, strict=True):
            for axis in (0, 2):
                x = np.interp(a.xyz_cam[:, 1], b.xyz_cam[:, 1], b.xyz_cam[:, axis])
                assert a.xyz_cam[:, axis] == pytest.approx(x, abs=1e-3)
