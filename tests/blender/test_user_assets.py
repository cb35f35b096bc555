"""A user's own cars, trees, textures and skies: measured, recorded, rendered; and what is wrong with a bad folder."""

import dataclasses
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from PIL import Image  # noqa: E402

from synth3dlanes.blender import example_assets as example  # noqa: E402
from synth3dlanes.blender import render as renderer  # noqa: E402
from synth3dlanes.blender.check_assets import _wheels, check_folder  # noqa: E402
from synth3dlanes.blender.load_assets import read_sky  # noqa: E402
from synth3dlanes.draw.sample import Scenes, sample_scene  # noqa: E402
from synth3dlanes.geometry.frames import transform  # noqa: E402
from synth3dlanes.imaging.daylight import daylight  # noqa: E402
from synth3dlanes.imaging.sky import AZIMUTH_RAD, HORIZON, LUMINANCE, irradiance  # noqa: E402
from synth3dlanes.imaging.user_sky import hang, prepare_sky  # noqa: E402
from synth3dlanes.params.params import load_params  # noqa: E402
from synth3dlanes.production.recipe import Recipe, take_picture  # noqa: E402
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Library  # noqa: E402
from synth3dlanes.scene.assets.folder import FolderCheck, require_assets  # noqa: E402
from synth3dlanes.scene.instance_ids import instance_id  # noqa: E402
from synth3dlanes.scene.scene import Scene, Thing, from_json, to_json  # noqa: E402
from synth3dlanes.scene.settings import RenderSettings  # noqa: E402
from synth3dlanes.scene.things import SEMANTIC_IDS  # noqa: E402
from synth3dlanes.system.errors import FormatError, InputError  # noqa: E402
from synth3dlanes.world.world import resolve  # noqa: E402

pytestmark = pytest.mark.render

CHANGES = ("cars.n=4", "cars.s_m=[-45, 20]", "trees.n=30")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The example that docs/assets.md shows."""
    path = tmp_path_factory.mktemp("own")
    example.make_example(path)
    yield path
    renderer.opened.cache_clear()


@pytest.fixture(scope="module")
def library(folder: Path) -> Library:
    checked = check_folder(folder)
    assert (checked.problems, checked.warnings) == ((), ())
    return Library(str(folder), checked.assets)


@pytest.fixture(scope="module")
def scene(library: Library) -> Scene:
    recipe = Recipe(
        Scenes(load_params("tiny", CHANGES, library.assets), 5, "own", assets=library.assets),
        RenderSettings(),
        "png",
        library,
    )
    return recipe.scene(2)


def test_sizes_are_those_that_the_files_were_made_with(library: Library) -> None:
    (car,), (tree,), (sky,) = library.assets.cars, library.assets.trees, library.assets.skies
    sizes = (car.length_m, car.width_m, car.height_m, car.wheelbase_m, car.track_m, car.wheel_radius_m)
    expected = (4.2, 1.7, 1.5, example.WHEELBASE_M, example.TRACK_M, example.WHEEL_RADIUS_M)
    assert sizes == pytest.approx(expected, abs=1e-3)
    assert (tree.height_m, tree.crown_radius_m) == pytest.approx((example.TREE_M, example.CROWN_M), abs=0.02)
    assert np.rad2deg(sky.sun_azimuth_rad) == pytest.approx(example.SUN_AZIMUTH_DEG, abs=1)


def test_a_person_has_the_size_and_the_paints_of_its_files_and_walks(scene: Scene, library: Library) -> None:
    """The box is around all poses; 12 m ahead it is rendered where the box is, in its colours, with the legs apart."""
    (person,) = library.assets.pedestrians
    sizes = (person.width_m, person.length_m, person.height_m, person.stride_m)
    assert sizes == pytest.approx((0.44, 0.7, example.PERSON_M, 1.2), abs=1e-3)
    assert (person.name, person.n_poses, person.paints) == ("boxes", 2, ("upper", "lower", "skin"))
    x_m, y_m = transform(resolve(scene).view.world_from_host, np.array([[0.0, 12.0, 0.0]]))[0, :2].tolist()
    counts, settings = [], RenderSettings(1, ("instance", "semantic"))
    for speed_m_s in (0.0, 1.0):
        place = {"kind": "pedestrian", "model": 1, "x_m": x_m, "y_m": y_m, "yaw_rad": 1.5, "speed_m_s": speed_m_s}
        thing = Thing(**place, colors=((0.9, 0.05, 0.05), (0.05, 0.05, 0.9), (0.9, 0.7, 0.6)))  # type: ignore[arg-type]
        shown = scene.model_copy(update={"things": (thing,), "cars": (), "trees": ()})
        assert from_json(to_json(shown), "") == shown
        picture = take_picture(resolve(shown), settings, library)
        mask = picture.passes["semantic"] == SEMANTIC_IDS["pedestrian"]
        np.testing.assert_array_equal(mask, picture.passes["instance"] == instance_id("thing", 0))
        rows = np.flatnonzero(mask.any(axis=1))
        (item,) = picture.labels.objects or ()
        assert item.box_px is not None
        _, y0, _, y1 = item.box_px
        assert (rows[0], rows[-1] + 1) == pytest.approx((y0, y1), abs=1)
        upper = rows[0] + int(0.35 * len(rows))
        red, _, blue = picture.image[upper][mask[upper]].mean(axis=0)
        assert red > 1.5 * blue
        counts.append(int(mask[rows[0] + int(0.8 * len(rows)) :].any(axis=0).sum()))
    assert counts[1] > 1.5 * counts[0], "legs apart"


def test_people_of_a_town_are_the_users(library: Library) -> None:
    """All of their numbers; the built-in ones have more."""
    params = load_params(
        "town", ("people.per_100_m=10", "town.walkway_m=2.6", "town.traffic=0", "town.parked=0"), library.assets
    )
    scene = sample_scene(Scenes(params, 5, assets=library.assets), 0)
    people = [thing for thing in scene.things if thing.kind == "pedestrian"]
    assert len(people) > 5
    assert {(thing.model, len(thing.colors)) for thing in people} == {(1, 3)}
    with pytest.raises(
        InputError, match=r"scene.json: pedestrians: expected 'boxes' with digest \w+, got the built-in"
    ):
        require_assets(scene.assets, BUILT_IN, "scene.json")


def test_a_copy_elsewhere_is_the_same_library_and_notes_overrule(
    folder: Path, library: Library, tmp_path: Path
) -> None:
    shutil.copytree(folder, tmp_path / "copy")
    assert check_folder(tmp_path / "copy").assets == library.assets
    notes = {"cars": {"box": {"wheelbase_m": 2.5, "track_m": 1.4, "wheel_radius_m": 0.3}}}
    (tmp_path / "copy" / "assets.yaml").write_text(
        json.dumps({**notes, "skies": {"evening": {"sun_azimuth_deg": -20}}})
    )
    noted = check_folder(tmp_path / "copy").assets
    assert (noted.cars[0].wheelbase_m, noted.cars[0].track_m, noted.cars[0].wheel_radius_m) == (2.5, 1.4, 0.3)
    assert noted.skies[0].sun_azimuth_rad == pytest.approx(np.deg2rad(-20), abs=1e-6)
    assert noted.cars[0].sha256 == library.assets.cars[0].sha256
    renderer.opened.cache_clear()  # what was checked took its place


def test_wheels_without_names_are_what_touches_the_ground_or_shares_of_the_body() -> None:
    body = np.array([[x, y, z] for x in (-0.9, 0.9) for y in (-2.2, 2.2) for z in (0.3, 1.4)])
    tyres = np.array(
        [[x + dx, y + dy, 0] for x in (-0.7, 0.7) for y in (-1.1, 1.5) for dx in (-0.1, 0.1) for dy in (-0.05, 0.05)]
    )
    nothing = np.zeros((0, 3))
    assert _wheels(np.concatenate([body, tyres]), nothing)[:2] == pytest.approx((2.6, 1.4))
    assert _wheels(body, nothing)[:2] == pytest.approx((0.6 * 4.4, 0.84 * 1.8))


def test_the_scene_records_what_it_was_drawn_with(scene: Scene, library: Library) -> None:
    read = from_json(to_json(scene), "")
    assert read == scene
    assert read.assets == library.assets
    assert (scene.sky, scene.surface.road_texture, {car.model for car in scene.cars}) == (1, 1, {1})
    require_assets(read.assets, library, "scene.json")
    with pytest.raises(InputError, match=r"scene.json: cars: expected 'box' with digest \w+, got the built-in"):
        require_assets(read.assets, BUILT_IN, "scene.json")
    with pytest.raises(FormatError, match=r"cars.0.model: expected at most 1, got 2"):
        from_json(to_json(scene).replace('"model":1', '"model":2', 1), "scene.json")


def test_samples_of_other_assets_do_not_mix(library: Library) -> None:
    recipe = Recipe(Scenes(load_params("tiny"), 0, "own"), RenderSettings(), "png")
    described = dataclasses.replace(recipe, library=library).description()["assets"]
    assert recipe.description()["assets"]["cars"] == {}
    assert described["cars"]["box"]["sha256"] == library.assets.cars[0].sha256
    assert "/" not in json.dumps(described)


@pytest.mark.thorough
def test_rendered_twice_with_ours_in_between(scene: Scene, library: Library) -> None:
    settings = RenderSettings(2, ("semantic", "instance"))
    first = take_picture(resolve(scene), settings, library)
    ours = scene.model_copy(update={"assets": BUILT_IN.assets, "sky": 0})
    between = take_picture(resolve(ours), settings)
    again = take_picture(resolve(scene), settings, library)
    np.testing.assert_array_equal(first.image, again.image)
    assert np.abs(first.image.astype(int) - between.image).mean() > 5
    semantic, instance = first.passes["semantic"], first.passes["instance"]
    assert set(np.unique(semantic)) <= set(range(7))
    assert {1, 2, 5} <= set(np.unique(semantic))
    np.testing.assert_array_equal(semantic == 5, (instance > 0) & (instance < 200))
    np.testing.assert_array_equal(semantic == 6, instance >= 300)


def test_paint_is_the_scenes_and_glass_its_own(scene: Scene, library: Library) -> None:
    mesh = renderer.studio(library).assets.cars[0]
    kinds = {m.name.split(".")[0]: {node.bl_idname for node in m.node_tree.nodes} for m in mesh.materials}
    assert "ShaderNodeObjectInfo" in kinds["paint"]
    assert "ShaderNodeBsdfPrincipled" in kinds["glass"]
    assert "ShaderNodeObjectInfo" not in kinds["glass"]


def test_the_sky_is_turned_to_the_sun_and_as_bright_as_ours(scene: Scene, folder: Path, library: Library) -> None:
    sky = prepare_sky(read_sky(folder / "skies" / "evening.hdr"), library.assets.skies[0].sun_azimuth_rad)
    clear = scene.model_copy(update={"air": scene.air.model_copy(update={"visibility_m": 1e6, "overcast": 0.0})})
    light = daylight(clear, clear.camera.height_m)
    upper = hang(sky, clear, light)[:, HORIZON:]
    assert LUMINANCE @ irradiance(upper) == pytest.approx(LUMINANCE @ irradiance(light.sky[:, HORIZON:]), rel=0.02)
    row = upper.sum(axis=0)[np.unravel_index(upper.sum(axis=0).argmax(), upper.shape[1:])[0]]
    brightest = AZIMUTH_RAD[np.flatnonzero(row > 0.95 * row.max())].mean()
    apart = np.angle(np.exp(1j * (brightest - scene.light.sun_azimuth_rad)))
    assert abs(np.rad2deg(apart)) < 3


def test_a_file_that_changed_after_the_check_is_noticed(folder: Path, library: Library, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "copy")
    (tmp_path / "copy" / "roads" / "brick_albedo.png").write_bytes(b"other")
    with pytest.raises(FormatError, match=r"roads/brick: its files have changed since they were checked"):
        renderer.studio(Library(str(tmp_path / "copy"), library.assets))


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FolderCheck]:
    """A folder in which everything is wrong, each in its own way."""
    root = tmp_path_factory.mktemp("bad")
    for kind in ("cars", "trees", "roads", "terrains", "skies", "pedestrians"):
        (root / kind).mkdir()
    for kind, name, size_m, z_m in (
        ("cars", "centimetres", (180, 420, 150), 75),
        ("cars", "sideways", (4.2, 1.8, 1.5), 0.75),
        ("cars", "hovering", (1.8, 4.2, 1.5), 0.95),
        ("cars", "clay", (1.8, 4.2, 1.5), 0.75),
        ("cars", "photo", (1.8, 4.2, 1.5), 0.75),
        ("trees", "floating", (0.2, 0.2, 3), 2.5),
        ("pedestrians", "giant", (0.4, 0.3, 170), 85),
        ("pedestrians", "flying", (0.4, 0.3, 1.7), 1.25),
        ("pedestrians", "stiff", (0.4, 0.3, 1.7), 0.85),
        ("pedestrians", "lame", (0.4, 0.3, 1.7), 0.85),
        ("pedestrians", "lame.2", (0.4, 0.3, 1.7), 0.85),
    ):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        coat = example.material({"cars": "paint", "trees": "bark", "pedestrians": "upper"}[kind], (1, 1, 1))
        example.box("body", size_m, (0, 0, z_m), coat)
        if name == "clay":
            bpy.context.object.modifiers.new("fine", "SUBSURF").levels = 7
        if name == "photo":
            Image.new("RGB", (8, 8)).save(root / "decal.png")
            coat.node_tree.nodes.new("ShaderNodeTexImage").image = bpy.data.images.load(str(root / "decal.png"))
        bpy.data.libraries.write(str(root / kind / f"{name}.blend"), {bpy.context.object})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.data.libraries.write(str(root / "cars" / "empty.blend"), {bpy.data.objects.new("nothing", None)})
    (root / "cars" / "broken.glb").write_text("glTF")
    (root / "cars" / "broken.fbx").write_text("")
    example.texture(root / "roads", "small_", (1, 1, 1), 128)
    example.texture(root / "roads", "half_", (1, 1, 1), 256)
    (root / "roads" / "half_roughness.png").rename(root / "roads" / "half_ruoghness.png")
    example.texture(root / "terrains", "wide_", (1, 1, 1), 256)
    Image.new("RGB", (512, 256)).save(root / "terrains" / "wide_albedo.png")
    (root / "terrains" / "wide_normal.png").write_text("no picture")
    Image.new("RGB", (64, 64)).save(root / "skies" / "square.png")
    example.sky(root / "skies" / "dome.hdr", 64)
    picture = bpy.data.images.new("square", 64, 64, float_buffer=True)
    picture.file_format, picture.filepath_raw = "HDR", str(root / "skies" / "square.hdr")
    picture.save()
    (root / "assets.yaml").write_text(
        "cars: {bus: {wheelbase_m: 3, track_m: 2, wheel_radius_m: 0.5}}\n"
        "things: {stiff: {stride_m: 1}, nobody: {stride_m: 1}}"
    )
    yield check_folder(root)
    renderer.opened.cache_clear()


@pytest.mark.parametrize(
    "expected",
    [
        "cars/centimetres.blend: expected a length (along y) of 2.5 to 20 m, got 420 m; modelled in centimetres?",
        "cars/sideways.blend: expected a length (along y) of 2.5 to 20 m, got 1.8 m",
        "cars/sideways.blend: expected its front towards +y, got 4.20 m by x, 1.80 m by y",
        "cars/hovering.blend: expected its wheels on z = 0, got its lowest point at 0.20 m",
        "cars/clay.blend: expected at most 15,000 triangles, got 196,608; decimate it",
        "cars/photo.blend: expected its pictures packed (File > External Data > Pack Resources), got ",
        "cars/empty.blend: expected a mesh, found no face in it",
        "cars/broken.glb: cannot read it: ",
        "trees/floating.blend: expected its trunk to begin at z = 0, got its lowest point at 1.00 m",
        "roads/small_albedo.png: expected at least 256 px, got 128",
        "roads/half: expected albedo, roughness and normal, got no roughness (half_albedo.png, half_normal.png)",
        "terrains/wide_albedo.png: expected a square picture, got 512x256",
        "terrains/wide_normal.png: cannot read it: ",
        "skies/square.hdr: expected a picture twice as wide as high (equirectangular), got 64x64",
        "pedestrians/giant.blend: expected a height of 0.2 to 3 m, got 170 m; modelled in centimetres?",
        "pedestrians/flying.blend: expected its lowest point at z = 0, got it at 0.40 m",
        "pedestrians/stiff.blend: expected things.stiff.stride_m in assets.yaml with a cycle of poses, got one pose",
        "pedestrians/lame.blend: expected the poses 0 to 2, got no lame.1",
        "assets.yaml: things.nobody: expected the name of a file in pedestrians/, cyclists/",
        "assets.yaml: cars.bus: expected the name of a file in cars/",
    ],
)
def test_each_problem_is_named(bad: FolderCheck, expected: str) -> None:
    assert sum(problem.startswith(expected) for problem in bad.problems) == 1, "\n".join(bad.problems)


def test_what_has_no_meaning_is_listed_and_what_is_right_is_kept(bad: FolderCheck) -> None:
    unused = {line.split(":")[0] for line in bad.warnings}
    assert unused == {"cars/broken.fbx", "roads/half_ruoghness.png", "skies/square.png", "decal.png"}
    assert [row.name for row in bad.rows] == ["dome"]
