"""The splits of a data set, or one named split. Reads indices; addresses are fsspec's."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from synth3dlanes.dataset.address import can_list, connect, is_url, splits_near, translate_store_errors
from synth3dlanes.dataset.description import DESCRIPTION
from synth3dlanes.dataset.listing import splits_with_shards
from synth3dlanes.dataset.read import Reader
from synth3dlanes.system.errors import FormatError, InputError


def readers(folder: str) -> list[Reader]:
    """Readers of every split of a data set that has finished shards, or of the one split that is named."""
    splits = _finished_splits(folder)
    if splits is None:
        return [Reader(folder)]
    return [Reader(f"{folder.rstrip('/')}/{split}") for split in splits]


def only_split(place: str) -> str:
    """`DIR/SPLIT` for a data set with one split; other places unchanged. Raises InputError if there are several
    splits, FormatError if there is none."""
    splits = _finished_splits(place) or []
    if len(splits) > 1:
        raise InputError(f"{place}: expected one split, got {len(splits)}{splits_near(place)}")
    return "/".join((place.rstrip("/"), *splits))


def one_reader(place: str, columns: Sequence[str] | None = None) -> Reader:
    """The reader of the split that is named, or of the only split of a data set, with these columns of its index."""
    return Reader(only_split(place), columns)


def _finished_splits(place: str) -> list[str] | None:
    """The splits of a data set that have finished shards; None where there is no data set. Raises FormatError where
    there is nothing, and where no split has any."""
    files, root = connect(place)
    with translate_store_errors(place):
        if can_list(files) and not files.exists(root):
            there = splits_near(place)
            raise FormatError(f"{place}: expected a data set or one of its splits, got no folder{there}")
    splits = splits_with_shards(place)
    if splits == []:
        raise FormatError(f"{place}: expected finished shards (SPLIT/00000.parquet), got none; run generate again")
    return splits


def has_split(folder: str, split: str) -> bool:
    """Whether a data set has a split of this name, finished or not."""
    files, root = connect(folder)
    with translate_store_errors(folder):
        return bool(files.exists(f"{root}/{split}")) if can_list(files) else split in (splits_with_shards(folder) or [])


def evenly_spaced(found: Sequence[Reader], n: int, is_once_a_scene: bool = False) -> list[tuple[Reader, int]]:
    """At most `n` samples, evenly spaced over all splits, as (reader, position). `is_once_a_scene` takes the first
    sample of each scene only."""
    of_reader = (np.unique(one.scene_of, return_index=True)[1] if is_once_a_scene else range(len(one)) for one in found)
    places = [(reader, int(i)) for reader, chosen in zip(found, of_reader, strict=True) for i in chosen]
    count = min(n, len(places))
    return [places[number * len(places) // count] for number in range(count)]


def split_size(reader: Reader) -> int:
    """The number of samples that the split shall have. Raises FormatError if `dataset.json` does not name it."""
    name, splits = split_name(reader), reader.description["splits"]
    if name not in splits:
        raise FormatError(f"{reader.url}: {DESCRIPTION} has no split {name}, only {', '.join(splits) or 'none'}")
    return int(splits[name]["n"])


def split_name(reader: Reader) -> str:
    """The name of the split: the name of its folder."""
    return reader.url.rpartition("/")[2]


def data_set_name(reader: Reader) -> str:
    """The name of the data set: the name of the folder above the split's."""
    place = reader.url if is_url(reader.url) else str(Path(reader.url).resolve())
    return place.rsplit("/", 2)[-2]
