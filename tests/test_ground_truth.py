"""Labels: closed forms, the rules of docs/decisions.md, and a second implementation of the paper's Appendix I."""

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.geometry.frames import invert, project, road_from_cam, transform
from synth3dlanes.labels import labels as label_file
from synth3dlanes.params.params import load_params
from synth3dlanes.scene import scene as scene_file
from synth3dlanes.truth.ground_truth import ground_truth
from tests.scenes import changed, hill
from tests.thorough import first


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


Y = np.arange(-100, 100.0001, 0.02)


def right_of(xy):
    step = np.gradient(xy, axis=0)
    return np.column_stack([step[:, 1], -step[:, 0]]) / np.linalg.norm(step, axis=1)[:, None]


def plan_middle(road):
    """The middle of the main road in the plan: the quartic through its five offsets."""
    knots = [road["offset_m50_m"] + road["offset_m100_m"], road["offset_m50_m"], 0, road["offset_p50_m"],
             road["offset_p50_m"] + road["offset_p100_m"]]  # fmt: skip
    return np.column_stack([np.polyval(np.polyfit([-1, -0.5, 0, 0.5, 1], knots, 4), Y / 100), Y])


def terrain(scene, xy):
    z = np.zeros(len(xy))
    for g in scene["terrain"]["gaussians"]:
        a = g["orientation_rad"]
        d = xy - g["center_m"]
        along = (d @ [np.cos(a), np.sin(a)]) / g["sd_m"][0]
        across = (d @ [-np.sin(a), np.cos(a)]) / g["sd_m"][1]
        z += g["magnitude_m"] * np.exp(-(along**2 + across**2) / 2)
    return z


def expected_centres(scene):
    """Plan polylines and ramp heights of all lanes: {(road, lane of the plan): (xy, above)}."""
    r = scene["road"]
    n, w, kind = r["n_lanes"], r["lane_width_m"], r["topology"]
    main = plan_middle(r)
    normal = right_of(main)
    centre = {k: (k - (n + 1) / 2) * w for k in range(1, n + 1)}
    q = np.clip(Y, 0, None) * np.tan(r["exit_angle_rad"]) + r["exit_offset_m"] * (np.clip(Y, 0, None) / 60) ** 2
    flat = np.zeros_like(Y)
    lanes = {("main", k): (main + c * normal, flat) for k, c in centre.items()}
    count = r.get("n_oncoming", 0)
    for k in range(1, count + 1):
        inwards = n / 2 * w + r.get("median_m", 0)  # from the middle of the host's lanes to the first oncoming one
        lanes["oncoming", k] = main - (inwards + (count - k + 0.5) * w) * normal, flat
    if kind == 1:
        return lanes
    if kind == 3:
        lanes["main", n] = (main + (centre[n - 1] + np.minimum(q, w))[:, None] * normal, flat)
    if kind == 4:
        del lanes["main", n]
    count = 2 if kind == 4 else 1
    middle = centre[n] if count == 1 else (centre[n] + centre[n - 1]) / 2
    reference = (main + (middle + q)[:, None] * normal)[Y >= 0]
    own = right_of(reference)
    separated = Y[(Y >= 0) & (q >= w + 2 * r["shoulder_factor"] * w)]
    above = np.zeros(len(reference))
    if separated.size:
        u = np.clip((Y[Y >= 0] - separated[0]) / (r["ramp_height_m"] * r["ramp_slope"]), 0, 1)
        above = r["ramp_height_m"] * (3 * u**2 - 2 * u**3)
    for k in range(1, count + 1):
        t = (k - (count + 1) / 2) * w
        stem = (main + (middle + t) * normal)[Y < 0]
        lanes["exit", k] = (np.concatenate([stem, reference + t * own]), np.concatenate([flat[Y < 0], above]))
    return lanes


BOTH_WAYS = ("trees.n=0", "road.n_oncoming=[1, 3]", "road.median_m={0: 1, 2: 1, 6: 1}", "road.n_lanes=[1, 3]")


def drawn_both_ways(index, *changes, split="train"):
    return sample_scene(Scenes(load_params("realistic", [*BOTH_WAYS, *changes]), 4711, split), index)


@pytest.mark.parametrize("index", first(4, range(40)))
@pytest.mark.parametrize("ways", [1, 2])
def test_lanes_agree_with_a_second_reading(index, ways):
    """Oncoming lanes lie beyond the median, on the side opposite the exit; without one a line divides both ways."""
    one_way = Scenes(load_params("appendix_i", ["trees.n=0", "cars.n=0"]), 4711, "train")
    drawn = sample_scene(one_way, index) if ways == 1 else drawn_both_ways(index, "cars.n=0")
    scene = json.loads(scene_file.to_json(drawn))
    labels = json.loads(label_file.to_json(ground_truth(drawn)))
    world_from_cam = np.array(labels["camera"]["world_from_cam"])
    flips = np.array([-1 if scene["road"]["flip_longitudinal"] else 1, -1 if scene["road"]["flip_lateral"] else 1])
    found = {lane["id"]: lane for lane in labels["lanes"] if lane["kind"] == "centerline"}
    expected = expected_centres(scene)
    assert len(found) == len(expected)
    for lane in labels["lanes"]:
        assert lane["direction"] == ("oncoming" if lane["id"].startswith("oncoming") else "same"), lane["id"]
        assert (np.diff(np.array(lane["xyz_cam"])[:, 1]) > 0).all(), f"{lane['id']} runs from near to far"
    n_lines = sum(lane["id"].startswith("oncoming_line") for lane in labels["lanes"])
    assert n_lines == drawn.road.n_oncoming + (drawn.road.median_m > 0)
    for (road, k), (xy_plan, above) in expected.items():
        count = sum(name == road for name, _ in expected)
        lane = found[f"{road}_{count + 1 - k if flips[0] < 0 else k}"]
        points = np.array(lane["xyz_cam"]) @ world_from_cam[:3, :3].T + world_from_cam[:3, 3]
        xy = xy_plan * flips
        inside = np.abs(points[:, 1]) < 90
        gap, at = cKDTree(xy).query(points[inside, :2])
        assert gap.max() < 0.02 + 0.011, (road, k)  # the polyline's own points lie up to 2 cm apart
        z = terrain(scene, points[inside, :2]) + above[at]
        steep = np.abs(np.gradient(above, Y))[at] > 0.5  # there half a polyline step alone is centimetres
        assert np.abs(z - points[inside, 2])[~steep].max() < 0.03, (road, k)


@pytest.mark.parametrize("index", first(3, range(20)))
def test_the_camera_stands_its_height_over_the_surface_and_its_right_side_sinks_by_its_roll(index):
    """As seen by the driver, who looks along the axis with the road's normal up, clockwise is right side down."""
    changes = ["trees.n=0", "cars.n=0", "camera.roll_deg=[-4, 4]", "camera.principal_offset_px=[-20, 20]"]
    drawn = sample_scene(Scenes(load_params("appendix_i", changes), 4711, "test"), index)
    scene = json.loads(scene_file.to_json(drawn))
    camera = json.loads(label_file.to_json(ground_truth(drawn)))["camera"]
    world_from_cam, road_from_cam = (np.array(camera[name]) for name in ("world_from_cam", "road_from_cam"))
    eye = world_from_cam[:3, 3]
    # The foot is the surface point whose normal goes through the eye: walk to it.
    foot = eye[:2].copy()
    for _ in range(300):
        h = 1e-4
        z, zx, zy = terrain(scene, foot + np.array([[0, 0], [h, 0], [0, h]]))
        slope = np.array([zx - z, zy - z]) / h
        foot += 0.2 * (eye[:2] + slope * (eye[2] - z) - foot)
    assert np.linalg.norm(eye - [*foot, z]) == pytest.approx(scene["camera"]["height_m"], abs=1e-4)
    normal = np.array([*-slope, 1]) / np.sqrt(1 + slope @ slope)
    assert normal @ world_from_cam[:3, :3] == pytest.approx(road_from_cam[2, :3], abs=1e-4), "the road frame's z"
    assert camera["roll_rad"] == scene["camera"]["roll_rad"] != 0
    right, axis, up = road_from_cam[:3, :3].T
    assert np.arcsin(-axis[2]) == pytest.approx(scene["camera"]["pitch_rad"], abs=1e-8)
    assert axis[0] == pytest.approx(0, abs=1e-8)
    unrolled_up = np.array([0, 0, 1]) - axis[2] * axis
    unrolled_right = np.cross(axis, unrolled_up / np.linalg.norm(unrolled_up))
    turned_right = np.arctan2(up @ unrolled_right, up @ unrolled_up / np.linalg.norm(unrolled_up))
    assert turned_right == pytest.approx(scene["camera"]["roll_rad"], abs=1e-8), "the top leans to the right"
    assert np.sign(-right[2]) == np.sign(scene["camera"]["roll_rad"]), "the right side is down"
    (_, cx, _), (_, cy, _), _ = camera["img_from_cam"]
    assert (cx, cy) == (scene["camera"]["cx_px"], scene["camera"]["cy_px"])
    assert max(abs(cx - 240), abs(cy - 180)) <= 20
    assert (cx, cy) != (240, 180)
    # The road frame is the camera's without roll: labels in it do not depend on the roll.
    level = ground_truth(drawn.model_copy(update={"camera": drawn.camera.model_copy(update={"roll_rad": 0.0})}))
    rolled = ground_truth(drawn)
    for a, b in zip(level.lanes, rolled.lanes, strict=True):
        in_road = b.xyz_cam @ rolled.camera.road_from_cam[:3, :3].T
        np.testing.assert_allclose(in_road, a.xyz_cam @ level.camera.road_from_cam[:3, :3].T, atol=1e-9)


@pytest.mark.parametrize(
    ("seed", "split", "index"), first(6, [(2026, "test", 9), *((4711, "trees", i) for i in range(20))])
)
def test_no_tree_stands_on_a_road_or_its_shoulders(seed, split, index):
    """The first is one that leaves so sharply that its far part lies abreast of an early station."""
    changes = ["cars.n=1", "road.topology={2: 1, 3: 1, 4: 1}"] if split == "trees" else ["cars.n=1"]
    drawn = sample_scene(Scenes(load_params("appendix_i", changes), seed, split), index)
    scene = json.loads(scene_file.to_json(drawn))
    road = scene["road"]
    flips = np.array([-1 if road["flip_longitudinal"] else 1, -1 if road["flip_lateral"] else 1])
    trees = np.array([[tree["x_m"], tree["y_m"]] for tree in scene["trees"]]) * flips
    onwards = np.linspace(0, 200, 4001)[:, None]
    for (name, k), (xy, _) in expected_centres(scene).items():
        xy = xy[2:-2]  # the normals at a polyline's very ends are one-sided differences
        before, after = (xy[0] - xy[1]) / 0.02 * onwards, (xy[-1] - xy[-2]) / 0.02 * onwards
        gap, _ = cKDTree(np.concatenate([xy[0] + before, xy, xy[-1] + after])).query(trees)
        assert gap.min() > (0.5 + road["shoulder_factor"]) * road["lane_width_m"], (name, k)
