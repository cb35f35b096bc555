"""What the ground hides."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from synth3dlanes.world.visibility import TOLERANCE_M, _behind_crest, seen_over_ground
from synth3dlanes.world.world import resolve
from tests.scenes import changed, hill


def seen(scene, eye, points):
    return seen_over_ground(resolve(scene).ground, np.array(eye, dtype=float), np.array(points, dtype=float))


def test_everything_is_seen_on_a_plain():
    points = [[x, y, 0] for x in (-5, 0, 5) for y in range(-45, 60, 5)]
    assert seen(changed(), [0, -50, 1.5], points).all()


def test_a_crest_hides_the_road_behind_it_and_not_the_road_before_it():
    scene = changed(terrain={"gaussians": (hill(0, 0, 8, 25),)})
    heights = resolve(scene).ground.height(np.array([[0.0, -60], [0, -20], [0, 50]]))
    before, behind = seen(scene, [0, -60, heights[0] + 1.5], [[0, -20, heights[1]], [0, 50, heights[2]]])
    assert before
    assert not behind


@settings(max_examples=25)
@given(st.floats(2, 15), st.floats(0.1, 10), st.floats(20, 60))
def test_raising_the_terrain_between_a_fixed_eye_and_fixed_points_never_reveals(magnitude, more, sd):
    points = [[x, y, 1.0] for x in (-20, -3, 0, 3, 20) for y in (30, 60, 90)]
    low, high = (
        seen(changed(terrain={"gaussians": (hill(0, 0, height, sd),)}), [0, -60, 6.0], points)
        for height in (magnitude, magnitude + more)
    )
    assert not (high & ~low).any()


def test_a_raised_exit_hides_the_ground_behind_it():
    """From the main road, what lies beyond the exit's embankment at ground level is hidden; above it is not."""
    road = {"topology": 2, "exit_offset_m": 10, "ramp_height_m": 4, "ramp_slope": 2}
    raised = resolve(changed(road=road)).network.road("exit")
    s = np.array([raised.ramp.start_m + 15])
    beyond = raised.xy(s, 20.0)[0]
    eye = [0, s[0], 1.5]
    low, high = seen(changed(road=road), eye, [[*beyond, 0.0], [*beyond, 12.0]])
    assert high
    assert not low


def is_below(eye, to, crest):
    """Whether a line of sight passes below any step of a crest, each by a linear system of its own."""
    for start, end in pairwise(crest):
        share, place = np.linalg.solve(np.stack([to[:2], (start - end)[:2]], axis=1), (start - eye)[:2])
        top_m = (start + place * (end - start))[2] - TOLERANCE_M
        if 0 < share < 1 and 0 <= place <= 1 and (eye + share * to)[2] < top_m:
            return True
    return False


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(-3.2, 3.2), st.floats(0.3, 9))
def test_a_crest_hides_the_same_whatever_its_direction_even_all_around(seed, first_rad, turn_rad):
    """Kerbs to all sides of the eye and around it, past the direction where angles jump."""
    rng = np.random.default_rng(seed)
    angle = first_rad + np.linspace(0, turn_rad, 12)
    away_m = rng.uniform(5, 30, 12)
    eye = np.array([3.0, -7.0, 1.5])
    crest = np.column_stack([eye[0] + away_m * np.cos(angle), eye[1] + away_m * np.sin(angle), rng.uniform(0, 2, 12)])
    to = np.column_stack([rng.uniform(-60, 60, (80, 2)), rng.uniform(-1.5, 0, 80)])
    assert _behind_crest(eye, to, crest).tolist() == [is_below(eye, way, crest) for way in to]
