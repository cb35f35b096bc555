"""Formats of lines in space: frames, order, visibility, caps, and the way back through our own readers."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from synth3dlanes.formats import apollo, once, openlane
from synth3dlanes.formats.apollo import cam_height_m
from synth3dlanes.formats.apollo import parse as parse_apollo
from synth3dlanes.formats.once import parse as parse_once
from synth3dlanes.formats.openlane import ground_from_waymo, vehicle_from_cam_waymo
from synth3dlanes.formats.openlane import parse as parse_openlane
from synth3dlanes.formats.writing import Pinhole
from tests.formats import closed_form as cf
from tests.formats.closed_form import ROUNDING_M, cameras, distance_to_lane_m, roads

APOLLO = cf.frame(Pinhole(1920, 1080, 2015.0))


def apollo_frame(labels, frame=APOLLO):
    return parse_apollo(apollo.write(replace(frame, labels=labels)).shared[0][0], "test")


def project_as_apollo_does(points_apollo, height_m, pitch_rad):
    """Their own projection: the camera's right, down and forward axes in their ground frame, its centre as noted."""
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    axes_apollo = np.array([[1, 0, 0], [0, -s, -c], [0, c, -s]])
    points_cv = (points_apollo - [0, height_m * s, height_m * c]) @ axes_apollo.T
    return apollo_pixels(points_cv)


def apollo_pixels(points_cv):
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
    np.testing.assert_allclose(seen_img, apollo_pixels(points_cv), atol=1e-9)


@given(cameras, roads)
@settings(max_examples=25, deadline=None)
def test_apollo_lines_come_back_within_rounding(camera, plan):
    labels = cf.road(cf.camera_label(*camera), **plan)
    frame = apollo_frame(labels)
    by_id = {lane.id: lane for lane in labels.lanes}
    ids = json.loads(apollo.write(replace(APOLLO, labels=labels)).shared[2][0])
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
    annotation = apollo.write(replace(APOLLO, labels=cf.labels_of(cf.camera_label())))
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
    annotation = apollo.write(replace(APOLLO, labels=labels))
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
    frame = replace(APOLLO, part=part, tags=frozenset(tags), illumination=illumination)
    annotation = apollo.write(replace(frame, labels=cf.road(cf.camera_label())))
    assert f"images/{folder}/" in annotation.image
    assert set(annotation.shared[0][1]) == {f"data_splits/{split}/{part}.json" for split in splits}
    assert set(annotation.shared[1][1]) == {f"data_lists/{split}/{part}.txt" for split in splits}


OPENLANE = cf.frame(Pinhole(1920, 1280, 2015.0))


def openlane_frame(labels, frame=OPENLANE):
    (text,) = openlane.write(replace(frame, labels=labels)).files.values()
    return parse_openlane(text, "test")


@given(cameras, roads)
@settings(max_examples=25, deadline=None)
def test_openlane_points_reproject_to_their_uv(camera, plan):
    labels = cf.road(cf.camera_label(*camera), **plan)
    frame = openlane_frame(labels)
    for line in frame.lines:
        x_m, y_m, z_m = line.xyz_waymo[line.visible].T
        homogeneous = np.column_stack([-y_m, -z_m, x_m]) @ frame.img_from_cv.T
        np.testing.assert_allclose(homogeneous[:, :2] / homogeneous[:, 2:], line.uv_img, atol=1e-4)
        assert np.all(np.diff(line.xyz_waymo[:, 0]) > 0)
        assert np.linalg.norm(np.diff(line.xyz_waymo, axis=0), axis=1).max() <= 0.5 + 1e-3
        assert np.all(np.diff(line.visible.astype(int)) <= 0)


@given(cameras, roads)
@settings(max_examples=25, deadline=None)
def test_openlane_holds_our_samples_and_its_extrinsic_leads_to_the_road_frame(camera, plan):
    labels = cf.road(cf.camera_label(*camera), **plan)
    frame = openlane_frame(labels)
    road_from_cam = labels.camera.road_from_cam
    ours_road = np.concatenate([lane.xyz_cam @ road_from_cam[:3, :3].T + road_from_cam[:3, 3] for lane in labels.lanes])
    for line in frame.lines:
        ground = ground_from_waymo(line.xyz_waymo, frame.vehicle_from_cam_waymo)
        gaps_m = np.linalg.norm(ground[:, None] - ours_road, axis=2).min(axis=1)
        assert np.mean(gaps_m < ROUNDING_M) > 0.3, "every second or third point is one of our samples"
        assert gaps_m.max() < 0.6


def test_openlane_extrinsic_turns_the_axis_of_sight_down():
    vehicle_from_cam = vehicle_from_cam_waymo(1.5, 0.1)
    np.testing.assert_allclose(vehicle_from_cam[:3, 0], [np.cos(0.1), 0, -np.sin(0.1)])
    np.testing.assert_allclose(vehicle_from_cam[:3, 3], [0, 0, 1.5])


def test_a_point_to_the_right_has_negative_waymo_y_and_ground_x_to_the_right():
    camera = cf.camera_label()
    frame = openlane_frame(cf.labels_of(camera, cf.lane(camera, cf.curve(2.0))))
    (line,) = frame.lines
    np.testing.assert_allclose(line.xyz_waymo[:, 1], -2.0, atol=ROUNDING_M)
    ground = ground_from_waymo(line.xyz_waymo, frame.vehicle_from_cam_waymo)
    np.testing.assert_allclose(ground[:, 0], 2.0, atol=ROUNDING_M)
    np.testing.assert_allclose(ground[:, 2], 0.0, atol=1e-5)


def test_openlane_categories_attributes_and_ids():
    frame = openlane_frame(cf.road(cf.camera_label(), n_lines=5, width_m=3.0))
    by_x = sorted(frame.lines, key=lambda line: -line.xyz_waymo[0, 1])
    assert [line.category for line in by_x] == [2, 1, 1, 1, 2]
    # The middle line runs under the camera (x = 0), which counts as right.
    assert [line.attribute for line in by_x] == [1, 2, 3, 4, 0]
    assert len({line.track_id for line in by_x}) == 5
    other = openlane_frame(cf.road(cf.camera_label()), replace(OPENLANE, number=18))
    assert not {line.track_id for line in by_x} & {line.track_id for line in other.lines}


def test_openlane_starts_at_the_image_border():
    width_px, height_px = 1920, 1280
    for line in openlane_frame(cf.road(cf.camera_label())).lines:
        u_px, v_px = line.uv_img[0]
        assert 0 <= u_px <= width_px
        assert 0 <= v_px <= height_px
        assert min(u_px, width_px - u_px, height_px - v_px) < 100


def test_a_narrow_frame_has_its_own_intrinsics():
    frame = replace(OPENLANE, pinhole=Pinhole(1920, 1280, 2500.0))
    for line in (found := openlane_frame(cf.road(cf.camera_label()), frame)).lines:
        ahead_m, left_m, up_m = line.xyz_waymo[line.visible].T
        expected = np.stack([960 - 2500 * left_m / ahead_m, 640 - 2500 * up_m / ahead_m], axis=1)
        np.testing.assert_allclose(line.uv_img, expected, atol=1e-4)
    np.testing.assert_array_equal(found.img_from_cv, [[2500, 0, 960], [0, 2500, 640], [0, 0, 1]])


ONCE = cf.frame(Pinhole(1920, 1020, 2015.0))


def once_frame(labels, frame=ONCE):
    text, *_ = once.write(replace(frame, labels=labels)).files.values()
    return parse_once(text, "test")


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


def test_once_frames_without_lanes_are_there_but_not_for_anchor3dlane_to_train_on():
    for part, n_lists in (("train", 0), ("test", 2)):
        annotation = once.write(replace(replace(ONCE, part=part), labels=cf.labels_of(cf.camera_label())))
        for text in annotation.files.values():
            assert json.loads(text)["lanes"] == []
        # Its converter leaves out training frames without lanes; its loader opens what data_lists name.
        assert len(annotation.shared[1][1]) == n_lists


def test_once_calibration_is_the_frames_own():
    frame = replace(ONCE, pinhole=Pinhole(1920, 1020, 1200.0))
    found = once_frame(cf.labels_of(cf.camera_label()), frame)
    np.testing.assert_array_equal(found.img_from_cv, [[1200, 0, 960, 0], [0, 1200, 510, 0], [0, 0, 1, 0]])


def test_once_lines_that_its_evaluator_cannot_assign_come_last():
    camera = cf.camera_label()
    # The evaluator's raster ends 10 m ahead and 10 m aside.
    far = cf.lane(camera, cf.curve(1.0, start_m=12.0), "far")
    labels = cf.labels_of(camera, far, cf.lane(camera, cf.curve(-2.0)), cf.lane(camera, cf.curve(4.0)))
    assert [round(points_cv[-1, 0]) for points_cv in once_frame(labels).lanes_cv] == [-2, 4, 1]
