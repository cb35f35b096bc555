"""What the checks find wrong about people, riders and road works: labels that are not the scene's, pixels elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.draw.sample import with_lidar
from synth3dlanes.geometry.frames import quaternion, rotation, turned
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.world import resolve
from tests.scenes import changed, things_ahead
from tests.validate.examining import findings, reasons

pytestmark = [pytest.mark.render, pytest.mark.thorough]
SETTINGS = RenderSettings(samples=1, passes=("depth", "normal", "semantic", "instance"))


@pytest.fixture(scope="module")
def sample():
    sharp = {"width_px": 1200, "height_px": 640, "fx_px": 1000.0, "fy_px": 1000.0, "cx_px": 600.0, "cy_px": 200.0}
    world = resolve(with_lidar(changed(things_ahead(), camera=sharp), load_lidar("hdl_64e")))
    picture = take_picture(world, SETTINGS)
    return Evidence(world, picture.labels, picture.image, picture.passes, picture.sweep)


def spoilt(sample, number, **fields):
    items = list(sample.labels.objects)
    items[number] = replace(items[number], **fields)
    return replace(sample, labels=replace(sample.labels, objects=tuple(items)))


def moved(sample, number, **fields):
    """The sample as if the scene had the thing elsewhere: labels and scene agree, pixels do not."""
    scene = sample.world.scene
    things = list(scene.things)
    things[number] = things[number].model_copy(update=fields)
    world = resolve(scene.model_copy(update={"things": tuple(things)}))
    items = zip(label(world, world.view).objects, sample.labels.objects, strict=True)
    seen = ("seen_box_px", "visible_fraction", "lidar_points")
    objects = tuple(replace(new, **{name: getattr(old, name) for name in seen}) for new, old in items)
    labels = replace(sample.labels, objects=objects)
    return Evidence(world, labels, sample.image, sample.passes, sample.sweep)


def test_what_is_as_the_scene_says_has_no_findings(sample):
    assert findings(sample) == []


@pytest.mark.parametrize("number", [1, 9, 11, 14])
def test_labels_turned_by_ten_degrees_ten_centimetres_aside_or_of_another_kind_are_found(sample, number):
    item = sample.labels.objects[number]
    turn = quaternion(rotation(item.rotation_wxyz) @ turned(np.radians(10))[:3, :3])
    aside = item.center_cam + np.array([0.1, 0, 0])
    for change in ({"rotation_wxyz": turn}, {"center_cam": aside}, {"category": "car"}, {"lidar_points": 1}):
        assert f"objects.{item.id}" in reasons(spoilt(sample, number, **change), "labels")


@pytest.mark.parametrize("number", [6, 9, 13])
def test_pixels_and_points_ten_centimetres_beside_the_scenes_place_are_found(sample, number):
    thing = sample.world.scene.things[number]
    found = reasons(moved(sample, number, x_m=thing.x_m + 0.1), "ids")
    assert f"thing {number} within its body" in found


def test_a_share_that_does_not_fit_the_pixels_is_found_of_every_thing(sample):
    shares = [item.visible_fraction for item in sample.labels.objects]
    wrong = {number: share + (-0.9 if share > 0.5 else 0.9) for number, share in enumerate(shares)}
    asked = {number: share for number, share in wrong.items() if 0 <= share <= 1}
    assert len(asked) > 10
    for number, share in asked.items():
        assert f"of thing {number} by its" in reasons(spoilt(sample, number, visible_fraction=share), "cars"), shares


def test_swapped_ids_are_found_in_pixels_and_points(sample):
    def swapped(ids):
        return np.where(ids == 10_002, 10_004, np.where(ids == 10_004, 10_002, ids)).astype(ids.dtype)

    pixels = replace(sample, passes={**sample.passes, "instance": swapped(sample.passes["instance"])})
    assert "objects.10002" in reasons(pixels, "labels")
    assert "thing 1" in reasons(pixels, "ids")
    points = replace(sample, sweep=replace(sample.sweep, instance=swapped(sample.sweep.instance)))
    assert "thing 3" in reasons(points, "lidar")


def test_a_person_with_the_semantic_id_of_a_car_is_found(sample):
    semantic = np.where(sample.passes["semantic"] == 16, np.uint8(5), sample.passes["semantic"])
    assert "kind thing" in reasons(replace(sample, passes={**sample.passes, "semantic": semantic}), "kinds")
