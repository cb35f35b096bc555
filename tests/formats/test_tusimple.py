"""tuSimple: columns by rows, and frames without lines."""

import json
from dataclasses import replace

import numpy as np
from hypothesis import given, settings

from synth3dlanes.formats import tusimple
from synth3dlanes.formats.tusimple import FORMAT, parse
from synth3dlanes.formats.writing import Pinhole
from tests.formats import closed_form as cf
from tests.formats.random_roads import cameras, roads

FRAME = cf.frame(Pinhole(1280, 720, 2015 * 2 / 3))


@given(cameras, roads)
@settings(max_examples=25, deadline=None)
def test_tusimple_columns_lie_on_the_projected_lanes(camera, plan):
    labels = cf.road(cf.camera_label(*camera), **plan)
    annotation = tusimple.write(replace(FRAME, labels=labels))
    frame = parse(annotation.shared[0][0], "test")
    ids = json.loads(annotation.shared[1][0])["lines_ids"]
    assert 1 <= len(frame.lanes_u_px) <= 5
    by_id = {lane.id: lane for lane in labels.lanes}
    for lane_u_px, name in zip(frame.lanes_u_px, ids, strict=True):
        points_cam = by_id[name].xyz_cam[by_id[name].xyz_cam[:, 1] > 0.5]
        # 1280x720 px, f = 1343.3 px
        right_m, ahead_m, up_m = points_cam.T
        points_img = 2015 * 2 / 3 * np.stack([right_m, -up_m], axis=1) / ahead_m[:, None] + [640, 360]
        rows = np.flatnonzero(lane_u_px != -2)
        u_px, v_px = lane_u_px[rows], frame.rows_px[rows]
        # Distance to the projected polyline along the row, whole pixels.
        above = np.array([np.flatnonzero(points_img[:, 1] <= v)[0] for v in v_px])
        a, b = points_img[above - 1], points_img[above]
        expected_u_px = a[:, 0] + (v_px - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
        assert np.abs(u_px - expected_u_px).max() <= 0.5 + 1e-6


def test_tusimple_row_by_hand():
    camera = cf.camera_label(1.5, 0.0)
    annotation = tusimple.write(replace(FRAME, labels=cf.labels_of(camera, cf.lane(camera, cf.curve(1.5)))))
    frame = parse(annotation.shared[0][0], "test")
    # On level ground 1.5 m below and 1.5 m right of the camera: u - 640 = v - 360.
    (lane_u_px,) = frame.lanes_u_px
    present = lane_u_px != -2
    np.testing.assert_array_equal(lane_u_px[present], frame.rows_px[present] + 280)
    assert not present[frame.rows_px <= 370].any()
    assert present[frame.rows_px >= 380].all()


def test_tusimple_skips_frames_without_lines():
    assert tusimple.write(replace(FRAME, labels=cf.labels_of(cf.camera_label()))) is None


# What LaneATT, CLRNet and UFLD open: training on 0313 and 0601, with or without 0531; validation on 0531; test_label.
LABEL_FILES = {"label_data_0313.json", "label_data_0531.json", "label_data_0601.json", "test_label.json"}


def files_of(part, parts):
    frames = (replace(FRAME, part=part, parts=frozenset(parts), key=f"{key:08d}") for key in range(20))
    road = cf.road(cf.camera_label())
    return [tusimple.write(replace(frame, labels=road)).shared[0][1][0] for frame in frames]


def test_tusimple_label_files_are_those_that_loaders_open():
    assert set(files_of("test", {"train", "test"})) == {"test_label.json"}
    assert set(files_of("val", {"train", "val"})) == {"test_label.json"}, "no training file may hold a test frame"
    assert set(files_of("val", {"train", "val", "test"})) == {"label_data_0531.json"}
    assert set(files_of("train", {"train", "val", "test"})) == LABEL_FILES - {"test_label.json", "label_data_0531.json"}
    dealt = files_of("train", {"train", "test"})
    assert set(dealt) == LABEL_FILES - {"test_label.json"}
    assert dealt.count("label_data_0313.json") == 16
    assert set(FORMAT.lists) >= LABEL_FILES, "they are there even when empty"


def test_the_list_of_test_images_has_no_lanes():
    # UFLD opens test_tasks_0627.json for the names of the test images, with these three keys.
    frame = replace(FRAME, part="test")
    text, files = tusimple.write(replace(frame, labels=cf.road(cf.camera_label()))).shared[2]
    assert files == ("test_tasks_0627.json",)
    document = json.loads(text)
    assert document.keys() == {"raw_file", "h_samples", "lanes"}
    assert document["raw_file"] == "clips/train/00000017/20.jpg"
    assert document["lanes"] == []
    assert tusimple.write(replace(FRAME, labels=cf.road(cf.camera_label()))).shared[2][1] == ()
