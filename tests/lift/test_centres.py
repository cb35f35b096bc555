"""Centre lines between delimiters, on tracks in closed form."""

import numpy as np
import pytest

from synth3dlanes.recorded.lift import tracks as lifted_tracks
from synth3dlanes.recorded.lift.tracks import Track, unplaced

S = np.arange(0.0, 120.0)


def track(name: str, d: np.ndarray) -> Track:
    return Track(name, S, d, unplaced(len(S)), np.full((len(S), 1), 0.02))


@pytest.mark.parametrize(("narrow_m", "has_second"), [(6.0, False), (30.0, True)])
def test_a_centre_line_is_where_a_lane_is_not_where_lines_meet(narrow_m: float, has_second: bool) -> None:
    """The right line of a lane leaves after 60 m, and comes near again for some metres."""
    apart = np.where(S < 60, 3.5, 8.0)
    apart[(S >= 90) & (90 + narrow_m > S)] = 4.0
    found = lifted_tracks._between(track("line_0", np.zeros(len(S))), track("line_1", apart), ())
    assert found is not None
    np.testing.assert_allclose(found.d, np.where(found.s < 60, 1.75, 2.0))
    assert found.s[0] == 0
    assert bool((found.s >= 90).any()) == has_second
    assert (np.diff(found.s) == 1).sum() == len(found.s) - 1 - has_second
