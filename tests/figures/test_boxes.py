"""Boxes of objects in figures: their lines are where the labels project their corners, on images, pages and tables."""

from dataclasses import replace

import numpy as np

from synth3dlanes.figures.colors import ELEMENT, OBJECT
from synth3dlanes.figures.overlay import draw_overlay, lines_img, objects_in_image
from synth3dlanes.geometry.lens import Lens
from synth3dlanes.truth.ground_truth import ground_truth
from tests.scenes import changed
from tests.signals import signals_scene


def test_lines_connect_the_projected_corners(flat_scene):
    labels = ground_truth(flat_scene)
    ((item, lines), _) = objects_in_image(labels)
    corners = labels.camera.project(item.corners_cam)
    ends = np.concatenate([line[[0, -1]] for line in lines[:12]])
    for corner in corners:
        assert (np.abs(ends - corner).max(axis=1) < 1e-6).sum() == 3
    middle, front = labels.camera.project(item.corners_cam[[[2, 3, 6, 7], [2, 3, 2, 3]]].mean(axis=1))
    np.testing.assert_allclose(lines[12], [middle, front], atol=2)


def test_a_box_beside_the_camera_is_drawn_as_far_as_it_is_ahead(flat_scene):
    long = flat_scene.cars[0].model_copy(update={"model": 10, "s_m": -47.0})
    labels = ground_truth(flat_scene.model_copy(update={"cars": (long,)}))
    lines = list(lines_img(labels.camera, labels.objects[0]))
    assert 5 <= len(lines) < 13
    assert all(np.isfinite(line).all() for line in lines)


def test_a_lens_bends_the_lines(flat_scene):
    camera = {"lens": Lens(model="fisheye", coefficients=(0.02, 0, 0, 0)), "fx_px": 90, "fy_px": 90}
    labels = ground_truth(changed(flat_scene, camera=camera))
    assert all(len(line) > 2 for _, lines in objects_in_image(labels) for line in lines)


def test_the_overlay_shows_seen_objects_and_no_hidden_ones(flat_scene, gray_image):
    labels = ground_truth(flat_scene)
    empty = draw_overlay(gray_image, replace(labels, objects=(), lanes=()))
    drawn = draw_overlay(gray_image, replace(labels, lanes=()))
    changed_px = (drawn != empty).any(axis=2)
    left, top, right, bottom = labels.objects[0].box_px.astype(int)
    assert changed_px[top : bottom + 1, left : right + 1].sum() > 50
    assert (np.abs(drawn.astype(int) - OBJECT).max(axis=2) < 60).sum() > 20
    hidden = draw_overlay(gray_image, replace(labels, lanes=()).with_seen_shares((0.0, 0.0)))
    assert (hidden == empty).all()


def test_faces_of_traffic_elements_are_drawn_where_their_corners_are_but_for_hidden_ones():
    labels = replace(ground_truth(signals_scene()), lanes=())
    drawn = [found for found in objects_in_image(labels) if found[0].is_element]
    assert len(drawn) == 9
    for item, lines in drawn:
        corners = labels.camera.project(item.corners_cam[4:])
        ends = np.concatenate([line[[0, -1]] for line in lines])
        for corner in corners:
            assert (np.abs(ends - corner).max(axis=1) < 1e-6).sum() == 2
    gray = np.full((labels.camera.height_px, labels.camera.width_px, 3), 90, np.uint8)
    overlay = draw_overlay(gray, labels)
    assert (np.abs(overlay.astype(int) - ELEMENT).max(axis=2) < 60).sum() > 20
    hidden = tuple(replace(item, visible_fraction=0.0) for item in labels.traffic_elements)
    assert (draw_overlay(gray, replace(labels, traffic_elements=hidden)) == gray).all()
