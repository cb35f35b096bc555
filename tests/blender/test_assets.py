"""The built assets: sizes, wheels, triangle caps, semantic ids, tiling textures."""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

bpy = pytest.importorskip("bpy")

from synth3dlanes.assets.built_in import assets_dir  # noqa: E402
from synth3dlanes.assets.catalogue import CARS, ROAD_MEANS, TREES  # noqa: E402
from synth3dlanes.blender.load_assets import LoadedAssets, load_assets  # noqa: E402
from synth3dlanes.blender.materials import BUMPS, TERRAIN_MEANS, Materials, make_materials  # noqa: E402
from synth3dlanes.blender.render import opened  # noqa: E402

BODY_TOLERANCE_M = 0.03
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


def test_triangle_caps(assets: LoadedAssets) -> None:
    caps = [(mesh, 18_000 if mesh.name == "semitrailer" else 15_000) for mesh in assets.cars]
    for mesh, cap in [*caps, *((mesh, 10_000) for mesh in assets.trees)]:
        mesh.calc_loop_triangles()
        assert 1000 < len(mesh.loop_triangles) <= cap, mesh.name


@pytest.mark.parametrize("number", range(6, len(CARS)), ids=[m.name for m in CARS[6:]])
def test_tyres_face_outwards(assets: LoadedAssets, number: int) -> None:
    """Seen from its back, a coated face reflects like a mirror."""
    model, mesh = CARS[number], assets.cars[number]
    slot = [material.name for material in mesh.materials].index("car_tyre")
    tops = [f for f in mesh.polygons if f.material_index == slot and f.center.z > 1.8 * model.wheel_radius_m]
    assert len(tops) >= 4
    assert all(face.normal.z > 0.5 for face in tops if abs(face.normal.x) < 0.3)


def test_every_material_has_its_semantic_id(assets: LoadedAssets, materials: Materials) -> None:
    expected = [(materials.terrains, 1), (materials.roads, 2), (materials.shoulders, 3), ((materials.marking,), 4)]
    expected += [(mesh.materials, 5) for mesh in assets.cars] + [(mesh.materials, 6) for mesh in assets.trees]
    for group, semantic_id in expected:
        assert [material.pass_index for material in group] == [semantic_id] * len(group)


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
