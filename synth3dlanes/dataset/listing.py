"""Which shards a split has. A store that lists its files is asked once; of a server of plain HTTP, which does not, the
names follow from `dataset.json`, and each is asked for.

Which data set a place belongs to: no data set lies in another. One folder would be a split of the outer one and all of
the inner one, and a command that is given this folder could read either.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from synth3dlanes.dataset.address import (
    can_list,
    connect,
    listed_splits,
    read_file,
    splits_near,
    translate_store_errors,
)
from synth3dlanes.dataset.description import DATASET_FORMAT, DESCRIPTION, parse_description
from synth3dlanes.system.errors import FormatError, InputError

# A split and what lies in it: deeper folders are no concern of the outer data set.
LEVELS = 2


def data_set_of(place: str) -> tuple[str, str]:
    """The data set that a place names, and the split of it that is named; "" for all.

    Raises FormatError where neither the place nor the folder that it is in has a `dataset.json`, and where both have.
    """
    files, root = connect(place)
    place = place.rstrip("/")
    with translate_store_errors(place):
        if read_file(files, f"{root}/{DESCRIPTION}") is not None:
            require_no_split(place)
            return place, ""
        parent, _, name = root.rpartition("/")
        is_folder = not can_list(files) or files.isdir(root)
        if is_folder and read_file(files, f"{parent}/{DESCRIPTION}") is not None:
            return place.removesuffix(name).rstrip("/") or ".", name
    raise FormatError(f"{place}: expected a data set or one of its splits, got no {DESCRIPTION}{splits_near(place)}")


def require_outside(place: str, split: str) -> None:
    """Raise InputError where a data set at `place` would lie in another, or its new split would be the folder of one.

    Nothing is written.
    """
    files, root = connect(place)
    outer, inside = root, ""
    for _ in range(LEVELS):
        outer, name = _above(outer)
        inside = f"{name}/{inside}".rstrip("/")
        if outer and _data_set(files, outer, place) is not None:
            raise InputError(
                f"out {place}: expected a folder outside of every data set, got {inside} of the data set {outer}; "
                f"choose another folder, or name the data set itself to extend it"
            )
    for line in inner_data_sets(place, [split]):
        raise InputError(f"out {line}")


def require_no_split(place: str) -> None:
    """Raise FormatError where the data set at `place` is a split of another too."""
    for line in outer_data_sets(place):
        raise FormatError(line)


def outer_data_sets(place: str) -> Iterator[str]:
    """A line if the data set at `place` is a split of another too."""
    files, root = connect(place)
    outer, name = _above(root)
    document = _data_set(files, outer, place) if outer else None
    if document is not None and name in document.get("splits", {}):
        yield _line(place, name, outer)


def inner_data_sets(place: str, splits: Iterable[str]) -> Iterator[str]:
    """A line for each of these splits of the data set at `place` that is a data set itself."""
    files, root = connect(place)
    for split in splits:
        if _data_set(files, f"{root}/{split}", place) is not None:
            yield _line(f"{place.rstrip('/')}/{split}", split, place)


def _line(folder: str, split: str, outer: str) -> str:
    return (
        f"{folder}: expected a data set or a split, got both: it is split {split} of {outer} and has a {DESCRIPTION} "
        f"of its own; move the inner data set ({DESCRIPTION} and the folders of its splits) elsewhere"
    )


def _above(root: str) -> tuple[str, str]:
    """The folder above one, and the name of this in it; "" above a bucket or a server."""
    above, _, name = root.rpartition("/")
    return ("" if above.endswith("/") else above), name


def _data_set(files: Any, root: str, place: str) -> dict[str, Any] | None:
    """The `dataset.json` in a folder of a file system; None where there is none of ours. A store may show its user this
    data set alone."""
    try:
        with translate_store_errors(place):
            data = read_file(files, f"{root}/{DESCRIPTION}")
        document = None if data is None else json.loads(data)
    except (FormatError, ValueError):
        return None
    return document if isinstance(document, dict) and document.get("format") == DATASET_FORMAT else None


N_CONNECTIONS = 8
Index = TypeVar("Index")


@dataclass(frozen=True)
class FinishedShard(Generic[Index]):
    """A finished shard: the paths of its files in the file system, what was read from its index, and the size of its
    tar, 0 where there is none, None where that is not known without asking."""

    parquet: str
    tar: str
    index: Index
    tar_bytes: int | None


def read_shards(
    url: str, description: Mapping[str, Any], read: Callable[[bytes, str], Index]
) -> list[FinishedShard[Index]]:
    """The finished shards of the split at `url`, in order; `read` is given the bytes of each parquet and its path."""
    files, root = connect(url)
    if can_list(files):
        with translate_store_errors(url, "cannot list the shards"):
            found = files.ls(root, detail=True) if files.isdir(root) else []
        sizes: dict[str, int | None] = {str(entry["name"]): int(entry["size"] or 0) for entry in found}
        links = {str(entry["name"]) for entry in found if entry.get("islink")}
        parquets = sorted(path for path in sizes if path.endswith(".parquet"))
    else:
        sizes, links, parquets = {}, set(), _expected(root, description)

    def listed(parquet: str) -> FinishedShard[Index] | None:
        tar = f"{parquet.removesuffix('.parquet')}.tar"
        with translate_store_errors(parquet, "cannot be read"):
            data = read_file(files, parquet)
        if data is None and parquet in links:
            raise FormatError(f"{parquet}: expected the index of a shard, got a link to nothing")
        return (
            None
            if data is None
            else FinishedShard(parquet, tar, read(data, parquet), sizes.get(tar, 0 if sizes else None))
        )

    with ThreadPoolExecutor(N_CONNECTIONS) as pool:
        return [shard for shard in pool.map(listed, parquets) if shard is not None]


def splits_with_shards(place: str) -> list[str] | None:
    """The splits of the data set at `place` that have finished shards; None where there is no `dataset.json`. Raises
    FormatError where it is a split of another one."""
    files, root = connect(place)
    with translate_store_errors(place):
        data = read_file(files, f"{root}/{DESCRIPTION}")
        if data is None:
            return None
        require_no_split(place)
        if can_list(files):
            return listed_splits(files, root)
        description = parse_description(data, f"{place}/{DESCRIPTION}")
        named = {name: _expected(f"{root}/{name}", description) for name in sorted(description["splits"])}
        return [name for name, paths in named.items() if any(files.exists(path) for path in paths)]


def _expected(root: str, description: Mapping[str, Any]) -> list[str]:
    """The indices of a whole split."""
    n = int(description["splits"].get(root.rpartition("/")[2], {"n": 0})["n"])
    return [f"{root}/{number:05d}.parquet" for number in range(math.ceil(n / int(description["shard_size"])))]
