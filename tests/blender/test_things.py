"""Cars, things and structures in pictures and sweeps: ids, boxes, what hides what, how much is seen; no holes."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from synth3dlanes.blender import build as builder
from synth3dlanes.blender import render as renderer
from synth3dlanes.draw.sample import Scenes, sample_scene, sample_world, with_lidar
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.geometry.lens import Lens
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.params.params import load_params
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.assets.catalogue import THINGS
from synth3dlanes.scene.instance_ids import instance_id, numbers_of
from synth3dlanes.scene.roadside import Building, Crossing, Post, Rail, Roadside
from synth3dlanes.scene.scene import Car
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.world import World, resolve
from tests.scenes import FLAT, changed, hill, things_ahead
from tests.thorough import first
from tests.validate.examining import findings

pytestmark = pytest.mark.render

SETTINGS = RenderSettings(samples=1, passes=("depth", "semantic", "instance"))
DENSE = LidarSpec.model_validate(
    {"elevations_deg": list(range(4, -12, -1)), "azimuths": 2000, "max_range_m": 60, "height_m": 1.5}
)
# Meshes have 1/2048 m digits, depths and ranges 32 bits.
ROOM_M = 0.005


@pytest.fixture(scope="module")
def scene():
    return with_lidar(things_ahead(), DENSE)


@pytest.fixture(scope="module")
def picture(scene):
    return take_picture(resolve(scene), SETTINGS)


def in_boxes(labels, points_cam, ids):
    """Whether each point is in the box of the object that its id names."""
    found = np.zeros(len(ids), dtype=bool)
    for item in labels.objects:
        own = transform(invert(item.cam_from_object), points_cam[ids == item.id])
        found[ids == item.id] = (np.abs(own) < item.size_m / 2 + ROOM_M).all(axis=1)
    return found


def test_every_thing_has_its_id_and_that_of_its_kind_in_pixels_and_points(scene, picture):
    assert [item.category for item in picture.labels.objects] == [thing.kind for thing in scene.things]
    points = picture.sweep.points()
    for ids, semantic in ((picture.passes["instance"], picture.passes["semantic"]), (points.instance, points.semantic)):
        for item in picture.labels.objects:
            assert set(semantic[ids == item.id].tolist()) == {SEMANTIC_IDS[item.category]}
        assert np.isin(semantic, [SEMANTIC_IDS[kind] for kind in THINGS]).sum() == (ids > 10_000).sum() > 0


def test_pixels_and_points_of_a_thing_are_in_its_box_which_they_fill(picture):
    labels, passes = picture.labels, picture.passes
    rows, columns = np.nonzero(passes["instance"] > 10_000)
    ids = passes["instance"][rows, columns]
    points_cam = labels.camera.points(np.column_stack([columns, rows]) + 0.5, passes["depth"][rows, columns])
    assert in_boxes(labels, points_cam, ids).all()
    points = picture.sweep.points()
    hit = points.instance > 10_000
    assert in_boxes(labels, points.xyz_cam[hit], points.instance[hit]).all()
    for item in labels.objects:
        assert item.lidar_points == (points.instance == item.id).sum()
        if item.visible_fraction == 1 and item.truncation == 0:
            # Boxes are around all poses; a cone, which has one, reaches its top.
            assert np.abs(item.seen_box_px[[1, 3]] - item.box_px[[1, 3]]).max() < 3 + 0.12 * np.ptp(item.box_px[[1, 3]])


def test_what_stands_behind_another_is_seen_in_part(scene):
    near, far = (thing for thing in scene.things if thing.kind in ("barrel", "barricade"))
    far = far.model_copy(update={"x_m": near.x_m, "y_m": near.y_m + 2, "yaw_rad": 0.0})
    hidden = scene.model_copy(update={"things": (near, far), "lidar": None})
    barrel, barricade = take_picture(resolve(hidden), SETTINGS).labels.objects
    assert barrel.visible_fraction == 1
    assert 0.3 < barricade.visible_fraction < 0.9


IDS = RenderSettings(samples=1, passes=("instance",))
# Of a car's pixels alone; of a small one to less than one of them.
MAX_OFF, EDGE_PX = 0.02, 0.5

SMALL = {"width_px": 240, "height_px": 180, "fx_px": 208, "fy_px": 208, "cx_px": 120, "cy_px": 90}
FISHEYE = Lens(model="fisheye", coefficients=(0.02, 0, 0, 0))
BARREL = Lens(model="opencv", coefficients=(-0.25, 0.06, 0.003, -0.002, 0, 0, 0, 0))
CAMERAS = {
    "barrel": {"fx_px": 150, "fy_px": 150, "roll_rad": 0.1, "lens": BARREL},
    "fisheye of 220 degrees": {"fx_px": 60, "fy_px": 60, "lens": FISHEYE},
    "to the right, beside the host": {"yaw_rad": -1.4, "right_m": 0.9, "forward_m": 1.5},
    "back": {"yaw_rad": 3.1, "forward_m": -2.0},
}


def car(model, lane, s_m):
    return Car(model=model, scale=1.0, color=(1, 0, 0), gloss=0.5, lane=lane, s_m=s_m)


# Semitrailers and a bus alongside, partly behind the camera or all around its axis, and cars one behind the other.
TRAFFIC = (
    *(car(10, "main_3", -49.0), car(11, "main_1", -42.0), car(10, "main_1", -63.0), car(2, "main_2", -41.0)),
    *(car(6, "main_2", -31.0), car(4, "main_3", -33.0), car(9, "main_2", -61.0), car(10, "main_3", 20.0)),
)


def counted(scene, monkeypatch, least_px=1):
    """For each car with so many pixels, or labelled as seen without any: its number, share, pixels, and pixels
    alone."""
    picture = take_picture(resolve(scene), IDS)
    shares, ids = picture.labels.car_visible_fraction, picture.passes["instance"]
    seen = np.bincount(numbers_of("car", ids).ravel() + 1, minlength=len(shares) + 1)[1:]
    build = builder.build

    def alone(number):
        def bare(*arguments):
            placed = build(*arguments)
            for name in builder.COLLECTIONS:
                for item in bpy.data.collections[name].objects:
                    item.hide_render = name != "lens" and item.pass_index != instance_id("car", number)
            return placed

        with monkeypatch.context() as patch:
            patch.setattr(renderer, "build", bare)
            ids = take_picture(resolve(scene), IDS).passes["instance"]
        renderer.studio().ground = None
        return int((ids == instance_id("car", number)).sum())

    numbers = [i for i, n in enumerate(seen) if n >= least_px or (n == 0 and shares[i] > MAX_OFF)]
    return [(i, shares[i], int(seen[i]), alone(i)) for i in numbers]


def check(cars):
    for number, share, seen, whole in cars:
        assert abs(share * whole - seen) <= MAX_OFF * whole + EDGE_PX, (number, share, seen, whole)


@pytest.mark.thorough
@pytest.mark.parametrize("camera", CAMERAS)
def test_near_and_long_vehicles(camera, monkeypatch):
    scene = changed(camera={**SMALL, **CAMERAS[camera]}).model_copy(update={"cars": TRAFFIC})
    cars = counted(scene, monkeypatch)
    check(cars)
    assert any(whole > 2000 for *_, whole in cars)


@pytest.mark.thorough
@pytest.mark.parametrize(("index", "number", "px"), first(1, [(11, 13, 3_472), (5, 1, 45_335)]))
def test_vehicles_beside_the_host(index, number, px, monkeypatch):
    """A semitrailer on 26 % of the picture, and the front of a truck; nothing hides either."""
    scene = sample_scene(Scenes(load_params("streets", ["works.present=false"]), 4102, "train"), index)
    cars = counted(scene, monkeypatch, least_px=100)
    check(cars)
    share, seen, whole = next(values for i, *values in cars if i == number)
    assert share == 1
    assert seen == whole == px


def test_a_crest_hides_cars_from_below(monkeypatch):
    scene = changed(terrain={"gaussians": (hill(0, -10, 1.6, 12),)}, camera={**SMALL, "fx_px": 416, "fy_px": 416})
    scene = scene.model_copy(update={"cars": (car(1, "main_2", 25), car(10, "main_1", 25), car(11, "main_3", 40))})
    cars = counted(scene, monkeypatch)
    check(cars)
    assert [number for number, share, *_ in cars if 0.1 < share < 0.9] == [1, 2]


GROUND = [SEMANTIC_IDS[name] for name in ("terrain", "road", "shoulder", "marking", "symbol")]


def sky_below_ground(world: World) -> int:
    """How many pixels of sky lie below a pixel of ground in their columns."""
    semantic = take_picture(world, RenderSettings(samples=1, passes=("semantic",))).passes["semantic"]
    below = np.maximum.accumulate(np.isin(semantic, GROUND), axis=0)
    return int((below & (semantic == SEMANTIC_IDS["sky"])).sum())


@pytest.mark.parametrize("index", first(0, [39, 6]))
def test_a_town_has_no_holes(index: int) -> None:
    assert sky_below_ground(sample_world(Scenes(load_params("town"), 7001), index)) == 0


@pytest.mark.thorough
def test_the_terrain_is_not_seen_through_the_pavement_of_a_town() -> None:
    """Strips of roads and areas of junctions meet: a gap between them shows the terrain under both. Single pixels at
    their borders may."""
    world = sample_world(Scenes(load_params("town"), 2611), 0)
    picture = take_picture(world, RenderSettings(samples=1, passes=("semantic", "depth")))
    is_terrain = picture.passes["semantic"] == SEMANTIC_IDS["terrain"]
    v, u = np.nonzero(is_terrain & (picture.passes["depth"] < 60))
    points_cam = picture.labels.camera.points(np.column_stack([u, v]) + 0.5, picture.passes["depth"][v, u])
    xy = transform(world.view.world_from_cam, points_cam)[:, :2]
    assert len(xy) > 1000
    assert (-world.ground.clearance(xy) > 0.2).sum() <= 1


GRAY = (0.3, 0.3, 0.3)
WALL = Rail(
    kind="noise_wall", road="main", side="right", from_m=15.0, to_m=100.0, aside_m=0.3, height_m=4.0, color=GRAY
)
EVERYTHING = Roadside(
    rails=(
        WALL.model_copy(update={"kind": "guardrail", "side": "left", "from_m": -60.0, "height_m": 0.75}),
        WALL.model_copy(update={"kind": "kerb", "from_m": -60.0, "aside_m": 0.0, "height_m": 0.15}),
        WALL.model_copy(update={"aside_m": 3.0, "from_m": -60.0}),
    ),
    posts=(
        Post(kind="lamp", road="main", side="left", s_m=-20, aside_m=1.5, height_m=8),
        Post(kind="sign", road="main", side="right", s_m=-25, aside_m=1.8, height_m=2, face=9),
        Post(kind="delineator", road="main", side="left", s_m=-30, aside_m=1.0, height_m=1),
    ),
    crossings=(
        Crossing(kind="gantry", s_m=-10, clearance_m=5, width_m=0.9, color=(0.0, 0.1, 0.3)),
        Crossing(kind="bridge", s_m=30, clearance_m=5, width_m=9, color=GRAY),
    ),
    buildings=(
        Building(kind="hall", x_m=-40, y_m=0, yaw_rad=0.1, width_m=20, length_m=30, height_m=8, color=GRAY, roof=GRAY),
    ),
)
KINDS = ["barrier", "kerb", "barrier", "pole", "sign", "pole", "pole", "bridge", "building"]


def test_every_structure_has_its_ids_where_its_body_is():
    scene = changed(FLAT, camera=SMALL).model_copy(update={"roadside": EVERYTHING})
    world = resolve(scene)
    picture = take_picture(world, RenderSettings(samples=1, passes=("depth", "semantic", "instance")))
    semantic, instance = picture.passes["semantic"], picture.passes["instance"]
    for i, kind in enumerate(KINDS):
        # Boards of signs and gantries have ids of their own.
        own = SEMANTIC_IDS["pole" if kind == "sign" else kind]
        assert set(semantic[instance == instance_id("structure", i)].tolist()) == {own}, (i, kind)
    boards = numbers_of("structure", np.unique(instance[semantic == SEMANTIC_IDS["sign"]]))
    assert len(boards) >= 2
    assert boards.min() >= len(world.site.structures) - len(world.site.elements) == len(KINDS)
    sample = Evidence(world, picture.labels, picture.image, picture.passes)
    assert findings(sample, "ids", "points") == []
    swapped = np.where(instance == instance_id("structure", 0), instance_id("structure", 5), instance)
    found = findings(replace(sample, passes={**picture.passes, "instance": swapped}), "ids")
    assert "pixels of structure 5 within its body" in found[0].reason


def test_a_wall_hides_the_points_behind_it_and_no_others():
    """A bend behind a wall: the rendered depth says what is hidden."""
    road = {"offset_p50_m": 9.0, "offset_p100_m": 9.0}
    bare = changed(FLAT, road=road, camera={**SMALL, "lane": 3, "y_m": -40})
    walled = resolve(bare.model_copy(update={"roadside": Roadside(rails=(WALL.model_copy(update={"from_m": -20.0}),))}))
    settings = RenderSettings(samples=1, passes=("depth", "semantic"))
    without, behind = (take_picture(world, settings) for world in (resolve(bare), walled))
    semantic, depth = behind.passes["semantic"], behind.passes["depth"]
    assert (semantic == SEMANTIC_IDS["barrier"]).sum() > 300
    hidden = 0
    for free, lane in zip(without.labels.lanes, behind.labels.lanes, strict=True):
        assert free.object_visible.all()
        u, v = (lane.xyz_cam @ behind.labels.camera.img_from_cam.T)[lane.in_image].T[:2] / lane.xyz_cam[
            lane.in_image, 1
        ]
        column, row = np.clip(u.astype(int), 1, 238), np.clip(v.astype(int), 1, 178)
        around = np.stack([semantic[row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1)])
        nearer = depth[row, column] < 0.9 * lane.xyz_cam[lane.in_image, 1]
        is_wall = (around == SEMANTIC_IDS["barrier"]).all(axis=0) & nearer
        seen = lane.object_visible[lane.in_image]
        assert not seen[is_wall].any()
        assert seen[(around != SEMANTIC_IDS["barrier"]).all(axis=0)].all()
        hidden += int(is_wall.sum())
    assert hidden > 20
    lanes = behind.labels.lanes
    unhidden = tuple(replace(lane, object_visible=np.ones(len(lane.xyz_cam), dtype=bool)) for lane in lanes)
    sample = Evidence(walled, behind.labels, behind.image, behind.passes)
    assert not findings(sample, "points")
    found = findings(replace(sample, labels=replace(behind.labels, lanes=unhidden)), "points")
    assert {finding.lane for finding in found} >= {"main_3", "main_line_3"}
