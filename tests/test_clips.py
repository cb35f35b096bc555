"""Clips and views of one world: the host and the cars drive or stand elsewhere, everything else stays."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import synth3dlanes as s3d
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import merge
from synth3dlanes.dataset.scenes import read_scene
from synth3dlanes.draw.sample import Scenes, sample_scene, sample_world, scene_texts, world_in_shot
from synth3dlanes.figures.samples import load_clip
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.verify import verify
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels import labels as labels_format
from synth3dlanes.labels.labels import Labels
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.params.params import Params, load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import ShotNumbers, Shots, clips
from synth3dlanes.production.job import Job
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.production.twins import twin_recipes
from synth3dlanes.scene.scene import from_json, to_json
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import ground_truth, label
from synth3dlanes.validate.labels import check_shape
from synth3dlanes.validate.origin import read_origin
from synth3dlanes.world.world import World, resolve
from tests import fake_samples
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


@pytest.mark.parametrize("shots", [clips(4, 10), Shots(views=4)])
def test_a_picture_is_the_same_whether_drawn_alone_or_in_a_clip_or_read_back(shots):
    scenes = Scenes(params(), shots=shots)
    texts = list(scene_texts(scenes, range(8)))
    for index in (6, 1, 7, 3):
        world = sample_world(scenes, index)
        assert to_json(world.scene) == texts[index]
        again = ground_truth(from_json(texts[index], "test"))
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


@pytest.mark.parametrize(
    ("preset", "shots"),
    first(2, [("appendix_i", clips(3, 2)), ("streets", Shots(views=4)), ("town", Shots(views=4))]),
)
def test_pictures_of_a_world_have_the_same_things_at_the_same_places(preset, shots):
    """By their labels alone: lines of equal ids lie on those of the first picture, interpolated by splines that know
    nothing of our roads; signs, and cars of other views, stand where they stood."""
    compared = 0
    for index in range(1 if preset == "town" else 3):
        own = load_params(preset, ("road.topology=1", "works.present=false", "roadside.n_gantries=1"))
        scenes = Scenes(own, shots=shots)
        drawn = sample_world(scenes, index * shots.per_scene)
        worlds = (world_in_shot(scenes, drawn, shots.place(i)) for i in range(shots.per_scene))
        first, *later = [label(world, world.view) for world in worlds]
        for lane in first.lanes if preset != "town" else ():
            x, y, z = transform(first.camera.world_from_cam, lane.xyz_cam).T
            if len(y) < 30:
                continue
            order = np.argsort(y)
            spline = CubicSpline(y[order], np.column_stack([x, z])[order])
            for seen, other in ((labels, at) for labels in later for at in labels.lanes if at.id == lane.id):
                points = transform(seen.camera.world_from_cam, other.xyz_cam)
                # Splines are loose at ends of lines and where the road's curvature jumps, 100 m from its middle.
                inner = points[(points[:, 1] > y.min() + 5) & (points[:, 1] < min(y.max(), 100) - 5)]
                assert np.abs(spline(inner[:, 1]) - inner[:, [0, 2]]).max(initial=0) < 1e-3
                compared += len(inner)
        places = {item.id: middle(first, item) for item in standing(first, shots)}
        for labels in later:
            for item in (item for item in standing(labels, shots) if item.id in places):
                np.testing.assert_allclose(middle(labels, item), places[item.id], atol=1e-3)
                compared += 1
    assert compared > (15 if preset == "town" else 200)


def standing(labels: Labels, shots: Shots) -> list[ObjectLabel]:
    """Signs and signals, and the cars of views."""
    return [*(labels.traffic_elements or ()), *((labels.objects or ()) if shots.views > 1 else ())]


def middle(labels: Labels, item: ObjectLabel) -> np.ndarray:
    """The middle of an object in the world."""
    return np.asarray(transform(labels.camera.world_from_cam, item.cam_from_object[:3, 3][None]))


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


def test_clips_beyond_the_road_are_refused():
    with pytest.raises(InputError, match=r"at most 400 m, got 14\.9 s at up to 33 m/s"):
        sample_scene(Scenes(params(), shots=clips(150, 10)), 0)
    with pytest.raises(InputError, match="frames: expected at most 1000, got 1001"):
        clips(1001, 10)


FEW = ("trees.n=3", "cars.n=4")


def recipe(preset: str, views: int, *changes: str, **fields: object) -> Recipe:
    several = {"views_per_scene": views} if views > 1 else {}
    return Job(params=preset, set=changes, seed=5, **several, **fields).recipe()


def worlds(preset: str, scene: int, views: int) -> list[World]:
    made = recipe(preset, views)
    return [made.world(views * scene + view) for view in range(views)]


@pytest.mark.parametrize("of", ["view", "frame"])
def test_sample_numbers_and_places_are_one_to_one(of: str) -> None:
    shots = Shots(**{f"{of}s": 4}, cameras=load_rig("nuscenes")[:3])
    places = [shots.place(index) for index in range(48)]
    assert [shots.index(place) for place in places] == list(range(48))
    assert places[17] == ShotNumbers(**{"scene": 1, "frame": 0, "camera": 2, of: 1})
    assert len(set(places)) == 48
    assert shots.per_scene == 12


@pytest.mark.parametrize("preset", first(1, ["streets", "town"]))
def test_views_share_the_world_that_a_single_picture_has(preset: str) -> None:
    """Camera, light and sky differ, and nothing else; the first view is the single picture, and a view is the same
    among two as among four."""
    single, few = recipe(preset, 1).world(1), worlds(preset, 1, 2)
    found = worlds(preset, 1, 4)
    other = {"camera", "light", "sky", "shot"}
    assert {world.scene.model_dump_json(exclude=other) for world in (*found, *few)} == {
        single.scene.model_dump_json(exclude=other)
    }
    assert found[0].scene.model_copy(update={"shot": single.scene.shot}) == single.scene
    for two, four in zip(few, found, strict=False):
        assert (two.scene.camera, two.scene.light) == (four.scene.camera, four.scene.light)
    assert len({(world.scene.camera.y_m, world.scene.camera.pitch_rad) for world in found}) == 4
    assert len({world.scene.light.sun_azimuth_rad for world in found}) == 4
    first = found[0].scene.camera.y_m
    assert all(first <= world.scene.camera.y_m <= first + 40 for world in found)
    assert all(world.site is found[0].site for world in found)
    xy = single.network.host_points(single.scene.camera, np.linspace(1, 80, 60))[:, :2]
    np.testing.assert_allclose(found[0].ground.height(xy), single.ground.height(xy), atol=2e-3)


def small(out: Path | str, n: int, part: tuple[int, int] = (1, 1), workers: int = 1, **how: object) -> Plan:
    maker = how.pop("maker", fake_samples.make_labelled)
    of = recipe("tiny", 3, *FEW, image_format="png", **how)
    return Plan(str(out), n, of, workers, part, shard_size=2, maker=maker)  # type: ignore[arg-type]


def made(out: Path, n: int, **how: object) -> Reader:
    assert not generate(small(out, n, **how), lambda event: None).problem  # type: ignore[arg-type]
    return Reader(f"{out}/train")


def samples(reader: Reader) -> list[dict[str, bytes]]:
    return [reader.raw(i) for i in range(len(reader))]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    """Two worlds of three views, and one view of a third."""
    return made(tmp_path_factory.mktemp("views") / "d", 7)


def test_the_bytes_depend_on_nothing_but_the_recipe(data: Reader, tmp_path: Path) -> None:
    """Not on workers, on parts, nor on where an earlier run ended, within a world too."""
    whole = samples(data)
    made(tmp_path / "a", 2)
    made(tmp_path / "a", 5, workers=2)
    assert samples(made(tmp_path / "a", 7)) == whole
    for part in (1, 2):
        made(tmp_path / f"part{part}", 7, part=(part, 2))
    merge([str(tmp_path / "part1"), str(tmp_path / "part2")], str(tmp_path / "b"))
    assert samples(Reader(f"{tmp_path}/b/train")) == whole


def test_the_index_counts_views_as_it_counts_frames(data: Reader) -> None:
    index = data.index
    assert index["scene"].to_pylist() == [0, 0, 0, 1, 1, 1, 2]
    assert index["frame"].to_pylist() == [0, 1, 2, 0, 1, 2, 0]
    assert [read_scene(data, i).shot.view for i in range(7)] == [0, 1, 2, 0, 1, 2, 0]
    assert data.description["shots"]["views"] == 3


def test_views_are_no_clip(data: Reader) -> None:
    for key in (0, 1):
        with pytest.raises(InputError, match=r"expected a sample of a clip .*, got a single picture"):
            load_clip(f"{data.url}:{key}")


def test_validate_draws_every_view_again(data: Reader) -> None:
    origin = read_origin(data.description)
    for i in range(7):
        scene = read_scene(data, i)
        assert origin.fault(scene, "train", i) == ""
        moved = scene.camera.model_copy(update={"y_m": scene.camera.y_m + 0.01})
        assert "camera.y_m" in origin.fault(scene.model_copy(update={"camera": moved}), "train", i)
    assert "camera.lane: expected" in origin.fault(read_scene(data, 1), "train", 2)


def test_scenes_near_a_view_and_twins_of_it_are_drawn_from_its_world(data: Reader, tmp_path: Path) -> None:
    params, view = s3d.load_params("tiny", FEW), read_scene(data, 4)
    near = s3d.sample_scene(params, like=[view], seed=9, spreads="0", views_per_scene=3, index=1)
    assert (near.camera, near.light) == (view.camera, view.light)
    (darker,) = twin_recipes(data.url, "light.exposure=0.5", "cpu")
    changed = darker.scene(4)
    assert changed.model_copy(update={"light": view.light}) == view
    (other,) = twin_recipes(data.url, "road.n_lanes=4", "cpu")
    assert (other.scene(4).road.n_lanes, other.scene(4).shot.view) == (4, 1)


@pytest.mark.parametrize("name", first(1, ["openlane", "opendrive", "apollo", "openlane_v2"]))
def test_exports_take_every_view_as_a_picture_of_its_own(name: str, data: Reader, tmp_path: Path) -> None:
    export = Export(data.url, tmp_path / "out", name)
    assert export.write().n_frames.total() == (3 if name == "opendrive" else 7)
    for verified in verify(export, 100):
        assert (verified.problems, verified.n_matched) == ((), verified.n)


@pytest.mark.parametrize("name", first(0, ["argoverse2", "nuscenes"]))
def test_every_view_is_a_log_with_its_map(name: str, tmp_path: Path) -> None:
    how = {"lidar": "hdl_32e", "maker": fake_samples.make_with_passes, "rig": load_rig("nuscenes")[:1]}
    generate(small(tmp_path / "d", 2, **how), lambda event: None)
    export = Export(str(tmp_path / "d"), tmp_path / "out", name)
    assert export.write().n_frames.total() == 2
    for verified in verify(export, 100):
        assert (verified.problems, verified.n_matched) == ((), verified.n)


@pytest.mark.thorough
@pytest.mark.render
def test_rendered_views_are_right_and_the_same_alone(tmp_path: Path) -> None:
    """Blender keeps the world from view to view; made again in another order, the bytes are equal."""
    report = s3d.generate_dataset(
        params="tiny", set=("weather.daytime={any: 1, night: 1}",), out=tmp_path / "d", n=6, views_per_scene=3,
        samples=1, passes="all", workers=1, device="cpu",
    )  # fmt: skip
    assert (report.done, report.problem) == (6, "")
    found = s3d.validate_dataset(tmp_path / "d", rerender=4, workers=1)
    assert found.problems == []
    assert {key.split()[0] for key in found.made_again.values()} == {"equal"}
