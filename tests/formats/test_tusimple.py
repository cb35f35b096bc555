"""tuSimple: columns by rows, and frames without lines."""

import json
from dataclasses import replace

import numpy as np

from synth3dlanes.formats import tusimple
from synth3dlanes.formats.tusimple import FORMAT, parse
from synth3dlanes.formats.writing import Pinhole
from tests.formats import closed_form as cf

FRAME = cf.frame(Pinhole(1280, 720, 2015 * 2 / 3))


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
