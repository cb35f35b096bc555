"""Make data sets from data sets: divide one split into several, merge parts. Samples are copied as bytes.

Calling either function again resumes it. Both read and write folders and URLs.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from synth3dlanes.dataset.address import MAX_READ_BYTES
from synth3dlanes.dataset.description import (
    differences,
    names_of,
    pictures_per_scene,
    recipe_of_description,
    recipe_text,
)
from synth3dlanes.dataset.destination import Destination
from synth3dlanes.dataset.format import key_of
from synth3dlanes.dataset.index import read_recipe
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.splits import readers, split_name, split_size
from synth3dlanes.dataset.write import Shard, scan
from synth3dlanes.scene.settings import SPLIT_NAME
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import read_bounded
from synth3dlanes.system.schema import shown

# By number in a split: the reader that has the sample, and its position there.
SampleSources = dict[int, tuple[Reader, int]]


def assign(n: int, shares: Mapping[str, float], seed: int) -> dict[str, list[int]]:
    """Positions 0 to n - 1 assigned to names at random by a seed, in order within each name. Shares are weights."""
    order = np.random.default_rng(seed).permutation(n)
    ends = np.round(n * np.cumsum(list(shares.values())) / sum(shares.values())).astype(int)
    return {name: np.sort(part).tolist() for name, part in zip(shares, np.split(order, ends[:-1]), strict=True)}


def split_dataset(source: Reader, shares: Mapping[str, float], seed: int, out: str) -> dict[str, int]:
    """Divide one split's samples into new splits in `out`, numbered from 0; returns how many each has.

    The pictures of a scene stay together. `scene.json` keeps the split and index that a sample was drawn for. `derived`
    in `dataset.json` says what was done; `generate` does not extend such a data set.
    """
    if not shares or any(re.fullmatch(SPLIT_NAME, name) is None or share <= 0 for name, share in shares.items()):
        raise InputError(f"shares: expected names of splits, each with a share above 0, got {shown(dict(shares))}")
    scenes = source.scenes
    chosen = assign(len(scenes), shares, seed)
    empty = [name for name, numbers in chosen.items() if not numbers]
    if empty:
        raise InputError(f"into: expected a scene for each split, got none of {len(scenes)} for {', '.join(empty)}")
    assigned = {name: source.positions([scenes[k] for k in numbers]) for name, numbers in chosen.items()}
    origin = {"cut": source.url, "n": len(source), "seed": seed, "into": dict(shares), **how_derived(source)}
    for name, positions in assigned.items():
        places = {number: (source, i) for number, i in enumerate(positions)}
        _put(out, {**_recipe(source), "derived": origin}, name, len(places), places)
    return {name: len(positions) for name, positions in assigned.items()}


def merge(sources: Sequence[str], out: str) -> dict[str, int]:
    """Merge data sets of one recipe; every sample keeps its number. Returns the number of samples of each split.

    Shards that only one source has are linked where the file system can. Raises InputError where recipes differ or two
    sources have the same sample. The result equals the data set of one run, and `generate` may continue it.
    """
    found = [reader for source in sources for reader in readers(source)]
    if not found:
        raise InputError("sources: expected the data sets to merge, got none")
    first = found[0]
    problems = [
        f"{first.url}: {line} in {other.url}"
        for other in found[1:]
        for line in differences(_recipe(first), _recipe(other))
    ]
    if problems:
        raise InputError(*dict.fromkeys(problems))
    counts = {}
    # All of them: some may have no licence.
    recipe = {key: value for reader in found for key, value in _recipe(reader).items()}
    merged = {name: [one for one in found if split_name(one) == name] for name in sorted(map(split_name, found))}
    places = {name: _union(several) for name, several in merged.items()}
    for name, several in merged.items():
        n = max(map(split_size, several))
        _put(out, recipe, name, n, places[name])
        counts[name] = len(places[name])
    return counts


def how_derived(source: Reader) -> dict[str, Any]:
    """The key `derived` for a data set that is made from a derived data set."""
    return {key: value for key, value in source.description.items() if key == "derived"}


def _recipe(reader: Reader) -> dict[str, Any]:
    return recipe_of_description(reader.description)


def _union(several: Sequence[Reader]) -> SampleSources:
    places: SampleSources = {}
    for reader in several:
        for i, index in enumerate(reader.index["index"].to_pylist()):
            if index in places:
                other = places[index][0].url
                raise InputError(f"{reader.url}: sample {key_of(index)} is also in {other}")
            places[index] = (reader, i)
    return places


def _put(out: str, recipe: dict[str, Any], split: str, n: int, places: SampleSources) -> None:
    """Write the samples that are not there yet, shard by shard. A shard records the recipe of its sources if they all
    have the same."""
    size, names = int(recipe["shard_size"]), names_of(recipe)
    sources = {id(reader): reader for reader, _ in places.values()}.values()
    is_known = all(reader.recipes == {recipe_text(reader.description)} for reader in sources)
    text = recipe_text(recipe) if is_known else ""
    shards: dict[int, SampleSources] = {}
    for index, place in places.items():
        shards.setdefault(index // size, {})[index] = place
    destination = Destination(out)
    with destination.claim(recipe, split, n, sorted(shards)):
        for number, members in sorted(shards.items()):
            shard = Shard(Path(split), number, size, names, text, frames=pictures_per_scene(recipe))
            if destination.needs_join(shard, n) or members.keys() & set(destination.missing(shard, n)):
                with destination.working_copy(shard) as here:
                    _fill(here, members, n)


def _fill(shard: Shard, members: SampleSources, n: int) -> None:
    if not shard.path("parquet").exists():
        _adopt_whole(shard, members)
    for index in sorted(members.keys() & set(shard.missing(n))):
        reader, i = members[index]
        shard.write_part(index, reader.raw(i))
    if shard.needs_join(n):
        shard.join(n)


def _adopt_whole(shard: Shard, members: SampleSources) -> None:
    """Link or copy the files of a finished shard of this file system that is already as it shall be."""
    sources = {id(reader): reader for reader, _ in members.values()}
    positions = sorted(i for _, i in members.values())
    reader = next(iter(sources.values()))
    theirs = Shard(Path(reader.url), shard.number, shard.size, shard.names)
    is_theirs = len(sources) == 1 and theirs.path("parquet").exists() and theirs.joined() == members.keys()
    index = theirs.path("parquet")
    is_theirs = is_theirs and read_recipe(read_bounded(index, MAX_READ_BYTES), str(index)) == shard.recipe
    if not is_theirs or any(int(reader.key(i)) != index for i, index in zip(positions, sorted(members), strict=True)):
        return
    # A tar that is not what its index says is read sample by sample, which names what is wrong.
    if scan(theirs.path("tar"), theirs.names)[0].keys() == members.keys():
        shard.adopt(theirs)
