"""Real renders against the labels: two independent ways from a scene to pixels."""

import bpy
import numpy as np
import pytest

from synth3dlanes.blender import build as builder
from synth3dlanes.blender import render as renderer
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.geometry.frames import project, transform
from synth3dlanes.imaging.daylight import daylight
from synth3dlanes.params.params import load_params
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.roads.terrain import gradient_at
from synth3dlanes.scene.instance_ids import instance_id, numbers_of
from synth3dlanes.scene.scene import Car, Tree
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.world import resolve
from tests.scenes import changed, hill
from tests.thorough import first

pytestmark = pytest.mark.render

BARE = load_params("appendix_i", ["trees.n=40", "cars.n=1"])
# For what holds of pixels of any size.
SMALL = ("camera.width_px=160", "camera.height_px=120")
SMALL_CAMERA = {"width_px": 160, "height_px": 120, "fx_px": 138.6, "fy_px": 138.6, "cx_px": 80, "cy_px": 60}
ONE_SAMPLE = RenderSettings(samples=1, passes=("depth", "semantic", "instance"))


def rendered(scene, settings=ONE_SAMPLE):
    return take_picture(resolve(scene), settings)


def built(scene, studio=None):
    world = resolve(scene)
    light = daylight(scene, world.view.eye_world[2])
    return builder.build(studio or renderer.studio(), world, world.view, light)


def interpolated_depth(depth, uv):
    """Depth at sub-pixel places: its inverse is linear over a plane. Also the ratio over the four pixels used."""
    x, y = (uv - 0.5).T
    j = np.clip(np.floor(x).astype(int), 0, depth.shape[1] - 2)
    i = np.clip(np.floor(y).astype(int), 0, depth.shape[0] - 2)
    fx, fy = x - j, y - i
    inverse = 1 / depth.astype(float)
    a, b, c, d = inverse[i, j], inverse[i, j + 1], inverse[i + 1, j], inverse[i + 1, j + 1]
    value = (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
    corners = np.stack([a, b, c, d])
    with np.errstate(divide="ignore"):
        return 1 / value, corners.max(axis=0) / np.maximum(corners.min(axis=0), 1e-9)


def test_rendered_surface_agrees_with_label_points_within_40_m():
    """Median depth error under 1 cm; 99 % of points within 2 cm of the rendered surface, measured along its normal
    (at a crest one pixel spans metres of depth, so that depth alone would judge the interpolation)."""
    errors, gaps = [], []
    for index in range(2):
        scene = sample_scene(Scenes(BARE, 7, "test"), index)
        result = rendered(scene)
        for lane in result.labels.lanes:
            points_cam = lane.xyz_cam[lane.visible & (lane.xyz_cam[:, 1] < 40)]
            depth, spread = interpolated_depth(
                result.passes["depth"], project(result.labels.camera.img_from_cam, points_cam)
            )
            clear = spread < 1.2
            error = (depth / points_cam[:, 1] - 1)[clear]
            world_from_cam = result.labels.camera.world_from_cam
            slope = gradient_at(scene.terrain, transform(world_from_cam, points_cam)[clear, :2])
            normals = np.column_stack([-slope, np.ones(len(slope))])
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            errors.append(np.abs(error * points_cam[clear, 1]))
            gaps.append(np.abs(error * ((points_cam[clear] @ world_from_cam[:3, :3].T) * normals).sum(axis=1)))
    errors, gaps = np.concatenate(errors), np.concatenate(gaps)
    assert len(errors) > 250
    assert np.median(errors) < 0.01
    assert np.percentile(gaps, 99) < 0.02


def test_terrain_visible_agrees_with_the_depth_of_a_scene_without_objects():
    right, total = 0, 0
    for index in range(2):
        scene = sample_scene(Scenes(BARE, 8, "test"), index).model_copy(update={"cars": (), "trees": ()})
        result = rendered(scene)
        for lane in result.labels.lanes:
            uv = project(result.labels.camera.img_from_cam, lane.xyz_cam[lane.in_image])
            y = lane.xyz_cam[lane.in_image, 1]
            depth, spread = interpolated_depth(result.passes["depth"], uv)
            clear = spread < 1.05
            seen = depth > y * 0.985 - 0.05
            right += (seen == lane.terrain_visible[lane.in_image])[clear].sum()
            total += clear.sum()
    assert total > 350
    assert right / total > 0.995


def emissive_line(scene, delimiter):
    """The linear image of one delimiter's paint alone, glowing in the dark."""
    studio = renderer.studio()
    built(scene, studio)
    glow = bpy.data.materials.new("glow")
    glow.use_nodes = True
    glow.node_tree.nodes.clear()
    emission = glow.node_tree.nodes.new("ShaderNodeEmission")
    output = glow.node_tree.nodes.new("ShaderNodeOutputMaterial")
    glow.node_tree.links.new(emission.outputs[0], output.inputs[0])
    for item in bpy.context.scene.objects:
        if item.type == "MESH" and item.pass_index == delimiter:
            item.data.materials.clear()
            item.data.materials.append(glow)
        elif item.type in ("MESH", "LIGHT"):
            item.hide_render = True
    world, bpy.context.scene.world = bpy.context.scene.world, None
    renderer.configure(RenderSettings(samples=64), 1.0)
    bpy.context.scene.cycles.use_denoising = False
    image = renderer.run_cycles()["Combined"][..., 0]
    bpy.context.scene.world = world
    for item in bpy.context.scene.objects:
        item.hide_render = False
    bpy.data.materials.remove(glow)
    return image


ODD_CAMERA = {"roll_rad": 0.05, "cx_px": 252.0, "cy_px": 171.0, "fy_px": 430.0}


@pytest.mark.parametrize(
    ("line", "is_double", "camera"), first(1, [(0, True, ODD_CAMERA), (0, False, {}), (3, False, {})])
)
def test_projected_delimiter_runs_through_the_middle_of_its_rendered_paint(line, is_double, camera):
    """Also between the stripes of a double line, seen by a camera that is rolled, off-centre and not square."""
    scene = changed(
        terrain={"gaussians": (hill(10, 0, 6, 60), hill(-40, -20, -8, 45))},
        road={"offset_p50_m": 4},
        markings={"left_double": is_double},
        camera=camera,
    )
    image = emissive_line(scene, instance_id("delimiter", line))
    labels = ground_truth(scene)
    lane = next(x for x in labels.lanes if x.id == f"main_line_{line}")
    near = lane.visible & (lane.xyz_cam[:, 1] < 40)
    uv = project(labels.camera.img_from_cam, lane.xyz_cam[near])
    order = np.argsort(uv[:, 1])
    rows = np.arange(int(np.ceil(uv[:, 1].min())), int(uv[:, 1].max()))
    errors = []
    for row in rows:
        light = image[row]
        if light[[0, -1]].any() or light.sum() == 0:
            continue
        centroid = (light * (np.arange(480) + 0.5)).sum() / light.sum()
        u = np.interp(row + np.array([0.0, 0.5, 1.0]), uv[order, 1], uv[order, 0])
        errors.append((centroid - u[1]) / np.hypot(1, u[2] - u[0]))
    assert len(errors) > 40
    assert np.abs(errors).max() < 0.5


@pytest.mark.thorough
def test_yellow_worn_and_wet_paint_is_the_same_paint_to_every_pass():
    behind = {"camera": {"lane": 1}, "light": {"sun_azimuth_rad": -1.6}}  # a sun ahead would glitter on the water
    plain = rendered(changed(**behind))
    odd = rendered(changed(**behind, markings={"left_yellow": True, "wear": 0.3}, surface={"wetness": 0.4}))
    for name in plain.passes:
        np.testing.assert_array_equal(plain.passes[name], odd.passes[name])
    near = plain.passes["depth"] < 20
    lines = [(plain.passes["instance"] == instance_id("delimiter", line)) & near for line in (0, 1)]
    road = (plain.passes["semantic"] == SEMANTIC_IDS["road"]) & near

    def yellowness(image, pixels):
        red, green, blue = image[pixels].mean(axis=0)
        return (red + green) / 2 - blue

    assert yellowness(odd.image, lines[0]) > 40 > 10 > yellowness(odd.image, lines[1]), "left is yellow, next is white"
    assert yellowness(plain.image, lines[0]) < 10
    steep = road & (plain.passes["depth"] < 8)
    assert odd.image[steep].mean() < 0.93 * plain.image[steep].mean(), "a wet road is darker where one looks down on it"
    assert odd.image[lines[1]].mean() < 0.9 * plain.image[lines[1]].mean(), "worn paint is darker"


def arrays(scene):
    built(scene)
    found = []
    for item in sorted(bpy.context.scene.objects, key=lambda x: x.name):
        if item.type == "MESH" and item.data.name.startswith("surface"):
            points = np.zeros(3 * len(item.data.vertices), dtype=np.float32)
            item.data.vertices.foreach_get("co", points)
            found.append(points)
    return np.concatenate(found)


def test_no_scene_can_see_the_last_one():
    params = load_params("appendix_i", ["trees.n=40", "cars.n=1", *SMALL])
    a, b = (sample_scene(Scenes(params, 9, "test"), index) for index in (0, 1))
    settings = RenderSettings(samples=1)
    first, other, again = (rendered(scene, settings).image for scene in (a, b, a))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    np.testing.assert_array_equal(arrays(a), arrays(a))
    counts = (len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.images), len(bpy.data.materials))
    arrays(b)
    arrays(a)
    assert counts == (len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.images), len(bpy.data.materials))


def test_object_visible_agrees_with_the_instance_pass():
    right, hidden, total = 0, 0, 0
    for index in range(2):
        result = rendered(
            sample_scene(Scenes(load_params("appendix_i", ["cars.n=20", "trees.n=300"]), 3, "test"), index)
        )
        instance = result.passes["instance"]
        objects = (instance > 0) & (numbers_of("delimiter", instance) < 0)
        for lane in result.labels.lanes:
            at = lane.in_image & lane.terrain_visible & (lane.xyz_cam[:, 1] < 80)
            u, v = np.floor(project(result.labels.camera.img_from_cam, lane.xyz_cam[at])).astype(int).T
            u, v = np.clip(u, 1, 478), np.clip(v, 1, 358)
            patch = np.stack([objects[v + i, u + j] for i in (-1, 0, 1) for j in (-1, 0, 1)])
            inside = patch.all(axis=0) | ~patch.any(axis=0)
            # An object can also stand behind a point; then the pixel shows its depth further away.
            behind = result.passes["depth"][v, u] > lane.xyz_cam[at, 1] + 0.2
            shown = patch[4] & ~behind
            right += (shown == ~lane.object_visible[at])[inside].sum()
            hidden += (~lane.object_visible[at]).sum()
            total += inside.sum()
    assert hidden > 30
    assert right / total > 0.99


def test_seen_share_of_cars():
    """A lone car ahead is seen whole; with a truck before it, hardly; one behind the camera, not at all."""
    car = {"model": 1, "scale": 1.0, "color": (1, 0, 0), "gloss": 0.5, "lane": "main_2"}
    ahead, behind = Car(**car, s_m=-20), Car(**car, s_m=-90)
    truck = Car(**{**car, "model": 6}, s_m=-32)
    scene = changed(camera=SMALL_CAMERA)

    def shares(*cars):
        return rendered(scene.model_copy(update={"cars": cars}), RenderSettings(samples=1)).labels.car_visible_fraction

    assert shares(ahead, behind) == (1.0, 0.0)
    hidden, before = shares(ahead, truck)
    assert hidden < 0.1
    assert before > 0.95


@pytest.mark.thorough
def test_grass_is_terrain_beside_the_road_and_changes_no_label():
    """Its pixels lie on the verge and are nearer than the ground behind them; nothing else moves."""
    bare = changed()
    plain, grown = (rendered(scene) for scene in (bare, changed(vegetation={"grass_m": 0.4})))
    for one, other in zip(plain.labels.lanes, grown.labels.lanes, strict=True):
        np.testing.assert_array_equal(one.xyz_cam, other.xyz_cam)
        np.testing.assert_array_equal(one.object_visible, other.object_visible)
    moved = grown.passes["depth"] != plain.passes["depth"]
    assert moved.mean() > 0.01
    assert (grown.passes["depth"] <= plain.passes["depth"])[moved].all()
    assert set(np.unique(grown.passes["semantic"][moved])) == {SEMANTIC_IDS["terrain"]}
    assert set(np.unique(grown.passes["instance"][moved])) == {0}
    np.testing.assert_array_equal(grown.passes["instance"], plain.passes["instance"])


@pytest.mark.thorough
def test_leaves_let_the_sun_through():
    """Crowns get brighter and greener, and most so against the sun."""
    gains = {}
    for place, azimuth_rad in (("ahead", np.pi / 2), ("behind", -np.pi / 2)):
        light = {"sun_zenith_rad": 1.0, "sun_azimuth_rad": azimuth_rad}
        trees = (Tree(model=1, x_m=9, y_m=-30, yaw_rad=0, scale=1), Tree(model=3, x_m=-9, y_m=-28, yaw_rad=0, scale=1))
        scenes = [changed(light=light, vegetation={"translucency": share}) for share in (0, 1)]
        opaque, lit = (rendered(scene.model_copy(update={"trees": trees})) for scene in scenes)
        np.testing.assert_array_equal(opaque.passes["semantic"], lit.passes["semantic"])
        crown = opaque.passes["semantic"] == SEMANTIC_IDS["tree"]
        gains[place] = lit.image[crown].mean(axis=0) / opaque.image[crown].mean(axis=0)
    assert gains["ahead"][1] > 1.3
    assert gains["ahead"][1] > gains["ahead"][2] + 0.1, "more green than blue"
    assert gains["ahead"][1] > gains["behind"][1] + 0.1


def test_instance_ids_of_paint_follow_the_labels():
    scene = changed(road={"topology": 3, "flip_lateral": True, "exit_offset_m": 8.0}, camera={"lane": 3, "y_m": -60})
    result = rendered(scene)
    delimiters = [lane for lane in result.labels.lanes if lane.kind == "delimiter"]
    instance = result.passes["instance"]
    hits = []
    for i, lane in enumerate(delimiters):
        near = lane.visible & (lane.xyz_cam[:, 1] < 25)
        u, v = np.floor(project(result.labels.camera.img_from_cam, lane.xyz_cam[near])).astype(int).T
        ids = instance[np.clip(v, 0, 359), np.clip(u, 0, 479)]
        painted = ids[ids >= instance_id("delimiter", 0)]
        assert (painted == instance_id("delimiter", i)).all(), lane.id
        hits.append(len(painted))
    assert sum(hits) > 30
    assert np.count_nonzero(hits) >= 4, "several lines are hit, or this would say nothing"


@pytest.mark.thorough
def test_a_far_road_that_mirrors_the_low_sun_is_even():
    """Bumps finer than a pixel under a glossy coat once looked like white gravel: 9 gray levels between neighbours."""
    scene = sample_scene(Scenes(load_params("streets"), 901, "train"), 95)
    picture = rendered(scene, RenderSettings(passes=("depth", "semantic")))
    image, passes = picture.image, picture.passes
    is_far = (passes["semantic"] == SEMANTIC_IDS["road"]) & (passes["depth"] > 150) & (passes["depth"] < 400)
    luma = image.mean(axis=2, dtype=float)
    steps = np.abs(luma[:, 1:] - luma[:, :-1])[is_far[:, 1:] & is_far[:, :-1]]
    assert len(steps) > 1000
    assert steps.mean() < 3.5
