"""Make samples of a data set again, as its `dataset.json` says, and compare them with what lies there.

Equal bytes need no more words: one kind of machine makes them. Of another kind of machine, or where something is wrong,
the members are read and compared layer by layer with the tolerances of `likeness`.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from synth3dlanes import __version__
from synth3dlanes.dataset.description import DESCRIPTION, Description
from synth3dlanes.dataset.format import SCENE, encode
from synth3dlanes.production.devices import WorkerSlots, resolve_device
from synth3dlanes.production.forecast import patience_s
from synth3dlanes.production.job import Job, pictures_of
from synth3dlanes.production.recipe import Recipe, take_picture
from synth3dlanes.production.workers import Limits, Pool
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.scene.assets.catalogue import Library
from synth3dlanes.scene.assets.folder import require_assets
from synth3dlanes.scene.settings import PASSES as ALL_PASSES
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.validate.integrity import Entry, read_sample
from synth3dlanes.validate.likeness import IDS, compare
from synth3dlanes.validate.origin import Origin
from synth3dlanes.validate.report import VERDICTS
from synth3dlanes.world.world import resolve

T = TypeVar("T")


class RemakeResult(NamedTuple):
    """What came of making a sample again: whether its bytes are equal, and how it differs otherwise."""

    name: str
    is_equal: bool
    faults: Sequence[str]

    @property
    def verdict(self) -> str:
        """One of the report's `VERDICTS`."""
        return VERDICTS[0 if self.is_equal else 2 if self.faults else 1]


@dataclass(frozen=True)
class RemakePlan:
    """How the samples of a data set are made again on this machine."""

    origin: Origin
    recipe: Recipe
    slots: WorkerSlots


def how_to_make(description: Description, origin: Origin | None, library: Library) -> RemakePlan:
    """How to make a data set's samples again. Raises InputError where this version, its assets or its dataset.json
    cannot, MissingPackageError without Blender."""
    if origin is None:
        raise InputError(f"rerender: {DESCRIPTION} does not say how its samples are made")
    if description.generator != __version__:
        raise InputError(
            f"rerender: made by version {description.generator}, and this one, {__version__}, makes other samples: "
            "use that version, or validate without"
        )
    require_assets(origin.assets, library, DESCRIPTION)
    job = Job(**pictures_of(origin), assets=library)
    try:
        return RemakePlan(origin, *resolve_device(job.recipe()))
    except InputError:
        # Pixels of another device agree within the tolerances.
        return RemakePlan(origin, *resolve_device(job.changed({"device": "auto"}).recipe()))


def some_of(entries: Sequence[T], n: int, seed: int) -> list[T]:
    """Some samples at random, in order: the same for equal seeds, and some more of them for a larger n."""
    chosen = np.random.default_rng(seed).permutation(len(entries))[:n]
    return [entries[i] for i in sorted(chosen)]


def make_again(making: RemakePlan, entries: Sequence[Entry], workers: int) -> Iterator[RemakeResult]:
    """Make samples again in worker processes, as `generate` does."""
    todo, limits = deque(entries), Limits(patience_s(making.recipe))
    with Pool(max(1, min(workers or making.slots.workers, len(todo))), limits, masks=making.slots.masks) as pool:
        while todo or pool.busy:
            while todo and pool.idle:
                entry = todo.popleft()
                pool.start(entry.name, _make, making.origin, making.recipe, entry)
            for outcome in pool.wait(1.0):
                failed = RemakeResult(outcome.task, False, [f"cannot be made again: {outcome.reason}"])
                yield outcome.value if outcome.status == "done" else failed


def _make(origin: Origin, recipe: Recipe, entry: Entry) -> RemakeResult:
    found, _ = read_sample(entry)
    try:
        scene = origin.drawn(scene_module.from_json(found[SCENE], SCENE), entry.split, entry.index)
    except (InputError, FormatError, ValueError, LookupError, ArithmeticError) as error:
        return RemakeResult(entry.name, False, [f"cannot be made again: {' '.join(str(error).split())}"])
    asked = recipe.settings
    passes = tuple(name for name in (*ALL_PASSES, "lidar") if name in asked.passes or name in IDS)
    world = resolve(scene)
    made = take_picture(world, replace(asked, passes=passes), recipe.library)
    kept = {name: pixels for name, pixels in made.passes.items() if name in asked.passes}
    text, quality = scene_module.to_json(scene), scene.sensor.jpeg_quality
    members = encode(replace(made, passes=kept), text, recipe.image_format, quality)
    faults = [f"made again: {fault}" for fault in compare(made, members, found)]
    return RemakeResult(entry.name, members == found, faults)
