"""The height map against labels and closed forms."""

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.geometry.frames import transform
from synth3dlanes.params.params import load_params
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.height_map import cells_road, height_map
from synth3dlanes.world.world import resolve
from tests.scenes import changed, hill


def map_of(scene):
    world = resolve(scene)
    return height_map(world.ground, world.view.world_from_road)


def test_a_plain_is_flat():
    inside = map_of(changed())[:, 35:65]
    np.testing.assert_allclose(inside, 0, atol=1e-9)


def test_lane_points_lie_on_the_map():
    scene = changed(
        terrain={"gaussians": (hill(20, 0, 8, 50), hill(-40, -60, -9, 60))},
        road={"topology": 2, "offset_p50_m": 4, "ramp_slope": 4},
    )
    heights = map_of(scene)
    read = RegularGridInterpolator(
        (0.2 + 0.4 * np.arange(200), -9.9 + 0.2 * np.arange(100)), heights[::-1], bounds_error=False
    )
    labels = ground_truth(scene)
    gaps = []
    for lane in labels.lanes:
        if lane.kind == "centerline" and lane.road == "main":
            points = transform(labels.camera.road_from_cam, lane.xyz_cam)
            gaps.append(read(points[:, [1, 0]]) - points[:, 2])
    gaps = np.abs(np.concatenate(gaps))
    assert np.isfinite(gaps).sum() > 100
    assert np.nanmax(gaps) < 0.01


def test_every_cell_of_a_steep_ramp_is_on_it():
    """Of a ramp that rises 1 in 2.4, in a scene where the search for cells takes most steps."""
    world = sample_world(Scenes(load_params("appendix_i"), 7, "train"), 2)
    points_world = transform(
        world.view.world_from_road, cells_road(height_map(world.ground, world.view.world_from_road))
    )
    np.testing.assert_allclose(points_world[:, 2], world.ground.height(points_world[:, :2]), atol=1e-3)


def test_ground_that_rises_to_the_right_is_higher_in_the_right_columns():
    heights = map_of(changed(terrain={"gaussians": (hill(60, -20, 20, 30),)}))
    assert heights[150, 90] > heights[150, 10] + 0.1
