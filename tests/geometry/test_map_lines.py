"""Reference lines of maps against independent formulas: small steps, circles and differences."""

import numpy as np
import pytest

from synth3dlanes.roads.map_lines import Chain, Cubic, Spiral

ARC = Spiral(60.0, (3.0, -2.0), 0.7, 0.02)
SPIRAL = Spiral(80.0, (1.0, 5.0), -0.4, 0.01, -0.0006)
CUBIC = Cubic(50.0, (1.0, 0.9, 0.01, -0.0001), (2.0, 0.5, -0.004, 0.0002))
CHAIN = Chain.of([Spiral(30.0, (0.0, 0.0), 0.2), Spiral(40.0, (30 * np.cos(0.2), 30 * np.sin(0.2)), 0.2, 0.0, 0.001)])
LINES = [Spiral(50.0, (0.0, 1.0), 1.1), ARC, SPIRAL, CUBIC, CHAIN]


@pytest.mark.parametrize("line", LINES)
def test_normals_speed_and_turn_are_those_of_the_points(line):
    s, h = np.linspace(1, 49, 97), 1e-4
    s = s[np.abs(s - 30) > 1e-3] if line is CHAIN else s
    before, here, after = (line.frames(s + step) for step in (-h, 0, h))
    step = (after.points_world - before.points_world) / (2 * h)
    np.testing.assert_allclose(here.speed, np.linalg.norm(step, axis=1), rtol=1e-6)
    right = np.stack([step[:, 1], -step[:, 0]], -1) / here.speed[:, None]
    np.testing.assert_allclose(here.normals, right, atol=1e-6)
    heading = [np.unwrap(np.arctan2(at.normals[:, 1], at.normals[:, 0])) for at in (before, after)]
    np.testing.assert_allclose(here.turn, -(heading[1] - heading[0]) / (2 * h), atol=1e-5)


@pytest.mark.parametrize("line", LINES)
def test_places_are_found_again_and_t_grows_to_the_right(line):
    s = np.linspace(1, line.length_m - 1, 60)
    for t in (-6.0, 0.0, 9.0):
        back_s, back_t = line.project(line.xy(s, t))
        np.testing.assert_allclose([back_s, back_t], [s, np.full(60, t)], atol=1e-6)
    ahead, aside = line.xy(s + 0.1, 0.0) - line.xy(s, 0.0), line.xy(s, 1.0) - line.xy(s, 0.0)
    assert (ahead[:, 0] * aside[:, 1] - ahead[:, 1] * aside[:, 0] < 0).all()


def test_a_polyline_runs_through_its_points_by_length():
    points = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 14.0], [11.0, 20.0]])
    line = Chain.through(points)
    np.testing.assert_allclose(line.frames(np.array([0.0, 5.0, 15.0, 25.0])).points_world, points, atol=1e-9)
    np.testing.assert_allclose(line.frames(np.array([10.0])).points_world, [[3.0, 9.0]], atol=1e-9)
