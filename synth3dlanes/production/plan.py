"""What a run is asked to make: samples of a recipe, where, and by how many workers."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from synth3dlanes.dataset.description import recipe_text
from synth3dlanes.dataset.destination import Destination
from synth3dlanes.dataset.write import Shard
from synth3dlanes.draw.makers import check_way
from synth3dlanes.params.cameras import black_pictures
from synth3dlanes.production.devices import WorkerSlots, resolve_device
from synth3dlanes.production.forecast import Forecast, forecast, measured
from synth3dlanes.production.recipe import EncodedSample, Recipe, make_sample
from synth3dlanes.production.workers import Limits
from synth3dlanes.scene.settings import MAX_SAMPLES, SPLIT_NAME
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.machine import renderers_here
from synth3dlanes.system.words import counted

SHARD_SIZE = 1000


@dataclass(frozen=True)
class Plan:
    """Samples 0 to n - 1 of the recipe's split, in the folder or at the URL `out`. `workers` 0 means one per core.
    `part` (i, k) means part i of k, counted from 1. Without `limits`, the time that a worker may take depends on the
    size of the images."""

    out: str | Path
    n: int
    recipe: Recipe
    workers: int = 0
    part: tuple[int, int] = (1, 1)
    limits: Limits | None = None
    slots: WorkerSlots = field(default_factory=WorkerSlots)
    shard_size: int = SHARD_SIZE
    maker: Callable[[Recipe, int], EncodedSample] = make_sample

    def __post_init__(self) -> None:
        (part, parts), split = self.part, self.recipe.scenes.split
        problems = [
            *([] if 0 <= self.n <= MAX_SAMPLES else [f"n: expected 0 to {MAX_SAMPLES}, got {self.n}"]),
            *([] if self.workers >= 0 else [f"workers: expected 0 or more, got {self.workers}"]),
            *([] if re.fullmatch(SPLIT_NAME, split) else [f"split: expected letters, digits, - and _, got {split!r}"]),
            *([] if 1 <= part <= parts else [f"part: expected i/n with 1 <= i <= n, got {part}/{parts}"]),
        ]
        if problems:
            raise InputError(*problems)
        check_way(self.recipe.scenes.params.motion, self.recipe.scenes.shots)

    @property
    def destination(self) -> Destination:
        return Destination(self.out)

    def shards(self) -> dict[int, Shard]:
        """The shards of this part by number, relative to the data set."""
        part, parts = self.part
        numbers = range(part - 1, math.ceil(self.n / self.shard_size), parts)
        first = self.shard(0)
        return {number: replace(first, number=number) for number in numbers}

    def shard(self, number: int) -> Shard:
        """Any shard of the split, relative to the data set."""
        return Shard(
            Path(self.recipe.scenes.split), number, self.shard_size, self.recipe.names, recipe_text(self.description())
        )

    def missing(self) -> dict[int, list[int]]:
        """The indices of the missing samples, by shard."""
        destination = self.destination
        return {number: destination.missing(shard, self.n) for number, shard in self.shards().items()}

    def n_missing(self) -> int:
        """The number of missing samples. In a folder, shards that have not begun are counted without being listed."""
        begun = self.destination.begun(self.recipe.scenes.split, self.shards())
        return sum(
            len(self.destination.missing(shard, self.n)) if number in begun else len(shard.indices(self.n))
            for number, shard in self.shards().items()
        )

    def text(self) -> str:
        """The plan as one line of text."""
        (part, parts), recipe, settings = self.part, self.recipe, self.recipe.settings
        told = [
            f"{self.destination.place}/{recipe.scenes.split}: {counted(self.n, 'sample')}",
            *filter(None, [recipe.scenes.shots.text(self.n)]),
            *([f"part {part} of {parts}"] if parts > 1 else []),
            f"seed {recipe.scenes.seed}",
            f"{recipe.sizes} {recipe.image_format}",
            f"{counted(settings.samples, 'sample')} per pixel",
            f"device {settings.device}",
            f"passes {', '.join(settings.passes) or 'none'}",
            *black_pictures(recipe.scenes.shots.cameras),
        ]
        return ", ".join(told)

    def expected(self, n_workers: int = 0) -> Forecast:
        """The time and the disk space that the missing samples will take.

        Raises InputError if the destination has samples of another recipe, DiskFullError if its disk has too little
        room.
        """
        # Checked before anything else is read there.
        self.destination.check_recipe(self.description(), self.recipe.scenes.split, self.n)
        missing = self.n_missing()
        here = None if self.destination.is_store else self.destination.folder
        before = None if here is None else measured(here, self.recipe.scenes.split)
        workers = n_workers or self.workers or renderers_here()
        found = forecast(self.recipe, missing, max(1, min(workers, missing)), before)
        if here is not None:
            found.require_room(here)
        return found

    def n_asked(self) -> int:
        """The number of samples of this part."""
        return sum(len(shard.indices(self.n)) for shard in self.shards().values())

    def only(self, number: int) -> "Plan":
        return replace(self, part=(number + 1, math.ceil(self.n / self.shard_size)))

    def description(self) -> dict[str, Any]:
        """The contents of `dataset.json` about the recipe and the layout."""
        return {**self.recipe.description(), "shard_size": self.shard_size}

    def resolved(self) -> "Plan":
        """The plan with the device and the number of workers of this machine. Raises MissingPackageError without
        Blender, InputError without the device asked for."""
        if self.maker is not make_sample:
            return self
        recipe, slots = resolve_device(self.recipe)
        return replace(self, recipe=recipe, slots=slots, workers=self.workers or slots.workers)

    def n_workers(self, n_tasks: int) -> int:
        """The number of workers that have work and room."""
        return max(1, min(self.workers or renderers_here(), n_tasks))
