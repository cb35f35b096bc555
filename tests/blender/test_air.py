"""Air, daylight and sensor: each against its law, in numbers that do not come from the code under test."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("bpy")

from synth3dlanes.blender import build as builder
from synth3dlanes.blender import render as renderer
from synth3dlanes.blender.air import through_air
from synth3dlanes.blender.sensor import add_noise, motion_blur
from synth3dlanes.blender.sky import daylight, film_factor, overcast_dome
from synth3dlanes.blender.tonemap import tonemap
from synth3dlanes.geometry.camera import world_from_cam
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.ground_truth import ground_truth
from synth3dlanes.scene import Car, Tree
from synth3dlanes.settings import SEMANTIC_IDS, RenderSettings
from tests.scenes import FLAT, changed, hill

FAR = {"magnitude_m": 12.0, "sd_m": 40.0, "x_m": 60.0, "y_m": 90.0}


def lit(**parts):
    """The flat scene and its daylight with fields changed."""
    scene = changed(**parts)
    return scene, daylight(scene)


@pytest.mark.render
@pytest.mark.parametrize("visibility_m", [150.0, 900.0])
def test_contrast_falls_with_distance_by_koschmieders_law(visibility_m):
    """A black world in fog: what its pixels lack of the horizon's light is exp(-3.912 distance / visibility), the
    distance from Cycles' depth, at any exposure."""
    tree = Tree(model=1, x_m=14, y_m=20, yaw_rad=0, scale=1)
    scene = changed(terrain={"gaussians": (hill(**FAR),)}, air={"visibility_m": visibility_m})
    scene = scene.model_copy(update={"trees": (tree,)})
    builder.build(renderer.studio(), scene)
    renderer.configure(RenderSettings(samples=1), film_factor(scene))
    layers = renderer.run_cycles()
    light, pose = daylight(scene), world_from_cam(RoadPlan(scene))
    black = through_air(np.zeros((360, 480, 3), np.float32), layers["haze"], scene, light, pose)
    camera, depth_m = scene.camera, layers["Depth"][..., 0]
    v, u = np.mgrid[:360, :480] + 0.5
    ray = np.sqrt(1 + ((u - 240) / camera.fx_px) ** 2 + ((180 - v) / camera.fy_px) ** 2)
    hit = depth_m < 1e9
    # The sample lies anywhere in its pixel, and so does the ray to it: 0.1 % of a distance.
    expected = np.exp(-3.912 * (depth_m * ray)[hit] / visibility_m)
    horizon = through_air(np.zeros_like(black), np.ones_like(layers["haze"]), scene, light, pose)
    contrast = ((horizon - black) / horizon)[hit]
    assert np.ptp(expected) > 0.3
    np.testing.assert_allclose(contrast, np.repeat(expected[:, None], 3, axis=1), atol=5e-3)


@pytest.mark.render
def test_in_dense_fog_the_world_ends_in_the_sky_without_an_edge():
    scene = changed(terrain={"gaussians": (hill(0, 90, 12, 40),)}, air={"visibility_m": 120, "overcast": 1})
    result = renderer.render(scene, ground_truth(scene), RenderSettings(samples=1, passes=("semantic",)))
    image = result.image.astype(int)
    edge = np.diff(np.minimum(result.passes["semantic"], 1), axis=0) > 0
    assert edge.sum() > 400
    assert np.abs(np.diff(image, axis=0)[edge]).max() <= 4
    assert np.ptp(image[:100].mean(axis=(0, 1))) < 6, "fog is gray"


def test_haze_is_bluish_far_away_and_fog_is_not():
    for visibility_m, blue_per_red in ((200.0, 1.0), (40_000.0, 1.4)):
        scene, light = lit(air={"visibility_m": visibility_m})
        pose = world_from_cam(RoadPlan(scene))
        haze = np.full((360, 480, 4), [0.2, 1, 0, 1], np.float32)
        black = through_air(np.zeros((360, 480, 3), np.float32), haze, scene, light, pose)
        airlight = through_air(np.zeros_like(black), np.full_like(haze, 1), scene, light, pose)
        red, _, blue = (black / airlight)[100, 240]
        assert blue / red > blue_per_red - 1e-3
    assert blue / red > 1.4


def test_overcast_takes_the_sun_and_most_of_the_light():
    (_, clear), (_, half), (_, closed) = (lit(air={"overcast": share}) for share in (0, 0.5, 1))
    assert np.all(closed.sun == 0)
    assert np.all(clear.sun > half.sun)
    zenith, horizon = closed.sky[1, -1].mean(), closed.sky[1, 270].mean()
    assert 2 < zenith / horizon < 3.2, "the CIE overcast sky is three times brighter overhead"
    assert overcast_dome(np.pi / 2) == pytest.approx(3 * overcast_dome(0.0))


def test_full_metering_keeps_the_daylight_of_a_picture():
    """Of a low sun and of closed clouds; none keeps the exposure as it is."""
    for parts in ({"light": {"sun_zenith_rad": 1.5}}, {"air": {"overcast": 1}}):
        fixed, metered = (
            changed(**{**parts, "light": {**parts.get("light", {}), "metering": metering}}) for metering in (0, 1)
        )
        assert film_factor(fixed) == fixed.light.exposure
        assert film_factor(metered) > 1.5 * fixed.light.exposure
    clear = changed(light={"sun_zenith_rad": 0.5, "metering": 1}, air={"visibility_m": 1e6})
    assert film_factor(clear) == pytest.approx(clear.light.exposure, rel=0.1)


def road_picture(rng):
    """Linear stripes across a level road, and its depth."""
    v = np.arange(360)[:, None] + 0.5
    depth_m = np.where(v > 185, 1.5 * 415.7 / np.maximum(v - 180, 1), np.inf) * np.ones((1, 480))
    return rng.random((360, 480, 3), dtype=np.float32), depth_m.astype(np.float32)


LEVEL = FLAT.camera.model_copy(update={"pitch_rad": 0.0})


def test_motion_blur_is_symmetric_in_time_and_in_space(rng):
    image, depth_m = road_picture(rng)
    forward = motion_blur(image, depth_m, LEVEL, np.array([0, 0.4, 0.0]))
    backward = motion_blur(image, depth_m, LEVEL, np.array([0, -0.4, 0.0]))
    np.testing.assert_allclose(forward, backward, atol=1e-5)
    mirrored = motion_blur(np.ascontiguousarray(image[:, ::-1]), depth_m, LEVEL, np.array([0, 0.4, 0.0]))
    np.testing.assert_allclose(mirrored[:, ::-1], forward, atol=1e-5)


def test_a_mark_on_the_road_is_smeared_by_the_way_driven_and_stays_centred():
    """A bright bar across the lane at 6 m: its rows are those of the road 0.2 m nearer to 0.2 m farther."""
    v = np.arange(360) + 0.5
    _, depth_m = road_picture(np.random.default_rng(0))
    bar = np.zeros((360, 480, 3), np.float32)
    at = 180 + 1.5 * 415.7 / 6.0
    bar[int(at)] = 1.0
    blurred = motion_blur(bar, depth_m, LEVEL, np.array([0, 0.4, 0.0]))[:, 240, 0]
    rows = np.flatnonzero(blurred > 0.02)
    near, far = 180 + 1.5 * 415.7 / 5.8, 180 + 1.5 * 415.7 / 6.2
    assert rows.min() + 0.5 == pytest.approx(far, abs=1.5)
    assert rows.max() + 0.5 == pytest.approx(near, abs=1.5)
    assert (blurred * v).sum() / blurred.sum() == pytest.approx(at, abs=0.5)


def test_the_sky_stands_still(rng):
    image, depth_m = road_picture(rng)
    blurred = motion_blur(image, depth_m, LEVEL, np.array([0, 0.5, 0.0]))
    np.testing.assert_array_equal(blurred[:180], image[:180])
    np.testing.assert_array_equal(motion_blur(image, np.full_like(depth_m, np.inf), LEVEL, np.ones(3)), image)


@given(st.sampled_from([1.0, 2.5, 6.0]))
def test_noise_at_middle_gray_has_the_deviation_asked_for(levels):
    gray = np.full((200, 200, 3), 0.18, np.float32)
    noisy = add_noise(gray, levels, np.random.default_rng(1))
    picture = tonemap(noisy).astype(float)
    assert picture.std() == pytest.approx(np.hypot(levels, 12**-0.5), rel=0.04), "with the rounding to whole levels"
    bright = add_noise(np.full_like(gray, 0.72), levels, np.random.default_rng(2))
    assert bright.std() / noisy.std() == pytest.approx(np.sqrt(0.1 + 0.9 * 4), rel=0.03), "photons: with the root"


@pytest.mark.render
def test_noise_and_blur_come_again_byte_for_byte_and_are_the_scenes_own():
    scene = changed(sensor={"motion_blur_m": 0.3, "noise": 3})
    labels, settings = ground_truth(scene), RenderSettings(samples=1)
    first, again = (renderer.render(scene, labels, settings).image for _ in range(2))
    np.testing.assert_array_equal(first, again)
    other = renderer.render(scene.model_copy(update={"index": 1}), labels, settings).image
    assert (first != other).mean() > 0.5


@pytest.mark.render
def test_blur_leaves_a_car_ahead_sharp_and_the_road_smeared():
    car = Car(model=1, scale=1.0, color=(1, 0, 0), gloss=0.5, lane="main_2", s_m=-42)
    scene = FLAT.model_copy(update={"cars": (car,)})
    labels, settings = ground_truth(scene), RenderSettings(samples=1, passes=("semantic",))
    still = renderer.render(scene, labels, settings)
    moving = renderer.render(changed(scene, sensor={"motion_blur_m": 0.5}), labels, settings)
    differs = (still.image != moving.image).any(axis=-1)
    assert not differs[still.passes["semantic"] == SEMANTIC_IDS["car"]].any()
    assert differs[still.passes["semantic"] == SEMANTIC_IDS["road"]].mean() > 0.5
    np.testing.assert_array_equal(still.passes["semantic"], moving.passes["semantic"])
