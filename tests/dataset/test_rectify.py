"""Pictures and labels turned upright and freed of their lens: the same world as a level pinhole sees it."""

import numpy as np
import pytest

from synth3dlanes.dataset.rectify import rectified_image, rectified_labels
from synth3dlanes.geometry.frames import road_from_cam
from synth3dlanes.geometry.lens import PINHOLE, Lens
from synth3dlanes.labels import labels as label_file
from synth3dlanes.truth.ground_truth import ground_truth
from tests.scenes import changed

CAMERA = {"cx_px": 251, "cy_px": 172, "pitch_rad": 0.07}
BARREL = Lens(model="opencv", coefficients=(-0.25, 0.06, 0.003, -0.002, -0.01, 0, 0, 0))
FISHEYE = Lens(model="fisheye", coefficients=(0.02, -0.01, 0.002, -0.0003))
lenses = pytest.mark.parametrize("lens", [PINHOLE, BARREL, FISHEYE])


@lenses
@pytest.mark.parametrize(("roll", "yaw"), [(0.0, 0.0), (-0.05, 0.0), (0.2, 0.0), (0.1, -0.3)])
def test_upright_labels_are_those_of_the_level_pinhole_at_its_place(lens, roll, yaw):
    expected = ground_truth(changed(camera={**CAMERA, "yaw_rad": yaw}))
    found = rectified_labels(ground_truth(changed(camera={**CAMERA, "roll_rad": roll, "yaw_rad": yaw, "lens": lens})))
    assert (found.camera.lens, found.camera.roll_rad, found.camera.yaw_rad) == (PINHOLE, 0, 0)
    np.testing.assert_allclose(found.camera.world_from_cam, expected.camera.world_from_cam, atol=1e-12)
    # A road frame in which the camera looks along y, as formats take it by pitch and height alone.
    road = road_from_cam(found.camera.height_m, found.camera.pitch_rad)
    np.testing.assert_allclose(found.camera.road_from_cam, road, atol=1e-12)
    if lens == PINHOLE and not yaw:
        for name in ("img_from_cam", "road_from_cam", "pitch_rad", "height_m"):
            np.testing.assert_allclose(getattr(found.camera, name), getattr(expected.camera, name), atol=1e-12)
        assert found.horizon == expected.horizon
    for a, b in zip(found.lanes, expected.lanes, strict=True):
        np.testing.assert_allclose(a.xyz_cam, b.xyz_cam, atol=1e-9)
        assert not (a.in_image & ~b.in_image).any(), "what the camera did not see is not seen now"


def test_a_level_pinhole_is_not_touched_and_corners_that_were_not_seen_repeat_the_border(rng):
    labels = ground_truth(changed(camera=CAMERA))
    image = rng.integers(0, 255, (360, 480, 3), dtype=np.uint8)
    assert rectified_labels(labels) is labels
    assert rectified_image(image, labels.camera) is image
    rolled = ground_truth(changed(camera={"roll_rad": 0.05})).camera
    assert (rectified_image(np.full((360, 480, 3), 77, dtype=np.uint8), rolled) == 77).all()


@lenses
@pytest.mark.parametrize("roll", [-0.08, 0.08])
def test_a_mark_that_a_camera_sees_lands_where_the_level_pinhole_sees_it(lens, roll):
    labels = ground_truth(changed(camera={**CAMERA, "roll_rad": roll, "lens": lens}))
    camera, level = labels.camera, rectified_labels(labels).camera
    turn = camera.road_from_cam[:3, :3].T @ level.road_from_cam[:3, :3]
    rows, columns = np.indices((camera.height_px, camera.width_px)) + 0.5
    for point_level in np.array([[-3.0, 10, -1.2], [2.0, 8, 1.5]]):
        (u, v), target = camera.project(turn @ point_level), level.project(point_level)
        spot = 200 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 18)
        image = np.repeat(spot[..., None].astype(np.uint8), 3, axis=2)
        found = rectified_image(image, camera)[..., 0].astype(float)
        centroid = np.array([(found * columns).sum(), (found * rows).sum()]) / found.sum()
        np.testing.assert_allclose(centroid, target, atol=0.1)


def test_labels_written_before_there_was_roll_are_read():
    labels = ground_truth(changed())
    text = label_file.to_json(labels)
    assert text.count('"roll_rad":0.0,') == 1
    old = label_file.from_json(text.replace('"roll_rad":0.0,', ""), "old")
    assert label_file.to_json(old) == text
    assert old.camera.roll_rad == 0
