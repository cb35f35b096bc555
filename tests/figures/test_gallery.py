"""Contact sheets."""

import numpy as np
import pytest

from synth3dlanes.figures.gallery import draw_gallery
from synth3dlanes.figures.overlay import draw_overlay
from synth3dlanes.figures.samples import ShownSample


def test_every_image_has_its_cell_in_reading_order(straight_labels):
    images = [np.full((36, 48, 3), 10 * i, dtype=np.uint8) for i in range(5)]
    sheet = np.asarray(draw_gallery([ShownSample("", image) for image in images], 3))
    assert sheet.shape == (2 * (18 + 36) + 3 * 4, 3 * 48 + 4 * 4, 3)
    assert [int(sheet[22 + 18 + 58 * (i // 3), 4 + 24 + 52 * (i % 3), 0]) for i in range(5)] == [0, 10, 20, 30, 40]
    assert (sheet[-10, -10] == 255).all()


def test_lanes_are_drawn_when_given(straight_labels, gray_image):
    plain = draw_gallery([ShownSample("00000007", gray_image)], 4)
    drawn = draw_gallery([ShownSample("00000007", gray_image, straight_labels)], 4)
    assert plain.size == drawn.size == (488, 386)
    expected = draw_overlay(gray_image, straight_labels)
    assert (expected != gray_image).any()
    for sheet, image in ((plain, gray_image), (drawn, expected)):
        np.testing.assert_array_equal(np.asarray(sheet)[22:382, 4:484], image)


@pytest.mark.parametrize("width_px", [None, 300])
def test_each_cell_carries_its_own_key_above_its_picture_at_a_size_that_can_be_read(gray_image, width_px):
    """The keys are drawn after the images are shrunk: each cell begins with the same picture of its key."""
    names = ["00000007", "00000017", "00000007" + 100 * "x"]
    sheet = np.asarray(draw_gallery([ShownSample(name, gray_image) for name in names], 3, width_px))
    assert sheet.shape[1] <= (width_px or sheet.shape[1])
    pitch = (sheet.shape[1] - 4) // 3
    first, second, third = (sheet[4:22, 4 + i * pitch : 4 + i * pitch + 56] for i in range(3))
    np.testing.assert_array_equal(first, third)
    assert (first != second).any()
    assert (first < 110).all(axis=-1).sum() > 40, "dark strokes of a font of a fixed size"
    assert (sheet[22:-4, 4 : pitch - 1] == 120).all(), "nothing covers a picture"
    assert (sheet[:, -4:] == 255).all(), "a long key ends with its cell"
