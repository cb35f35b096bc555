"""Check that each scene is the one that dataset.json describes, by drawing it again.

In a data set made by `split`, scene.json keeps the seed, split and index that the scene was drawn for, and it is drawn
again with those; so are the scenes of `twins`, to which the recorded change is then applied. Which scene of the source
a sample of such a set must have is not known: the source may lack some. `ValidationReport` finds duplicate scenes.
"""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import ValidationError

from synth3dlanes import __version__
from synth3dlanes.dataset.description import DESCRIPTION
from synth3dlanes.dataset.format import SCENE
from synth3dlanes.dataset.scenes import Provenance
from synth3dlanes.draw.sample import draw_world, sample_scene, world_again, world_in_shot
from synth3dlanes.production.recipe import Condition, belongs_to
from synth3dlanes.production.twins import changed_world
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.schema import Excerpt, validation_problems
from synth3dlanes.validate.findings import NAMED_AT_MOST, Problem, differences, some


class Derivation(Excerpt):
    """How a data set was derived from another: split again (`cut`), or with one factor changed (`of`, `vary`,
    `values`). `derived` says the same of that other data set, if it was derived too."""

    cut: str = ""
    of: str = ""
    vary: str = ""
    values: tuple[str, ...] = ()
    derived: "Derivation | None" = None

    def changes(self, split: str) -> list[tuple[str, str]]:
        """All changes to the scenes of a split since they were drawn, in order: paths and JSON values."""
        before = self.derived.changes((self.cut or self.of).rpartition("/")[2]) if self.derived else []
        if not self.vary:
            return before
        number = split.removeprefix("twin_")
        if not (number.isdecimal() and 1 <= int(number) <= len(self.values)):
            raise InputError(f"expected splits twin_1 to twin_{len(self.values)}, got {split}")
        return [*before, (self.vary, self.values[int(number) - 1])]


class Origin(Provenance):
    """What a data set's scenes were drawn from and how they were changed since, according to its dataset.json."""

    derived: Derivation | None = None

    def fault(self, scene: Scene, split: str, index: int) -> str:
        """How a sample's scene differs from the one drawn again, in one line; "" if they are equal. A scene on a map
        cannot be drawn again without its file; its map must be a part of the file's."""
        if self.map is not None:
            digest = scene.roads.digest
            return "" if digest == self.map.digest else f"map.digest: expected {self.map.digest}, got {digest}"
        try:
            drawn = self.drawn(scene, split, index)
        except (InputError, ValueError, LookupError, ArithmeticError) as error:
            return f"cannot be drawn again: {' '.join(str(error).split())}"
        if scene == drawn:
            return ""
        return some(list(differences(drawn.model_dump(mode="json"), scene.model_dump(mode="json"))))

    def drawn(self, scene: Scene, split: str, index: int) -> Scene:
        """The scene of a sample, drawn again; of derived data sets `scene`, which lies there, says for what it was
        drawn."""
        if self.derived is None and self.where is not None:
            return self._drawn_where(Condition(self.where), scene.index, split, index)
        if self.derived is None:
            return sample_scene(self.scenes(split), index)
        scenes = self.scenes(scene.split)
        again = world_again(scenes, scene).scene
        for path, value in self.derived.changes(split):
            again = changed_world(again, scenes, path, value).scene
        return again

    def _drawn_where(self, condition: Condition, number: int, split: str, index: int) -> Scene:
        """The scene `number` as a sample shows it. Raises InputError if it was not drawn for the sample or does not fit
        the condition."""
        scenes, place = self.scenes(split), self.shots.place(index)
        if not belongs_to(number, place.scene):
            raise InputError(f"index: expected one of the scenes of sample {place.scene}, got {number}")
        world = draw_world(scenes, number)
        if not condition.fits(scenes, world):
            raise InputError(f"expected a scene where {condition.query}, got another")
        return world_in_shot(scenes, world, place).scene


def read_origin(description: Mapping[str, Any]) -> Origin:
    """The origin recorded in a dataset.json; raise FormatError with all problems in one line."""
    try:
        return Origin.model_validate(description)
    except ValidationError as error:
        raise FormatError(some([line.removeprefix(": ") for line in validation_problems(error, "")])) from None


def made_otherwise(recipes: Mapping[str, str], recipe: str) -> Iterator[Problem]:
    """Problems of shards made from another recipe than that of dataset.json; "" means that none is recorded."""
    wrong = {name: made for name, made in recipes.items() if made not in ("", recipe)}
    if wrong and len(wrong) == sum(1 for made in recipes.values() if made):
        name, made = next(iter(wrong.items()))
        yield Problem(DESCRIPTION, "", f"not what shard {name} was made from: {_recipes_differ(made, recipe)}")
        return
    for name, made in wrong.items():
        yield Problem(f"{name}.parquet", "", f"not made from what {DESCRIPTION} says: {_recipes_differ(recipe, made)}")


def _recipes_differ(expected: str, found: str) -> str:
    try:
        return some(list(differences(json.loads(expected), json.loads(found))))
    except ValueError:
        return "expected JSON, got something else"


def drawn_otherwise(
    faults: Mapping[str, str], n: int, generator: str, recipes: Mapping[str, str], recipe: str
) -> Iterator[Problem]:
    """A problem for each of the `n` samples whose scene differs from the one drawn again; `faults` maps names to
    differences. There is one problem for all of them if another version drew them, or if dataset.json was edited: the
    shards' recipes differ from it."""
    example = next((f"{name}: {fault}" for name, fault in faults.items()), "")
    if faults and generator != __version__:
        reason = f"made by version {generator}, which drew other scenes than this one, {__version__}, for {len(faults)}"
        yield Problem(DESCRIPTION, "", f"{reason} of {n} samples: validate it with that version; {example}")
    elif len(faults) > NAMED_AT_MOST and any(made not in ("", recipe) for made in recipes.values()):
        yield Problem(DESCRIPTION, "", f"draws other scenes than {len(faults)} of {n} samples have; {example}")
    else:
        for name, fault in faults.items():
            yield Problem(name, "", f"{SCENE}: not what {DESCRIPTION} draws: {fault}")
