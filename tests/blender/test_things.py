"""Cars, things and structures in pictures and sweeps: ids, boxes, what hides what, and how much of each is seen."""

import bpy
import numpy as np
import pytest

from synth3dlanes.blender import build as builder
from synth3dlanes.blender import render as renderer
from synth3dlanes.draw.sample import Scenes, sample_scene, with_lidar
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.geometry.lens import Lens
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.params.params import load_params
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.assets.catalogue import THINGS
from synth3dlanes.scene.instance_ids import instance_id, numbers_of
from synth3dlanes.scene.scene import Car
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.world.world import resolve
from tests.scenes import changed, hill, things_ahead
from tests.thorough import first

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
    "ahead": {},
    "wide": {"fx_px": 60, "fy_px": 60, "roll_rad": 0.1},
    "barrel": {"fx_px": 150, "fy_px": 150, "lens": BARREL},
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
