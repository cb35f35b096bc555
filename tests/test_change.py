"""One factor of a scene changed: that one and no other."""

import math

import pytest

from synth3dlanes.scene.change import change_scene
from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.scene import Scene, Weather
from synth3dlanes.system.errors import InputError
from tests.map_scenes import FOUR_WAY, map_scene


def test_nothing_else_changes(hilly_scene: Scene) -> None:
    brighter = change_scene(hilly_scene, ["light.exposure=3"])
    assert brighter.light.exposure == 3
    assert brighter.model_copy(update={"light": hilly_scene.light}) == hilly_scene


def test_no_change_is_the_same_scene(hilly_scene: Scene) -> None:
    assert change_scene(hilly_scene, []) == hilly_scene


def test_degrees_become_radians(hilly_scene: Scene) -> None:
    assert change_scene(hilly_scene, ["camera.pitch_deg=3"]).camera.pitch_rad == math.radians(3)


def test_lists_take_indices_and_can_be_emptied(hilly_scene: Scene) -> None:
    changed = change_scene(hilly_scene, ["cars.1.color=[1, 0, 0]", "trees=[]"])
    assert changed.cars[1].color == (1, 0, 0)
    assert changed.cars[0] == hilly_scene.cars[0]
    assert changed.trees == ()


# A value that differs, by what a scene was drawn by: alone it would say what is not so.
DRAWN_BY = {"split": "any", "index": "7", "weather.kind": "rain", "weather.daytime": "night", "weather": "{kind: fog}"}


@pytest.mark.parametrize("path", DRAWN_BY)
def test_a_value_from_which_others_follow_is_refused(path: str, hilly_scene: Scene) -> None:
    with pytest.raises(InputError, match=rf"changes {path}[\w.]*: the scene was drawn by it, and other values follow"):
        change_scene(hilly_scene, [f"{path}={DRAWN_BY[path]}"])


def test_a_scene_may_be_of_any_weather(hilly_scene: Scene) -> None:
    rainy = hilly_scene.model_copy(update={"weather": Weather(kind="rain", rain=0.5)})
    assert change_scene(rainy, ["weather.kind=any", "weather.rain=1"]).weather == Weather(rain=1)
    assert change_scene(rainy, ["weather.rain=1"]).weather.kind == "rain"


def test_a_speed_that_follows_from_a_track_is_refused() -> None:
    shot = Shot(n_frames=2, fps=1, speed_m_s=5.0, track=((0.0, 0.0), (1.0, 5.0)))
    driving = map_scene(FOUR_WAY, 20.0, shot=shot)
    with pytest.raises(InputError, match=r"changes shot\.speed_m_s: follows from shot\.track"):
        change_scene(driving, ["shot.speed_m_s=9"])
    assert change_scene(driving, ["shot.speed_m_s=9", "shot.track=[[0, 0], [1, 9]]"]).shot.speed_m_s == 9


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("light.exposur=3", "changes light.exposur: unknown key exposur; did you mean exposure?"),
        ("lihgt.exposure=3", "changes lihgt.exposure: unknown key lihgt; did you mean light?"),
        ("cars.99.gloss=1", "changes cars.99.gloss: unknown key 99"),
        ("light.exposure", "changes light.exposure: expected path=value"),
        ("light.exposure=-1", "changes light.exposure: expected more than 0, got -1"),
        ("light.exposure=[1", "changes light.exposure: line 1: not YAML: "),
        ("camera.pitch_deg=flat", "changes camera.pitch_deg: expected degrees, got 'flat'"),
    ],
)
def test_a_mistake_is_one_line(change: str, expected: str, hilly_scene: Scene) -> None:
    with pytest.raises(InputError) as error:
        change_scene(hilly_scene, [change])
    assert str(error.value).startswith(expected)
    assert "\n" not in str(error.value)
