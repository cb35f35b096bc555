"""Objects that are not where depth, ids and the sweep show them are found, and labels that are not the scene's."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.host import Lidar
from synth3dlanes.scene.scene import Car
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.world import resolve
from tests.scenes import changed
from tests.thorough import first
from tests.validate.examining import findings, reasons

pytestmark = pytest.mark.render

BEAMS = tuple(np.deg2rad(np.linspace(10, -25, 64)).tolist())
HDL = Lidar(name="mine", elevations_rad=BEAMS, azimuths=1800, min_range_m=1, max_range_m=80, height_m=1.9)


def car(model: int, lane: str, s_m: float) -> Car:
    return Car(model=model, scale=1.02, color=(1, 0, 0), gloss=0.5, lane=lane, s_m=s_m)


@pytest.fixture(scope="module")
def sample() -> Evidence:
    """Three vehicles that are seen as a whole, one behind another, and one that is cut by the image's border."""
    scene = changed(road={"n_oncoming": 1})
    cars = (car(2, "main_2", -38), car(5, "main_1", -26), car(6, "oncoming_1", -31), car(1, "main_3", -20))
    scene = scene.model_copy(update={"cars": (*cars, car(3, "main_2", -30), car(10, "main_3", -45)), "lidar": HDL})
    settings = RenderSettings(samples=1, passes=("depth", "semantic", "instance"))
    picture = take_picture(resolve(scene), settings)
    return Evidence(resolve(scene), picture.labels, picture.image, picture.passes, picture.sweep)


def move(*by_m: float) -> Callable[[ObjectLabel], ObjectLabel]:
    return lambda item: replace(item, center_cam=item.center_cam + item.cam_from_object[:3, :3] @ np.array(by_m))


def with_objects(sample: Evidence, change: Callable[[list[ObjectLabel]], list[ObjectLabel]]) -> Evidence:
    items = tuple(change(list(sample.labels.objects)))
    return Evidence(
        sample.world, replace(sample.labels, objects=items), sample.image, dict(sample.passes), sample.sweep
    )


def test_correct_boxes_have_no_findings(sample):
    assert findings(sample, "labels", "ids", "lidar") == []


@pytest.mark.parametrize(
    "by", first(2, [{"s_m": 0.1}, {"offset_m": 0.2}, {"s_m": -0.1}, {"offset_m": -0.2}, {"scale": -0.06}])
)
def test_pixels_and_points_of_every_car_that_the_scene_has_elsewhere_are_found(sample, by):
    """A tenth of a metre along, two aside, or 6 % smaller."""
    told = []
    for number, car in enumerate(sample.scene.cars[:3]):
        (name, step), cars = *by.items(), list(sample.scene.cars)
        cars[number] = car.model_copy(update={name: getattr(car, name) + step})
        world = resolve(sample.scene.model_copy(update={"cars": tuple(cars)}))
        told.append(reasons(replace(sample, known_world=world), "ids", "lidar"))
        assert f"instance: expected pixels of car {number}" in told[-1]
    # A box that is nearer has all points that beams show.
    assert by == {"s_m": -0.1} or sum("lidar: expected points of car" in text for text in told) >= 2


def test_swapped_ids_are_found_by_the_scene_and_by_pixels(sample):
    def swap(items: list[ObjectLabel]) -> list[ObjectLabel]:
        first, second = (replace(items[i], id=items[1 - i].id) for i in (0, 1))
        return [second, first, *items[2:]]

    assert "objects.1: category: expected" in reasons(with_objects(sample, swap), "labels")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda items: items[:-1], "objects: expected 6 as in the scene"),
        (lambda items: [replace(items[0], category="truck"), *items[1:]], 'objects.1: category: expected "car"'),
        (lambda items: [move(0, 0.001, 0)(items[0]), *items[1:]], "objects.1: center_cam"),
        (lambda items: [replace(items[0], box_px=items[0].box_px + 0.5), *items[1:]], "objects.1: box_px"),
        (lambda items: [replace(items[0], truncation=0.1), *items[1:]], "objects.1: truncation: expected 0"),
        (lambda items: [replace(items[0], velocity_cam=np.zeros(3)), *items[1:]], "objects.1: velocity_cam"),
        (lambda items: [replace(items[0], lidar_points=7), *items[1:]], "objects.1: lidar_points: expected"),
        (
            lambda items: [replace(items[0], seen_box_px=items[0].seen_box_px + 1), *items[1:]],
            "objects.1: seen_box_px",
        ),
    ],
)
def test_other_numbers_than_those_of_scene_ids_and_sweep_are_found(sample, change, words):
    assert words in reasons(with_objects(sample, change), "labels")


def test_what_is_seen_of_a_hidden_car_is_what_is_left_of_it(sample):
    """The car behind the first one in its lane: its rectangle is within that of its box, and its share below 1."""
    hidden = sample.labels.objects[4]
    assert 0 < hidden.visible_fraction < 0.9
    assert hidden.seen_box_px is not None
    assert (hidden.seen_box_px[:2] >= hidden.box_px[:2] - 1).all()
    assert (hidden.seen_box_px[2:] <= hidden.box_px[2:] + 1).all()
