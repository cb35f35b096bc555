"""Apollo Sim-3D: frames, order, visibility, caps, and the way back through our own reader."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from synth3dlanes.formats import apollo
from synth3dlanes.formats.apollo import cam_height_m, parse
from synth3dlanes.formats.writing import Pinhole
from tests.formats import closed_form as cf
from tests.formats.random_roads import ROUNDING_M, cameras, distance_to_lane_m, roads

FRAME = cf.frame(Pinhole(1920, 1080, 2015.0))


def apollo_frame(labels, frame=FRAME):
    return parse(apollo.write(replace(frame, labels=labels)).shared[0][0], "test")


def project_as_apollo_does(points_apollo, height_m, pitch_rad):
    """Their own projection: the camera's right, down and forward axes in their ground frame, its centre as noted."""
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    axes_apollo = np.array([[1, 0, 0], [0, -s, -c], [0, c, -s]])
    points_cv = (points_apollo - [0, height_m * s, height_m * c]) @ axes_apollo.T
    return pixels(points_cv)


def pixels(points_cv):
    """The intrinsics that their tools hard-code."""
    homogeneous = points_cv @ np.array([[2015, 0, 960], [0, 2015, 540], [0, 0, 1.0]]).T
    return homogeneous[:, :2] / homogeneous[:, 2:]


def cv_from_apollo(points_apollo, height_m, pitch_rad):
    """Camera coordinates by their own 4x4: turn by the pitch, the camera's height along y of the turned frame."""
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    x_m, y_m, z_m = points_apollo.T
    return np.column_stack([x_m, height_m - s * y_m - c * z_m, c * y_m - s * z_m])


@given(cameras)
@settings(deadline=None)
def test_apollo_projection_reproduces_our_pixels(pose):
    camera = cf.camera_label(*pose)
    points_cv = np.array([[2.0, 1.5, 6.0], [-3, 1, 10], [5, -2, 80]])
    points_apollo = apollo.apollo_from_cv(points_cv, camera)
    seen_img = project_as_apollo_does(points_apollo, cam_height_m(camera.height_m, camera.pitch_rad), camera.pitch_rad)
    np.testing.assert_allclose(seen_img, pixels(points_cv), atol=1e-9)


@given(cameras, roads)
@settings(max_examples=25, deadline=None)
def test_apollo_lines_come_back_within_rounding(camera, plan):
    labels = cf.road(cf.camera_label(*camera), **plan)
    frame = apollo_frame(labels)
    by_id = {lane.id: lane for lane in labels.lanes}
    ids = json.loads(apollo.write(replace(FRAME, labels=labels)).shared[2][0])
    for lines_apollo, flags, names in (
        (frame.lines_apollo("delimiter"), frame.visible("delimiter"), ids["laneLines_ids"]),
        (frame.lines_apollo("centerline"), frame.visible("centerline"), ids["centerLines_ids"]),
    ):
        assert len(lines_apollo) == len(names) > 0
        for points_apollo, visible, name in zip(lines_apollo, flags, names, strict=True):
            points_cv = cv_from_apollo(points_apollo, frame.cam_height_m, frame.cam_pitch_rad)
            assert distance_to_lane_m(points_cv, by_id[name]).max() < ROUNDING_M
            assert np.all(np.diff(points_apollo[:, 1]) > 0)
            assert points_apollo[0, 1] > 0
            assert np.all(np.diff(visible.astype(int)) <= 0), "visibility must be a prefix"


def test_a_point_to_the_right_and_ahead_is_positive_in_both_and_a_hill_is_up():
    labels = cf.labels_of(camera := cf.camera_label(), cf.lane(camera, cf.curve(2.0, slope=0.001)))
    (points_apollo,) = apollo_frame(labels).lines_apollo("delimiter")
    assert np.all(points_apollo[:, 0] > 0)
    assert points_apollo[-1, 1] > 90
    assert points_apollo[-1, 2] > 3


def test_a_crest_hides_and_cars_do_not():
    camera = cf.camera_label()
    lane = cf.lane(camera, cf.curve(2.0), hidden_from_m=40)
    behind_a_car = replace(lane, object_visible=np.zeros(len(lane.xyz_cam), dtype=bool))
    (points_apollo,), (visible,) = (
        (frame := apollo_frame(cf.labels_of(camera, behind_a_car))).lines_apollo("delimiter"),
        frame.visible("delimiter"),
    )
    assert 38 < points_apollo[visible][-1, 1] < 40.2
    assert visible[0], "the stretch below the image counts as visible"


def test_visibility_bridges_a_hole_between_two_visible_stretches():
    camera = cf.camera_label()
    lane = cf.lane(camera, cf.curve(2.0))
    seen = (lane.xyz_cam[:, 1] < 23) | ((lane.xyz_cam[:, 1] > 63) & (lane.xyz_cam[:, 1] < 80))
    frame = apollo_frame(cf.labels_of(camera, replace(lane, terrain_visible=seen)))
    (visible,), (points_apollo,) = frame.visible("delimiter"), frame.lines_apollo("delimiter")
    assert 78 < points_apollo[visible][-1, 1] < 81
    assert np.all(visible[points_apollo[:, 1] < 78])


def test_apollo_line_has_every_key_on_one_physical_line_even_without_lanes():
    annotation = apollo.write(replace(FRAME, labels=cf.labels_of(cf.camera_label())))
    text = annotation.shared[0][0]
    assert "\n" not in text
    assert json.loads(text) == {
        "raw_file": "images/02/train_00000017.jpg",
        "cam_height": pytest.approx(1.6 / np.cos(0.05)),
        "cam_pitch": 0.05,
        "laneLines": [],
        "laneLines_visibility": [],
        "centerLines": [],
        "centerLines_visibility": [],
    }


def test_apollo_keeps_the_six_nearest_and_says_what_it_dropped():
    camera = cf.camera_label()
    x_m = [7.0, -5.0, 1.0, -1.0, 3.0, -3.0, 5.5, 14.0]
    labels = cf.labels_of(camera, *(cf.lane(camera, cf.curve(x), f"x{x}") for x in x_m))
    annotation = apollo.write(replace(FRAME, labels=labels))
    sidecar = json.loads(annotation.shared[2][0])
    assert sidecar["laneLines_ids"] == ["x1.0", "x-1.0", "x3.0", "x-3.0", "x-5.0", "x5.5"]
    assert sum(annotation.dropped.values()) == 2
    assert any("10 m" in reason for reason in annotation.dropped)
    assert any("6 nearest" in reason for reason in annotation.dropped)


def test_a_folded_line_ends_where_it_folds():
    camera = cf.camera_label()
    angle = np.linspace(0, np.pi, 60)
    u_turn = np.column_stack([2 + 10 * (1 - np.cos(angle)), 10 + 30 * np.sin(angle), np.zeros(60)])
    (points_apollo,) = apollo_frame(cf.labels_of(camera, cf.lane(camera, u_turn))).lines_apollo("delimiter")
    assert np.all(np.diff(points_apollo[:, 1]) > 0)
    assert len(points_apollo) < 35


def test_two_paths_that_look_alike_are_one_centre_line():
    camera = cf.camera_label()
    lanes = [cf.lane(camera, cf.curve(0.0), name, "centerline", hidden_from_m=50) for name in ("stay", "leave")]
    assert len(apollo_frame(cf.labels_of(camera, *lanes)).lines_apollo("centerline")) == 1


@pytest.mark.parametrize(
    ("is_train", "tags", "illumination", "folder", "splits"),
    [
        (True, (), 0, "00", {"standard", "rare_subset"}),
        (True, ("curve",), 1, "03", {"standard", "rare_subset", "illus_chg"}),
        (False, (), 1, "02", {"standard"}),
        (False, ("merge_split",), 0, "01", {"standard", "illus_chg"}),
        (False, ("steep",), 2, "10", {"standard", "rare_subset"}),
        (False, ("steep", "curve"), 0, "07", {"standard", "rare_subset", "illus_chg"}),
    ],
)
def test_apollo_splits_follow_the_folder_numbers(is_train, tags, illumination, folder, splits):
    part = "train" if is_train else "test"
    frame = replace(FRAME, part=part, tags=frozenset(tags), illumination=illumination)
    annotation = apollo.write(replace(frame, labels=cf.road(cf.camera_label())))
    assert f"images/{folder}/" in annotation.image
    assert set(annotation.shared[0][1]) == {f"data_splits/{split}/{part}.json" for split in splits}
    assert set(annotation.shared[1][1]) == {f"data_lists/{split}/{part}.txt" for split in splits}
