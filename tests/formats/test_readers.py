"""Readers of foreign folders: files written here by each format's own rule give the same lanes in our camera frame."""

import json

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.formats.apollo import ApolloSplit
from synth3dlanes.formats.openlane import OpenLaneSplit, is_openlane
from synth3dlanes.formats.tusimple import TusimpleSplit, is_tusimple
from synth3dlanes.system.errors import FormatError
from tests.formats import closed_form as cf


def save_image(path, size_px):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size_px, (90, 90, 90)).save(path)


def lanes_of(labels, kind):
    return [lane for lane in labels.lanes if lane.kind == kind]


def assert_same_lanes(found, wanted, kind):
    assert found.camera.pitch_rad == pytest.approx(wanted.camera.pitch_rad)
    assert found.camera.height_m == pytest.approx(wanted.camera.height_m)
    np.testing.assert_allclose(found.camera.road_from_cam, wanted.camera.road_from_cam, atol=1e-12)
    for mine, theirs in zip(lanes_of(found, kind), lanes_of(wanted, kind), strict=True):
        np.testing.assert_allclose(mine.xyz_cam, theirs.xyz_cam, atol=1e-9)


@pytest.fixture
def labels():
    return cf.road(cf.camera_label(1.6, 0.04), n_lines=3, curvature=0.002, slope=0.0005)


def test_an_apollo_split_gives_our_lanes(labels, tmp_path):
    pitch_rad, height_m = labels.camera.pitch_rad, labels.camera.height_m / np.cos(labels.camera.pitch_rad)
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)

    def ground(xyz_cam):
        # The format's formula, from the usual camera frame (x right, y down, z forward).
        x, y, z = xyz_cam[:, 0], -xyz_cam[:, 2], xyz_cam[:, 1]
        return np.stack([x, -s * (y - height_m) + c * z, -c * (y - height_m) - s * z], axis=1).tolist()

    document = {"raw_file": "images/00/0001.jpg", "cam_height": height_m, "cam_pitch": pitch_rad}
    for name, kind in (("laneLines", "delimiter"), ("centerLines", "centerline")):
        lanes = lanes_of(labels, kind)
        document[name] = [ground(lane.xyz_cam) for lane in lanes]
        document[f"{name}_visibility"] = [[1.0] * 50 + [0.0] * (len(lane.xyz_cam) - 50) for lane in lanes]
    path = tmp_path / "data_splits/standard/train.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(document) + "\n")
    save_image(tmp_path / "images/00/0001.jpg", (1920, 1080))
    (sample,) = ApolloSplit(path)
    assert sample.key == "images/00/0001.jpg"
    assert sample.image.shape == (1080, 1920, 3)
    # fx = fy = 2015, cx = 960, cy = 540: 2 m right and 1 m up, 10 m ahead.
    u, v, depth = sample.labels.camera.img_from_cam @ [2.0, 10.0, 1.0]
    assert (u / depth, v / depth) == pytest.approx((960 + 403, 540 - 201.5))
    for kind in ("delimiter", "centerline"):
        assert_same_lanes(sample.labels, labels, kind)
    assert sample.labels.lanes[0].terrain_visible.sum() == 50


def test_an_openlane_split_gives_our_lanes(labels, tmp_path):
    c, s = np.cos(labels.camera.pitch_rad), np.sin(labels.camera.pitch_rad)
    key = "validation/segment-1/100.jpg"
    document = {
        "intrinsic": [[415.7, 0, 250], [0, 410.0, 180], [0, 0, 1]],
        "extrinsic": [[c, 0, s, 1.5], [0, 1, 0, 0.1], [-s, 0, c, labels.camera.height_m], [0, 0, 0, 1]],
        "file_path": key,
        # x forward, y left, z up; some sets have neither attribute nor track_id
        "lane_lines": [
            {
                "xyz": np.stack([lane.xyz_cam[:, 1], -lane.xyz_cam[:, 0], lane.xyz_cam[:, 2]]).tolist(),
                "visibility": [1.0] * len(lane.xyz_cam),
                "category": category,
            }
            for lane, category in zip(lanes_of(labels, "delimiter"), (12, 1, 21), strict=True)
        ],
    }
    folder = tmp_path / "lane3d_1000/validation"
    (folder / "segment-1").mkdir(parents=True)
    (folder / "segment-1/100.json").write_text(json.dumps(document))
    save_image(tmp_path / "images" / key, (480, 360))
    assert is_openlane(folder)
    (sample,) = OpenLaneSplit(folder)
    assert sample.key == key
    camera = sample.labels.camera
    assert (camera.width_px, camera.height_px) == (480, 360)
    u, v, depth = camera.img_from_cam @ [2.0, 10.0, 1.0]
    assert (u / depth, v / depth) == pytest.approx((250 + 83.14, 180 - 41))
    assert_same_lanes(sample.labels, labels, "delimiter")
    # Double yellow with a solid left stripe, white dashed, right curb.
    paints = [(lane.marking, lane.color, lane.double, lane.pair) for lane in sample.labels.lanes]
    assert paints == [
        ("solid", "yellow", True, "solid_dashed"),
        ("dashed", "white", False, None),
        ("none", None, None, None),
    ]


def test_a_tusimple_file_gives_columns_and_images(tmp_path):
    path = tmp_path / "label_data_0313.json"
    document = {"raw_file": "clips/1/20.jpg", "lanes": [[-2, 630, 620]], "h_samples": [240, 250, 260]}
    path.write_text(json.dumps(document) + "\n")
    save_image(tmp_path / "clips/1/20.jpg", (1280, 720))
    assert is_tusimple(path)
    split = TusimpleSplit(path)
    assert len(split) == 1
    np.testing.assert_array_equal(split.frame(0).rows_px, [240, 250, 260])
    np.testing.assert_array_equal(split.frame(0).lanes_u_px, [[-2, 630, 620]])
    assert split.image(0).shape == (720, 1280, 3)


def test_broken_frames_are_refused(tmp_path):
    path = tmp_path / "train.json"
    path.write_text('{"raw_file": "images/00/1.jpg", "cam_height": 1.5, "laneLines": []}\n')
    with pytest.raises(FormatError, match=r"train\.json:1: expected a frame of Apollo Sim-3D, got another"):
        ApolloSplit(path).labels(0)
    document = {"raw_file": "images/00/1.jpg", "cam_height": 1.5, "cam_pitch": 0.0, "laneLines": [[[0, 1, 0]]]}
    document |= {"laneLines_visibility": [[1.0, 1.0]], "centerLines": [], "centerLines_visibility": []}
    path.write_text(json.dumps(document))
    with pytest.raises(FormatError, match="laneLines_visibility: expected a value for every point of laneLines"):
        ApolloSplit(path).labels(0)
    path.write_text(json.dumps({**document, "laneLines": [], "laneLines_visibility": []}))
    with pytest.raises(FormatError, match=r"expected an image images/00/1\.jpg"):
        ApolloSplit(path)[0]
