"""Lines are drawn where the camera sees them."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.figures.colors import KINDS
from synth3dlanes.figures.overlay import draw_overlay, stretches_img
from synth3dlanes.labels.labels import Labels, LaneKind


def middle_of(drawn: np.ndarray, row: int, kind: LaneKind, background: int = 120) -> float:
    """Mean column (at pixel centres) of one colour in a row, weighted by how strongly it was drawn."""
    line = drawn[row].astype(float) - background
    color = np.array(KINDS[kind], dtype=float) - background
    weight = np.clip(line @ color / (color @ color), 0, 1)
    return float((weight * (np.arange(len(weight)) + 0.5)).sum() / weight.sum())


@pytest.mark.parametrize("row", [210, 260, 330])
def test_a_line_straight_ahead_is_drawn_at_the_principal_column(row, straight_labels, gray_image):
    labels = Labels(straight_labels.camera, straight_labels.lanes[:1], straight_labels.graph)
    assert middle_of(draw_overlay(gray_image, labels), row, "centerline") == pytest.approx(240, abs=0.15)


@pytest.mark.parametrize("row", [210, 260, 330])
def test_a_line_beside_the_road_is_drawn_where_the_pinhole_puts_it(row, straight_labels, gray_image):
    """On a flat road, a pixel row v lies at one distance; solve the pinhole for it."""
    labels = Labels(straight_labels.camera, straight_labels.lanes[1:], straight_labels.graph)
    v = row + 0.5
    below_horizon_rad = np.arctan((v - 180) / 400) + labels.camera.pitch_rad
    depth_m = 1.5 / np.sin(below_horizon_rad) * np.cos(below_horizon_rad - labels.camera.pitch_rad)
    expected_u = 240 + 400 * 2.0 / depth_m
    assert middle_of(draw_overlay(gray_image, labels), row, "delimiter") == pytest.approx(expected_u, abs=0.25)


def test_hidden_points_are_dotted_and_seen_ones_solid(straight_labels, gray_image):
    lane = straight_labels.lanes[0]
    stretches = list(stretches_img(straight_labels.camera, lane))
    assert [is_seen for is_seen, _ in stretches] == [True, False]
    assert np.allclose(stretches[0][1][-1], stretches[1][1][0])
    # Seen up to 7 m, so that the hidden stretch is long in the image.
    half = replace(lane, terrain_visible=lane.xyz_cam[:, 1] < 7.5)
    labels = Labels(straight_labels.camera, (half,), straight_labels.graph)
    drawn = draw_overlay(gray_image, labels)
    is_line = (drawn != gray_image).any(axis=(1, 2))
    horizon, border, foot = 168, round(180 + 400 * (1.5 / 7 - 0.03)), 300
    assert is_line[border + 4 : foot].all(), "solid up to the border"
    beyond = is_line[horizon + 15 : border - 4]
    assert beyond.any()
    assert not beyond.all(), "dots with gaps beyond it"


def test_the_image_is_left_as_it_was_and_lines_follow_its_size(straight_labels, gray_image):
    before = gray_image.copy()
    draw_overlay(gray_image, straight_labels)
    assert (gray_image == before).all()
    twice = draw_overlay(np.full((720, 960, 3), 120, dtype=np.uint8), straight_labels)
    labels = Labels(straight_labels.camera, straight_labels.lanes[:1], straight_labels.graph)
    assert middle_of(draw_overlay(np.full_like(twice, 120), labels), 520, "centerline") == pytest.approx(480, abs=0.15)


def test_points_behind_the_camera_are_never_drawn(straight_labels, gray_image):
    lanes = tuple(replace(lane, xyz_cam=lane.xyz_cam * [1, -1, 1]) for lane in straight_labels.lanes)
    labels = Labels(straight_labels.camera, lanes, straight_labels.graph)
    assert (draw_overlay(gray_image, labels) == gray_image).all()
