"""Labels: closed forms, golden files, and the rules of docs/decisions.md."""

import json
from pathlib import Path

import numpy as np
import pytest

from synth3dlanes.geometry.frames import invert, project, road_from_cam, transform
from synth3dlanes.labels import labels as label_file
from synth3dlanes.scene import scene as scene_file
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.world import resolve
from tests.golden.make import GOLDEN, golden_text
from tests.scenes import changed, hill


def test_a_straight_flat_road_has_the_closed_form():
    labels = ground_truth(changed(camera={"pitch_rad": 0.05, "height_m": 1.6, "lane": 2}))
    c, s = np.cos(0.05), np.sin(0.05)
    ahead = np.arange(111.0)
    for lane in labels.lanes:
        number = int(lane.id.split("_")[-1])
        x = (number - 2) * 3.5 if lane.kind == "centerline" else (number - 1.5) * 3.5
        expected = np.stack([np.full(111, x), ahead * c + 1.6 * s, ahead * s - 1.6 * c], 1)
        np.testing.assert_allclose(lane.xyz_cam, expected, atol=1e-9)
        assert lane.terrain_visible.all()
        assert lane.object_visible is None
    assert [lane.id for lane in labels.lanes] == [
        "main_1", "main_2", "main_3", "main_line_0", "main_line_1", "main_line_2", "main_line_3"
    ]  # fmt: skip


def test_only_points_inside_the_image_are_in_the_image():
    labels = ground_truth(changed(road={"topology": 4}, terrain={"gaussians": (hill(0, 40, 10, 50),)}))
    for lane in labels.lanes:
        uv = project(labels.camera.img_from_cam, lane.xyz_cam)
        expected = (uv[:, 0] >= 0) & (uv[:, 0] <= 480) & (uv[:, 1] >= 0) & (uv[:, 1] <= 360)
        np.testing.assert_array_equal(lane.in_image, expected)
        assert lane.in_image.any()
    host = next(lane for lane in labels.lanes if lane.id == "main_2")
    assert not host.in_image[0], "the road under the camera is not in the image"


def test_road_coordinates_have_the_road_at_height_zero_at_the_host():
    labels = ground_truth(changed(terrain={"gaussians": (hill(30, -50, 20, 40),)}))
    host = next(lane for lane in labels.lanes if lane.id == "main_2")
    points_road = transform(labels.camera.road_from_cam, host.xyz_cam)
    np.testing.assert_allclose(points_road[0], 0, atol=1e-9)
    slope = (points_road[1] - points_road[0]) / np.linalg.norm(points_road[1] - points_road[0])
    assert slope[1] > 0.999, "the road frame's y is the driving direction"


@pytest.mark.parametrize("topology", [2, 3, 4])
@pytest.mark.parametrize("merge", [False, True])
def test_paths_share_their_stem_and_every_curve_runs_near_to_far(topology, merge):
    labels = ground_truth(changed(road={"topology": topology, "flip_lateral": merge, "exit_offset_m": 8}))
    lanes = {lane.id: lane for lane in labels.lanes}
    for segment in labels.graph.segments:
        if len(segment.centerlines) == 2 and segment.id.startswith("stem"):
            a, b = (lanes[name].xyz_cam for name in segment.centerlines)
            at = slice(0, 49) if not merge else slice(-40, None)
            np.testing.assert_allclose(a[at][:, 0], b[at][:, 0], atol=2e-3)
    for lane in labels.lanes:
        y = lane.xyz_cam[:, 1]
        assert (np.diff(y) > 0).all(), lane.id
        assert len(y) >= 2


def test_lines_of_a_split_begin_exactly_at_the_nose():
    scene = changed(road={"topology": 2, "exit_offset_m": 5})
    labels = ground_truth(scene)

    lanes = {lane.id: lane for lane in labels.lanes}
    points_world = transform(labels.camera.world_from_cam, lanes["main_line_3"].xyz_cam)
    assert points_world[0, 1] == pytest.approx(resolve(scene).network.roads[-1].parting.station(0.0), abs=1e-6)


def test_every_reference_names_a_lane_that_exists():
    for topology in (1, 2, 3, 4):
        labels = ground_truth(changed(road={"topology": topology, "exit_offset_m": 0.0, "exit_angle_rad": 0.02}))
        ids = {lane.id for lane in labels.lanes}
        assert len(ids) == len(labels.lanes)
        assert {x for lane in labels.lanes for x in (lane.left, lane.right)} <= ids | {None}
        assert {x for segment in labels.graph.segments for x in segment.centerlines} <= ids


@pytest.mark.parametrize("name", sorted(GOLDEN))
def test_golden_labels(name):
    """Scenes and labels as committed; `make golden` rewrites them, and the diff is for a person to read."""
    folder = Path(__file__).parent / "golden"
    scene_text, labels_text = golden_text(name)
    assert scene_text == (folder / f"{name}.scene.json").read_text()
    expected = label_file.from_json((folder / f"{name}.labels.json").read_text(), name)
    found = label_file.from_json(labels_text, name)
    assert [lane.id for lane in found.lanes] == [lane.id for lane in expected.lanes]
    assert found.graph == expected.graph
    for a, b in zip(found.lanes, expected.lanes, strict=True):
        assert (a.marking, a.color, a.double, a.pair) == (b.marking, b.color, b.double, b.pair)
        np.testing.assert_allclose(a.xyz_cam, b.xyz_cam, atol=1.01e-4)
        np.testing.assert_array_equal(a.in_image, b.in_image)
        np.testing.assert_array_equal(a.terrain_visible, b.terrain_visible)


@pytest.mark.parametrize("merge", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_the_left_edge_of_every_road_has_its_paint_and_all_other_lines_are_single_and_white(mirrored, merge):
    road = {"topology": 4, "n_lanes": 4, "flip_longitudinal": mirrored, "flip_lateral": merge, "exit_offset_m": 8}
    painted = {"left_yellow": True, "left_double": True}
    camera = {"lane": 1, "y_m": -80 if merge else -20}
    labels, plain = (ground_truth(changed(road=road, camera=camera, markings=paint)) for paint in (painted, {}))
    for lane, other in zip(labels.lanes, plain.lanes, strict=True):
        if lane.kind == "centerline":
            assert (lane.marking, lane.color, lane.double) == ("none", None, None)
            continue
        # By position alone: no other line of the same road is to its left at any distance.
        of_road = [one.xyz_cam for one in labels.lanes if one.kind == "delimiter" and one.road == lane.road]
        far = max(points[0, 1] for points in of_road), min(points[-1, 1] for points in of_road)
        at_m = np.linspace(*far, 5)
        x_m = [np.interp(at_m, points[:, 1], points[:, 0]) for points in of_road]
        is_leftmost = (np.interp(at_m, lane.xyz_cam[:, 1], lane.xyz_cam[:, 0]) <= np.min(x_m, axis=0) + 1e-6).all()
        assert (lane.color, lane.double) == (("yellow", True) if is_leftmost else ("white", False)), lane.id
        assert (other.color, other.double) == ("white", False)
        np.testing.assert_array_equal(lane.xyz_cam, other.xyz_cam)
    assert {lane.id for lane in labels.lanes if lane.double} == {"main_line_0", "exit_line_0"}


def test_labels_come_back_from_their_file():
    labels = ground_truth(changed(road={"topology": 3}, markings={"left_yellow": True}))
    text = label_file.to_json(labels)
    again = label_file.from_json(text, "labels.json")
    assert label_file.to_json(again) == text
    np.testing.assert_allclose(again.lanes[0].xyz_cam, labels.lanes[0].xyz_cam, atol=0.5001e-4)
    assert json.loads(text)["lanes"][0]["object_visible"] is None
    assert {lane.color for lane in again.lanes} == {None, "white", "yellow"}


def test_older_labels_have_no_paint():
    document = json.loads(label_file.to_json(ground_truth(changed())))
    for lane in document["lanes"]:
        del lane["color"], lane["double"], lane["pair"]
    older = label_file.from_json(json.dumps(document), "labels.json")
    assert {(lane.color, lane.double, lane.pair) for lane in older.lanes} == {(None, None, None)}


def test_scenes_come_back_from_their_file():
    scene = changed(road={"topology": 3})
    assert scene_file.from_json(scene_file.to_json(scene), "scene.json") == scene


def test_the_horizon_plane_of_a_plain_is_the_road_itself_and_a_rise_tilts_it_up():
    flat = ground_truth(changed())
    assert (flat.horizon.pitch_rad, flat.horizon.height_m) == (pytest.approx(0.05), pytest.approx(1.6))
    rising = ground_truth(changed(terrain={"gaussians": (hill(0, 200, 40, 90),)}))
    assert rising.horizon.pitch_rad > rising.camera.pitch_rad, "the plane rises ahead: the camera looks down at it more"
    host = next(lane for lane in rising.lanes if lane.id == "main_2")
    far = transform(rising.camera.road_from_cam, host.xyz_cam)[np.flatnonzero(host.in_image & host.terrain_visible)[-1]]
    assert far[2] > 1, "the farthest point that is seen lies above the road plane at the host"
    horizon_from_cam = road_from_cam(rising.horizon.height_m, rising.horizon.pitch_rad)
    horizon_from_road = horizon_from_cam @ invert(rising.camera.road_from_cam)
    on_plane = transform(horizon_from_road, np.array([[0, 0, 0], far]))
    np.testing.assert_allclose(on_plane[:, 2], 0, atol=1e-6, err_msg="the host's foot and that point lie on the plane")
