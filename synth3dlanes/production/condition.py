"""Samples whose scenes fit a condition: each shows the first of the scenes drawn for it whose labels fit.

Sample n has SCENES_OF_ONE scenes to itself, those from n * SCENES_OF_ONE on (clip n, and moment n of a rig, likewise).
So what it shows depends on no other sample, and a set can be resumed, extended, and divided among workers.
"""

import re
from dataclasses import dataclass
from functools import lru_cache

from synth3dlanes.dataset.columns import PLACE_COLUMNS, numbers_of, table
from synth3dlanes.dataset.query import rows_where
from synth3dlanes.draw.sample import Scenes, draw_world, world_in_shot
from synth3dlanes.params.shots import ShotNumbers
from synth3dlanes.scene.settings import SCENES_OF_ONE, TRIES
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world.world import World

# The fewest scenes that the share of those that fit is estimated from.
PROBED = 30
# Columns that say nothing of a scene, and those that are known once it is rendered.
OF_FILES = ("key", "index", "sha256", *PLACE_COLUMNS)
OF_PICTURES = ("object_hidden_fraction", "n_visible_centerlines", "n_visible_delimiters")


@dataclass(frozen=True)
class Condition:
    """A query on the columns of the index (docs/format.md), as of `gallery --where`, and the most scenes to draw for a
    sample until one fits."""

    query: str
    tries: int = TRIES

    def __post_init__(self) -> None:
        if not 1 <= self.tries <= SCENES_OF_ONE:
            raise InputError(f"tries: expected 1 to {SCENES_OF_ONE}, got {self.tries}")
        for name in OF_PICTURES:
            if re.search(rf"\b{name}\b", self.query):
                raise InputError(f"where {self.query}: expected columns of scenes and labels, got {name} of pictures")

    def fits(self, scenes: Scenes, drawn: World) -> bool:
        """Whether a drawn scene fits, as its first view and frame by its first camera shows it. Raises InputError for a
        query that cannot be read."""
        world = world_in_shot(scenes, drawn, ShotNumbers(drawn.scene.index, 0, 0))
        row = {"key": "0", "index": 0, **numbers_of(world.scene, label(world, world.view))}
        found = table([row])
        known = [name for name in found.column_names if name not in (*OF_FILES, *OF_PICTURES)]
        return len(rows_where(found.select(known), self.query)) > 0

    def probe(self, scenes: Scenes) -> str:
        """How many of the scenes drawn for the first sample fit, in words. Raises InputError if none does."""
        first = fitting_world(scenes, self, 0).scene.index
        others = range(first + 1, PROBED)
        n_fitting = 1 + sum(self.fits(scenes, draw_world(scenes, number)) for number in others)
        return f"where {self.query} ({n_fitting} of the first {max(PROBED, first + 1)} scenes drawn fit)"


# The pictures of one scene are made one after the other.
@lru_cache(maxsize=1)
def fitting_world(scenes: Scenes, condition: Condition, n: int) -> World:
    """The world of the scene that sample n shows, or clip n. Raises InputError if none of those drawn fits."""
    for number in range(n * SCENES_OF_ONE, n * SCENES_OF_ONE + condition.tries):
        world = draw_world(scenes, number)
        if condition.fits(scenes, world):
            return world
    raise InputError(
        f"where {condition.query}: expected a scene that fits, got none in {condition.tries:,} tries for sample "
        f"{n} (up to {SCENES_OF_ONE:,} can be asked for)"
    )


def belongs_to(number: int, n: int) -> bool:
    """Whether a scene is one of those drawn for sample n."""
    return number // SCENES_OF_ONE == n
