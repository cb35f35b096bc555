"""Change single values of a scene and nothing else, as twins need: `light.exposure=3`.

No side effects.
"""

import json
import math
from collections.abc import Sequence
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.scene import Car, Scene, Thing
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import did_you_mean, problem_line, shown
from synth3dlanes.system.yaml_text import read_yaml

# What pydantic calls the limits of a number.
LIMITS = ("gt", "ge", "lt", "le")
MAX_DEG = 1e6
# Values that only tell how a scene was drawn, and what to change in their place.
RECORDS = {
    "split": "another scene has another one: draw it",
    "index": "another scene has another one: draw it",
    "town": "change what was drawn from it: map, roadside, cars",
    "weather.kind": "change air, surface.wetness, weather.rain and the like",
    "weather.daytime": "change light, sensor and weather.headlights",
}
# A record that tells nothing, which fits all values.
TELLS_NOTHING = {"weather.kind": "any", "weather.daytime": "any"}


def change_scene(scene: Scene, changes: Sequence[str]) -> Scene:
    """The scene with every change `path=value` applied; a path is e.g. `camera.pitch_deg` or `cars.0.color`.

    The value is YAML; angles whose key ends in `_deg` are in degrees. Raises InputError with one line per problem, also
    for a value from which others follow, which would no longer fit it.
    """
    changed = _changed(scene, changes)
    problems = [
        f"changes {path}: the scene was drawn by it, and other values follow from it; {instead}"
        for path, instead in RECORDS.items()
        for before in [value_at(scene, path)]
        if value_at(changed, path) not in (before, TELLS_NOTHING.get(path, before))
    ]
    problems += [
        f"changes {path}.speed_m_s: follows from {path}.track; change both"
        for (path, old), (_, new) in zip(_driving(scene), _driving(changed), strict=False)
        if new.track and new.track == old.track and new.speed_m_s != old.speed_m_s
    ]
    if problems:
        raise InputError(*problems)
    return changed


def _driving(scene: Scene) -> list[tuple[str, Shot | Car | Thing]]:
    """The host and all that may move, by their paths."""
    moving = [(name, item) for name in ("cars", "things") for item in enumerate(getattr(scene, name))]
    return [("shot", scene.shot), *((f"{name}.{number}", item) for name, (number, item) in moving)]


def value_at(scene: Scene, path: str) -> Any:
    """The value at a path of groups and keys, such as `weather.kind`."""
    value: Any = scene
    for step in path.split("."):
        value = getattr(value, step)
    return value


def _changed(scene: Scene, changes: Sequence[str]) -> Scene:
    document = scene.model_dump(mode="json")
    problems: list[str] = []
    degrees: dict[str, Any] = {}
    for change in changes:
        path, equals, text = (part.strip() for part in change.partition("="))
        if not equals:
            problems.append(f"changes {change}: expected path=value")
            continue
        value, value_problems = read_yaml(text, f"changes {path}")
        problems += value_problems or _put(document, path, value, degrees)
    if problems:
        raise InputError(*problems)
    try:
        return Scene.model_validate_json(json.dumps(document), strict=True)
    except ValidationError as error:
        found = error.errors(include_url=False)
        raise InputError(*(f"changes {problem_line(_as_given(problem, degrees))}" for problem in found)) from None


def _as_given(problem: ErrorDetails, degrees: dict[str, Any]) -> ErrorDetails:
    """A problem of an angle that was given in degrees, with its numbers in degrees."""
    path = ".".join(str(step) for step in problem["loc"])
    if path not in degrees:
        return problem
    limits = {name: math.degrees(value) if name in LIMITS else value for name, value in problem.get("ctx", {}).items()}
    return {**problem, "loc": (path.removesuffix("_rad") + "_deg",), "input": degrees[path], "ctx": limits}


def _put(document: dict[str, Any], path: str, value: Any, degrees: dict[str, Any]) -> list[str]:
    """Set the value at a path. If it is an angle in degrees, record it in `degrees` by its path in radians."""
    *steps, last = path.split(".")
    place: Any = document
    for step in steps:
        keys = _keys(place)
        if step not in keys:
            return [_unknown(path, step, keys)]
        place = place[int(step) if isinstance(place, list) else step]
    keys = _keys(place)
    radians_key = last.removesuffix("_deg") + "_rad"
    if last.endswith("_deg") and radians_key in keys:
        if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < MAX_DEG:
            return [f"changes {path}: expected degrees, got {shown(value)}"]
        degrees[".".join([*steps, radians_key])] = value
        last, value = radians_key, math.radians(value)
    if last not in keys:
        return [_unknown(path, last, keys)]
    place[int(last) if isinstance(place, list) else last] = value
    return []


def _keys(place: Any) -> list[str]:
    if isinstance(place, list):
        return [str(number) for number in range(len(place))]
    return list(place) if isinstance(place, dict) else []


def _unknown(path: str, step: str, keys: list[str]) -> str:
    return f"changes {path}: unknown key {step}{did_you_mean(step, keys)}"
