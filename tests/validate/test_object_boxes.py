"""Boxes that do not fit what depth, ids and the sweep show are found, whatever the scene says; and the objects of
another scene."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.geometry.frames import quaternion, rotation, turned
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.host import Lidar
from synth3dlanes.scene.scene import Car
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Finding
from synth3dlanes.validate.things import SeenPart, judge, views_of
from synth3dlanes.world.world import resolve
from tests.scenes import changed
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


def turn(degrees: float) -> Callable[[ObjectLabel], ObjectLabel]:
    by = turned(np.deg2rad(degrees))[:3, :3]
    return lambda item: replace(item, rotation_wxyz=quaternion(rotation(item.rotation_wxyz) @ by))


def move(*by_m: float) -> Callable[[ObjectLabel], ObjectLabel]:
    return lambda item: replace(item, center_cam=item.center_cam + item.cam_from_object[:3, :3] @ np.array(by_m))


def scale(*by: float) -> Callable[[ObjectLabel], ObjectLabel]:
    return lambda item: replace(item, size_m=item.size_m * np.array(by))


FAULTS = {
    **{f"turned by {by} degrees": turn(by) for by in (2, -2)},
    **{f"{by} m to the right": move(by, 0, 0) for by in (0.1, -0.1)},
    **{f"{by} m on": move(0, by, 0) for by in (0.1, -0.1)},
    **{f"{by} m up": move(0, 0, by) for by in (0.1, -0.1)},
    **{f"width times {by}": scale(by, 1, 1) for by in (0.9, 1.1)},
    **{f"length times {by}": scale(1, by, 1) for by in (0.9, 1.1)},
    **{f"height times {by}": scale(1, 1, by) for by in (0.9, 1.1)},
}


def with_objects(sample: Evidence, change: Callable[[list[ObjectLabel]], list[ObjectLabel]]) -> Evidence:
    items = tuple(change(list(sample.labels.objects)))
    return Evidence(
        sample.world, replace(sample.labels, objects=items), sample.image, dict(sample.passes), sample.sweep
    )


def found_in(sample: Evidence, item: ObjectLabel) -> dict[str, int]:
    """How many findings pixels and points have of a box, by their source."""
    return {
        view.source: sum(isinstance(result, Finding) for result in judge(item, view)) for view in views_of(sample, item)
    }


def test_correct_boxes_have_no_findings_and_are_judged_by_pixels_and_by_points(sample):
    assert findings(sample, "boxes") == []
    sources = [{view.source for view in views_of(sample, item)} for item in sample.labels.objects]
    assert sources[:3] == [{"pixels", "points"}] * 3
    whole = [item.id for item in sample.labels.objects if item.visible_fraction == 1 and item.truncation == 0]
    assert {1, 2, 3, 4} <= {*whole}


@pytest.mark.parametrize("name", FAULTS)
def test_pixels_find_every_fault_of_every_box_that_is_seen_as_a_whole(sample, name):
    """Without the scene: by judging the box against its own pixels and points alone. Of a car 30 m away pixels are 7 cm
    apart."""
    for item in sample.labels.objects[:3]:
        assert found_in(sample, FAULTS[name](item))["pixels"], item.id


@pytest.mark.parametrize("name", [name for name in FAULTS if "0.9" in name or "turned" in name])
def test_points_of_the_sweep_find_boxes_that_are_turned_or_too_small(sample, name):
    """The nearest three, without any pixel."""
    blind = Evidence(sample.world, sample.labels, sweep=sample.sweep)
    for item in sample.labels.objects[:2]:
        assert found_in(blind, FAULTS[name](item)) == {"points": 1}


def test_swapped_ids_are_found_by_the_scene_and_by_pixels(sample):
    def swap(items: list[ObjectLabel]) -> list[ObjectLabel]:
        first, second = (replace(items[i], id=items[1 - i].id) for i in (0, 1))
        return [second, first, *items[2:]]

    def swap_boxes(items: list[ObjectLabel]) -> list[ObjectLabel]:
        places = [(item.center_cam, item.rotation_wxyz, item.size_m) for item in items[1::-1]]
        moved = [
            replace(item, center_cam=center, rotation_wxyz=turned_by, size_m=size)
            for item, (center, turned_by, size) in zip(items[:2], places, strict=True)
        ]
        return [*moved, *items[2:]]

    found = reasons(with_objects(sample, swap), "boxes", "labels")
    for name in ("objects.1: expected its pixels in its box", "objects.2: expected its points in its box"):
        assert name in found
    assert "objects.1: category: expected" in found
    assert "objects.1: size_m" in reasons(with_objects(sample, swap_boxes), "labels")


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
    assert words in reasons(with_objects(sample, change), "boxes", "labels")


def test_what_is_seen_of_a_hidden_car_is_what_is_left_of_it(sample):
    """The car behind the first one in its lane: its rectangle is within that of its box, and its share below 1."""
    hidden = sample.labels.objects[4]
    assert 0 < hidden.visible_fraction < 0.9
    assert hidden.seen_box_px is not None
    assert (hidden.seen_box_px[:2] >= hidden.box_px[:2] - 1).all()
    assert (hidden.seen_box_px[2:] <= hidden.box_px[2:] + 1).all()


@pytest.mark.parametrize(("eye_up_m", "is_told"), [(-1.5, False), (1.6, True)])
def test_a_nearer_end_may_hide_the_top_of_a_roof_from_below_alone(sample, eye_up_m, is_told):
    bus = replace(sample.labels.objects[0], size_m=np.array([2.5, 11.8, 3.06]), truncation=0.0, visible_fraction=1.0)
    half = bus.size_m / 2
    seen = np.array([[-half[0], -half[1], -half[2]], [half[0], -half[1], half[2] - 0.12]])
    told = list(judge(bus, SeenPart("pixels", seen, np.array([0, -35.0, eye_up_m]), 0.04)))
    problems = [result.reason for result in told if isinstance(result, Finding)]
    assert bool(problems) == is_told
    assert all("upper side of its box, got them 0.12 m before it" in problem for problem in problems)
