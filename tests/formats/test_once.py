"""ONCE-3DLanes: frames, order, layout, and the way back through our own reader."""

import json
from dataclasses import replace

import numpy as np
from hypothesis import given, settings

from synth3dlanes.formats.once import write
from synth3dlanes.formats.once.read import parse
from tests.formats import closed_form as cf
from tests.formats.random_roads import ROUNDING_M, cameras, distance_to_lane_m, roads


def once_frame(labels, frame=cf.FRAME):
    (text,) = write.annotate(labels, frame).files.values()
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


def test_once_layout_avoids_the_words_that_loaders_replace():
    for is_train, part in ((True, "train"), (False, "val")):
        annotation = write.annotate(cf.labels_of(cf.camera_label()), replace(cf.FRAME, is_train=is_train))
        ((path, text),) = annotation.files.items()
        assert path == f"ONCE_3DLanes/{part}/000000/cam01/00000017.json"
        assert path.replace(part, "data").replace(".json", ".jpg") == annotation.image
        assert json.loads(text)["lanes"] == []
        assert np.shape(json.loads(text)["calibration"]) == (3, 4)


def test_once_leaves_out_what_its_evaluator_cannot_assign():
    camera = cf.camera_label()
    labels = cf.labels_of(camera, cf.lane(camera, cf.curve(2.0)), cf.lane(camera, cf.curve(4.0, start_m=30.0), "far"))
    annotation = write.annotate(labels, cf.FRAME)
    assert annotation.n_lines == 1
    assert sum(annotation.dropped.values()) == 1
