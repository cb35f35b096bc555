"""ONCE-3DLanes: frames, order, layout, and the way back through our own reader."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from synth3dlanes.formats import once
from synth3dlanes.formats.once import parse
from synth3dlanes.formats.writing import Pinhole
from tests.formats import closed_form as cf
from tests.formats.random_roads import ROUNDING_M, cameras, distance_to_lane_m, roads

FRAME = cf.frame(Pinhole(1920, 1020, 2015.0))


def once_frame(labels, frame=FRAME):
    text, *_ = once.write(replace(frame, labels=labels)).files.values()
    return parse(text, "test")


@given(cameras, roads)
@settings(max_examples=25, deadline=None)
def test_once_lines_come_back_far_to_near_within_rounding(camera, plan):
    labels = cf.road(cf.camera_label(*camera), **plan)
    frame = once_frame(labels)
    lanes = [lane for lane in labels.lanes if lane.kind == "delimiter"]
    for points_cv in frame.lanes_cv:
        assert np.all(np.diff(points_cv[:, 2]) < 0)
        assert min(distance_to_lane_m(points_cv, lane).max() for lane in lanes) < ROUNDING_M
        in_raster = (points_cv[:, 2] < 10) & (np.abs(points_cv[:, 0]) < 10)
        assert in_raster.sum() >= 2
    assert (frame.camera_height_m, frame.camera_pitch_rad) == (labels.camera.height_m, labels.camera.pitch_rad)


def test_once_axes_are_right_down_forward():
    camera = cf.camera_label(1.5, 0.0)
    (points_cv,) = once_frame(cf.labels_of(camera, cf.lane(camera, cf.curve(2.0)))).lanes_cv
    np.testing.assert_allclose(points_cv[:, 0], 2.0, atol=ROUNDING_M)
    np.testing.assert_allclose(points_cv[:, 1], 1.5, atol=ROUNDING_M)
    assert points_cv[0, 2] > 90 > 10 > points_cv[-1, 2] > 0


@pytest.mark.parametrize(
    ("part", "parts", "folders"),
    [
        ("train", {"train", "val"}, {"train"}),
        ("val", {"train", "val"}, {"val", "test"}),
        ("test", {"train", "test"}, {"val", "test"}),
        ("val", {"train", "val", "test"}, {"val"}),
        ("test", {"train", "val", "test"}, {"test"}),
    ],
)
def test_once_layout_is_that_of_its_loaders(part, parts, folders):
    frame = replace(FRAME, part=part, parts=frozenset(parts))
    annotation = once.write(replace(frame, labels=cf.road(cf.camera_label())))
    # PersFormer opens train/ and test/, LATR train/ and val/: <folder>/*/*/*.json
    assert set(annotation.files) == {f"ONCE_3DLanes/{folder}/000000/cam01/00000017.json" for folder in folders}
    for path, text in annotation.files.items():
        # The first of these words that is anywhere in the path becomes "data".
        word = next(word for word in ("train", "val", "test") if word in path)
        assert path.replace(word, "data").replace(".json", ".jpg") == annotation.image
        assert "\n" not in text
        assert np.shape(json.loads(text)["calibration"]) == (3, 4)
    # Anchor3DLane: data_lists/<part>.txt, lines below raw_data/
    lines, lists = annotation.shared[1]
    assert annotation.image == f"ONCE_3DLanes/data/{lines}"
    assert set(lists) == {f"data_lists/{folder}.txt" for folder in folders}


def test_once_frames_without_lanes_are_there_but_not_for_anchor3dlane_to_train_on():
    for part, n_lists in (("train", 0), ("test", 2)):
        annotation = once.write(replace(replace(FRAME, part=part), labels=cf.labels_of(cf.camera_label())))
        for text in annotation.files.values():
            assert json.loads(text)["lanes"] == []
        # Its converter leaves out training frames without lanes; its loader opens what data_lists name.
        assert len(annotation.shared[1][1]) == n_lists


def test_once_calibration_is_the_frames_own():
    frame = replace(FRAME, pinhole=Pinhole(1920, 1020, 1200.0))
    found = once_frame(cf.labels_of(cf.camera_label()), frame)
    np.testing.assert_array_equal(found.img_from_cv, [[1200, 0, 960, 0], [0, 1200, 510, 0], [0, 0, 1, 0]])


def test_once_lines_that_its_evaluator_cannot_assign_come_last():
    camera = cf.camera_label()
    # The evaluator's raster ends 10 m ahead and 10 m aside.
    far = cf.lane(camera, cf.curve(1.0, start_m=12.0), "far")
    labels = cf.labels_of(camera, far, cf.lane(camera, cf.curve(-2.0)), cf.lane(camera, cf.curve(4.0)))
    assert [round(points_cv[-1, 0]) for points_cv in once_frame(labels).lanes_cv] == [-2, 4, 1]
