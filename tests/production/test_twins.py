"""Twins differ in one factor, and in nothing that this factor does not touch."""

from pathlib import Path

import numpy as np
import pytest

from synth3dlanes.dataset.read import Reader
from synth3dlanes.errors import InputError
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import scene_json
from synth3dlanes.production.run import generate
from synth3dlanes.production.twins import twin_recipes
from synth3dlanes.scene import Scene, from_json
from tests import fake_samples


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
    ],
)
def test_what_cannot_be_varied(source: str, vary: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        twin_recipes(source, vary, "cpu")
    assert expected in str(caught.value)
    assert len(caught.value.problems) == 1


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
