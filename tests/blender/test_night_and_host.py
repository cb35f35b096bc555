"""Air, lamps, snow and the host's bonnet in real renders: laws of light, who is lit, what is covered and hidden."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

pytest.importorskip("bpy")

import bpy

from synth3dlanes.blender.light import set_light
from synth3dlanes.blender.render import render, studio
from synth3dlanes.imaging.daylight import daylight
from synth3dlanes.imaging.film import response
from synth3dlanes.imaging.haze import through_air
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.scene.roadside import Building, Post
from synth3dlanes.scene.scene import Car, Tree
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.paint import WorldPaint
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed, flat_road_places, hill
from tests.thorough import first
from tests.validate.examining import findings

pytestmark = pytest.mark.render

NIGHT = {"sun_zenith_rad": np.radians(105), "metering": 1}
ALL = RenderSettings(samples=2, passes=("depth", "semantic", "instance"))


def light_of(image):
    """The light that reached the film, by the tone curve read backwards."""
    levels = np.linspace(0, 5, 4000)
    return np.interp(image.mean(axis=2) / 255, response(levels), levels)


def ratio_of_paint(shot, scene, far_m):
    """Paint's light over the road's, and the road's light, from 8 m ahead."""
    _, ahead_m = flat_road_places(scene)
    near = (ahead_m > 8) & (ahead_m < far_m)
    light = light_of(shot.image)
    paint, road = (light[near & (shot.passes["semantic"] == SEMANTIC_IDS[name])] for name in ("marking", "road"))
    return np.median(paint) / np.median(road), np.median(road)


@pytest.mark.parametrize("yaw_deg", first(1, [70, 180]))
def test_cameras_that_look_where_no_headlights_shine_are_not_black(yaw_deg):
    """Without lamps, under a closed sky, in fog: noise and a dim road, as a camera would show it."""
    air = {"visibility_m": 150.0, "overcast": 1.0}
    camera = {"yaw_rad": np.radians(yaw_deg)}
    dark = changed(light=NIGHT, weather={"headlights": True}, air=air, camera=camera, sensor={"noise": 4.0})
    assert 20 < take_picture(resolve(dark), ALL).image.mean() < 60


def test_tail_lamps_are_redder_and_brighter_than_white_paint_in_the_headlights():
    """Ten metres ahead, where the paint is nearly white."""
    white = Car(model=3, scale=1.0, color=(0.95, 0.95, 0.95), gloss=0.5, lane="main_1", s_m=-38.0)
    scene = changed(light=NIGHT, weather={"headlights": True}, camera={"y_m": -50.0, "lane": 1})
    shot = take_picture(resolve(scene.model_copy(update={"cars": (white,)})), ALL)
    red, green, _ = np.moveaxis(shot.image[shot.passes["instance"] == 1].astype(float), -1, 0)
    is_lamp = (red > 200) & (red - green > 60)
    assert 0.01 < is_lamp.mean() < 0.2
    assert not ((np.minimum(red, green) > 252).mean() > 0.4), "the body is not all white"


def small_patterns(wetness):
    """Deviation of the road's light at lengths below 0.4 m as a share of the light, 5 to 9 m ahead of a low camera."""
    surface = {"wetness": wetness, "road_gloss": 0.0}
    light, air = {"sun_zenith_rad": 0.9, "metering": 1}, {"overcast": 1.0}
    scene = changed(surface=surface, light=light, air=air, camera={"pitch_rad": np.radians(22)})
    shot = take_picture(resolve(scene), RenderSettings(samples=16, passes=("depth", "semantic")))
    light, (_, ahead_m) = light_of(shot.image), flat_road_places(scene)
    blurred = scipy.ndimage.gaussian_filter(light, (8, 14))
    near = (ahead_m > 5) & (ahead_m < 9)
    near &= scipy.ndimage.binary_erosion(shot.passes["semantic"] == SEMANTIC_IDS["road"], iterations=16)
    return float(((light - blurred) / blurred)[near].std())


@pytest.mark.thorough
def test_rain_lies_on_a_road_in_patches_and_not_in_grains():
    """A film of water covers the grain of the asphalt."""
    assert small_patterns(0.8) < 0.6 * small_patterns(0.0)


def test_headlights_light_the_road_below_their_edge_and_paint_throws_more_back():
    day = changed()
    lit, dark = (changed(light=NIGHT, weather={"headlights": on}) for on in (True, False))
    shots = {name: take_picture(resolve(scene), ALL) for name, scene in (("day", day), ("lit", lit))}
    unlit = daylight(lit, 1.6), daylight(dark, 1.6)
    assert unlit[0].film < unlit[1].film / 5, "the exposure is for what the headlights light"
    at_night, road = ratio_of_paint(shots["lit"], lit, 25)
    by_day, _ = ratio_of_paint(shots["day"], day, 25)
    assert at_night > 1.1 * by_day
    assert road > 0.015
    _, ahead_m = flat_road_places(lit)
    light, is_terrain = light_of(shots["lit"].image), shots["lit"].passes["semantic"] == SEMANTIC_IDS["terrain"]
    assert np.median(light[is_terrain & (ahead_m > 90)]) < road / 3
    sky = shots["lit"].passes["semantic"] == SEMANTIC_IDS["sky"]
    assert np.median(light[sky]) < road
    for name in ("depth", "semantic", "instance"):
        np.testing.assert_array_equal(shots["day"].passes[name], shots["lit"].passes[name])


def test_the_nearest_street_lamps_are_lit_at_night_only():
    heads = np.column_stack([np.full(30, 5.0), np.arange(30) * 30.0 - 200, np.full(30, 9.0)])
    pose = resolve(changed()).view.world_from_road
    studio()
    for scene, n in ((changed(light=NIGHT), 8), (changed(), 0)):
        set_light(scene, daylight(scene, 1.6), [], pose, heads)
        lamps = [bpy.data.objects[f"street_lamp_{i}"] for i in range(8)]
        lit = [lamp for lamp in lamps if not lamp.hide_render]
        assert len(lit) == n
        expected = sorted(abs(heads[:, 1] + 50))[:n]
        np.testing.assert_allclose(sorted(abs(lamp.location[1] + 50) for lamp in lit), expected, atol=1e-3)
        assert bpy.data.objects["sun"].hide_render == (n > 0)
        assert bpy.data.objects["headlight_0"].hide_render


@pytest.mark.thorough
@pytest.mark.parametrize(("oncoming", "lane_m"), first(1, [({}, 0.0), ({"n_oncoming": 2, "median_m": 4.0}, -11.0)]))
def test_snow_covers_the_road_between_the_wheel_tracks_and_no_id_changes(oncoming, lane_m):
    stage = changed(air={"overcast": 1}, road=oncoming)
    bare, snowy = (changed(stage, weather={"snow": s, "snow_on_road": s}) for s in (0.0, 0.6))
    shots = [take_picture(resolve(scene), ALL) for scene in (bare, snowy)]
    for name in ("depth", "semantic", "instance"):
        np.testing.assert_array_equal(shots[0].passes[name], shots[1].passes[name])
    right_m, ahead_m = flat_road_places(bare)
    right_m = right_m - lane_m
    road = (shots[0].passes["semantic"] == SEMANTIC_IDS["road"]) & (ahead_m > 5) & (ahead_m < 25 + abs(lane_m))
    gain = light_of(shots[1].image) / light_of(shots[0].image)
    in_track, between = abs(abs(right_m) - 0.8) < 0.2, (abs(right_m) < 0.25) | (abs(abs(right_m) - 1.4) < 0.15)
    assert np.mean(gain[road & in_track]) < 1.2
    assert np.mean(gain[road & between]) > 1.6
    assert not WorldPaint(resolve(snowy)).shows
    assert WorldPaint(resolve(bare)).shows


@pytest.mark.thorough
def test_some_windows_are_lit_at_night_only():
    house = Building(kind="house", x_m=10, y_m=-15, yaw_rad=0.3, width_m=9, length_m=14, height_m=9,
                     color=(0.7, 0.7, 0.7), roof=(0.1, 0.1, 0.1))  # fmt: skip
    day, night = (changed(light=light, roadside={"buildings": (house,)}) for light in ({}, NIGHT))
    shots = [take_picture(resolve(scene), ALL) for scene in (day, night)]
    by_day, at_night = (light_of(shot.image) for shot in shots)
    is_house = shots[0].passes["semantic"] == SEMANTIC_IDS["building"]
    is_glass = is_house & (by_day < 0.5 * np.median(by_day[is_house]))
    shining = at_night > 4 * np.median(at_night[is_house])
    assert 0.1 < np.mean(shining[is_glass]) < 0.5
    assert np.mean(shining[is_house & ~is_glass]) < 0.1


@pytest.mark.thorough
def test_signs_and_reflectors_throw_headlights_back_and_backs_of_signs_do_not():
    """A sign of 250 cd/lx/m2 in the stray light of 128 cd, at 34 m: 28 cd/m2, or 7e-4 of the daylight's unit."""
    sign = Post(kind="sign", road="main", side="right", s_m=-16, aside_m=1.8, height_m=2, face=9)
    posts = (sign, sign.model_copy(update={"side": "left", "turned": True}),
             Post(kind="delineator", road="main", side="left", s_m=-35, aside_m=1.0, height_m=1))  # fmt: skip
    stage = changed(roadside={"posts": posts}, light=NIGHT)
    layers = {}
    for is_lit in (True, False):
        world = resolve(changed(stage, weather={"headlights": is_lit}))
        light = daylight(world.scene, float(world.view.eye_world[2]))
        layers[is_lit] = render(world, world.view, light, label(world, world.view), ALL).layers
    gained = (layers[True].radiance - layers[False].radiance).max(axis=-1)
    # The boards come after all posts.
    of = [layers[True].instance == instance_id("structure", number) for number in (3, 4, 2)]
    is_face = layers[True].semantic == SEMANTIC_IDS["sign"]
    front, back = (gained[ids & is_face] for ids in of[:2])
    assert 3e-4 < np.quantile(front, 0.9) < 2e-3
    assert np.median(back) < np.quantile(front, 0.9) / 5
    post = gained[of[2]]
    assert post.max() > 10 * np.median(post)
    assert post.max() > 2 * front.max(), "a reflector stands in the beam"


@pytest.mark.thorough
def test_snow_lies_on_roofs_trees_and_cars_where_they_look_up_and_leaves_no_trace():
    dark = {"gloss": 0.0, "scale": 1.0, "lane": "main_2", "model": 1}
    cars = (Car(color=(0.1, 0, 0), s_m=-38, **dark), Car(color=(0.3, 0, 0), s_m=-20, **dark))
    house = Building(kind="house", x_m=14, y_m=-10, yaw_rad=0.3, width_m=9, length_m=12, height_m=5,
                     color=(0.3, 0.1, 0.1), roof=(0.1, 0.1, 0.1))  # fmt: skip
    stage = changed(air={"overcast": 1}, roadside={"buildings": (house,)}, camera={"height_m": 4.0})
    stage = stage.model_copy(update={"cars": cars, "trees": (Tree(model=1, x_m=-12, y_m=-25, yaw_rad=0, scale=1),)})
    scenes = [changed(stage, weather={"snow": snow}) for snow in (0.0, 0.99, 0.0)]
    shots = [take_picture(resolve(scene), replace(ALL, passes=(*ALL.passes, "normal"))) for scene in scenes]
    np.testing.assert_array_equal(shots[0].image, shots[2].image)
    for name in ALL.passes:
        np.testing.assert_array_equal(shots[0].passes[name], shots[1].passes[name])
    gain = light_of(shots[1].image) / light_of(shots[0].image)
    up = shots[0].passes["normal"][..., 2]
    names, cars_ids = shots[0].passes["semantic"], shots[0].passes["instance"]
    for is_it, flat in ((cars_ids == 2, 0.95), (names == SEMANTIC_IDS["building"], 0.5)):
        assert np.median(gain[is_it & (up > flat)]) > 3
        assert np.median(gain[is_it & (abs(up) < 0.2)]) < 1.6
    assert np.median(gain[(cars_ids == 1) & (up > 0.92)]) < 1.6, "this one was brushed off"
    assert np.mean(gain[names == SEMANTIC_IDS["tree"]]) > 1.4


def test_the_bonnet_fills_its_share_hides_points_and_is_known_by_its_ids():
    scene = changed(host={"bonnet": 0.3, "gray": 0.2, "gloss": 0.5}, sensor={"motion_blur_m": 0.5})
    world = resolve(scene)
    shot = take_picture(world, replace(ALL, samples=1))
    is_host = shot.passes["semantic"] == SEMANTIC_IDS["host"]
    np.testing.assert_array_equal(is_host, shot.passes["instance"] == instance_id("bonnet", 0))
    assert abs(is_host[:, 238:242].sum(axis=0).mean() - 0.3 * 360) <= 2
    assert is_host[-1].all(), "down to the image's edge"
    assert shot.passes["depth"][is_host].max() < 1.7
    hidden = 0
    for lane in shot.labels.lanes:
        uv = lane.xyz_cam @ shot.labels.camera.img_from_cam.T
        u, v = (uv[:, :2] / uv[:, 2:])[lane.in_image].astype(int).T
        inner = np.array(
            [is_host[max(b - 2, 0) : b + 3, max(a - 2, 0) : a + 3].all() for a, b in zip(u, v, strict=True)]
        )
        assert not lane.object_visible[lane.in_image][inner].any()
        hidden += inner.sum()
    assert hidden > 3
    sample = Evidence(world, shot.labels, shot.image, shot.passes)
    assert findings(sample, "ids", "points", "bonnet") == []
    assert findings(replace(sample, known_world=resolve(changed())), "bonnet")


FAR = {"magnitude_m": 12.0, "sd_m": 40.0, "x_m": 60.0, "y_m": 90.0}


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


def test_in_dense_fog_the_world_ends_in_the_sky_without_an_edge():
    scene = changed(terrain={"gaussians": (hill(0, 90, 12, 40),)}, air={"visibility_m": 120, "overcast": 1})
    result = take_picture(resolve(scene), RenderSettings(samples=1, passes=("semantic",)))
    image = result.image.astype(int)
    edge = np.diff(np.minimum(result.passes["semantic"], 1), axis=0) > 0
    assert edge.sum() > 400
    assert np.abs(np.diff(image, axis=0)[edge]).max() <= 4
    assert np.ptp(image[:100].mean(axis=(0, 1))) < 6, "fog is gray"


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
