"""Instance ids, and the table of kinds of things: people, riders and road works in scenes and clips."""

import ast
import json
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.verify import verify
from synth3dlanes.params.params import load_params
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.scene.assets.catalogue import CARS, THINGS
from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.instance_ids import END, instance_id, kind_indices, most_of, numbers_of, thing_of
from synth3dlanes.scene.instance_ids import KINDS as SERIES
from synth3dlanes.scene.road_map import MapLane, MapMark, MapRoad, MapSection, PlanPiece, RoadMap
from synth3dlanes.scene.scene import PlanInstant, Scene, Thing
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import KIND_OF_CATEGORY, KINDS, STUFF, ObjectCategory, ThingKind, classes_in
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.motion import thing_at
from synth3dlanes.world.world import World, resolve
from tests.map_scenes import constant, map_scene
from tests.scenes import FLAT, changed, hill
from tests.validate.examining import findings

ROOT = Path(__file__).parents[1]


def walker(**changes):
    colors = ((0.5, 0.5, 0.5),) * len(THINGS["pedestrian"][0].paints)
    fields = {"kind": "pedestrian", "model": 1, "x_m": 2.0, "y_m": -30.0, "yaw_rad": 0.0, "colors": colors, **changes}
    return Thing.model_validate(fields)


def with_things(*things, **parts):
    return changed(FLAT.model_copy(update={"things": things}), **parts)


def test_the_table_has_each_kind_once_with_what_all_need():
    assert [kind.semantic_id for kind in KINDS] == list(range(len(KINDS)))
    assert len({kind.name for kind in KINDS}) == len({kind.color for kind in KINDS}) == len(KINDS)
    assert {kind.series for kind in KINDS} == {"", *SERIES}
    assert STUFF == ("sky", "terrain", "road", "shoulder")
    categories = [found for of in get_args(ObjectCategory) for found in get_args(of) or [of]]
    assert sorted(KIND_OF_CATEGORY) == sorted(categories)
    assert set(THINGS) == set(get_args(ThingKind)) == {kind.name for kind in KINDS if kind.series == "thing"}
    assert {car.category for car in CARS} < set(categories)


def test_classes_are_those_of_the_formats():
    """Names as the public development kits spell them."""
    assert classes_in("kitti").items() >= {("pedestrian", "Pedestrian"), ("cyclist", "Cyclist"), ("car", "Car")}
    assert "cone" not in classes_in("kitti")
    assert classes_in("argoverse2")["barrel"] == "CONSTRUCTION_BARREL"
    assert classes_in("nuscenes")["cone"] == "movable_object.trafficcone"
    assert classes_in("cosmos")["motorcyclist"] == "rider"


def test_a_thing_stands_upright_on_the_ground_and_faces_left_when_turned_counter_clockwise():
    steep = FLAT.model_copy(update={"terrain": changed(terrain={"gaussians": (hill(30, -30, 8, 12),)}).terrain})
    thing = walker(x_m=20.0, yaw_rad=np.pi / 2, above_m=0.15, scale=1.1)
    world = resolve(Scene.model_validate(steep.model_copy(update={"things": (thing,)}).model_dump()))
    (pose,) = world.view.world_from_things
    np.testing.assert_allclose(pose[:3, 1], [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(pose[:3, 2], [0, 0, 1], atol=1e-12)
    assert pose[2, 3] == pytest.approx(world.ground.height(np.array([[20.0, -30.0]]))[0] + 0.15)
    (item,) = label(world, world.view).objects
    np.testing.assert_allclose(item.size_m, 1.1 * np.array([0.505, 0.97, 1.79]))
    middle_world = world.view.world_from_cam[:3, :3] @ item.center_cam + world.view.eye_world
    np.testing.assert_allclose(middle_world - pose[:3, 3], [0, 0, 1.1 * 1.79 / 2], atol=1e-9)
    assert item.velocity_cam is None


def clip(thing, time_s, slope=False):
    terrain = {"gaussians": (hill(0, 0, 10, 20),)} if slope else {}
    shot = Shot(frame=round(time_s * 1000), n_frames=1000, fps=1000.0)
    scene = with_things(thing, terrain=terrain).model_copy(update={"shot": shot})
    return resolve(Scene.model_validate(scene.model_dump()))


TRACK = tuple(
    PlanInstant(time_s=0.25 * i, x_m=20 + 3 * np.sin(0.2 * i), y_m=-30 + 0.3 * i, yaw_rad=-0.1 * i) for i in range(5)
)


@pytest.mark.parametrize("thing", [walker(speed_m_s=1.4, yaw_rad=0.5), walker(x_m=20.0, track=TRACK)])
def test_velocities_are_how_places_change(thing):
    """Up a hill, too; central differences over two milliseconds."""
    before, now, after = (clip(thing, time_s, slope=True) for time_s in (0.499, 0.5, 0.501))
    (velocity,) = (item.velocity_world for item in now.view.objects)
    moved = (after.view.world_from_things[0][:3, 3] - before.view.world_from_things[0][:3, 3]) / 0.002
    assert np.linalg.norm(velocity[:2]) > 1
    np.testing.assert_allclose(velocity, moved, atol=0.02)
    (item,) = label(now, now.view).objects
    np.testing.assert_allclose(now.view.world_from_cam[:3, :3] @ item.velocity_cam, velocity, atol=1e-9)


def test_who_walks_round_a_corner_keeps_walking_and_who_stands_stands():
    """Straight on at an even pace, then to the left at a right angle, then at rest; instants of half a second."""
    xy = [(0.0, 0.0), (0.0, 0.6), (0.0, 1.2), (-0.6, 1.2), (-1.2, 1.2), (-1.2, 1.2), (-1.2, 1.2)]
    places = ({"time_s": i / 2, "x_m": x, "y_m": y, "yaw_rad": 0.0} for i, (x, y) in enumerate(xy))
    thing = walker(track=tuple(PlanInstant.model_validate(place) for place in places))
    straight, corner, still = (thing_at(thing, time_s) for time_s in (0.2, 1.0, 2.6))
    assert (straight.thing.x_m, straight.thing.y_m, straight.thing.speed_m_s) == pytest.approx((0.0, 0.24, 1.2))
    np.testing.assert_allclose(corner.velocity_world, [-0.6, 0.6], atol=1e-9)
    assert (still.thing.x_m, still.thing.speed_m_s) == (-1.2, 0.0)
    way = [thing_at(thing, time_s).thing for time_s in np.linspace(0.5, 1.5, 41)]
    assert max(min(abs(at.x_m), abs(at.y_m - 1.2)) for at in way) < 0.06, "near its straight lines"
    assert min(at.speed_m_s for at in way) > 0.7


def test_a_thing_is_where_its_track_says_and_stands_before_and_after_it():
    thing = walker(track=TRACK)
    for instant in TRACK:
        found = thing_at(thing, instant.time_s).thing
        assert (found.x_m, found.y_m, found.yaw_rad) == pytest.approx((instant.x_m, instant.y_m, instant.yaw_rad))
    late = thing_at(thing, 9.0)
    assert (late.thing.x_m, late.thing.speed_m_s) == (TRACK[-1].x_m, 0.0)
    assert late.driven_m == pytest.approx(np.hypot(*np.diff([(at.x_m, at.y_m) for at in TRACK], axis=0).T).sum())


def test_steps_follow_the_way_and_rest_is_at_standstill():
    model = THINGS["pedestrian"][0]
    at_rest = clip(walker(phase=0.5), 0.5).view.objects[0].pose
    poses = [clip(walker(speed_m_s=model.stride_m), 0.125 * i + 0.01).view.objects[0].pose for i in range(8)]
    assert (at_rest, poses) == (0, list(range(1, 9)))


# Modules and folders that may name kinds of things: the table and lists of scenes, who draws and judges a kind, and its
# shape, place, paint and models.
NAMING = (
    "params/groups.py",
    "draw/",
    "validate/",
    *(f"scene/{name}.py" for name in ("assets/catalogue", "instance_ids", "roadside", "scene", "things")),
    *(f"world/{name}.py" for name in ("bonnet", "buildings", "crossings", "elements", "placement")),
    *(f"world/{name}.py" for name in ("posts", "rails", "signals", "solids", "world")),
    *(f"blender/{name}.py" for name in ("check_assets", "load_assets", "materials", "user_models")),
)
# There the words are those of other formats, unless a kind is looked up or a category compared. Of scenes, too.
FOREIGN, SHARED = ("formats/", "roads/maps/"), {"host", "kerb", "bridge"}
LOOKED_UP = {"SEMANTIC_IDS", "FIRST_OF", "instance_id", "numbers_of", "most_of"}


def asks_for_a_kind(node):
    """Whether an expression looks up a kind by its name, or compares a category of labels."""
    if isinstance(node, ast.Compare):
        return any(isinstance(of, ast.Attribute) and of.attr == "category" for of in (node.left, *node.comparators))
    at = getattr(node, "value", None) if isinstance(node, ast.Subscript) else getattr(node, "func", None)
    return getattr(at, "id", "") in LOOKED_UP


def names_in(tree, of_things, shared):
    """The names of kinds of things that stand in quotes in a module; those that are `shared` only where it asks for a
    kind."""
    for node in ast.walk(tree):
        if asks_for_a_kind(node):
            yield from {part.value for part in ast.walk(node) if isinstance(part, ast.Constant)} & of_things
        elif isinstance(node, ast.Constant) and node.value in of_things - shared:
            yield node.value


def test_modules_that_name_a_kind_of_thing_are_its_makers():
    """Kinds, their categories of labels and their series of ids, but for the ground and lines on it."""
    rows = [kind for kind in KINDS if kind.series not in ("", "delimiter")]
    of_things = {name for kind in rows for name in (kind.name, kind.series, *(of.category for of in kind.objects))}
    used, wrong = set(), {}
    for package in ("synth3dlanes", "cli", "baseline_model"):
        for path in (ROOT / package).rglob("*.py"):
            name, code = path.relative_to(ROOT / package).as_posix(), path.read_text()
            if not any(f'"{word}"' in code for word in of_things):
                continue
            named = {*names_in(ast.parse(code), of_things, of_things if name.startswith(FOREIGN) else SHARED)}
            makers = [start for start in NAMING if named and name.startswith(start)]
            used.update(makers)
            if named and not makers:
                wrong[name] = named
    assert wrong == {}, "replace them by a property of the row"
    assert {*NAMING} == used, "no longer needed in NAMING"


# Data sets on disk have these.
KNOWN = [("car", 0, 1), ("car", 198, 199), ("delimiter", 0, 200), ("delimiter", 99, 299), ("delimiter", 100, 20_100)]
KNOWN += [("tree", 0, 300), ("tree", 5699, 5999), ("structure", 0, 6000), ("structure", 2999, 8999)]
KNOWN += [("symbol", 0, 9000), ("symbol", 999, 9999), ("bonnet", 0, 10_000)]
KNOWN += [("thing", 0, 10_001), ("thing", 998, 10_999)]
# Those of a scene at most, and delimiters of a map of hundreds of roads.
LEAST = {"car": 1000, "tree": 10_000, "symbol": 1000, "bonnet": 1, "structure": 8000, "delimiter": 20_000, "thing": 900}
N_ROADS, N_LANES, LANE_M = 7, 20, 0.7


def test_every_thing_has_an_id_of_its_own_that_gives_it_back():
    numbered = [(kind, number) for kind in SERIES for number in range(most_of(kind))]
    ids = np.array([instance_id(*thing) for thing in numbered])
    assert len(np.unique(ids)) == len(ids)
    assert ids.min() == 1
    assert ids.max() == END - 1
    assert [thing_of(id_) for id_ in ids.tolist()] == numbered
    for kind in SERIES:
        expected = [number if of == kind else -1 for of, number in numbered]
        np.testing.assert_array_equal(numbers_of(kind, ids.astype(np.uint16)), expected)
    np.testing.assert_array_equal(kind_indices(ids), [SERIES.index(kind) for kind, _ in numbered])
    assert thing_of(0) == ("nothing", 0)
    assert kind_indices(np.array([0])) == numbers_of("car", np.array([0])) == -1


def test_ids_of_data_sets_on_disk_stay_what_they_are():
    assert [instance_id(kind, number) for kind, number, _ in KNOWN] == [id_ for *_, id_ in KNOWN]
    assert {kind: most_of(kind) for kind, least in LEAST.items() if most_of(kind) < least} == {}
    with pytest.raises(InputError, match="at most 1000 of the kind symbol, got 1001"):
        instance_id("symbol", 1000)


def parallel_roads() -> RoadMap:
    """Roads of many narrow lanes side by side; the host's is in the middle, and the last one."""
    lanes = tuple(
        MapLane(number=n, kind="driving" if n else "none", marks=(MapMark(kind="solid"),))
        if n == 0
        else MapLane(number=n, kind="driving", widths=constant(LANE_M), marks=(MapMark(kind="solid"),))
        for n in range(-N_LANES, N_LANES + 1)
    )
    places = sorted(range(N_ROADS), key=lambda i: -abs(i - N_ROADS // 2))
    roads = tuple(
        MapRoad(
            id=f"r{i}",
            plan=(PlanPiece(x_m=(i - N_ROADS // 2) * (2 * N_LANES * LANE_M + 4), y_m=-20, heading_rad=np.pi / 2,
                            length_m=140),),
            sections=(MapSection(s_m=0.0, lanes=lanes),),
        )
        for i in places
    )  # fmt: skip
    return RoadMap(roads=roads, links=(), route=(f"r{places[-1]}.0.-1",))


@dataclass(frozen=True)
class Parallel(Recipe):
    """A sample on these roads."""

    def world(self, index: int) -> World:
        return resolve(map_scene(parallel_roads(), 10.0, cars=(), trees=()))


@pytest.mark.thorough
@pytest.mark.render
def test_hundreds_of_delimiters_are_told_apart_by_all_readers(tmp_path):
    passes = ("depth", "semantic", "instance")
    recipe = Parallel(Scenes(load_params("tiny"), 0), RenderSettings(1, passes), "png")
    generate(Plan(tmp_path / "data", 1, recipe, workers=1), lambda event: None)
    reader = Reader(str(tmp_path / "data/train"))
    sample, ids = reader[0], reader.passes(0)
    names = [lane.id for lane in sample.labels.lanes if lane.kind == "delimiter"]
    assert len(names) > 256

    evidence = Evidence(recipe.world(0), sample.labels, sample.image, ids)
    assert findings(evidence, "ids", "points", "cars", "appearance") == []

    numbers = numbers_of("delimiter", ids["instance"])
    seen = {names[number] for number in np.unique(numbers[numbers >= 0]).tolist()}
    assert len([name for name in seen if name.startswith(evidence.scene.map.roads[-1].id)]) > 10
    for name in ("masks", "coco"):
        export = Export(str(tmp_path / "data"), tmp_path / name, name)
        export.write()
        assert [problem for result in verify(export, 9) for problem in result.problems] == []
    coco = json.loads((tmp_path / "coco/annotations/instances_train.json").read_text())
    assert {item["lane"]["id"] for item in coco["annotations"] if "lane" in item} == seen
