"""Which shards a split has. A store that lists its files is asked once; of a server of plain HTTP, which does not, the
names follow from `dataset.json`, and each is asked for."""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from synth3dlanes.dataset.address import can_list, connect, read_file, translate_store_errors
from synth3dlanes.dataset.description import DESCRIPTION, parse_description
from synth3dlanes.dataset.nesting import require_no_split
from synth3dlanes.system.errors import FormatError

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
            return sorted({str(path).rsplit("/", 2)[-2] for path in files.glob(f"{root}/*/*.parquet")})
        description = parse_description(data, f"{place}/{DESCRIPTION}")
        named = {name: _expected(f"{root}/{name}", description) for name in sorted(description["splits"])}
        return [name for name, paths in named.items() if any(files.exists(path) for path in paths)]


def _expected(root: str, description: Mapping[str, Any]) -> list[str]:
    """The indices of a whole split."""
    n = int(description["splits"].get(root.rpartition("/")[2], {"n": 0})["n"])
    return [f"{root}/{number:05d}.parquet" for number in range(math.ceil(n / int(description["shard_size"])))]
