"""Terrain: closed forms and the gradient against finite differences."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.roads.terrain import gradient_at, height_at
from synth3dlanes.scene.scene import Gaussian, Terrain
from synth3dlanes.world.horizon import FarHills

GAUSSIANS = st.builds(
    Gaussian,
    center_m=st.tuples(st.floats(-150, 150), st.floats(-150, 150)),
    magnitude_m=st.floats(-50, 50),
    sd_m=st.tuples(st.floats(25, 250), st.floats(25, 250)),
    orientation_rad=st.floats(0, np.pi / 2),
)
TERRAINS = st.builds(Terrain, gaussians=st.lists(GAUSSIANS, min_size=1, max_size=7).map(tuple))


@given(TERRAINS, st.floats(-200, 200), st.floats(-200, 200))
def test_gradient_equals_central_differences(terrain, x, y):
    step = 1e-3
    around = np.array([[x + step, y], [x - step, y], [x, y + step], [x, y - step]])
    z = height_at(terrain, around)
    differences = [(z[0] - z[1]) / (2 * step), (z[2] - z[3]) / (2 * step)]
    np.testing.assert_allclose(gradient_at(terrain, np.array([[x, y]]))[0], differences, atol=1e-6)


def test_far_hills_rise_behind_all_roads_and_nowhere_else(flat_scene):
    angles, radii_m = np.meshgrid(np.linspace(0, 2 * np.pi, 90), np.linspace(0, 4000, 161))
    xy = np.stack([radii_m * np.cos(angles), radii_m * np.sin(angles)], axis=-1)
    scenes = [flat_scene.model_copy(update={"index": index}) for index in range(20)]
    heights_m = np.array([FarHills.draw(scene.stream("far_hills")).height(xy) for scene in scenes])
    assert not heights_m[:, radii_m < 500].any()
    assert heights_m.min() == 0
    assert 40 < heights_m.max() < 300
    assert len({round(float(height.max()), 3) for height in heights_m}) == 20, "every scene has its own"
    np.testing.assert_array_equal(FarHills.draw(scenes[0].stream("far_hills")).height(xy), heights_m[0])
