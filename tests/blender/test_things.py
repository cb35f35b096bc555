"""People, riders and road works in pictures and sweeps: ids, semantic ids, boxes and how much of them is seen."""

import numpy as np
import pytest

from synth3dlanes.draw.sample import with_lidar
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.assets.catalogue import THINGS
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.world.world import resolve
from tests.scenes import things_ahead

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
