"""One factor of a scene changed: that one and no other."""

import math

import pytest

from synth3dlanes.change import change_scene
from synth3dlanes.errors import InputError
from synth3dlanes.scene import Scene


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
