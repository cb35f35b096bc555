"""What follows from the weather and the time of day of a scene fits them."""

import json
from collections.abc import Mapping

import pytest

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.params.distributions import Distribution
from synth3dlanes.params.groups import DAYTIMES, KINDS
from synth3dlanes.params.params import load_params
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.origin import Origin
from synth3dlanes.world.world import resolve
from tests.validate.examining import reasons, seen

FEW = ("cars.n=0", "trees.n=0", "road.topology=1")


def scenes(*changes: str) -> Scenes:
    return Scenes(load_params("diverse", [*FEW, *changes]), 3, "weather")


def told(scene: Scene, follows: Mapping[str, Distribution]) -> str:
    return reasons(Evidence(resolve(scene), seen(ground_truth(scene)), follows=follows), "weather")


def said(scene: Scene, *changes: str, without: str = "") -> str:
    """What is told of a scene by parameters with these changes, but for one key."""
    follows = load_params("diverse", changes).replaced(scene.weather.kind, scene.weather.daytime)
    return told(scene, {path: distribution for path, distribution in follows.items() if path != without})


@pytest.mark.parametrize("kind", ["any", *KINDS])
@pytest.mark.parametrize("daytime", ["any", *DAYTIMES])
def test_what_is_drawn_fits_and_another_weather_does_not(kind: str, daytime: str) -> None:
    scene = sample_scene(scenes(f"weather.kind={kind}", f"weather.daytime={daytime}"), 1)
    assert said(scene) == ""
    if kind == "rain":
        lying = scene.model_copy(update={"weather": scene.weather.model_copy(update={"kind": "clear"})})
        assert "air.overcast: expected 0 to 0.2 (weather clear, " in said(lying)
        assert "air.overcast" not in said(lying, without="air.overcast")
    if daytime == "night":
        lying = scene.model_copy(update={"weather": scene.weather.model_copy(update={"daytime": "day"})})
        assert "light.sun_zenith_deg: expected 15 to 84 (weather " in said(lying)


def test_the_ranges_are_those_that_the_scenes_were_drawn_from() -> None:
    changes = ("weather.kind=fog", "fog.visibility_m=[40, 60]", "fog.overcast=0.3")
    scene = sample_scene(scenes(*changes), 1)
    assert said(scene, *changes) == ""
    assert "air.visibility_m: expected 100 to 800 (weather fog, daytime any)" in said(scene)
    assert "air.overcast: expected 1 (weather fog, daytime any), got 0.3" in said(scene)


def test_own_values_and_changes_of_twins_are_no_fault() -> None:
    recipe = Recipe(scenes("weather.daytime=night", "light.sun_zenith_deg=40"), RenderSettings(), "png")
    document = json.loads(json.dumps(recipe.description()))
    scene = recipe.scene(0)
    assert told(scene, Origin.model_validate(document).follows(scene.weather, "weather")) == ""
    left_open = Origin.model_validate(document | {"params": {**document["params"], "kept": []}})
    assert "light.sun_zenith_deg" in told(scene, left_open.follows(scene.weather, "weather"))
    twins = {"derived": {"of": "d/weather", "vary": "weather.headlights", "values": ["false"]}}
    left = Origin.model_validate(document | twins).follows(scene.weather, "twin_1")
    assert recipe.scenes.params.replaced("any", "night").keys() - left.keys() == {
        "light.sun_zenith_deg",
        "weather.headlights",
    }
    dark = scene.model_copy(update={"weather": scene.weather.model_copy(update={"headlights": False})})
    assert told(dark, left) == ""
    assert "weather.headlights: expected 1 " in said(dark)
