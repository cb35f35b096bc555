"""Twins: the scenes of a split rendered again with one factor changed and nothing else; each value of the factor gives
a split.

Sample i shows the same world in every split, except for the factor. So a network whose answers differ between the
splits reacts to the factor alone. Labels are computed from the changed scene; if the factor does not affect them, their
bytes are equal.
"""

import json
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from synth3dlanes.assets.catalogue import BUILT_IN, Library
from synth3dlanes.assets.folder import require_assets
from synth3dlanes.change import change_scene
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import how_derived
from synth3dlanes.errors import InputError
from synth3dlanes.params import problems_of
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.settings import RenderSettings
from synth3dlanes.sources import read_scene, scenes_of
from synth3dlanes.world import World, resolve
from synth3dlanes.yaml_text import read_yaml


@dataclass(frozen=True)
class TwinRecipe(Recipe):
    """The recipe of the split `twin_k`: its sample i is sample i of `source` with value k at `path`."""

    source: str = ""
    path: str = ""
    values: tuple[str, ...] = ()

    def world(self, index: int) -> World:
        """The world of the changed scene, which keeps the seed, split and index that it was drawn for."""
        value = self.values[int(self.scenes.split.removeprefix("twin_")) - 1]
        return resolve(change_scene(read_scene(_reader(self.source), index), [f"{self.path}={value}"]))

    def description(self) -> dict[str, Any]:
        """The description of the recipe, with the factor that was varied."""
        varied = {"of": self.source, "vary": self.path, "values": list(self.values)}
        return {**super().description(), "derived": {**varied, **how_derived(_reader(self.source))}}


@lru_cache(maxsize=1)
def _reader(source: str) -> Reader:
    """The reader of the source, one for all samples of a process, because opening it reads every index."""
    return Reader(source)


def twin_recipes(source: str, vary: str, device: str, library: Library = BUILT_IN) -> list[TwinRecipe]:
    """A recipe for every value in `vary`, such as `light.exposure=1,2,3`, rendered as the source was.

    Raises InputError if a value does not fit the first scene of the source, or is out of the bounds of the parameter of
    that name, and if `library` is not the one that the source was made with.
    """
    path, equals, text = (part.strip() for part in vary.partition("="))
    values, problems = read_yaml(f"[{text}]", f"vary {path}")
    if not equals or problems or not values:
        raise InputError(*(problems or [f"vary {vary}: expected path=value,value,..."]))
    _reader.cache_clear()  # what lies there may have changed since earlier twins
    reader = Reader(source)
    render, shown = reader.description["render"], tuple(json.dumps(value) for value in values)
    settings = RenderSettings(int(render["samples"]), tuple(render["passes"]), device)
    require_assets(read_scene(reader, 0).assets, library, source)
    scenes, image_format = scenes_of(reader), str(reader.description["image_format"])
    recipes = [
        TwinRecipe(replace(scenes, split=f"twin_{k}"), settings, image_format, library, reader.url, path, shown)
        for k in range(1, len(shown) + 1)
    ]
    # A camera file has bounds of its own, which those of a scene are.
    is_of_file = bool(scenes.shots.cameras) and path.startswith("camera.")
    for recipe, value in zip(recipes, values, strict=True):
        try:
            recipe.scene(0)
        except InputError as error:
            problems += [line.removeprefix("changes ") for line in error.problems]
        else:
            problems += [] if is_of_file else problems_of(scenes.params, path, value)
    if problems:
        raise InputError(*(f"vary {line}" for line in dict.fromkeys(problems)))
    return recipes
