"""OpenLane: frames, pixels, categories, layout, and the way back through our own reader."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from synth3dlanes.formats import openlane
from synth3dlanes.formats.openlane import ground_from_waymo, parse, vehicle_from_cam_waymo
from synth3dlanes.formats.writing import Pinhole
from tests.formats import closed_form as cf
from tests.formats.random_roads import ROUNDING_M, cameras, roads

FRAME = cf.frame(Pinhole(1920, 1280, 2015.0))


def openlane_frame(labels, frame=FRAME):
    (text,) = openlane.write(replace(frame, labels=labels)).files.values()
    return parse(text, "test")


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
    other = openlane_frame(cf.road(cf.camera_label()), replace(FRAME, number=18))
    assert not {line.track_id for line in by_x} & {line.track_id for line in other.lines}


def test_openlane_starts_at_the_image_border():
    width_px, height_px = 1920, 1280
    for line in openlane_frame(cf.road(cf.camera_label())).lines:
        u_px, v_px = line.uv_img[0]
        assert 0 <= u_px <= width_px
        assert 0 <= v_px <= height_px
        assert min(u_px, width_px - u_px, height_px - v_px) < 100


def test_openlane_layout():
    frame = replace(FRAME, part="test", tags=frozenset({"curve", "steep"}))
    annotation = openlane.write(replace(frame, labels=cf.road(cf.camera_label())))
    name = "segment-000000_with_camera_labels/train-00000017"
    assert annotation.image == f"images/validation/{name}.jpg"
    assert set(annotation.files) == {
        f"lane3d_1000/validation/{name}.json",
        f"lane3d_1000/test/curve_case/{name}.json",
    }
    for text in annotation.files.values():
        assert "\n" not in text
        assert json.loads(text)["file_path"] == f"validation/{name}.jpg"
        assert "cam_pitch" not in text
    assert annotation.shared == (
        (f"validation/{name}.jpg", ("lane3d_1000/test/1000_curve.txt", "lists/validation.txt")),
        (f"validation/{name}", ("data_lists/validation.txt",)),
    )


@pytest.mark.parametrize(
    ("part", "parts", "folder"),
    [
        ("train", {"train", "val", "test"}, "training"),
        ("val", {"train", "val", "test"}, "validation"),
        ("test", {"train", "val", "test"}, "test"),
        ("test", {"train", "test"}, "validation"),
        ("val", {"train", "val"}, "validation"),
    ],
)
def test_openlane_names_are_those_that_loaders_look_for(part, parts, folder):
    frame = replace(FRAME, part=part, parts=frozenset(parts), number=1234)
    annotation = openlane.write(replace(frame, labels=cf.road(cf.camera_label())))
    # PersFormer takes the segment's name by this expression, and opens every label below the folder.
    (segment,) = re.findall(r"/segment-(.*)_with_camera_labels", annotation.image)
    assert segment == "000012"
    assert annotation.image.startswith(f"images/{folder}/segment-")
    # Anchor3DLane finds labels by seg*/*.json, and names by what stands before the first dot.
    (path,) = annotation.files
    assert re.fullmatch(rf"lane3d_1000/{folder}/seg[^/.]*/[^/.]*\.json", path)
    # Evaluators replace "jpg" in lines of the list.
    assert path == f"lane3d_1000/{annotation.shared[0][0].replace('jpg', 'json')}"


def test_openlane_categories_are_those_of_the_paint():
    # OpenLane: 1 white-dash, 2 white-solid, 3 double-white-dash, 4 double-white-solid, 5 white-ldash-rsolid,
    # 6 white-lsolid-rdash; 7 to 12 the same in yellow.
    expected = {
        ("dashed", False, False): 1,
        ("solid", False, False): 2,
        ("dashed", False, True): 3,
        ("solid", False, True): 4,
        ("dashed", True, False): 7,
        ("solid", True, False): 8,
        ("dashed", True, True): 9,
        ("solid", True, True): 10,
        ("none", True, True): 0,
    }
    camera = cf.camera_label()
    for (marking, is_yellow, is_double), category in expected.items():
        color = "yellow" if is_yellow else "white"
        lane = cf.lane(camera, cf.curve(2.0), marking=marking, color=color, double=is_double)
        assert [line.category for line in openlane_frame(cf.labels_of(camera, lane)).lines] == [category]
    mixed = {"dashed_solid": (5, 11), "solid_dashed": (6, 12)}
    for pair, categories in mixed.items():
        for color, category in zip(("white", "yellow"), categories, strict=True):
            lane = cf.lane(camera, cf.curve(2.0), marking="solid", color=color, double=True, pair=pair)
            frame = openlane_frame(cf.labels_of(camera, lane))
            assert [line.category for line in frame.lines] == [category]
            (again,) = frame.labels((1920, 1280)).lanes
            assert (again.marking, again.color, again.double, again.pair) == ("solid", color, True, pair)
    older = cf.lane(camera, cf.curve(2.0), marking="dashed")
    assert [line.category for line in openlane_frame(cf.labels_of(camera, older)).lines] == [1]


def test_a_narrow_frame_has_its_own_intrinsics():
    frame = replace(FRAME, pinhole=Pinhole(1920, 1280, 2500.0))
    for line in (found := openlane_frame(cf.road(cf.camera_label()), frame)).lines:
        ahead_m, left_m, up_m = line.xyz_waymo[line.visible].T
        expected = np.stack([960 - 2500 * left_m / ahead_m, 640 - 2500 * up_m / ahead_m], axis=1)
        np.testing.assert_allclose(line.uv_img, expected, atol=1e-4)
    np.testing.assert_array_equal(found.img_from_cv, [[2500, 0, 960], [0, 2500, 640], [0, 0, 1]])
