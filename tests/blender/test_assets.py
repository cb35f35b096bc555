"""The built assets: sizes, wheels, triangle caps, semantic ids, tiling textures, and their quick copies."""

from collections import defaultdict
from collections.abc import Iterator
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.blender.shaders import quick_copy
from synth3dlanes.scene.settings import SCRATCH

bpy = pytest.importorskip("bpy")

from mathutils import Vector  # noqa: E402
from mathutils.bvhtree import BVHTree  # noqa: E402

from synth3dlanes.blender.load_assets import LoadedAssets, load_assets  # noqa: E402
from synth3dlanes.blender.materials import BUMPS, TERRAIN_MEANS, Materials, make_materials  # noqa: E402
from synth3dlanes.blender.render import opened  # noqa: E402
from synth3dlanes.scene.assets.built_in import assets_dir  # noqa: E402
from synth3dlanes.scene.assets.catalogue import CARS, ROAD_MEANS, THINGS, TREES  # noqa: E402
from synth3dlanes.scene.things import SEMANTIC_IDS, ThingKind  # noqa: E402

BODY_TOLERANCE_M = 0.03
MODELS = [(kind, number) for kind, models in THINGS.items() for number in range(len(models))]
MODEL_NAMES = [THINGS[kind][number].name for kind, number in MODELS]
MAX_BYTES = 25e6


@pytest.fixture(scope="module")
def assets() -> Iterator[LoadedAssets]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    yield load_assets()
    opened.cache_clear()


@pytest.fixture(scope="module")
def materials(assets: LoadedAssets) -> Materials:
    return make_materials(assets.roads, assets.terrains)


def points(mesh: bpy.types.Mesh, slot: str | None = None) -> np.ndarray:
    """All vertices, or those of the faces in a material slot."""
    co = np.zeros(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", co)
    if slot is None:
        return co.reshape(-1, 3)
    number = [m.name for m in mesh.materials].index(slot)
    return co.reshape(-1, 3)[list(chain(*(f.vertices for f in mesh.polygons if f.material_index == number)))]


@pytest.mark.parametrize("number", range(len(CARS)), ids=[m.name for m in CARS])
def test_a_car_has_the_size_and_wheels_of_the_catalogue(assets: LoadedAssets, number: int) -> None:
    model, mesh = CARS[number], assets.cars[number]
    low, high = points(mesh).min(axis=0), points(mesh).max(axis=0)
    np.testing.assert_allclose(high - low, (model.width_m, model.length_m, model.height_m), atol=BODY_TOLERANCE_M)
    np.testing.assert_allclose((high + low)[:2], 0, atol=2 * BODY_TOLERANCE_M)
    tyres = points(mesh, "car_tyre")
    for side in (-1, 1):
        for end in (-1, 1):
            tyre = tyres[(side * tyres[:, 0] > 0) & (end * tyres[:, 1] > 0)]
            assert tyre[:, 2].min() == pytest.approx(0, abs=1e-3)
            assert tyre[:, 2].max() == pytest.approx(2 * model.wheel_radius_m, abs=1e-3)
            assert tyre[:, 1].min() + tyre[:, 1].max() == pytest.approx(end * model.wheelbase_m, abs=1e-3)


@pytest.mark.parametrize("number", range(len(TREES)), ids=[m.name for m in TREES])
def test_a_tree_has_the_size_of_the_catalogue(assets: LoadedAssets, number: int) -> None:
    model, co = TREES[number], points(assets.trees[number])
    assert co[:, 2].max() == pytest.approx(model.height_m, abs=BODY_TOLERANCE_M)
    assert -0.5 < co[:, 2].min() < 0
    reach = np.hypot(co[:, 0], co[:, 1])
    assert np.quantile(reach, 0.999) == pytest.approx(model.crown_radius_m, abs=BODY_TOLERANCE_M)
    assert reach.max() < 1.15 * model.crown_radius_m


@pytest.mark.parametrize(("kind", "number"), MODELS, ids=MODEL_NAMES)
def test_the_box_of_a_thing_is_that_of_all_its_poses(assets: LoadedAssets, kind: ThingKind, number: int) -> None:
    model, meshes = THINGS[kind][number], assets.things[kind][number]
    assert [mesh.name for mesh in meshes] == [f"{model.name}.{pose}" for pose in range(model.n_poses + 1)]
    corners = np.concatenate([points(mesh) for mesh in meshes])
    low, high = corners.min(axis=0), corners.max(axis=0)
    np.testing.assert_allclose(high - low, (model.width_m, model.length_m, model.height_m), atol=0.002)
    np.testing.assert_allclose([*(high + low)[:2], low[2]], 0, atol=0.002)
    # Each pose stands on the ground.
    assert max(abs(points(mesh)[:, 2].min()) for mesh in meshes) < 0.002


@pytest.mark.parametrize("number", range(len(THINGS["pedestrian"])), ids=[m.name for m in THINGS["pedestrian"]])
def test_feet_on_the_ground_stay_where_they_are(assets: LoadedAssets, number: int) -> None:
    """People walk forward: the foot that stands is pushed back by as much as the body goes on."""
    model, meshes = THINGS["pedestrian"][number], assets.things["pedestrian"][number]
    step_m, slips = model.stride_m / model.n_poses, []
    for this, following in pairwise([*meshes[1:], meshes[1]]):
        shoes = [points(mesh, "pedestrian_trim") for mesh in (this, following)]
        # In both poses the same vertices make the same part of a shoe.
        planted = (shoes[0][:, 2] < 0.03) & (shoes[1][:, 2] < 0.03)
        back_m = (shoes[0] - shoes[1])[planted, 1]
        if planted.sum() > 5:
            slips.append(float(np.median(back_m)) - step_m)
    assert len(slips) >= 5
    assert np.abs(slips).max() < 0.4 * step_m
    assert abs(np.mean(slips)) < 0.1 * step_m


def test_triangle_caps(assets: LoadedAssets) -> None:
    """At least as many as round edges need that are seen from near."""
    of_cars = [(mesh, 1000, 18_000 if mesh.name == "semitrailer" else 15_000) for mesh in assets.cars]
    of_trees = [(mesh, 1000, 10_000) for mesh in assets.trees]
    of_things = [(mesh, 300, 6_000) for models in assets.things.values() for poses in models for mesh in poses]
    for mesh, least, most in (*of_cars, *of_trees, *of_things):
        mesh.calc_loop_triangles()
        n = len(mesh.loop_triangles)
        assert least < n <= most, f"{mesh.name}: expected {least} to {most} triangles, got {n}"


def facing_outwards(mesh: bpy.types.Mesh) -> dict[str, list[bool]]:
    """Of faces that rays from outside meet first, by material, whether they face the ray's origin."""
    corners = np.array([vertex.co for vertex in mesh.vertices])
    tree = BVHTree.FromPolygons(corners.tolist(), [tuple(face.vertices) for face in mesh.polygons])
    low, high = corners.min(axis=0), corners.max(axis=0)
    rng, names = np.random.default_rng(0), [material.name for material in mesh.materials]
    seen: dict[str, list[bool]] = defaultdict(list)
    for azimuth_rad, elevation_rad, *share in (rng.random((4000, 5)) * [2 * np.pi, 0.5, 1, 1, 1]).tolist():
        level = np.cos(elevation_rad)
        back = np.array([level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), np.sin(elevation_rad)])
        _, normal, face, _ = tree.ray_cast((low + share * (high - low) + 30 * back).tolist(), (-back).tolist())
        if face is not None:
            seen[names[mesh.polygons[face].material_index]].append(normal @ Vector(back) > 0)
    return seen


@pytest.mark.thorough
@pytest.mark.parametrize("name", [*(model.name for model in CARS), *MODEL_NAMES])
def test_what_is_seen_of_a_car_or_thing_faces_outwards(assets: LoadedAssets, name: str) -> None:
    """Seen from its back, a coated face reflects like a mirror: a tyre would be white."""
    cars = {model.name: mesh for model, mesh in zip(CARS, assets.cars, strict=True)}
    things = {model: assets.things[kind][number][-1] for (kind, number), model in zip(MODELS, MODEL_NAMES, strict=True)}
    mesh = (cars | things)[name]
    seen = facing_outwards(mesh)
    if name in cars:
        assert {"car_paint", "car_tyre", "car_rim", "car_trim"} <= set(seen)
        assert len(seen["car_tyre"]) > 20
    else:  # of a bicycle the rear lamp is hardly seen
        assert len(seen) >= len(mesh.materials) - 1
    # Single rays slip through seams.
    least = 0.98 if name in cars else 0.95
    assert {part: np.mean(faces) for part, faces in seen.items() if np.mean(faces) < least} == {}


def test_colours_of_things_are_those_of_their_objects(assets: LoadedAssets) -> None:
    """A material reads the paint that its model names at this place, and all paints are used."""
    for kind, models in assets.things.items():
        for model, poses in zip(THINGS[kind], models, strict=True):
            read = {}
            for material in poses[0].materials:
                nodes = {node.bl_idname: node for node in material.node_tree.nodes}
                if "ShaderNodeAttribute" in nodes:
                    own = nodes["ShaderNodeAttribute"]
                    assert own.attribute_type == "OBJECT"
                    read[material.name.removeprefix(f"{kind}_")] = own.attribute_name
            alike = {"umbrella": "own", "vehicle": "own", "helmet": "hair"}
            expected = {alike.get(paint, paint): f"paint{i}" for i, paint in enumerate(model.paints)}
            assert read == expected


def test_every_material_has_its_semantic_id(assets: LoadedAssets, materials: Materials) -> None:
    expected = [(materials.terrains, 1), (materials.roads, 2), (materials.shoulders, 3), ((materials.marking,), 4)]
    expected += [(mesh.materials, 5) for mesh in assets.cars] + [(mesh.materials, 6) for mesh in assets.trees]
    expected += [
        (m.materials, SEMANTIC_IDS[kind]) for kind, models in assets.things.items() for poses in models for m in poses
    ]
    for group, semantic_id in expected:
        assert [material.pass_index for material in group] == [semantic_id] * len(group)


@pytest.mark.thorough
@pytest.mark.parametrize("path", sorted((assets_dir() / "textures").glob("*.jpg")), ids=lambda path: path.stem)
def test_textures_tile(path: Path) -> None:
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("RGB"), float)
    for axis in (0, 1):
        lines = np.moveaxis(pixels, axis, 0)
        inside = np.abs(np.diff(lines, axis=0)).mean(axis=(1, 2))
        seam = np.abs(lines[0] - lines[-1]).mean()
        assert seam <= 1.5 * np.quantile(inside, 0.99) + 1, f"axis {axis}: seam {seam}, inside {inside.mean()}"


def _texture(file: str) -> np.ndarray:
    with Image.open(assets_dir() / "textures" / file) as picture:
        return np.asarray(picture.convert("RGB"), float) / 255


@pytest.mark.parametrize("name", [*TERRAIN_MEANS, *ROAD_MEANS])
def test_far_ground_has_the_mean_colour_and_roughness_of_its_textures(name: str) -> None:
    srgb = _texture(f"{name}_albedo.jpg")
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).mean(axis=(0, 1))
    if name in TERRAIN_MEANS:
        np.testing.assert_allclose(linear, TERRAIN_MEANS[name], atol=2e-3)
    else:
        np.testing.assert_allclose(linear, ROAD_MEANS[name][0], atol=2e-3)
        assert _texture(f"{name}_roughness.jpg").mean() == pytest.approx(ROAD_MEANS[name][1], abs=2e-3)


def test_far_roads_are_as_rough_as_their_bumps() -> None:
    slopes = [0.4 * (2 * _texture(f"{name}_normal.jpg")[..., :2] - 1) for name in ROAD_MEANS]
    assert pytest.approx(np.mean([2 * slope.var(axis=(0, 1)) for slope in slopes]), abs=2e-3) == BUMPS


def test_assets_stay_small() -> None:
    assert sum(path.stat().st_size for path in assets_dir().rglob("*") if path.is_file()) < MAX_BYTES


def test_a_copy_holds_the_very_pixels_and_is_made_once_if_there_is_room(tmp_path, rng, monkeypatch):
    jpeg, scratch = tmp_path / "stone.jpg", tmp_path / "scratch"
    Image.fromarray(rng.integers(0, 255, (32, 48, 3), dtype=np.uint8)).save(jpeg)
    scratch.mkdir()
    monkeypatch.setenv(SCRATCH, str(scratch))
    copy = quick_copy(jpeg)
    assert np.array_equal(np.asarray(Image.open(copy)), np.asarray(Image.open(jpeg)))
    made_at = copy.stat().st_mtime_ns
    assert quick_copy(jpeg) == copy
    assert copy.stat().st_mtime_ns == made_at
    assert list(scratch.iterdir()) == [copy]
    monkeypatch.setenv(SCRATCH, str(tmp_path / "gone"))
    assert quick_copy(jpeg) == jpeg
    monkeypatch.delenv(SCRATCH)
    assert quick_copy(jpeg) == jpeg
