"""Is each scene the one that dataset.json draws for its place? Drawing it again.

A set dealt anew by `split` keeps in scene.json the seed, split and index that a scene was drawn for, and is drawn
again for those; the scenes of `twins` are, too, and then get the recorded change. Which scene of its source a sample of
such a set is cannot be told: the source may lack some. One scene in two places is found all the same (`Report`).
"""

import json
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import yaml
from pydantic import BeforeValidator, ConfigDict, Field, ValidationError

from synth3dlanes import __version__
from synth3dlanes.assets.catalogue import Assets
from synth3dlanes.change import change_scene
from synth3dlanes.dataset.description import DESCRIPTION
from synth3dlanes.dataset.format import SCENE
from synth3dlanes.errors import FormatError, InputError
from synth3dlanes.params import Params
from synth3dlanes.sample import sample_scene
from synth3dlanes.scene import Scene
from synth3dlanes.schema import Part, validation_problems
from synth3dlanes.validate.documents import NAMED_AT_MOST, differences, some
from synth3dlanes.validate.findings import Problem

# More samples than these are not named one by one where no sample fits dataset.json.
MANY = 20


class Derived(Part):
    """How a data set was made of another: dealt anew (`cut`), or with one factor changed (`of`, `vary`, `values`);
    and how that other one was made, if of a third."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    cut: str = ""
    of: str = ""
    vary: str = ""
    values: tuple[str, ...] = ()
    derived: "Derived | None" = None

    def changes(self, split: str) -> list[str]:
        """What was changed in the scenes of a split since they were drawn, first to last; see `change_scene`."""
        before = self.derived.changes((self.cut or self.of).rpartition("/")[2]) if self.derived else []
        if not self.vary:
            return before
        number = split.removeprefix("twin_")
        if not (number.isdecimal() and 1 <= int(number) <= len(self.values)):
            raise InputError(f"expected splits twin_1 to twin_{len(self.values)}, got {split}")
        return [*before, f"{self.vary}={self.values[int(number) - 1]}"]


def _in_order(document: Any) -> Any:
    """Own assets as scenes have them: dataset.json has them by name, in order."""
    if not isinstance(document, dict):
        return document
    return {kind: tuple(own.values()) if isinstance(own, dict) else own for kind, own in document.items()}


class Origin(Part):
    """What the scenes of a data set were drawn from by its dataset.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    seed: Annotated[int, Field(ge=0)]
    params: Params
    assets: Annotated[Assets, BeforeValidator(_in_order)] = Assets()
    derived: Derived | None = None

    def fault(self, scene: Scene, split: str, index: int) -> str:
        """How the scene of a sample differs from the one drawn again for it, in a line; "" where it does not."""
        try:
            drawn = self._drawn(scene, split, index)
        except (InputError, ValueError, LookupError, ArithmeticError) as error:
            return f"expected to draw it again, got {' '.join(str(error).split())}"
        if scene == drawn:
            return ""
        return some(list(differences(drawn.model_dump(mode="json"), scene.model_dump(mode="json"))))

    def _drawn(self, scene: Scene, split: str, index: int) -> Scene:
        if self.derived is None:
            return sample_scene(self.params, self.seed, split, index, self.assets)
        drawn = sample_scene(self.params, self.seed, scene.split, scene.index, self.assets)
        return change_scene(drawn, self.derived.changes(split))


def read_origin(description: Mapping[str, Any]) -> Origin:
    """What a dataset.json says of scenes; raise FormatError with what is wrong in one line."""
    try:
        return Origin.model_validate(description)
    except ValidationError as error:
        raise FormatError(some([line.removeprefix(": ") for line in validation_problems(error, "")])) from None
    except yaml.YAMLError as error:
        raise FormatError(f"params: {' '.join(str(error).split())}") from None


def made_otherwise(recipes: Mapping[str, str], recipe: str) -> Iterator[Problem]:
    """Where shards were made from another recipe than that of dataset.json; "" are those that do not say from which."""
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
    """A problem for each of `n` samples whose scene is not the one drawn again: `faults` has its differences by name.
    One for all of them where another version drew them, or dataset.json is to blame: its shards say so, or none says
    otherwise and no sample fits."""
    example = next((f"{name}: {fault}" for name, fault in faults.items()), "")
    is_edited = any(made not in ("", recipe) for made in recipes.values())
    is_unsure = not any(recipes.values()) and len(faults) == n
    if faults and generator != __version__:
        reason = f"made by version {generator}, which drew other scenes than this one, {__version__}, for {len(faults)}"
        yield Problem(DESCRIPTION, "", f"{reason} of {n} samples: validate it with that version; {example}")
    elif len(faults) > NAMED_AT_MOST if is_edited else is_unsure and len(faults) > MANY:
        yield Problem(DESCRIPTION, "", f"draws other scenes than {len(faults)} of {n} samples have; {example}")
    else:
        for name, fault in faults.items():
            yield Problem(name, "", f"{SCENE}: not what {DESCRIPTION} draws: {fault}")
