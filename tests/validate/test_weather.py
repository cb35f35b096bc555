"""What follows from the weather and the time of day of a scene fits them."""

import json

import pytest

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.params.params import load_params
from synth3dlanes.params.weather import DAYTIMES, KINDS
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


def told(scene: Scene, own: frozenset[str] = frozenset()) -> str:
    return reasons(Evidence(resolve(scene), seen(ground_truth(scene)), own_values=own), "weather")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("daytime", DAYTIMES)
def test_what_is_drawn_fits_and_another_weather_does_not(kind: str, daytime: str) -> None:
    scene = sample_scene(scenes(f"weather.kind={kind}", f"weather.daytime={daytime}"), 1)
    assert told(scene) == ""
    if kind == "rain":
        lying = scene.model_copy(update={"weather": scene.weather.model_copy(update={"kind": "clear"})})
        assert "air.overcast: expected 0 to 0.2 (weather clear, " in told(lying)
        assert "air.overcast" not in told(lying, frozenset({"air.overcast"}))
    if daytime == "night":
        lying = scene.model_copy(update={"weather": scene.weather.model_copy(update={"daytime": "day"})})
        assert "light.sun_zenith_deg: expected 15 to 84 (weather " in told(lying)


def test_own_values_and_changes_of_twins_are_no_fault() -> None:
    recipe = Recipe(scenes("weather.daytime=night", "light.sun_zenith_deg=40"), RenderSettings(), "png")
    document = json.loads(json.dumps(recipe.description()))
    scene = recipe.scene(0)
    assert told(scene, Origin.model_validate(document).own_values("weather")) == ""
    left_open = Origin.model_validate(document | {"params": {**document["params"], "kept": []}})
    assert "light.sun_zenith_deg" in told(scene, left_open.own_values("weather"))
    twins = {"derived": {"of": "d/weather", "vary": "weather.headlights", "values": ["false"]}}
    own = Origin.model_validate(document | twins).own_values("twin_1")
    assert own == {"light.sun_zenith_deg", "weather.headlights"}
    dark = scene.model_copy(update={"weather": scene.weather.model_copy(update={"headlights": False})})
    assert told(dark, own) == ""
    assert "weather.headlights: expected 1 " in told(dark)
