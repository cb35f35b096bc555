"""Traffic elements: places by closed forms, states by phases, lanes that exist, ids through clips and rigs, and what
presets draw."""

from collections import Counter

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.geometry.frames import rotation, transform
from synth3dlanes.labels.object_labels import as_seen, stacked
from synth3dlanes.params.params import load_params
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.scene.roadside import Roadside
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.traffic_elements import Phase, SignKind, TrafficSign, TrafficSignal
from synth3dlanes.truth.ground_truth import ground_truth, label
from synth3dlanes.truth.object_truth import meets_quads, with_pixel_shares
from synth3dlanes.world.sign_faces import SIGN_FACES
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed
from tests.signals import light, sign, signals_scene


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
