"""The built assets: sizes, wheels, triangle caps, semantic ids, tiling textures, sky."""

from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

bpy = pytest.importorskip("bpy")

from synth3dlanes.blender.assets import assets_dir  # noqa: E402
from synth3dlanes.blender.library import Assets, load_assets  # noqa: E402
from synth3dlanes.blender.materials import TERRAIN_MEANS, Materials, make_materials  # noqa: E402
from synth3dlanes.blender.sky import SKY_SHAPE, clear_sky, cloud_cover, daylight, sun_color, sun_direction  # noqa: E402
from synth3dlanes.catalogue import CARS, TREES  # noqa: E402
from synth3dlanes.scene import Light  # noqa: E402
from tests.scenes import changed  # noqa: E402

BODY_TOLERANCE_M = 0.03
MAX_BYTES = 25e6


@pytest.fixture(scope="module")
def assets() -> Assets:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return load_assets()


@pytest.fixture(scope="module")
def materials(assets: Assets) -> Materials:
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
def test_a_car_has_the_size_and_wheels_of_the_catalogue(assets: Assets, number: int) -> None:
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
def test_a_tree_has_the_size_of_the_catalogue(assets: Assets, number: int) -> None:
    model, co = TREES[number], points(assets.trees[number])
    assert co[:, 2].max() == pytest.approx(model.height_m, abs=BODY_TOLERANCE_M)
    assert -0.5 < co[:, 2].min() < 0
    reach = np.hypot(co[:, 0], co[:, 1])
    assert np.quantile(reach, 0.999) == pytest.approx(model.crown_radius_m, abs=BODY_TOLERANCE_M)
    assert reach.max() < 1.15 * model.crown_radius_m


def test_triangle_caps(assets: Assets) -> None:
    for meshes, cap in ((assets.cars, 15_000), (assets.trees, 10_000)):
        for mesh in meshes:
            mesh.calc_loop_triangles()
            assert 1000 < len(mesh.loop_triangles) <= cap, mesh.name


def test_every_material_has_its_semantic_id(assets: Assets, materials: Materials) -> None:
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


@pytest.mark.parametrize("name", TERRAIN_MEANS)
def test_far_terrain_has_the_mean_colour_of_its_texture(name: str) -> None:
    with Image.open(assets_dir() / "textures" / f"{name}_albedo.jpg") as picture:
        srgb = np.asarray(picture, float) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(linear.mean(axis=(0, 1)), TERRAIN_MEANS[name], atol=2e-3)


def test_assets_stay_small() -> None:
    assert sum(path.stat().st_size for path in assets_dir().rglob("*") if path.is_file()) < MAX_BYTES


def light(zenith_deg: float, azimuth_deg: float = 0.0) -> Light:
    return Light(sun_zenith_rad=np.deg2rad(zenith_deg), sun_azimuth_rad=np.deg2rad(azimuth_deg), exposure=1.0)


@pytest.mark.parametrize("zenith_deg", [5.0, 30.0, 45.0, 80.0])
def test_the_sky_is_symmetric_and_brighter_near_the_sun(zenith_deg: float) -> None:
    elevation = np.deg2rad([90 - zenith_deg])
    towards, left, right, away = clear_sky(light(zenith_deg), elevation, np.deg2rad([0, 60, 60, 180])).sum(axis=0)[0]
    assert left == right
    assert min(left, away) > 0
    assert towards > max(left, away)


def test_a_high_sun_leaves_a_blue_zenith_and_a_low_sun_is_red() -> None:
    zenith = clear_sky(light(40), np.array([np.pi / 2]), np.array([0.0]))[:, 0, 0]
    assert zenith[2] > zenith[1] > zenith[0]
    noon, evening = sun_color(light(0)), sun_color(light(86))
    assert np.all(noon > evening)
    assert evening[0] / evening[2] > 2 * noon[0] / noon[2]


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 200.0])
def test_the_image_is_brightest_where_the_lamp_shines_from(azimuth_deg: float) -> None:
    scene = changed(light={"sun_zenith_rad": np.deg2rad(60), "sun_azimuth_rad": np.deg2rad(azimuth_deg)})
    sky = daylight(scene).sky.sum(axis=0)
    row = SKY_SHAPE[0] // 2 + round(SKY_SHAPE[0] * 12 / 180)  # below the clouds, above the haze
    column = int(np.argmax(np.convolve(np.tile(sky[row], 3), np.ones(65) / 65, "same")[1024:2048]))
    u = (column + 0.5) / SKY_SHAPE[1]
    azimuth_rad = -(u - 0.5) * 2 * np.pi  # Blender's equirectangular projection
    seen = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad)])
    assert seen @ sun_direction(scene.light)[:2] > 0.999 * np.sin(scene.light.sun_zenith_rad)


def test_clouds_follow_their_generator() -> None:
    first, again, other = (cloud_cover(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert 0 <= first.min() <= first.max() <= 1
