"""Twins: the scenes of a split rendered again with one factor changed and nothing else; each value of the factor gives
a split.

Sample i shows the same world in every split, except for the factor and what follows from it. So a network whose answers
differ between the splits reacts to the factor alone. Labels are computed from the changed scene; if the factor does not
affect them, their bytes are equal.

A factor is a value of scene.json, which is changed in the scenes, or a parameter from which others follow. With that
parameter fixed the scenes are drawn again, from the same random streams: draws that do not follow from it stay equal.
"""

import json
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import how_derived
from synth3dlanes.dataset.scenes import provenance_of, read_scene, scenes_of
from synth3dlanes.draw.rules import ParameterRules
from synth3dlanes.draw.sample import Scenes, world_again
from synth3dlanes.params.params import fixed, is_parameter, problems_of
from synth3dlanes.production.job import Job, pictures_of
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Library
from synth3dlanes.scene.assets.folder import require_assets
from synth3dlanes.scene.change import change_scene
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.yaml_text import read_yaml
from synth3dlanes.world.world import World, resolve

# Parameters from which others follow, alone or all of a group: what stands beside a road and drives on it is placed by
# the road and by the host's place.
DECIDING = ("road", "town", "weather.kind", "weather.daytime", "camera.lane", "camera.y_m")
# What all scenes of a data set have in common with its dataset.json.
OF_DATA_SETS = ("format", "version", "split", "index", "shot", "map", "assets")


@dataclass(frozen=True)
class TwinRecipe(Recipe):
    """The recipe of the split `twin_k`: its sample i is sample i of `source` with value k at `path`."""

    source: str = ""
    path: str = ""
    values: tuple[str, ...] = ()

    def world(self, index: int) -> World:
        """The world of the changed scene, which keeps the seed, split and index that it was drawn for."""
        value = self.values[int(self.scenes.split.removeprefix("twin_")) - 1]
        return changed_world(read_scene(_reader(self.source), index), self.scenes, self.path, value)

    def description(self) -> dict[str, Any]:
        """The description of the recipe, with the factor that was varied."""
        varied = {"of": self.source, "vary": self.path, "values": list(self.values)}
        return {**super().description(), "derived": {**varied, **how_derived(_reader(self.source))}}


def changed_world(scene: Scene, scenes: Scenes, path: str, value: str) -> World:
    """The world of a scene, drawn from `scenes`, with this JSON value at the path."""
    if not is_drawn_again(scene, path):
        return resolve(change_scene(scene, [f"{path}={value}"]))
    group, key = path.split(".")
    return world_again(replace(scenes, params=fixed(scenes.params, group, key, json.loads(value))), scene)


def is_drawn_again(scene: Scene, path: str) -> bool:
    """Whether scenes are drawn again for a change at this path: of a parameter that decides others, or that no scene
    has as a value."""
    group, _, key = path.partition(".")
    is_value = hasattr(getattr(scene, group, None), key.replace("_deg", "_rad"))
    return is_parameter(group, key) and (not is_value or path in DECIDING or group in DECIDING)


@lru_cache(maxsize=1)
def _reader(source: str) -> Reader:
    """The reader of the source, one for all samples of a process, because opening it reads every index."""
    return Reader(source)


def twin_recipes(source: str, vary: str, device: str, library: Library = BUILT_IN) -> list[TwinRecipe]:
    """A recipe for every value in `vary`, such as `light.exposure=1,2,3`, rendered as the source was.

    Raises InputError if a value does not fit the first scene of the source, or is out of the bounds of the parameter of
    that name, if the source's pictures or roads would no longer be what its scenes say, and if `library` is not the one
    that the source was made with.
    """
    path, equals, text = (part.strip() for part in vary.partition("="))
    values, problems = read_yaml(f"[{text}]", f"vary {path}")
    if not equals or problems or not values:
        raise InputError(*(problems or [f"vary {vary}: expected path=value,value,..."]))
    _reader.cache_clear()  # what lies there may have changed since earlier twins
    reader = Reader(source)
    shown = tuple(json.dumps(value) for value in values)
    first = read_scene(reader, 0)
    require_assets(first.assets, library, source)
    scenes = scenes_of(reader)
    made = Job(**{**pictures_of(provenance_of(reader)), "device": device})
    again = is_drawn_again(first, path)
    if refused := _refusal(first, scenes, path):
        raise InputError(f"vary {path}: {refused}")
    recipes = [
        TwinRecipe(
            replace(scenes, split=f"twin_{k}"), made.settings, made.image_format, library, reader.url, path, shown
        )
        for k in range(1, len(shown) + 1)
    ]
    # A camera file's values are bounded by the scene, not by the parameters.
    is_of_file = bool(scenes.shots.cameras) and path.startswith("camera.")
    for recipe, value in zip(recipes, values, strict=True):
        unfit = [] if is_of_file and not again else problems_of(scenes.params, path, value)
        try:
            if not (again and unfit):
                recipe.scene(0)
        except InputError as error:
            problems += [line.removeprefix("changes ") for line in error.problems]
        else:
            problems += unfit
    if problems:
        raise InputError(*(f"vary {line}" for line in dict.fromkeys(problems)))
    return recipes


def _refusal(first: Scene, scenes: Scenes, path: str) -> str:
    """Why the factor at a path cannot be varied in scenes such as the first, "" if it can."""
    group = path.partition(".")[0]
    if not is_drawn_again(first, path):
        decides = path in (*DECIDING, "camera") or group in (*DECIDING, *OF_DATA_SETS)
        return "other values follow from it; expected one value of another group, or a parameter" if decides else ""
    # A part of a scene that it lacks has no parameters.
    is_used = path in ParameterRules(scenes.params).of(first) and getattr(first, group, first) is not None
    if not is_used or (group == "motion" and first.shot.n_frames == 1):
        return "has no effect on scenes such as the first of the source"
    if scenes.shots.cameras and group == "camera" and path not in DECIDING:
        return "expected scenes by the camera of the parameters, got those of camera files"
    if world_again(scenes, first).scene != first:
        return "other values follow from it; expected scenes as they were drawn, got changed ones"
    return ""
