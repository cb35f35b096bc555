"""Each format: frames, order, visibility, caps, and the way back through our own reader."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synth3dlanes.errors import FormatError
from synth3dlanes.export import apollo, once, openlane, tusimple
from synth3dlanes.export.lines import CV_FROM_CAM, scene_tags
from tests.export import closed_form as cf

ROUNDING_M = 2e-6
# Built inside the tests: the shape checks draw random numbers, which Hypothesis forbids in a strategy.
cameras = st.tuples(st.floats(1.4, 1.9), st.floats(0.0, 0.0873))
roads = st.fixed_dictionaries(
    {
        "n_lines": st.integers(2, 5),
        "width_m": st.floats(3.2, 4.0),
        "curvature": st.floats(-0.004, 0.004),
        "slope": st.floats(-0.0008, 0.0015),
    }
)


def apollo_frame(labels, frame=cf.FRAME):
    return apollo.read(apollo.annotate(labels, frame).shared[0][0], "test")


def openlane_frame(labels, frame=cf.FRAME):
    (text,) = openlane.annotate(labels, frame).files.values()
    return openlane.read(text, "test")


def once_frame(labels, frame=cf.FRAME):
    (text,) = once.annotate(labels, frame).files.values()
    return once.read(text, "test")


def distance_to_lane_m(points_cv, lane):
    """How far each point is from the nearest sample of a lane."""
    lane_cv = lane.xyz_cam @ CV_FROM_CAM.T
    return np.linalg.norm(points_cv[:, None] - lane_cv, axis=2).min(axis=1)


def project_as_apollo_does(points_apollo, height_m, pitch_rad):
    """Their own projection: the camera's right, down and forward axes in their ground frame, its centre as noted."""
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    axes_apollo = np.array([[1, 0, 0], [0, -s, -c], [0, c, -s]])
    points_cv = (points_apollo - [0, height_m * s, height_m * c]) @ axes_apollo.T
    homogeneous = points_cv @ apollo.VIEW.img_from_cv.T
    return homogeneous[:, :2] / homogeneous[:, 2:]


# ---- Apollo


@given(cameras)
@settings(deadline=None)
def test_apollo_frame_and_its_inverse(pose):
    camera = cf.camera_label(*pose)
    points_cv = np.random.default_rng(0).uniform(-40, 40, (50, 3))
    back_cv = apollo.cv_from_apollo(
        apollo.apollo_from_cv(points_cv, camera), apollo.cam_height_m(camera), camera.pitch_rad
    )
    np.testing.assert_allclose(back_cv, points_cv, atol=1e-12)


@given(cameras)
@settings(deadline=None)
def test_apollo_projection_reproduces_our_pixels(pose):
    camera = cf.camera_label(*pose)
    points_cv = np.array([[2.0, 1.5, 6.0], [-3, 1, 10], [5, -2, 80]])
    points_apollo = apollo.apollo_from_cv(points_cv, camera)
    seen_img = project_as_apollo_does(points_apollo, apollo.cam_height_m(camera), camera.pitch_rad)
    np.testing.assert_allclose(seen_img, apollo.VIEW.project(points_cv), atol=1e-9)


def test_foot_of_camera_coordinates_would_be_off_by_the_figures_of_the_notes():
    camera = cf.camera_label(1.9, np.radians(5))
    # (16.4, 14.9) px at 6 m, (6.0, 4.8) px at 10 m. The notes do not say how far aside: half a lane fits.
    points_road = np.array([[1.8, 6.0, 0], [1.8, 10.0, 0]])
    points_cam = (points_road - camera.road_from_cam[:3, 3]) @ camera.road_from_cam[:3, :3]
    right_img = apollo.VIEW.project(points_cam @ CV_FROM_CAM.T)
    wrong_img = project_as_apollo_does(points_road, 1.9, camera.pitch_rad)
    off_px = np.abs(wrong_img - right_img)
    np.testing.assert_allclose(off_px[:, 1], [14.9, 4.8], atol=0.2)
    np.testing.assert_allclose(off_px[:, 0], [16.4, 6.0], atol=0.5)


@given(cameras)
@settings(deadline=None)
def test_apollo_camera_position_and_road_plane(pose):
    camera = cf.camera_label(*pose)
    h_m, p = apollo.cam_height_m(camera), camera.pitch_rad
    center_apollo = apollo.apollo_from_cv(np.zeros((1, 3)), camera)[0]
    np.testing.assert_allclose(center_apollo, [0, h_m * np.sin(p), h_m * np.cos(p)], atol=1e-12)
    flat = cf.lane(camera, cf.curve(2.0))
    np.testing.assert_allclose(apollo.apollo_from_cv(flat.xyz_cam @ CV_FROM_CAM.T, camera)[:, 2], 0, atol=1e-12)
    axis_apollo = apollo.apollo_from_cv(np.array([[0, 0, 1.0]]), camera)[0] - center_apollo
    np.testing.assert_allclose(axis_apollo, [0, np.cos(p), -np.sin(p)], atol=1e-12)


@given(cameras, roads)
@settings(max_examples=25, deadline=None)
def test_apollo_lines_come_back_within_rounding(camera, plan):
    labels = cf.road(cf.camera_label(*camera), **plan)
    frame = apollo_frame(labels)
    by_id = {lane.id: lane for lane in labels.lanes}
    ids = json.loads(apollo.annotate(labels, cf.FRAME).shared[2][0])
    for lines_apollo, flags, names in (
        (frame.lane_lines_apollo, frame.lane_lines_visible, ids["laneLines_ids"]),
        (frame.center_lines_apollo, frame.center_lines_visible, ids["centerLines_ids"]),
    ):
        assert len(lines_apollo) == len(names) > 0
        for points_apollo, visible, name in zip(lines_apollo, flags, names, strict=True):
            points_cv = apollo.cv_from_apollo(points_apollo, frame.cam_height_m, frame.cam_pitch_rad)
            assert distance_to_lane_m(points_cv, by_id[name]).max() < ROUNDING_M
            assert np.all(np.diff(points_apollo[:, 1]) > 0)
            assert points_apollo[0, 1] > 0
            assert np.all(np.diff(visible.astype(int)) <= 0), "visibility must be a prefix"


def test_a_point_to_the_right_and_ahead_is_positive_in_both_and_a_hill_is_up():
    labels = cf.labels_of(camera := cf.camera_label(), cf.lane(camera, cf.curve(2.0, slope=0.001)))
    (points_apollo,) = apollo_frame(labels).lane_lines_apollo
    assert np.all(points_apollo[:, 0] > 0)
    assert points_apollo[-1, 1] > 90
    assert points_apollo[-1, 2] > 3


def test_a_crest_hides_and_cars_do_not():
    camera = cf.camera_label()
    lane = cf.lane(camera, cf.curve(2.0), hidden_from_m=40)
    behind_a_car = replace(lane, object_visible=np.zeros(len(lane.xyz_cam), dtype=bool))
    (points_apollo,), (visible,) = (
        (frame := apollo_frame(cf.labels_of(camera, behind_a_car))).lane_lines_apollo,
        frame.lane_lines_visible,
    )
    assert 38 < points_apollo[visible][-1, 1] < 40.2
    assert visible[0], "the stretch below the image counts as visible"


def test_visibility_bridges_a_hole_between_two_visible_stretches():
    camera = cf.camera_label()
    lane = cf.lane(camera, cf.curve(2.0))
    seen = (lane.xyz_cam[:, 1] < 23) | ((lane.xyz_cam[:, 1] > 63) & (lane.xyz_cam[:, 1] < 80))
    frame = apollo_frame(cf.labels_of(camera, replace(lane, terrain_visible=seen)))
    (visible,), (points_apollo,) = frame.lane_lines_visible, frame.lane_lines_apollo
    assert 78 < points_apollo[visible][-1, 1] < 81
    assert np.all(visible[points_apollo[:, 1] < 78])


def test_apollo_line_has_every_key_on_one_physical_line_even_without_lanes():
    annotation = apollo.annotate(cf.labels_of(cf.camera_label()), cf.FRAME)
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
    annotation = apollo.annotate(labels, cf.FRAME)
    sidecar = json.loads(annotation.shared[2][0])
    assert sidecar["laneLines_ids"] == ["x1.0", "x-1.0", "x3.0", "x-3.0", "x-5.0", "x5.5"]
    assert sum(annotation.dropped.values()) == 2
    assert any("10 m" in reason for reason in annotation.dropped)
    assert any("6 nearest" in reason for reason in annotation.dropped)


def test_a_folded_line_ends_where_it_folds():
    camera = cf.camera_label()
    angle = np.linspace(0, np.pi, 60)
    u_turn = np.column_stack([2 + 10 * (1 - np.cos(angle)), 10 + 30 * np.sin(angle), np.zeros(60)])
    (points_apollo,) = apollo_frame(cf.labels_of(camera, cf.lane(camera, u_turn))).lane_lines_apollo
    assert np.all(np.diff(points_apollo[:, 1]) > 0)
    assert len(points_apollo) < 35


def test_two_paths_that_look_alike_are_one_centre_line():
    camera = cf.camera_label()
    lanes = [cf.lane(camera, cf.curve(0.0), name, "centerline", hidden_from_m=50) for name in ("stay", "leave")]
    assert len(apollo_frame(cf.labels_of(camera, *lanes)).center_lines_apollo) == 1


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
    frame = replace(cf.FRAME, is_train=is_train, tags=frozenset(tags), illumination=illumination)
    annotation = apollo.annotate(cf.road(cf.camera_label()), frame)
    part = "train" if is_train else "test"
    assert f"images/{folder}/" in annotation.image
    assert set(annotation.shared[0][1]) == {f"data_splits/{split}/{part}.json" for split in splits}
    assert set(annotation.shared[1][1]) == {f"data_lists/{split}/{part}.txt" for split in splits}


# ---- OpenLane


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
        ground = openlane.ground_from_waymo(line.xyz_waymo, frame.vehicle_from_cam_waymo)
        gaps_m = np.linalg.norm(ground[:, None] - ours_road, axis=2).min(axis=1)
        assert np.mean(gaps_m < ROUNDING_M) > 0.3, "every second or third point is one of our samples"
        assert gaps_m.max() < 0.6


def test_openlane_extrinsic_turns_the_axis_of_sight_down():
    vehicle_from_cam = openlane.vehicle_from_cam_waymo(cf.camera_label(1.5, 0.1))
    np.testing.assert_allclose(vehicle_from_cam[:3, 0], [np.cos(0.1), 0, -np.sin(0.1)])
    np.testing.assert_allclose(vehicle_from_cam[:3, 3], [0, 0, 1.5])


def test_a_point_to_the_right_has_negative_waymo_y_and_ground_x_to_the_right():
    camera = cf.camera_label()
    frame = openlane_frame(cf.labels_of(camera, cf.lane(camera, cf.curve(2.0))))
    (line,) = frame.lines
    np.testing.assert_allclose(line.xyz_waymo[:, 1], -2.0, atol=ROUNDING_M)
    ground = openlane.ground_from_waymo(line.xyz_waymo, frame.vehicle_from_cam_waymo)
    np.testing.assert_allclose(ground[:, 0], 2.0, atol=ROUNDING_M)
    np.testing.assert_allclose(ground[:, 2], 0.0, atol=1e-5)


def test_openlane_categories_attributes_and_ids():
    frame = openlane_frame(cf.road(cf.camera_label(), n_lines=5, width_m=3.0))
    by_x = sorted(frame.lines, key=lambda line: -line.xyz_waymo[0, 1])
    assert [line.category for line in by_x] == [2, 1, 1, 1, 2]
    # The middle line runs under the camera (x = 0), which counts as right.
    assert [line.attribute for line in by_x] == [1, 2, 3, 4, 0]
    assert len({line.track_id for line in by_x}) == 5
    other = openlane_frame(cf.road(cf.camera_label()), replace(cf.FRAME, number=18))
    assert not {line.track_id for line in by_x} & {line.track_id for line in other.lines}


def test_openlane_starts_at_the_image_border():
    view = openlane.VIEW
    for line in openlane_frame(cf.road(cf.camera_label())).lines:
        u_px, v_px = line.uv_img[0]
        assert 0 <= u_px <= view.width_px
        assert 0 <= v_px <= view.height_px
        assert min(u_px, view.width_px - u_px, view.height_px - v_px) < 100


def test_openlane_layout():
    frame = replace(cf.FRAME, is_train=False, tags=frozenset({"curve", "steep"}))
    annotation = openlane.annotate(cf.road(cf.camera_label()), frame)
    assert annotation.image == "images/validation/segment-000000/train-00000017.jpg"
    assert set(annotation.files) == {
        "lane3d_1000/validation/segment-000000/train-00000017.json",
        "lane3d_1000/test/curve_case/segment-000000/train-00000017.json",
    }
    for text in annotation.files.values():
        assert "\n" not in text
        assert json.loads(text)["file_path"] == "validation/segment-000000/train-00000017.jpg"
        assert "cam_pitch" not in text
    listed = ("lists/validation.txt", "lane3d_1000/test/1000_curve_case.txt")
    assert annotation.shared == (("validation/segment-000000/train-00000017.jpg", listed),)


# ---- ONCE


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
        annotation = once.annotate(cf.labels_of(cf.camera_label()), replace(cf.FRAME, is_train=is_train))
        ((path, text),) = annotation.files.items()
        assert path == f"ONCE_3DLanes/{part}/000000/cam01/00000017.json"
        assert path.replace(part, "data").replace(".json", ".jpg") == annotation.image
        assert json.loads(text)["lanes"] == []
        assert np.shape(json.loads(text)["calibration"]) == (3, 4)


def test_once_leaves_out_what_its_evaluator_cannot_assign():
    camera = cf.camera_label()
    labels = cf.labels_of(camera, cf.lane(camera, cf.curve(2.0)), cf.lane(camera, cf.curve(4.0, start_m=30.0), "far"))
    annotation = once.annotate(labels, cf.FRAME)
    assert annotation.n_lines == 1
    assert sum(annotation.dropped.values()) == 1


# ---- tuSimple


@given(cameras, roads)
@settings(max_examples=25, deadline=None)
def test_tusimple_columns_lie_on_the_projected_lanes(camera, plan):
    labels = cf.road(cf.camera_label(*camera), **plan)
    annotation = tusimple.annotate(labels, cf.FRAME)
    frame = tusimple.read(annotation.shared[0][0], "test")
    ids = json.loads(annotation.shared[1][0])["lanes_ids"]
    assert 1 <= len(frame.lanes_u_px) <= 5
    by_id = {lane.id: lane for lane in labels.lanes}
    for lane_u_px, name in zip(frame.lanes_u_px, ids, strict=True):
        points_cam = by_id[name].xyz_cam[by_id[name].xyz_cam[:, 1] > 0.5]
        points_img = tusimple.VIEW.project(points_cam @ CV_FROM_CAM.T)
        rows = np.flatnonzero(lane_u_px != -2)
        u_px, v_px = lane_u_px[rows], frame.rows_px[rows]
        # Distance to the projected polyline along the row, whole pixels.
        above = np.array([np.flatnonzero(points_img[:, 1] <= v)[0] for v in v_px])
        a, b = points_img[above - 1], points_img[above]
        expected_u_px = a[:, 0] + (v_px - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
        assert np.abs(u_px - expected_u_px).max() <= 0.5 + 1e-6


def test_tusimple_row_by_hand():
    camera = cf.camera_label(1.5, 0.0)
    annotation = tusimple.annotate(cf.labels_of(camera, cf.lane(camera, cf.curve(1.5))), cf.FRAME)
    frame = tusimple.read(annotation.shared[0][0], "test")
    # On level ground 1.5 m below and 1.5 m right of the camera: u - 640 = v - 360.
    (lane_u_px,) = frame.lanes_u_px
    present = lane_u_px != -2
    np.testing.assert_array_equal(lane_u_px[present], frame.rows_px[present] + 280)
    assert not present[frame.rows_px <= 370].any()
    assert present[frame.rows_px >= 380].all()


def test_tusimple_skips_frames_without_lines():
    assert tusimple.annotate(cf.labels_of(cf.camera_label()), cf.FRAME) is None


# ---- all


@pytest.mark.parametrize("read", [apollo.read, openlane.read, once.read, tusimple.read])
@pytest.mark.parametrize("text", ["", "[]", "{}", '{"lanes": 3}'])
def test_a_wrong_file_is_a_format_error_that_names_it(read, text):
    with pytest.raises(FormatError, match=r"^some/file.json: "):
        read(text, "some/file.json")


def test_scene_tags():
    camera = cf.camera_label()
    assert scene_tags(cf.road(camera), apollo.VIEW) == set()
    assert scene_tags(cf.road(camera, curvature=0.004), apollo.VIEW) == {"curve"}
    assert scene_tags(cf.road(camera, slope=0.001), apollo.VIEW) == {"up_down", "steep"}
    leaving = cf.lane(camera, cf.curve(3.0), "exit", "centerline", road="exit")
    assert scene_tags(cf.labels_of(camera, leaving), apollo.VIEW) == {"merge_split"}
