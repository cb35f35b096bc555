"""Instance ids of pixels and lidar points: one rule for all kinds of things.

Cars, trees, symbols and `things` (people, riders, road works) are numbered from 0 in the order of the scene, structures
in the order of the site. Delimiters are numbered in the order of the labels; delimiters without a labelled point
follow. The host has one bonnet. Id 0 is nothing. `things.KINDS` has the series of each kind.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int, Integer

from synth3dlanes.system.errors import InputError


class IdRange(NamedTuple):
    """Ids of a kind: thing `first_number` has `first_id`, the next one the next id, up to the next range."""

    first_id: int
    kind: str
    first_number: int = 0


# In the order of ids. Those from 11,000 on continue a kind whose first range is full, mostly on large maps.
RANGES = (
    IdRange(1, "car"),
    IdRange(200, "delimiter"),
    IdRange(300, "tree"),
    IdRange(6000, "structure"),
    IdRange(9000, "symbol"),
    IdRange(10_000, "bonnet"),
    IdRange(10_001, "thing"),
    IdRange(11_000, "car", 199),
    IdRange(12_000, "tree", 5700),
    IdRange(20_100, "delimiter", 100),
    IdRange(50_000, "structure", 3000),
)
# Ids are stored in 16 bits.
END = 2**16
KINDS = tuple(dict.fromkeys(ids.kind for ids in RANGES))

_FIRST_IDS = np.array([ids.first_id for ids in RANGES])
# For id 0, then for each range: the index of its kind, and its first id less its first number.
_KIND_INDICES = np.array([-1, *(KINDS.index(ids.kind) for ids in RANGES)])
_SHIFTS = np.array([0, *(ids.first_id - ids.first_number for ids in RANGES)])


def most_of(kind: str) -> int:
    """How many things of a kind have ids."""
    ends = [*_FIRST_IDS[1:].tolist(), END]
    return sum(end - ids.first_id for ids, end in zip(RANGES, ends, strict=True) if ids.kind == kind)


def instance_id(kind: str, number: int) -> int:
    """The id of a thing of one of KINDS. Raises InputError if its kind has no id left for it."""
    if number >= most_of(kind):
        raise InputError(f"instance ids: expected at most {most_of(kind)} of the kind {kind}, got {number + 1}")
    ids = max(ids for ids in RANGES if ids.kind == kind and ids.first_number <= number)
    return ids.first_id + number - ids.first_number


def thing_of(id_: int) -> tuple[str, int]:
    """The kind and the number of the thing with an id; "nothing" and 0 for id 0."""
    if id_ <= 0:
        return "nothing", 0
    ids = max(ids for ids in RANGES if ids.first_id <= id_)
    return ids.kind, id_ - ids.first_id + ids.first_number


def kind_indices(ids: Integer[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
    """The indices in KINDS of the things with these ids; -1 for id 0."""
    return np.asarray(_KIND_INDICES[_ranges(ids)])


def numbers_of(kind: str, ids: Integer[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
    """The numbers of the things of a kind; -1 at ids of other kinds."""
    at = _ranges(ids)
    return np.where(_KIND_INDICES[at] == KINDS.index(kind), ids - _SHIFTS[at], -1)


def _ranges(ids: Integer[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
    """The ranges that ids are in, counted from 1; 0 of id 0."""
    return np.searchsorted(_FIRST_IDS, ids, side="right")
