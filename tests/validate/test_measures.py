"""The measuring itself, on numbers and pictures whose answers are known."""

import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.geometry.frames import project
from synth3dlanes.geometry.lens import Lens
from synth3dlanes.labels.labels import Labels, Lane
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.roads.maps.part import read_place
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.scene.scene import Car, Scene
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.truth.ground_truth import ground_truth, label
from synth3dlanes.validate.bodies import boxes_of, meet
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.faces import pavement_of
from synth3dlanes.validate.findings import Finding
from synth3dlanes.validate.paint import WorldPaint
from synth3dlanes.validate.report import ValidationReport
from synth3dlanes.validate.seen import wheels
from synth3dlanes.world.world import resolve
from tests.maps import files
from tests.scenes import FLAT, changed, flat_road_depth, flat_road_places
from tests.validate.examining import findings, numbers, reasons, seen


def test_points_on_dashes_are_told_from_those_between_also_aside_of_the_line():
    scene = changed(markings={"dash_cycle_m": 4.0, "dash_fraction": 0.5})
    labels = ground_truth(scene)
    lane = next(lane for lane in labels.lanes if lane.marking == "dashed")
    for aside_m in (0.0, 0.5):
        points_cam = lane.xyz_cam + np.array([aside_m, 0, 0])
        y_m = scene.camera.y_m + np.arange(len(points_cam))
        near = (np.arange(len(points_cam)) < 15) & (np.abs(np.mod(y_m, 2)) > 0.1)
        resolved = WorldPaint(resolve(scene)).strip(labels.camera, lane, points_cam).resolved
        np.testing.assert_array_equal(resolved[near], (np.mod(y_m, 4) < 2)[near])


def test_across_is_to_the_right_on_a_banked_road_and_the_normal_up():
    bank = '<lateralProfile><superelevation s="0" a="0.3" b="0" c="0" d="0"/></lateralProfile>'
    level = '<elevationProfile><elevation s="0" a="0" b="0" c="0" d="0"/></elevationProfile>'
    road = files.road(files.plan(("<line/>", 400.0)), profile=level + bank)
    given = read_opendrive(files.opendrive(road), "x.xodr", "map x.xodr")
    scenes = Scenes(load_params("tiny", ("cars.n=0", "trees.n=0")), map=MapPlace(given, read_place(given, "1:100:-1")))
    world = sample_world(scenes, 0)
    labels = label(world, world.view)
    for lane in (lane for lane in labels.lanes if lane.kind == "delimiter"):
        strip = WorldPaint(world).strip(labels.camera, lane, lane.xyz_cam)
        right, _, up = (strip.across_cam @ labels.camera.world_from_cam[:3, :3].T).T
        assert (strip.normal_cam @ labels.camera.world_from_cam[2, :3] > 0.9).all()
        np.testing.assert_allclose(up, -np.tan(0.3) * right, atol=1e-6)
        assert (right > 0.9).all()


def painted_picture(scene: Scene, aside_m: float, paint: float, noise: float) -> np.ndarray:
    """A road of gray 90 seen from the scene's camera, with solid lines `aside_m` right of their places; the leftmost
    may be two stripes."""
    camera = scene.camera
    x_m, _ = flat_road_places(scene)
    image = 90 + np.random.default_rng(0).normal(0, noise, x_m.shape)
    n, width_m = scene.road.n_lanes, scene.road.lane_width_m
    middle_m = (camera.lane - (n + 1) / 2) * width_m
    for j in range(n + 1):
        place_m = (j - n / 2) * width_m - middle_m + aside_m
        from_middle_m = np.abs(x_m - place_m)
        if j == 0 and scene.markings.left_double:
            from_middle_m = np.abs(from_middle_m - scene.markings.width_m)
        with np.errstate(invalid="ignore"):
            image[from_middle_m < scene.markings.width_m / 2] = paint
    return np.repeat(np.clip(image, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def picture_of(scene: Scene, image: np.ndarray | None = None, **passes: np.ndarray) -> Evidence:
    """A scene without objects, beside an image and passes."""
    return Evidence(resolve(scene), seen(ground_truth(scene)), image, passes)


def test_bright_and_dark_paint_is_found_in_place_and_aside():
    scene = changed(markings={"dash_cycle_m": 4.5, "dash_fraction": 1.0})
    for paint in (200.0, 40.0):
        in_place = picture_of(scene, painted_picture(scene, 0.0, paint, 8))
        assert findings(in_place, "ridges") == []
        assert numbers(in_place, "ridges")["ridges.in_place"] == [1.0]
        aside = picture_of(scene, painted_picture(scene, 0.5, paint, 8))
        named = [finding for finding in findings(aside, "ridges") if "+0.50 m aside" in finding.reason]
        assert len({finding.lane for finding in named}) == len(named) >= 2


@pytest.mark.parametrize(("aside_m", "is_found"), [(0.0, False), (0.1, False), (0.5, True), (-0.5, True)])
def test_a_photograph_tells_of_lines_that_are_half_a_metre_beside_their_paint(aside_m, is_found):
    """Without a scene; dashes, noise, and a line that has no paint at all."""
    scene = changed(markings={"dash_fraction": 1.0})
    image = painted_picture(scene, aside_m, 150.0, 12)
    gaps = np.mod(np.nan_to_num(flat_road_places(scene)[1]), 9) > 4
    image[gaps] = 90
    first, *others = seen(ground_truth(scene)).lanes
    bare = replace(first, xyz_cam=first.xyz_cam + np.array([1.3, 0, 0]))
    labels = replace(seen(ground_truth(scene)), lanes=(bare, *others))
    found = reasons(Evidence(None, labels, image), "ridges")
    assert (
        found == f"image: expected the paint of its lines where these are, got it {aside_m:+.2f} m aside"
    ) == is_found
    assert is_found or not found


def test_a_double_line_is_judged_by_both_its_stripes_also_by_a_rolled_camera():
    scene = changed(
        markings={"dash_fraction": 1.0, "left_double": True, "width_m": 0.2},
        camera={"roll_rad": 0.05, "cx_px": 250, "lane": 1},
    )
    left = leftmost(ground_truth(scene)).id
    for aside_m in (0.0, 0.2, 0.4):
        image = painted_picture(scene, aside_m, 200.0, 8)
        sample = picture_of(scene, image, depth=flat_road_depth(scene), semantic=painted(image))
        faults = {finding.lane for finding in findings(sample, "ids") if "in all of its paint" in finding.reason}
        if aside_m == 0:
            assert (findings(sample, "ridges"), faults) == ([], set())
            assert numbers(sample, "ridges")["ridges.in_place"] == [1.0]
        else:
            assert left in faults, "one stripe on the other's place is not enough"


def painted(image: np.ndarray) -> np.ndarray:
    """Semantic ids of what is bright as paint, and of the road."""
    return np.where(image[..., 0] > 150, SEMANTIC_IDS["marking"], SEMANTIC_IDS["road"]).astype(np.uint8)


def leftmost(labels: Labels) -> Lane:
    return next(lane for lane in labels.lanes if lane.kind == "delimiter" and lane.left is None)


def test_an_image_that_is_moved_or_stretched_is_told_by_all_its_lines_together():
    scene = changed(markings={"dash_fraction": 1.0})
    picture = painted_picture(scene, 0.0, 200.0, 8)
    assert reasons(picture_of(scene, picture), "ridges") == ""
    for px in (-3, 3):
        found = reasons(picture_of(scene, np.roll(picture, px, axis=1)), "ridges")
        assert f"clearest {px:+.1f} px to the right and stretched by +0.0 %" in found
    wide = np.array(Image.fromarray(picture).resize((504, 360)))[:, 12:-12]
    assert "stretched by +5.0 %" in reasons(picture_of(scene, wide), "ridges")


def test_what_is_bright_beside_the_pavement_or_about_a_car_is_not_paint_aside():
    """Faint paint, and a strip along it that is as bright as paint can be: beyond a narrow shoulder, or at a car."""
    car = Car(model=6, scale=1.0, color=(1, 1, 1), gloss=0.5, lane="main_1", s_m=-38.0)
    for road, cars in (({"shoulder_factor": 0.12}, ()), ({"shoulder_factor": 0.4}, (car,))):
        scene = changed(markings={"dash_fraction": 1.0}, road=road).model_copy(update={"cars": cars})
        faint, strips = painted_picture(scene, 0.0, 92.0, 0), painted_picture(scene, -0.6, 200.0, 0)
        blamed = {finding.lane for finding in findings(picture_of(scene, np.maximum(faint, strips)), "ridges")}
        assert leftmost(ground_truth(scene)).id not in blamed
        assert blamed, "the lines that are clear of both are asked"


def test_the_edge_of_a_bright_stretch_beside_faint_paint_is_not_paint_aside():
    """As that of a shadow, a puddle or a new surface: brighter on one side alone."""
    scene = changed(markings={"dash_fraction": 1.0}, road={"shoulder_factor": 0.4})
    faint = painted_picture(scene, 0.0, 92.0, 0)
    bright = np.max([painted_picture(scene, -aside_m, 200.0, 0) for aside_m in np.arange(0.35, 1.6, 0.05)], axis=0)
    found = reasons(picture_of(scene, np.maximum(faint, bright)), "ridges")
    assert "m aside" not in found
    strip = painted_picture(scene, -0.5, 200.0, 0)
    assert "m aside" in reasons(picture_of(scene, np.maximum(faint, strip)), "ridges")


@pytest.mark.parametrize(("yaw_rad", "is_asked"), [(0.0, True), (1.9, False)])
def test_what_passes_a_camera_that_looks_aside_is_not_asked_for_sharpness(yaw_rad, is_asked):
    scene = changed(camera={"yaw_rad": yaw_rad}, sensor={"motion_blur_m": 0.1})
    size = scene.camera.width_px, scene.camera.height_px
    noise = np.random.default_rng(0).integers(0, 255, (size[1] // 4, size[0] // 4, 3), dtype=np.uint8)
    image = np.array(Image.fromarray(noise).resize(size))
    assert ("detail of single pixels" in reasons(picture_of(scene, image), "sharpness")) == is_asked


def test_a_stripe_behind_a_car_is_not_asked_where_the_other_is_seen():
    scene = changed(markings={"dash_fraction": 1.0, "left_double": True, "width_m": 0.2}, camera={"lane": 1})
    labels = seen(ground_truth(scene))
    left = leftmost(labels)
    semantic, depth_m = painted(painted_picture(scene, 0.0, 200.0, 8)), flat_road_depth(scene)
    # Right of the line's middle, over its right stripe and not much more.
    u, v = project(labels.camera.img_from_cam, left.xyz_cam[left.visible & (left.xyz_cam[:, 1] < 20)]).T
    for row in range(int(v.min()) + 1, int(v.max())):
        first = int(np.interp(row, v[::-1], u[::-1])) + 2
        semantic[row, first : first + (row - int(v.min())) // 2 + 8] = SEMANTIC_IDS["car"]
    whole = reasons(picture_of(scene, depth=depth_m, semantic=semantic), "ids")
    assert "in all of its paint" not in whole
    semantic[semantic == SEMANTIC_IDS["car"]] = SEMANTIC_IDS["road"]
    found = findings(picture_of(scene, depth=depth_m, semantic=semantic), "ids")
    assert [finding.lane for finding in found if "in all of its paint" in finding.reason] == [left.id]


def test_black_white_and_pink_pictures_are_faults():
    gray = np.full((40, 60, 3), 120, np.uint8)
    scene = changed(camera={"width_px": 60, "height_px": 40})
    sample = picture_of(scene, gray)
    assert findings(sample, "frame") == []
    road = np.full((40, 60), SEMANTIC_IDS["road"], np.uint8)
    for color, words in (((0, 0, 0), "black"), ((255, 255, 255), "white"), ((250, 30, 240), "pink")):
        (finding,) = findings(picture_of(scene, np.full_like(gray, color), semantic=road), "frame", "colours")
        assert words in finding.reason
    pink = np.full((FLAT.camera.height_px, FLAT.camera.width_px, 3), (250, 30, 240), np.uint8)
    assert "pink" in reasons(picture_of(FLAT, pink), "colours"), "without passes"


def test_wheels_stand_on_the_meshes_and_terrain_in_the_road_is_a_fault(hilly_scene):
    hilly = picture_of(hilly_scene)
    assert findings(hilly, "standing") == []
    tyres = wheels(hilly.world)
    gaps_m = np.abs(pavement_of(hilly.world).height(tyres[:, :2]) - tyres[:, 2])
    assert np.isfinite(gaps_m).sum() > 8
    assert np.nanmax(gaps_m) < 0.03
    depth_m = flat_road_depth(FLAT)
    road = np.full((360, 480), SEMANTIC_IDS["road"], np.uint8)
    assert findings(picture_of(FLAT, depth=depth_m, semantic=road), "terrain") == []
    road[250:260, 230:240] = SEMANTIC_IDS["terrain"]
    found = reasons(picture_of(FLAT, depth=depth_m, semantic=road), "terrain")
    assert "expected pavement on the road and not terrain, got 100 of 100 pixels" in found


def semitrailer_alongside() -> Evidence:
    """A long vehicle that reaches from beside the camera far ahead, in the next lane."""
    long = max(range(len(FLAT.assets.car_models)), key=lambda i: FLAT.assets.car_models[i].length_m)
    car = Car(model=1 + long, scale=1.0, color=(1, 1, 1), gloss=0.5, lane="main_3", s_m=-47.0)
    return picture_of(FLAT.model_copy(update={"cars": (car,)}))


@pytest.mark.parametrize(("share", "is_fault"), [(0.0, True), (1.0, False)])
def test_the_seen_share_of_a_car_that_reaches_behind_the_camera_is_judged_by_its_pixels(share, is_fault):
    sample = semitrailer_alongside()
    left, top, right, bottom = (sample.labels.objects or ())[0].box_px.astype(int)
    instance = np.zeros((360, 480), np.uint16)
    instance[top:bottom, left:right] = instance_id("car", 0)
    labels = sample.labels.with_seen_shares((share,))
    found = reasons(replace(sample, labels=labels, passes={"instance": instance}), "cars")
    assert ("car_visible_fraction: expected" in found) == is_fault


@pytest.mark.parametrize(
    ("seen", "share", "is_fault"),
    [
        *((1.0, share, share < 1) for share in (1.0, 0.9, 0.5, 0.1)),
        *((0.5, share, share in (0.05, 1.0)) for share in (0.05, 0.4, 0.6, 1.0)),
        *((0.0, share, share > 0) for share in (0.0, 0.3)),
    ],
)
def test_the_share_that_something_nearer_leaves_of_a_box_limits_what_is_seen(seen, share, is_fault):
    """A car that fills 0.8 of the width of its box, and a wall 3 m ahead that covers its right part."""
    car = Car(model=1, scale=1.0, color=(1, 1, 1), gloss=0.5, lane="main_2", s_m=-38.0)
    sample = picture_of(FLAT.model_copy(update={"cars": (car,)}), depth=flat_road_depth(FLAT))
    left, top, right, bottom = (sample.labels.objects or ())[0].box_px.astype(int)
    wall, side = left + int(seen * (right - left)), (right - left) // 10
    depth_m, instance = sample.passes["depth"].copy(), np.zeros((360, 480), np.uint16)
    instance[top:bottom, left + side : right - side] = instance_id("car", 0)
    depth_m[top:bottom, left:right] = 12.0
    depth_m[top - 9 : bottom + 9, wall : right + 9], instance[:, wall:] = 3.0 if seen < 1 else 12.0, 0
    passes, labels = {"depth": depth_m, "instance": instance}, sample.labels.with_seen_shares((share,))
    assert ("car_visible_fraction: expected" in reasons(replace(sample, labels=labels, passes=passes), "cars")) == (
        is_fault
    )


@pytest.mark.parametrize(("share", "is_fault"), [(1.0, False), (0.2, True)])
def test_a_car_that_a_fisheye_sees_behind_the_camera_counts_as_a_whole(share, is_fault):
    lens = Lens(model="fisheye", coefficients=(0.02, 0, 0, 0))
    camera = FLAT.camera.model_copy(update={"lens": lens, "fx_px": 110.0, "fy_px": 110.0})
    sample = picture_of(semitrailer_alongside().scene.model_copy(update={"camera": camera}))
    corners_cam = (sample.labels.objects or ())[0].corners_cam
    assert corners_cam[:, 1].min() < -1 < 1 < corners_cam[:, 1].max()
    rays = sample.rays_world(*np.indices((camera.height_px, camera.width_px)).reshape(2, -1))
    eye_world = sample.camera.world_from_cam[:3, 3]
    hit = meet(boxes_of(sample.world.view.objects[:1]), eye_world, eye_world + 100 * rays).reshape(camera.height_px, -1)
    passes = {"instance": np.where(hit, instance_id("car", 0), 0).astype(np.uint16)}
    sample = replace(sample, labels=sample.labels.with_seen_shares((share,)), passes=passes)
    assert (findings(sample, "cars") != []) == is_fault


def test_places_that_a_fisheye_sees_aside_at_a_right_angle_have_no_points():
    lens = Lens(model="fisheye", coefficients=(0.02, 0, 0, 0))
    camera = FLAT.camera.model_copy(update={"lens": lens, "fx_px": 110.0, "fy_px": 110.0})
    depth_m = np.full((camera.height_px, camera.width_px), 5.0, np.float32)
    depth_m[0] = np.inf
    wide = picture_of(FLAT.model_copy(update={"camera": camera}), depth=depth_m).has_points
    aside = np.flatnonzero(~wide[camera.height_px // 2])
    assert 0 < len(aside) < 60
    assert (np.abs(np.abs(aside - camera.width_px / 2) - 175) < 15).all(), "a right angle is 175 pixels aside"
    np.testing.assert_array_equal(picture_of(FLAT, depth=depth_m).has_points, np.isfinite(depth_m))


@pytest.mark.parametrize(("road", "blamed"), [(90, [""]), (10, [])])
def test_an_image_without_any_paint_is_not_that_of_the_labels_unless_it_is_too_dark_to_show_any(road, blamed):
    """No line is blamed. A road of gray 10 with noise, as side cameras see it at night, shows no paint."""
    scene = changed(markings={"dash_fraction": 1.0})
    image = painted_picture(scene, 0.0, 90.0, 8).astype(float) * road / 90
    assert [finding.lane for finding in findings(picture_of(scene, image.astype(np.uint8)), "ridges")] == blamed


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda depth_m: depth_m, ""),
        (lambda depth_m: depth_m + np.float32(0.01), "the pavement within 0.002 m"),
        (lambda depth_m: np.round(depth_m * 20) / np.float32(20), "the pavement within 0.002 m"),
        (lambda depth_m: depth_m * np.float32(1.0015), "the pavement within 0.002 m"),
    ],
)
def test_depth_of_the_near_road_is_that_of_its_mesh(change, words):
    x_m, _ = flat_road_places(FLAT)
    with np.errstate(invalid="ignore"):
        semantic = np.where(np.abs(x_m) < 5.1, SEMANTIC_IDS["road"], SEMANTIC_IDS["marking"]).astype(np.uint8)
    depth_m = flat_road_depth(FLAT)
    semantic[~np.isfinite(depth_m)] = SEMANTIC_IDS["sky"]
    found = reasons(picture_of(FLAT, depth=change(depth_m), semantic=semantic), "pavement")
    assert (words in found) if words else (found == "")


def test_depth_in_another_unit_is_off_at_every_point():
    depth_m = flat_road_depth(FLAT)
    found = reasons(picture_of(FLAT, depth=depth_m * np.float32(1000)), "points")
    assert re.fullmatch(r"depth: expected pixels at lines .* got (\d+) of \1 places elsewhere", found)
    assert findings(picture_of(FLAT, depth=depth_m), "points") == []


def test_grass_in_a_shadow_has_the_light_of_the_sky():
    depth_m, grass = flat_road_depth(FLAT), (100, 104, 70)
    third = depth_m.shape[1] // 3
    semantic = np.full(depth_m.shape, SEMANTIC_IDS["terrain"], dtype=np.uint8)
    semantic[:, third : 2 * third] = SEMANTIC_IDS["road"]
    semantic[~np.isfinite(depth_m)] = SEMANTIC_IDS["sky"]

    def found(right):
        pixels = np.full((*depth_m.shape, 3), grass, dtype=np.uint8)
        pixels[:, third : 2 * third], pixels[:, 2 * third - 20 :] = 110, right
        return reasons(picture_of(FLAT, pixels, depth=depth_m, semantic=semantic), "appearance")

    assert found(grass) == ""
    assert found((10, 30, 10)) == "", "a shadow"
    assert "of red over green" in found((60, 160, 60)), "a tint"


def test_problems_are_told_in_the_order_of_the_checks():
    report = ValidationReport()
    report.sample("train:00000001", [Finding("", "z: the cause"), Finding("", "a: what follows")])
    report.sample("train:00000000", [Finding("", "b: another")])
    assert [problem["reason"][0] for problem in report.document()["problems"]] == ["b", "z", "a"]
