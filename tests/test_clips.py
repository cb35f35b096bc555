"""Clips: the host and the cars drive, everything else stays, and the first frame is the single picture."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from synth3dlanes.draw.sample import Scenes, sample_scene, sample_world, scene_texts
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels import labels as labels_format
from synth3dlanes.labels.labels import Labels
from synth3dlanes.params.params import Params, load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots, clips
from synth3dlanes.scene import scene as scene_format
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import ground_truth, label
from synth3dlanes.validate.labels import check_shape
from synth3dlanes.world.world import World, resolve
from tests.scenes import changed
from tests.thorough import first

TWO_SECONDS = clips(21, 10)
# Noses far away: their lines come into range and are passed.
EXIT = ("road.topology={2: 1, 3: 1, 4: 1}", "road.exit_angle_deg=[1, 2]", "cars.n=1", "trees.n=40")
SMOOTH = ("road.topology={1: 1, 2: 1}", "cars.n=6")


def params(*overrides: str) -> Params:
    return load_params("appendix_i", overrides)


def frames(scene: int, shots: Shots, drawn_from: Params) -> list[World]:
    indices = range(scene * shots.frames, (scene + 1) * shots.frames)
    return [sample_world(Scenes(drawn_from, shots=shots), index) for index in indices]


def test_the_first_frame_is_the_single_picture():
    same = 0
    for index in range(10):
        single = sample_scene(Scenes(params()), index)
        first = sample_scene(Scenes(params(), shots=TWO_SECONDS), 21 * index)
        standing = [car.model_copy(update={"speed_m_s": 0.0}) for car in first.cars]
        plain = first.model_copy(update={"shot": single.shot, "cars": tuple(standing)})
        moved = {"camera": single.camera, "cars": single.cars}
        assert plain.model_copy(update=moved) == single  # but for host and cars that found no way
        same += plain == single
    assert same >= 7


def test_frames_of_a_clip_differ_in_their_number_alone():
    worlds = frames(1, clips(5, 10), params())
    assert [world.scene.shot.frame for world in worlds] == list(range(5))
    assert len({world.scene.model_dump_json(exclude={"shot"}) for world in worlds}) == 1
    assert {world.scene.index for world in worlds} == {1}


def test_a_frame_is_the_same_whether_drawn_alone_or_in_a_clip_or_read_back():
    shots, drawn_from = clips(4, 10), params()
    texts = list(scene_texts(Scenes(drawn_from, shots=shots), range(8)))
    for index in (6, 1, 7, 3):
        world = sample_world(Scenes(drawn_from, shots=shots), index)
        assert scene_format.to_json(world.scene) == texts[index]
        again = ground_truth(scene_format.from_json(texts[index], "test"))
        assert labels_format.to_json(again) == labels_format.to_json(label(world, world.view))


@pytest.mark.parametrize("index", [0, 1, 2])
def test_poses_integrate_to_the_way_driven(index):
    worlds = frames(index, TWO_SECONDS, params(*SMOOTH, "camera.offset_m=0"))
    shot = worlds[0].scene.shot
    assert 20 <= shot.speed_m_s <= 33
    feet = np.array([world.view.world_from_host[:3, 3] for world in worlds])
    steps_m = np.linalg.norm(np.diff(feet, axis=0), axis=1)
    # A chord is shorter than its arc by less than a thousandth on these roads.
    assert steps_m == pytest.approx(shot.speed_m_s / 10, rel=1e-3)
    for world, step in zip(worlds, np.diff(feet, axis=0), strict=False):
        assert step @ world.view.world_from_host[:3, 1] > 0.99 * np.linalg.norm(step)


def clip_labels(index: int, shots: Shots) -> list[Labels]:
    """The labels of all pictures of a clip, as read back."""
    scenes = Scenes(params(*EXIT), 0, "train", shots=shots)
    pictures = range(index * shots.per_scene, (index + 1) * shots.per_scene)
    worlds = (sample_world(scenes, picture) for picture in pictures)
    texts = [labels_format.to_json(label(world, world.view)) for world in worlds]
    return [labels_format.from_json(text, "test") for text in texts]


def unknown(labels: Labels) -> list[str]:
    """The neighbours that `validate` does not accept."""
    reasons = [finding.reason for finding in check_shape(labels, changed())]
    return [reason for reason in reasons if "expected the id of a line" in reason]


def check_neighbours(clip: list[Labels]) -> None:
    """Lines have one description and one order through the clip, and their neighbours are lines of it."""
    lines = {}
    for labels in clip:
        assert labels.graph == clip[0].graph
        for lane in labels.lanes:
            same = (
                lane.kind, lane.road, lane.marking, lane.left, lane.right, lane.color, lane.double, lane.pair,
                lane.direction,
            )  # fmt: skip
            assert lines.setdefault(lane.id, same) == same, lane.id
    for _, _, _, left, right, *_ in lines.values():
        assert {left, right} <= {None, *lines}
    ids = [[lane.id for lane in labels.lanes] for labels in clip]
    for one in ids:
        for other in ids:
            assert [id_ for id_ in one if id_ in other] == [id_ for id_ in other if id_ in one]


@pytest.mark.parametrize("scenes", first(1, [[2, 4, 7], [0, 1, 3, 5, 6, 2, 4, 7]]))
def test_neighbours_ids_and_graph_are_constant_through_a_clip(scenes):
    """The first ones have lines that come, that go, and that are neighbours before they are seen."""
    came = went = elsewhere = 0
    for index in scenes:
        clip = clip_labels(index, clips(9, 1))
        check_neighbours(clip)
        ids = [{lane.id for lane in labels.lanes} for labels in clip]
        for before, after in pairwise(ids):
            came, went = came + len(after - before), went + len(before - after)
        for id_ in set.union(*ids):
            has = [id_ in frame for frame in ids]
            assert sum(a != b for a, b in pairwise(has)) <= 1, "a line comes or goes once"
        for labels, known in zip(clip, ids, strict=True):
            named = {side for lane in labels.lanes for side in (lane.left, lane.right) if side}
            elsewhere += len(named - known)
            assert not unknown(labels)
    assert came
    assert went
    assert elsewhere


def test_neighbours_are_constant_in_every_camera_of_a_rig():
    clip = clip_labels(0, clips(4, 0.5, load_rig("nuscenes")))
    assert len(clip) == 24
    check_neighbours(clip)
    frames_of = [clip[first : first + 6] for first in range(0, 24, 6)]
    assert all([lane.id for lane in one.lanes] == [lane.id for lane in of[0].lanes] for of in frames_of for one in of)


def test_neighbours_of_a_single_picture_are_among_its_lines():
    left_out = 0
    for index in range(8):
        scene = sample_scene(Scenes(params(*EXIT), 0, "train"), index)
        labels = ground_truth(scene)
        known = {lane.id for lane in labels.lanes}
        left_out += len({line.id for line in resolve(scene).site.lines} - known)
        assert {side for lane in labels.lanes for side in (lane.left, lane.right)} <= {None, *known}
        assert not unknown(labels)
        # A neighbour that no line has is an error there.
        wrong = replace(labels, lanes=(replace(labels.lanes[0], left="nobody"), *labels.lanes[1:]))
        assert len(unknown(wrong)) == 1
    assert left_out


@pytest.mark.parametrize("index", range(4))
def test_lanes_stay_at_one_place_of_the_world(index):
    """Lines of a later frame lie on those of the first, interpolated by splines that know nothing of our roads."""
    first, *later = [label(world, world.view) for world in frames(index, clips(3, 2), params("road.topology=1"))]
    compared = 0
    for lane in first.lanes:
        x, y, z = transform(first.camera.world_from_cam, read_back(first, lane.id)).T
        if len(y) < 30:
            continue
        order = np.argsort(y)
        spline = CubicSpline(y[order], np.column_stack([x, z])[order])
        for labels in later:
            if lane.id not in [other.id for other in labels.lanes]:
                continue
            points = transform(labels.camera.world_from_cam, read_back(labels, lane.id))
            # Splines are loose at ends of lines and where the road's curvature jumps, 100 m from its middle.
            inner = points[(points[:, 1] > y.min() + 5) & (points[:, 1] < min(y.max(), 100) - 5)]
            assert np.abs(spline(inner[:, 1]) - inner[:, [0, 2]]).max(initial=0) < 1e-3
            compared += len(inner)
    assert compared > 200
    assert [labels.time_s for labels in (first, *later)] == [0.0, 0.5, 1.0]


def read_back(labels, lane_id):
    again = labels_format.from_json(labels_format.to_json(labels), "test")
    return next(lane.xyz_cam for lane in again.lanes if lane.id == lane_id)


def test_cars_keep_their_numbers_speeds_and_direction():
    worlds = frames(3, TWO_SECONDS, params(*SMOOTH, "cars.parked=0.5", "road.n_oncoming=2", "road.shoulder_factor=0.8"))
    cars = worlds[0].scene.cars
    poses = np.array([world.view.world_from_cars for world in worlds])
    assert len(cars) == 6
    for number, car in enumerate(cars):
        steps = np.diff(poses[:, number, :3, 3], axis=0)
        assert np.linalg.norm(steps, axis=1) == pytest.approx(car.speed_m_s / 10, rel=0.01)
        assert (car.speed_m_s == 0) == (car.offset_m != 0)
        assert (poses[:, number, :3, 1] * poses[0, number, :3, 1]).sum(axis=1).min() > 0.9
        ahead = -1 if car.lane.startswith("oncoming") else 1
        assert (ahead * steps[:, 1] >= 0).all()
    assert {car.lane.startswith("oncoming") for car in cars} == {True, False}
    assert {car.offset_m != 0 for car in cars} == {True, False}


def test_speeds_follow_their_ranges():
    drawn = [
        frames(i, clips(2, 10), params("motion.host_speed_m_s=[8, 14]", "motion.car_speed_m_s=11"))[0] for i in range(6)
    ]
    speeds = [world.scene.shot.speed_m_s for world in drawn]
    assert all(8 <= speed <= 14 for speed in speeds)
    assert len(set(speeds)) == 6
    assert {car.speed_m_s for world in drawn for car in world.scene.cars} <= {11.0, *speeds}


def test_clips_beyond_the_road_are_refused():
    with pytest.raises(InputError, match=r"at most 400 m, got 14\.9 s at up to 33 m/s"):
        sample_scene(Scenes(params(), shots=clips(150, 10)), 0)
    with pytest.raises(InputError, match="frames: expected at most 1000, got 1001"):
        clips(1001, 10)
