"""Boxes of objects and traffic elements: places by closed forms, rectangles by dense points, shares, speeds, states."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_scene, sample_world
from synth3dlanes.geometry.frames import quaternion, road_from_cam, rotation, transform
from synth3dlanes.geometry.lens import Lens
from synth3dlanes.labels.object_labels import CORNERS, as_seen, stacked
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import Shots
from synth3dlanes.scene.assets.catalogue import CARS, Assets, vehicle_class
from synth3dlanes.scene.assets.folder import CarNotes
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.scene.roadside import Roadside
from synth3dlanes.scene.scene import Car, Scene
from synth3dlanes.scene.traffic_elements import Phase, SignKind, TrafficSign, TrafficSignal
from synth3dlanes.truth.ground_truth import ground_truth, label
from synth3dlanes.truth.object_truth import meets_quads, rectangles, truncation, with_pixel_shares
from synth3dlanes.world.sign_faces import SIGN_FACES
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed
from tests.signals import light, sign, signals_scene

FISHEYE = Lens(model="fisheye", coefficients=(0.02, 0, 0, 0))


def car(lane: str, s_m: float, model: int = 2, **other: float) -> Car:
    return Car(model=model, scale=1.0, color=(1, 0, 0), gloss=0.5, lane=lane, s_m=s_m, **other)


def with_cars(*cars: Car, **camera: object):
    return changed(FLAT.model_copy(update={"cars": cars}), camera=camera)


def test_a_car_straight_ahead_is_where_its_numbers_say():
    """On a flat road, 30 m ahead in the host's lane, seen from 1.6 m without pitch."""
    (item,) = ground_truth(with_cars(car("main_2", -20), pitch_rad=0)).objects
    width, length, height = CARS[1].width_m, CARS[1].length_m, CARS[1].height_m
    assert item.id == 1
    assert item.category == "car"
    assert item.velocity_cam is None
    np.testing.assert_allclose(item.size_m, (width, length, height))
    np.testing.assert_allclose(item.center_cam, (0, 30, height / 2 - 1.6), atol=1e-9)
    np.testing.assert_allclose(rotation(item.rotation_wxyz), np.eye(3), atol=1e-9)
    front_left_top, rear_right_bottom = item.corners_cam[0], item.corners_cam[6]
    np.testing.assert_allclose(front_left_top, (-width / 2, 30 + length / 2, height - 1.6), atol=1e-9)
    np.testing.assert_allclose(rear_right_bottom, (width / 2, 30 - length / 2, -1.6), atol=1e-9)
    near_m, far_m = 30 - length / 2, 30 + length / 2
    half_px, bottom, top = 415.7 * width / 2 / near_m, 415.7 * 1.6 / near_m, 415.7 * (1.6 - height) / far_m
    expected = (240 - half_px, 180 + top, 240 + half_px, 180 + bottom)
    np.testing.assert_allclose(item.unclipped_box_px, expected, atol=1e-6)
    np.testing.assert_allclose(item.box_px, expected, atol=1e-6)
    assert item.truncation == 0


def test_an_oncoming_car_looks_at_the_host():
    scene = changed(FLAT, road={"n_oncoming": 1})
    (item,) = ground_truth(scene.model_copy(update={"cars": (car("oncoming_1", -20),)})).objects
    ahead = rotation(item.rotation_wxyz)[:, 1]
    assert ahead[1] < -0.99
    assert (item.corners_cam[:4, 1] < item.corners_cam[4:, 1]).all()


def test_cars_behind_and_beside_the_camera():
    behind, beside = ground_truth(with_cars(car("main_2", -90), car("main_3", -47, 10))).objects
    assert (behind.box_px, behind.unclipped_box_px, behind.truncation) == (None, None, 1)
    assert beside.unclipped_box_px is None
    assert 0 < beside.truncation < 1
    assert beside.box_px[2] == FLAT.camera.width_px


@pytest.mark.parametrize(
    "camera",
    [
        {}, {"roll_rad": 0.3, "pitch_rad": 0.1}, {"fx_px": 90, "fy_px": 90, "lens": FISHEYE},
        {"yaw_rad": -1.4, "right_m": 0.9, "forward_m": 1.5},
        {"width_px": 40, "height_px": 30, "cx_px": 20, "cy_px": 15},
    ],
)  # fmt: skip
def test_rectangles_and_truncation_are_those_of_the_points_of_the_box(camera):
    """Of 200,000 points of a box's surface, and of 100,000 in it. A camera of 40 px sees but the middle of a van."""
    rng = np.random.default_rng(0)
    scene = with_cars(car("main_2", -42, 5), car("main_3", -44, 10), car("main_1", -30), car("main_3", -52), **camera)
    labels = ground_truth(scene)
    for item in labels.objects:
        inside = rng.uniform(-1, 1, (100_000, 3))
        share = 1 - labels.camera.shows(transform(item.cam_from_object, inside * item.size_m / 2)).mean()
        assert item.truncation == pytest.approx(share, abs=0.02)
        surface = rng.uniform(-1, 1, (200_000, 3))
        axis = np.repeat([0, 1, 2], (66_000, 67_000, 67_000))
        surface[np.arange(200_000), axis] = np.sign(surface[np.arange(200_000), axis])
        points_cam = transform(item.cam_from_object, surface * item.size_m / 2)
        uv = labels.camera.project(points_cam)
        shown = labels.camera.shows(points_cam)
        if not shown.any():
            assert item.box_px is None
            continue
        expected = np.concatenate([uv[shown].min(axis=0), uv[shown].max(axis=0)])
        np.testing.assert_allclose(item.box_px, expected, atol=2.5)
        outward = np.array([-1, -1, 1, 1]) * (item.box_px - expected)
        assert (outward > -0.01).all()
        if item.unclipped_box_px is not None:
            assert np.isfinite(uv).all()
            np.testing.assert_allclose(item.unclipped_box_px, [*uv.min(axis=0), *uv.max(axis=0)], rtol=0.05, atol=2.5)


def test_a_box_around_the_whole_view_fills_the_image():
    camera = ground_truth(FLAT).camera
    pose = np.eye(4)
    pose[1, 3] = 6
    size_m = np.array([50.0, 4.0, 50.0])
    inside, whole = rectangles(camera, pose, size_m)
    np.testing.assert_allclose(inside, (0, 0, 480, 360))
    assert whole[0] < -1000
    assert truncation(camera, pose, size_m) > 0.9


def test_a_box_that_reaches_to_the_end_of_a_lens_has_no_whole_rectangle():
    """There pixels are beyond what labels may say: such samples were made again and again."""
    scene = changed(FLAT, camera={"lens": Lens(model="opencv", coefficients=(-0.28, 0.07, 0, 0, 0, 0, 0, 0))})
    camera = ground_truth(scene).camera
    pose, size_m = np.eye(4), np.array([1.8, 4.5, 1.5])
    pose[:3, 3] = [-3.0, 2.35, 0.0]
    uv = camera.project(transform(pose, CORNERS * size_m / 2))
    assert np.isfinite(uv).all()
    assert np.abs(uv).max() > 1e6
    inside, whole = rectangles(camera, pose, size_m)
    assert whole is None
    assert inside is not None


def test_quaternions_are_those_of_rotations():
    rng = np.random.default_rng(1)
    for angles in rng.uniform(-3, 3, (200, 3)):
        turn = road_from_cam(0, *angles)[:3, :3]
        wxyz = quaternion(turn)
        assert np.linalg.norm(wxyz) == pytest.approx(1)
        assert wxyz[0] >= 0
        np.testing.assert_allclose(rotation(wxyz), turn, atol=1e-12)
    half = np.deg2rad(15)
    np.testing.assert_allclose(quaternion(road_from_cam(0, 0, 0, 2 * half)[:3, :3]), (np.cos(half), 0, 0, np.sin(half)))


def test_the_velocity_of_a_clip_is_what_a_car_drives_from_frame_to_frame():
    scenes = Scenes(load_params("streets"), 3, "train", shots=Shots(frames=6, fps=20.0))
    n = 0
    for start in (0, 6, 12):
        frames = [ground_truth(sample_scene(scenes, start + i)) for i in range(3)]
        poses = [[frame.camera.world_from_cam @ item.cam_from_object for item in frame.objects] for frame in frames]
        for i, item in enumerate(frames[1].objects):
            moved = (poses[2][i][:3, 3] - poses[0][i][:3, 3]) * 10
            got = frames[1].camera.world_from_cam[:3, :3] @ item.velocity_cam
            # The middle of the box is over the road, so on crests and in hollows it is a little faster or slower.
            assert np.linalg.norm(moved - got) < 0.02 + 0.02 * np.linalg.norm(moved)
            assert [frame.objects[i].id for frame in frames] == [i + 1] * 3
            n += np.linalg.norm(moved) > 3
    assert n > 20


def test_what_pixels_and_points_tell():
    labels = ground_truth(with_cars(car("main_2", -20), car("main_1", -20), car("main_3", -20)))
    ids = np.zeros((20, 30), np.uint16)
    ids[3:5, 7:11], ids[9, 2], ids[10:, :] = 1, 3, 205
    seen = as_seen(labels.objects, ids, np.array([0, 3, 3, 205, 9000], np.uint16))
    found = [None if item.seen_box_px is None else item.seen_box_px.tolist() for item in seen]
    assert found == [[7, 3, 11, 5], None, [2, 9, 3, 10]]
    assert [item.lidar_points for item in seen] == [0, 0, 2]
    assert [item.lidar_points for item in as_seen(labels.objects, ids)] == [None] * 3
    arrays = stacked(seen)
    assert np.isnan(arrays.seen_box_px[1]).all()
    assert np.isnan(arrays.velocity_cam).all()
    assert arrays.corners_cam.shape == (3, 8, 3)
    assert stacked(()).corners_cam.shape == (0, 8, 3)


def test_classes_of_a_users_models_follow_from_names_or_sizes():
    assert all(vehicle_class(model.name, model.length_m, model.height_m) == model.category for model in CARS)
    by_size = {model.name: vehicle_class("x", model.length_m, model.height_m) for model in CARS}
    assert {name for name in by_size if by_size[name] != dict((m.name, m.category) for m in CARS)[name]} == {"bus"}
    names = {"School_Bus": "bus", "busy": "car", "minivan2": "van", "my-semitrailer": "trailer", "avante": "car"}
    assert {name: vehicle_class(name, 4, 1.5) for name in names} == names
    own = replace(CARS[0], name="mine", sha256="0" * 64, category="van")
    scene = with_cars(car("main_2", -20, 1)).model_copy(update={"assets": Assets(cars=(own,))})
    assert [item.category for item in ground_truth(scene).objects] == ["van"]


def test_notes_of_a_users_model_have_its_class_its_wheels_or_both():
    assert CarNotes.model_validate({"category": "bus"}).wheels == dict.fromkeys(
        ("wheelbase_m", "track_m", "wheel_radius_m")
    )
    wheels = {"wheelbase_m": 2.6, "track_m": 1.5, "wheel_radius_m": 0.3}
    assert CarNotes.model_validate({**wheels, "category": "van"}).wheels == wheels
    with pytest.raises(ValueError, match="track_m: expected all of wheelbase_m, track_m, wheel_radius_m or none"):
        CarNotes.model_validate({"wheelbase_m": 2.6})
    with pytest.raises(ValueError, match="'car', 'van', 'truck', 'bus' or 'trailer'"):
        CarNotes.model_validate({"category": "tram"})


def with_roadside(**parts: object) -> Scene:
    return FLAT.model_copy(update={"roadside": Roadside(**parts)})


def test_a_sign_straight_ahead_is_where_its_numbers_say():
    """30 m ahead in the host's lane, its lower edge 2 m up, seen from 1.6 m without pitch."""
    (item,) = ground_truth(
        changed(with_roadside(signs=(sign("stop", 0.0, -20.0),)), camera={"pitch_rad": 0})
    ).traffic_elements
    size_m = np.ptp(SIGN_FACES["stop"][0].outline, axis=0)
    assert (item.id, item.category, item.kind, item.state) == (instance_id("structure", 1), "road_sign", "stop", None)
    assert item.lanes == ("main_3",)
    np.testing.assert_allclose(item.size_m[[0, 2]], size_m)
    assert item.center_cam[0] == pytest.approx(0, abs=1e-9)
    assert 29.7 < item.center_cam[1] < 30
    assert item.center_cam[2] == pytest.approx(2 + size_m[1] / 2 - 1.6)
    np.testing.assert_allclose(item.normal_cam, (0, -1, 0), atol=1e-9)
    np.testing.assert_allclose(
        item.corners_cam[4], item.center_cam + np.array([-1, -1, 1]) * item.size_m / 2, atol=1e-9
    )


def test_signals_over_lanes_hang_over_the_middle_of_the_lane_that_they_govern():
    labels = ground_truth(signals_scene())
    over_lanes = [item for item in labels.traffic_elements if item.category == "lane_signal"]
    assert len(over_lanes) == 3
    for item in over_lanes:
        line = next(lane.xyz_cam for lane in labels.lanes if lane.id == item.lanes[0])
        x_m, y_m = item.center_cam[:2]
        assert np.interp(y_m, line[:, 1], line[:, 0]) == pytest.approx(x_m, abs=0.05)


def test_the_yaw_is_the_way_of_the_traffic_and_an_arm_reaches_to_its_right():
    """One for traffic that drives to the left (world -x): its face looks to the right, and its right is ahead."""
    for_left = light(0.0, "red", yaw_rad=np.pi / 2, reach_m=3.0)
    (item,) = ground_truth(changed(with_roadside(signals=(for_left,)), camera={"pitch_rad": 0})).traffic_elements
    np.testing.assert_allclose(item.normal_cam, (1, 0, 0), atol=1e-9)
    assert item.center_cam[1] == pytest.approx(33.0)
    assert item.center_cam[0] > 0.2, "before its pole, towards its traffic"


def test_phases_follow_each_other_and_begin_again():
    one = TrafficSignal(
        x_m=0, y_m=0, yaw_rad=0, height_m=2.4, lanes=(), shift_s=4.5,
        phases=tuple(Phase(state=state, seconds=s) for state, s in (("red", 4.0), ("red_amber", 1.0), ("green", 5.0))),
    )  # fmt: skip
    at = {0.0: "red_amber", 0.6: "green", 5.4: "green", 5.6: "red", 9.4: "red", 9.6: "red_amber", 105.0: "green"}
    assert {time_s: one.state_at(time_s) for time_s in at} == at


def test_the_lights_of_a_head_are_those_of_its_state_at_the_time_of_the_picture():
    """Heights of the lit lenses: red above amber above green."""
    site = resolve(with_roadside(signals=(light(5.0, "red", "red_amber", "amber", "green", "off"),))).site
    heights = []
    for second in range(5):
        lit = site.lights(second + 0.5)
        corners = [body.corners_world[..., 2] for body in lit.values()]
        heights.append(sorted({round(float(z.mean()), 2) for body in corners for z in np.split(body, len(body) // 12)}))
    red, both, amber, green, off = heights
    assert (len(red), len(both), len(amber), len(green), off) == (1, 2, 1, 1, [])
    assert red[0] > amber[0] > green[0]
    assert both == sorted([amber[0], red[0]])
    assert {*site.lights(0.5)} == {*site.elements_by_id} == {instance_id("structure", 1)}, "of the head, after its pole"


def test_arrays_have_what_labels_have():
    labels = ground_truth(signals_scene())
    segments = [segment.id for segment in labels.graph.segments]
    arrays = stacked(labels.traffic_elements, segments)
    assert len(arrays) == 9
    for i, item in enumerate(labels.traffic_elements):
        assert [segments[k] for k in np.flatnonzero(arrays.governs[i])] == list(item.lanes)
        np.testing.assert_allclose(arrays.cam_from_object[i][:3, :3], rotation(item.rotation_wxyz))
        np.testing.assert_array_equal(arrays.cam_from_element[i], item.cam_from_element)
        np.testing.assert_allclose(arrays.corners_cam[i], item.corners_cam)
        np.testing.assert_allclose(arrays.normal_cam[i], item.normal_cam)
    assert np.isnan(arrays.visible_fraction).all()
    assert np.isnan(arrays.truncation).all()


def test_a_share_is_that_of_the_pixels_that_a_body_fills():
    """A board whose right half another thing hides, in ids made here: rays by the rectangle, by hand."""
    scene = with_roadside(signs=(sign("exit_left", 0.0, -30.0, height_m=1.0),))
    world = resolve(scene)
    labels = label(world, world.view)
    (item,) = labels.traffic_elements
    camera = labels.camera
    v, u = np.mgrid[: camera.height_px, : camera.width_px]
    rays = camera.rays(np.column_stack([u.ravel(), v.ravel()]) + 0.5)
    board = transform(
        item.cam_from_object, item.size_m / 2 * np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    )
    is_board = meets_quads(rays, board[None]).reshape(v.shape)
    is_left = u < 240
    for shown, share in ((is_board, 1.0), (is_board & is_left, 0.5), (is_board & False, 0.0)):
        instance = np.where(shown, item.id, 0).astype(np.uint16)
        (seen,) = with_pixel_shares(as_seen((item,), instance), world.site, camera, instance)
        assert seen.visible_fraction == pytest.approx(share, abs=0.03)
        rows, columns = np.nonzero(shown)
        expected = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1] if rows.size else None
        assert (seen.seen_box_px is None) if expected is None else (seen.seen_box_px.tolist() == expected)


@pytest.mark.parametrize("n", [4, pytest.param(30, marks=pytest.mark.thorough)])
def test_streets_draws_what_it_says(n):
    params = load_params("streets", ["roadside.n_gantries=1", "trees.n=0", "cars.n=0", "road.flip_lateral=false"])
    states, n_signs, n_exits = Counter[str](), 0, 0
    for index in range(n):
        world = sample_world(Scenes(params, 1, "train"), index)
        graph = ground_truth(world.scene).graph
        lanes = {segment.id: segment for segment in graph.segments}
        for crossing in world.scene.roadside.crossings:
            for signal in crossing.signals:
                states[signal.state] += 1
                own = lanes[signal.lane]
                beside = {"amber_left": own.left, "amber_right": own.right}
                if signal.state in beside and not signal.lane.startswith("oncoming"):
                    assert beside[signal.state] is not None, "an arrow sends the traffic to a lane"
        n_exits += world.scene.road.topology > 1
        for board in world.scene.roadside.signs:
            n_signs += 1
            assert board.kind == ("exit_left" if world.scene.road.flip_longitudinal else "exit_right")
            exits = [lane for lane in board.lanes if lane.startswith("exit")]
            assert exits
            before = [lane for lane in board.lanes if lane not in exits]
            assert {after for lane in before for after in graph.successors[lane]} >= {*exits}
            station = board.y_m
            assert station < min(lanes[lane].s_start_m for lane in exits)
    assert 0 < n_signs <= n_exits
    assert states["green_arrow"]
    if n == 30:
        assert 0.3 < n_signs / n_exits < 0.95
        assert states["green_arrow"] > states["red_cross"] > 3


def test_every_kind_of_sign_has_a_face_whose_lower_edge_is_at_its_height():
    (ground_m,) = resolve(FLAT).ground.height(np.array([[9.0, 0.0]]))
    assert set(SIGN_FACES) == set(SignKind.__args__)
    for kind in SIGN_FACES:
        body = resolve(
            with_roadside(signs=(TrafficSign(x_m=9, y_m=0, yaw_rad=0, height_m=2, kind=kind, lanes=()),))
        ).site
        low, high = (getattr(body.structures[-1].corners_world[..., 2], name)() for name in ("min", "max"))
        assert low == pytest.approx(2 + ground_m, abs=0.001)
        assert 0.5 < high - low < 2
