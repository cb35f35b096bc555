"""Test cases of OpenLane and CULane, kerbs and clips: what the scene decides about an export."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.formats import openlane
from synth3dlanes.formats.conditions import conditions, kerb_lanes
from synth3dlanes.formats.culane import SCENES, scene_list, scene_of
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.openlane import CASES, WAYMO_FROM_CAM, parse
from synth3dlanes.formats.writing import Pinhole
from synth3dlanes.geometry.frames import transform
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import SINGLE, clips
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.scene.roadside import Crossing, Rail, Roadside
from synth3dlanes.scene.scene import Car, Symbol, Tree
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.truth.ground_truth import ground_truth
from tests import fake_samples
from tests.formats import closed_form as cf
from tests.formats.planting import problems
from tests.map_scenes import ARM_M, FOUR_WAY, map_scene
from tests.scenes import FLAT, changed

SUN_AHEAD = {"sun_zenith_rad": 1.3, "sun_azimuth_rad": np.pi / 2}
BRIDGE = Crossing(kind="bridge", s_m=-20.0, clearance_m=5.0, width_m=12.0, color=(0.5, 0.5, 0.5))


def found_in(scene):
    return conditions(scene, ground_truth(scene))


def with_cars(n, s_m=-20.0):
    car = Car(model=1, scale=1, color=(1, 0, 0), gloss=0.5, lane="main_1", s_m=s_m)
    return FLAT.model_copy(update={"cars": tuple(car.model_copy(update={"s_m": s_m + 5 * i}) for i in range(n))})


def with_symbol(kind, lane=None, s_m=-20.0):
    return FLAT.model_copy(update={"symbols": (Symbol(kind=kind, lane=lane, s_m=s_m),)})


def under_trees(azimuth_rad):
    trees = tuple(Tree(model=3, x_m=12.0, y_m=y, yaw_rad=0, scale=1) for y in np.arange(-50.0, 0.0, 2.0))
    light = FLAT.light.model_copy(update={"sun_zenith_rad": 1.0, "sun_azimuth_rad": azimuth_rad})
    return FLAT.model_copy(update={"trees": trees, "light": light})


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        (FLAT, set()),
        (changed(weather={"daytime": "night"}, light={"sun_zenith_rad": 1.8}), {"night"}),
        (changed(light={"sun_zenith_rad": 1.62}), set()),
        (changed(light={"sun_zenith_rad": 1.9}), {"night"}),
        (changed(weather={"kind": "rain", "rain": 0.3}), {"extreme_weather"}),
        (changed(weather={"kind": "snow", "snow": 0.5}), {"extreme_weather"}),
        (changed(weather={"kind": "snow", "snow": 0.5, "snow_on_road": 0.5}), {"extreme_weather", "noline"}),
        (changed(air={"visibility_m": 400.0}), {"extreme_weather"}),
        (changed(markings={"grayscale": 0.5, "wear": 0.7}), {"noline"}),
        (changed(markings={"grayscale": 0.9, "missing": 0.9}), {"noline"}),
        (with_symbol("stop_line"), {"intersection"}),
        (with_symbol("crosswalk"), {"intersection"}),
        (with_symbol("crosswalk", s_m=60.0), set()),
        (with_symbol("arrow_straight", "main_1"), {"arrow"}),
        (with_cars(4), set()),
        (with_cars(6), {"crowd"}),
        (with_cars(6, s_m=-95.0), set()),
        (changed(light=SUN_AHEAD), {"hlight"}),
        (changed(light=SUN_AHEAD, air={"overcast": 1.0}), set()),
        (changed(light=SUN_AHEAD | {"sun_azimuth_rad": -np.pi / 2}), set()),
        (under_trees(0.0), {"shadow"}),
        (under_trees(np.pi), set()),
        (FLAT.model_copy(update={"roadside": Roadside(crossings=(BRIDGE,))}), {"shadow"}),
    ],
)
def test_conditions_follow_from_the_scene(scene, expected):
    assert found_in(scene) == expected


def test_cars_that_are_hidden_make_no_crowd():
    scene = with_cars(6)
    seen = ground_truth(scene).with_seen_shares((1.0, 1.0, 0.1, 0.1, 0.0, 0.0))
    assert conditions(scene, seen) == set()


@pytest.mark.parametrize(("to_m", "is_near"), [(75.0, False), (20.0, True)])
def test_a_junction_ahead_is_an_intersection(to_m, is_near):
    bare = FOUR_WAY.model_copy(update={"paint": ()})
    assert found_in(map_scene(bare, ARM_M - to_m)) == ({"intersection"} if is_near else set())


def test_cars_are_ahead_where_they_are_and_not_by_their_stations():
    """On a map a car's station is that of its own road."""
    car = Car(model=1, scale=1, color=(1, 0, 0), gloss=0.5, lane="north.0.-1", s_m=10.0)
    behind = [car.model_copy(update={"lane": "south.0.-1", "s_m": 40.0 + 5 * i}) for i in range(6)]
    ahead = [car.model_copy(update={"s_m": 4.0 + 5 * i}) for i in range(6)]
    for cars, is_crowd in ((ahead, True), (behind, False)):
        scene = map_scene(FOUR_WAY, ARM_M - 10.0)
        labels = ground_truth(scene.model_copy(update={"cars": tuple(cars)}))
        places = [item.center_cam[1] for item in labels.objects]
        assert ("crowd" in conditions(scene, labels)) == is_crowd, places


def test_every_frame_is_in_one_kind_of_culane():
    assert scene_of(frozenset()) == scene_of(frozenset({"steep", "up_down"})) == "normal"
    assert scene_of(frozenset({"curve", "night", "arrow"})) == "night"
    assert scene_of(frozenset({"intersection", "arrow"})) == "cross"
    for kind in set(SCENES) - {"normal", "cross"}:
        assert scene_of(frozenset({kind})) == kind


@pytest.mark.parametrize("flips", [(False, False), (True, False), (False, True), (True, True)])
@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("kind", ["kerb", "walkway"])
def test_kerbs_are_lines_of_openlane_at_the_foot_of_their_front(flips, side, kind):
    rail = Rail(
        kind=kind, road="main", side=side, from_m=-100, to_m=100, aside_m=0.3, height_m=0.12, color=(0.5, 0.5, 0.5)
    )
    fence = rail.model_copy(update={"kind": "guardrail", "aside_m": 1.0})
    road = FLAT.road.model_copy(update={"flip_longitudinal": flips[0], "flip_lateral": flips[1]})
    scene = FLAT.model_copy(update={"road": road, "roadside": Roadside(rails=(fence, rail))})
    labels = ground_truth(scene)
    (kerb,) = kerb_lanes(scene, labels.camera)
    assert kerb.id == "kerb_1"
    points_world = transform(labels.camera.world_from_cam, kerb.xyz_cam)
    # Lanes, shoulder, 5 cm of pavement beyond the paint's edge, and the distance from there.
    n, w = road.n_lanes, road.lane_width_m
    aside_m = n * w / 2 + w * road.shoulder_factor
    is_right = (side == "right") != flips[0]
    assert np.ptp(points_world[:, 0]) < 1e-6
    assert points_world[0, 0] * (1 if is_right else -1) == pytest.approx(aside_m + 0.3, abs=0.4)
    np.testing.assert_allclose(points_world[:, 2], 0, atol=1e-6)
    assert (np.diff(points_world[:, 1]) > 0).all(), "near to far"
    frame = cf.frame(Pinhole(1920, 1280, 1000.0), kerbs=(kerb,))
    (text,) = openlane.write(replace(frame, labels=labels)).files.values()
    lines = parse(text, "test").lines
    (found,) = [line for line in lines if line.category in (20, 21)]
    assert found.category == (21 if is_right else 20)
    assert len(lines) == n + 2
    np.testing.assert_allclose(
        transform(labels.camera.world_from_cam, found.xyz_waymo @ WAYMO_FROM_CAM)[:, 0], points_world[0, 0], atol=1e-4
    )


def made(folder, n, shots=SINGLE, *changes):
    small = ("camera.width_px=96", "camera.height_px=64", "camera.horizontal_fov_deg=60", "camera.roll_deg=0")
    recipe = Recipe(Scenes(load_params("streets", (*small, *changes)), 3, "test", shots=shots), RenderSettings(), "jpg")
    generate(Plan(str(folder), n, recipe, workers=1, maker=fake_samples.make_labelled), lambda event: None)
    return folder


@pytest.mark.thorough
def test_lists_of_streets_hold_what_the_scenes_are_and_are_counted(tmp_path):
    data = made(tmp_path / "data", 10, SINGLE, "weather.daytime={day: 1, night: 1}", "roadside.outer=kerb")
    Export(str(data), tmp_path / "culane", "culane").write()
    summary = Export(str(data), tmp_path / "openlane", "openlane").write()
    nights = sum(row["weather_daytime"] == "night" for row in Reader(f"{data}/test").index.to_pylist())
    assert 0 < nights < 10
    listed = (tmp_path / "openlane/lane3d_1000/test/1000_night.txt").read_text().splitlines()
    assert len(listed) == nights == summary.n_of_list["lane3d_1000/test/1000_night.txt"]
    assert f"| `lane3d_1000/test/1000_night.txt` | {nights} |" in (tmp_path / "openlane/README.md").read_text()
    kinds = {kind: (tmp_path / "culane" / scene_list(kind)).read_text().splitlines() for kind in SCENES}
    assert len(kinds["night"]) == nights
    assert Counter(image for images in kinds.values() for image in images) == Counter(
        (tmp_path / "culane/list/test.txt").read_text().splitlines()
    )
    texts = [path.read_text() for path in (tmp_path / "openlane/lane3d_1000/validation").rglob("*.json")]
    categories = Counter(line["category"] for text in texts for line in json.loads(text)["lane_lines"])
    assert categories[20] + categories[21] > 0
    for name in ("culane", "openlane"):
        assert not problems(tmp_path / "data", tmp_path / name, name)
    assert set(CASES) >= {"night", "extreme_weather", "intersection"}


def test_a_clip_is_a_segment_of_openlane_and_its_lines_keep_their_tracks(tmp_path):
    data = made(tmp_path / "data", 6, clips(3, 2))
    Export(str(data), tmp_path / "out", "openlane").write()
    folders = sorted((tmp_path / "out/lane3d_1000/validation").iterdir())
    assert [len(list(folder.iterdir())) for folder in folders] == [3, 3]
    reader = Reader(f"{data}/test")
    for clip, folder in enumerate(folders):
        tracks = []
        for frame, path in enumerate(sorted(folder.iterdir())):
            lines = parse(path.read_text(), path.name).lines
            assert len({line.track_id for line in lines}) == len(lines)
            world_from_cam = reader.labels(3 * clip + frame).camera.world_from_cam
            tracks.append({line.track_id: transform(world_from_cam, line.xyz_waymo @ WAYMO_FROM_CAM) for line in lines})
        assert len(set(tracks[0]) & set(tracks[2])) >= 2
        for track in set(tracks[0]) & set(tracks[1]):
            gaps_m = np.linalg.norm(tracks[1][track][:, None] - tracks[0][track], axis=2).min(axis=0)
            assert gaps_m.min() < 0.3, "the same line of the world"
