"""Air, blur and noise in real renders, against laws and numbers that do not come from the code under test."""

import numpy as np
import pytest

pytest.importorskip("bpy")

from synth3dlanes.blender.render import render
from synth3dlanes.imaging.daylight import daylight
from synth3dlanes.imaging.haze import through_air
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.scene import Car, Tree
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed, hill
from tests.thorough import first

FAR = {"magnitude_m": 12.0, "sd_m": 40.0, "x_m": 60.0, "y_m": 90.0}


@pytest.mark.render
@pytest.mark.parametrize("visibility_m", first(1, [150.0, 900.0]))
def test_contrast_falls_with_distance_by_koschmieders_law(visibility_m):
    """A black world in fog: what its pixels lack of the horizon's light is exp(-3.912 distance / visibility), the
    distance from Cycles' depth, at any exposure."""
    tree = Tree(model=1, x_m=14, y_m=20, yaw_rad=0, scale=1)
    scene = changed(terrain={"gaussians": (hill(**FAR),)}, air={"visibility_m": visibility_m})
    scene = scene.model_copy(update={"trees": (tree,)})
    world = resolve(scene)
    light = daylight(scene, world.view.eye_world[2])
    layers = render(world, world.view, light, label(world, world.view), RenderSettings(samples=1)).layers
    black = through_air(np.zeros_like(layers.radiance), layers.haze, visibility_m, light.airlight, world.view)
    camera, depth_m = scene.camera, layers.depth_m
    v, u = np.mgrid[:360, :480] + 0.5
    ray = np.sqrt(1 + ((u - 240) / camera.fx_px) ** 2 + ((180 - v) / camera.fy_px) ** 2)
    hit = depth_m < 1e9
    # The sample lies anywhere in its pixel, and so does the ray to it: 0.1 % of a distance.
    expected = np.exp(-3.912 * (depth_m * ray)[hit] / visibility_m)
    horizon = through_air(np.zeros_like(black), np.ones_like(layers.haze), visibility_m, light.airlight, world.view)
    contrast = ((horizon - black) / horizon)[hit]
    assert np.ptp(expected) > 0.3
    np.testing.assert_allclose(contrast, np.repeat(expected[:, None], 3, axis=1), atol=5e-3)


@pytest.mark.render
def test_in_dense_fog_the_world_ends_in_the_sky_without_an_edge():
    scene = changed(terrain={"gaussians": (hill(0, 90, 12, 40),)}, air={"visibility_m": 120, "overcast": 1})
    result = take_picture(resolve(scene), RenderSettings(samples=1, passes=("semantic",)))
    image = result.image.astype(int)
    edge = np.diff(np.minimum(result.passes["semantic"], 1), axis=0) > 0
    assert edge.sum() > 400
    assert np.abs(np.diff(image, axis=0)[edge]).max() <= 4
    assert np.ptp(image[:100].mean(axis=(0, 1))) < 6, "fog is gray"


@pytest.mark.thorough
@pytest.mark.render
def test_noise_and_blur_come_again_byte_for_byte_and_are_the_scenes_own():
    scene = changed(sensor={"motion_blur_m": 0.3, "noise": 3})
    settings = RenderSettings(samples=1)
    first, again = (take_picture(resolve(scene), settings).image for _ in range(2))
    np.testing.assert_array_equal(first, again)
    other = take_picture(resolve(scene.model_copy(update={"index": 1})), settings).image
    assert (first != other).mean() > 0.5


@pytest.mark.render
def test_blur_leaves_a_car_ahead_sharp_and_the_road_smeared():
    car = Car(model=1, scale=1.0, color=(1, 0, 0), gloss=0.5, lane="main_2", s_m=-42)
    scene = FLAT.model_copy(update={"cars": (car,)})
    settings = RenderSettings(samples=1, passes=("semantic",))
    still = take_picture(resolve(scene), settings)
    moving = take_picture(resolve(changed(scene, sensor={"motion_blur_m": 0.5})), settings)
    differs = (still.image != moving.image).any(axis=-1)
    assert not differs[still.passes["semantic"] == SEMANTIC_IDS["car"]].any()
    assert differs[still.passes["semantic"] == SEMANTIC_IDS["road"]].mean() > 0.5
    np.testing.assert_array_equal(still.passes["semantic"], moving.passes["semantic"])
