"""Twins differ in one factor, and in nothing that this factor does not touch."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.params.params import load_params
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe, scene_json
from synth3dlanes.production.run import generate
from synth3dlanes.production.twins import twin_recipes
from synth3dlanes.scene.scene import Scene, from_json
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import InputError
from synth3dlanes.validate.origin import Origin
from tests import fake_samples
from tests.thorough import first

FEW = ["cars.n=4", "trees.n=5", "road.topology={1: 1, 4: 1}"]
FEW += [f"roadside.n_{name}=0" for name in ("houses", "halls", "blocks", "gantries", "bridges")]


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A split of three scenes without real images."""
    out = tmp_path_factory.mktemp("twins") / "d"
    generate(Plan(out, 3, fake_samples.recipe(), workers=1, maker=fake_samples.make), lambda event: None)
    return f"{out}/train"


def without(scene: Scene, group: str) -> str:
    return scene.model_dump_json(exclude={group})


def test_a_twin_is_its_scene_but_for_one_factor(source: str) -> None:
    recipes = twin_recipes(source, "light.exposure=1,2.5", "cpu")
    assert [recipe.scenes.split for recipe in recipes] == ["twin_1", "twin_2"]
    for index in range(3):
        original = from_json(Reader(source).raw(index)["scene.json"], "")
        for recipe, exposure in zip(recipes, (1, 2.5), strict=True):
            twin = recipe.scene(index)
            assert twin.light == original.light.model_copy(update={"exposure": exposure})
            assert without(twin, "light") == without(original, "light")
            assert from_json(scene_json(recipe, index), "") == twin


def test_twins_share_a_data_set_that_generate_does_not_continue(source: str) -> None:
    first, second = (recipe.description() for recipe in twin_recipes(source, "cars=[],[]", "cpu"))
    assert first == second
    assert first["derived"] == {"of": source, "vary": "cars", "values": ["[]", "[]"]}
    assert {**first, "derived": None} == {**fake_samples.recipe().description(), "derived": None}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Recipe]:
    """A split of three drawn scenes in all weather, without real images."""
    out = tmp_path_factory.mktemp("weather") / "d"
    recipe = Recipe(Scenes(load_params("streets", FEW), 5), RenderSettings(device="cpu"), "png")
    generate(Plan(out, 3, recipe, workers=1, maker=fake_samples.make_labelled), lambda event: None)
    return f"{out}/train", recipe


# Parameters from which others follow, or that no scene has, with two values.
FOLLOWED = {
    "weather.kind": ("clear", "rain"),
    "weather.daytime": ("day", "night"),
    "road.n_lanes": (2, 4),
    "road.n_oncoming": (0, 3),
    "road.topology": (1, 4),
    "camera.lane": (1, 2),
    "camera.y_m": (-70, -30),
    "cars.n": (0, 3),
    "roadside.lamps": ("none", "both"),
    "camera.horizontal_fov_deg": (40, 70),
}


@pytest.mark.parametrize("path", first(5, FOLLOWED))
def test_what_follows_from_a_parameter_is_drawn_as_with_this_parameter_from_the_start(
    drawn: tuple[str, Recipe], path: str
) -> None:
    (source, recipe), values = drawn, FOLLOWED[path]
    twins = []
    recipes = twin_recipes(source, f"{path}={values[0]},{values[1]}", "cpu")
    for twin, value in zip(recipes, values, strict=True):
        expected = replace(recipe.scenes, params=load_params("streets", [*FEW, f"{path}={value}"]))
        twins.append([twin.scene(index) for index in range(2)])
        assert twins[-1] == [sample_scene(expected, index) for index in range(2)]
        origin = Origin.model_validate(json.loads(json.dumps(twin.description())))
        assert [origin.fault(scene, twin.scenes.split, i) for i, scene in enumerate(twins[-1])] == [""] * 2
    assert twins[0] != twins[1]
    if path.startswith("weather."):
        assert all(one != other for one, other in zip(*twins, strict=True))
        assert all((one.road, one.cars) == (other.road, other.cars) for one, other in zip(*twins, strict=True))


@pytest.mark.parametrize(
    ("vary", "expected"),
    [
        ("light.exposur=1", "vary light.exposur: unknown key exposur; did you mean exposure?"),
        ("light.exposure", "vary light.exposure: expected path=value,value,..."),
        ("light.exposure=", "vary light.exposure=: expected path=value,value,..."),
        ("light.exposure=1,-2", "vary light.exposure: expected more than 0, got -2"),
        ("light.exposure=[1", "vary light.exposure"),
        ("camera.pitch_deg=0,99", "vary camera.pitch_deg: expected numbers in [-30, 60]"),
        ("air.visibility_m=5,1000", "vary air.visibility_m: expected numbers in [20, 1e+06]"),
        ("weather.kind=foggy", "vary weather.kind: expected one of any, clear, cloudy, fog, rain, snow, got 'foggy'"),
        ("road.n_lanes=2,9", "vary road.n_lanes: expected integers from 1 to 8"),
        ("road.n_lanes=[1, 2]", "vary road.n_lanes: expected a constant, got [1, 2]"),
        ("road.exit_angle_rad=0.1", "vary road.exit_angle_rad: other values follow from it; expected one value of"),
        ("road={}", "vary road: other values follow from it"),
        ("camera={}", "vary camera: other values follow from it"),
        ("index=3", "vary index: other values follow from it"),
        ("shot.frame=1", "vary shot.frame: other values follow from it"),
        ("shot.speed_m_s=1", "vary shot.speed_m_s: other values follow from it"),
        ("assets={}", "vary assets: other values follow from it"),
        ("town.junction=t", "vary town.junction: has no effect on scenes such as the first"),
        ("motion.host_speed_m_s=10", "vary motion.host_speed_m_s: has no effect on scenes such as the first"),
        ("cars.color=0.3", "vary cars.color: has no effect on scenes such as the first"),
        ("weather={kind: fog}", "vary weather.kind: the scene was drawn by it"),
    ],
)
def test_what_cannot_be_drawn_again(drawn: tuple[str, Recipe], vary: str, expected: str) -> None:
    with pytest.raises(InputError, match=re.escape(expected)) as caught:
        twin_recipes(drawn[0], vary, "cpu")
    assert len(caught.value.problems) == 1


def test_changed_scenes_are_not_drawn_again(drawn: tuple[str, Recipe], tmp_path: Path) -> None:
    darker = twin_recipes(drawn[0], "light.exposure=1", "cpu")[0]
    generate(Plan(tmp_path / "t", 2, darker, workers=1, maker=fake_samples.make_labelled), lambda event: None)
    with pytest.raises(InputError, match="expected scenes as they were drawn, got changed ones"):
        twin_recipes(f"{tmp_path}/t/twin_1", "weather.kind=rain", "cpu")
    assert twin_recipes(f"{tmp_path}/t/twin_1", "camera.height_m=1.5", "cpu")


@pytest.mark.thorough
@pytest.mark.render
def test_rendered_twins(tmp_path: Path) -> None:
    plan = Plan(tmp_path / "d", 1, fake_samples.recipe(), workers=1)
    assert generate(plan, lambda event: None).exit_code == 0
    original = Reader(f"{tmp_path}/d/train").raw(0)
    kept = float(from_json(original["scene.json"], "").light.exposure)
    images = []
    for recipe in twin_recipes(f"{tmp_path}/d/train", f"light.exposure={kept},{kept / 3}", "cpu"):
        assert generate(Plan(tmp_path / "t", 1, recipe, workers=1), lambda event: None).exit_code == 0
        reader = Reader(f"{tmp_path}/t/{recipe.scenes.split}")
        assert reader.raw(0)["labels.json"] == original["labels.json"]
        images.append(reader.image(0))
    np.testing.assert_array_equal(images[0], Reader(f"{tmp_path}/d/train").image(0))
    assert images[1].mean() < 0.8 * images[0].mean()
