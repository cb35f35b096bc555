"""Contact sheets."""

import numpy as np

from synth3dlanes.figures.gallery import draw_gallery
from synth3dlanes.figures.overlay import draw_overlay


def test_every_image_has_its_cell_in_reading_order(straight_labels):
    images = [np.full((36, 48, 3), 10 * i, dtype=np.uint8) for i in range(5)]
    sheet = np.asarray(draw_gallery(images, None, 3))
    assert sheet.shape == (2 * 36 + 3 * 4, 3 * 48 + 4 * 4, 3)
    assert [int(sheet[4 + 18 + 40 * (i // 3), 4 + 24 + 52 * (i % 3), 0]) for i in range(5)] == [0, 10, 20, 30, 40]
    assert (sheet[-10, -10] == 255).all()


def test_lanes_are_drawn_when_given(straight_labels, gray_image):
    plain = draw_gallery([gray_image], None, 4)
    drawn = draw_gallery([gray_image], [straight_labels], 4)
    assert plain.size == drawn.size == (488, 368)
    expected = draw_overlay(gray_image, straight_labels)
    assert (expected != gray_image).any()
    for sheet, image in ((plain, gray_image), (drawn, expected)):
        np.testing.assert_array_equal(np.asarray(sheet)[4:364, 4:484], image)
