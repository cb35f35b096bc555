"""`--views-per-scene`: pictures of one world from several places of the host, each as exact as a world of its own."""

from pathlib import Path

import numpy as np
import pytest
import shapely

import synth3dlanes as s3d
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import merge, split_dataset
from synth3dlanes.dataset.scenes import read_scene
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.verify import verify
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import ShotNumbers, Shots
from synth3dlanes.production.job import Job
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.production.twins import twin_recipes
from synth3dlanes.scene.scene import from_json, to_json
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.origin import read_origin
from synth3dlanes.world.world import World, resolve
from tests import fake_samples
from tests.thorough import first
from tests.town_checks import bodies, touching

FEW = ("trees.n=3", "cars.n=4")
# Road, roadside and weather of a world on the paper's roads; a town's map and traffic.
PRESETS = pytest.mark.parametrize("preset", first(1, ["streets", "town"]))


def recipe(preset: str, views: int, *changes: str, **fields: object) -> Recipe:
    several = {"views_per_scene": views} if views > 1 else {}
    return Job(params=preset, set=changes, seed=5, **several, **fields).recipe()


def worlds(preset: str, scene: int, views: int) -> list[World]:
    made = recipe(preset, views)
    return [made.world(views * scene + view) for view in range(views)]


def middle(labels: Labels, item: ObjectLabel) -> np.ndarray:
    """The middle of an object in the world."""
    return np.asarray(transform(labels.camera.world_from_cam, item.cam_from_object[:3, 3][None]))


@pytest.mark.parametrize("of", ["view", "frame"])
def test_sample_numbers_and_places_are_one_to_one(of: str) -> None:
    shots = Shots(**{f"{of}s": 4}, cameras=load_rig("nuscenes")[:3])
    places = [shots.place(index) for index in range(48)]
    assert [shots.index(place) for place in places] == list(range(48))
    assert places[17] == ShotNumbers(**{"scene": 1, "frame": 0, "camera": 2, of: 1})
    assert len(set(places)) == 48
    assert shots.per_scene == 12


@PRESETS
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


@PRESETS
def test_two_views_see_the_same_things_at_the_same_places(preset: str) -> None:
    """By their labels alone: lines and cars of equal ids, in the world."""
    found = [(world, label(world, world.view)) for world in worlds(preset, 0, 4)]
    (_, first), *others = found
    lanes = {lane.id: shapely.LineString(transform(first.camera.world_from_cam, lane.xyz_cam)) for lane in first.lanes}
    cars = {item.id: middle(first, item) for item in first.objects or ()}
    compared = 0
    for _, labels in others:
        for lane in labels.lanes:
            if lane.id in lanes and preset == "streets":
                points = transform(labels.camera.world_from_cam, lane.xyz_cam)
                low, high = np.sort(np.array(lanes[lane.id].coords)[[0, -1], 1])
                inside = points[(points[:, 1] > low + 0.5) & (points[:, 1] < high - 0.5)]
                assert all(lanes[lane.id].distance(shapely.Point(point)) < 0.01 for point in inside)
                heights = np.array(lanes[lane.id].coords)
                z = np.interp(inside[:, 1], *heights[np.argsort(heights[:, 1])][:, 1:].T)
                np.testing.assert_allclose(inside[:, 2], z, atol=0.02)
                compared += len(inside)
        for item in labels.objects or ():
            if item.id in cars:
                np.testing.assert_allclose(middle(labels, item), cars[item.id], atol=1e-3)
                compared += 1
    assert compared > (500 if preset == "streets" else 5)


@PRESETS
def test_a_view_read_back_is_the_same_world(preset: str) -> None:
    for world in worlds(preset, 0, 3)[1:]:
        again = resolve(from_json(to_json(world.scene), "x"))
        for ours, theirs in zip(label(world, world.view).lanes, label(again, again.view).lanes, strict=True):
            assert ours.id == theirs.id
            np.testing.assert_array_equal(ours.xyz_cam, theirs.xyz_cam)
            np.testing.assert_array_equal(ours.terrain_visible, theirs.terrain_visible)
        terrain, its_own = (found.site.surfaces.terrain.vertices_world for found in (world, again))
        np.testing.assert_array_equal(terrain, its_own)


def test_the_host_touches_no_car() -> None:
    """On a road full of cars."""
    made = recipe("appendix_i", 8, "cars.n=40", "trees.n=0")
    assert [touching(bodies(made.world(index))) for index in range(16)] == [[]] * 16


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


def test_views_of_a_world_stay_together_when_a_split_is_divided(data: Reader, tmp_path: Path) -> None:
    split_dataset(data, {"a": 0.5, "b": 0.5}, 1, str(tmp_path / "out"))
    parts = [Reader(f"{tmp_path}/out/{name}") for name in ("a", "b")]
    found = [{read_scene(part, i).index for i in range(len(part))} for part in parts]
    assert not found[0] & found[1]
    assert found[0] | found[1] == {0, 1, 2}


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


@pytest.mark.parametrize("name", first(1, ["argoverse2", "nuscenes"]))
def test_every_view_is_a_log_with_its_map(name: str, tmp_path: Path) -> None:
    how = {"lidar": "hdl_32e", "maker": fake_samples.make_with_passes, "rig": load_rig("nuscenes")[:1]}
    generate(small(tmp_path / "d", 2, **how), lambda event: None)
    export = Export(str(tmp_path / "d"), tmp_path / "out", name)
    assert export.write().n_frames.total() == 2
    for verified in verify(export, 100):
        assert (verified.problems, verified.n_matched) == ((), verified.n)


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"frames": 2}, "views_per_scene: expected none beside frames of 2 or more"),
        ({"views_per_scene": 0}, "views_per_scene: expected at least 1, got 0"),
        ({"views_per_scene": 65}, "views_per_scene: expected at most 64, got 65"),
    ],
)
def test_what_cannot_be_is_refused(fields: dict[str, int], problem: str) -> None:
    with pytest.raises(s3d.InputError, match=problem):
        Job(**{"n": 1, "views_per_scene": 2, **fields})


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
