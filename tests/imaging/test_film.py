"""The film curve: increasing, anchored at middle gray, never clipping what a scene holds."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.imaging.film import response, tonemap


def test_more_light_is_never_darker() -> None:
    x = np.concatenate([np.linspace(0, 1e-4, 500), np.geomspace(1e-4, 60000, 20000)])
    assert np.all(np.diff(response(x)) >= 0)
    levels = tonemap(np.repeat(x[None, :, None], 3, axis=2).astype(np.float32))[0, :, 0]
    assert np.all(np.diff(levels.astype(int)) >= 0)
    assert (levels[0], levels[-1]) == (0, 255)


def test_every_level_between_black_and_white_is_used() -> None:
    x = np.linspace(0, 8, 200_000, dtype=np.float32)
    assert len(np.unique(tonemap(np.repeat(x[None, :, None], 3, axis=2)))) == 256


def test_middle_gray_stays_and_sunlit_white_does_not_clip() -> None:
    gray, white = tonemap(np.array([[[0.18] * 3, [2.5] * 3]], np.float32))[0, :, 0]
    assert abs(int(gray) - 118) <= 8
    assert 225 < white < 254


def test_what_is_no_light_is_black() -> None:
    assert np.all(tonemap(np.array([[[-1.0, np.nan, -np.inf]]], np.float32)) == 0)
    assert np.all(tonemap(np.array([[[np.inf, 1e9, 7e4]]], np.float32)) == 255)


@given(st.floats(0, 100, width=32))
def test_the_table_agrees_with_the_curve(x: float) -> None:
    level = tonemap(np.full((1, 1, 3), x, np.float32))[0, 0, 0]
    assert abs(float(level) - 255 * float(response(np.array(x)))) <= 0.7
