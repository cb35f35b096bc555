"""What a data set holds, from `dataset.json`, the indices and the files' sizes. No sample is read."""

from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from synth3dlanes.dataset.address import connect, naming, refusals
from synth3dlanes.dataset.format import parse_description
from synth3dlanes.errors import FormatError


@dataclass(frozen=True)
class SplitInfo:
    """A split: samples asked for; those in finished shards; those in shards in progress; those that were set aside."""

    name: str
    asked: int
    joined: int
    waiting: int
    set_aside: int
    shards: int
    bytes: int

    @property
    def is_complete(self) -> bool:
        """Whether every sample asked for is in a finished shard."""
        return self.joined >= self.asked


@dataclass(frozen=True, eq=False)
class DatasetInfo:
    """A data set: the recipe of its samples, and its splits."""

    recipe: dict[str, Any]
    splits: tuple[SplitInfo, ...]


def dataset_info(url: str) -> DatasetInfo:
    """Count and weigh the data set at any address that fsspec knows."""
    files, root = connect(url)
    where = f"{url.rstrip('/')}/dataset.json"
    try:
        recipe = parse_description(files.cat_file(f"{root}/dataset.json"), where)
    except refusals() as error:
        raise FormatError(f"{where}: expected the description of a data set, got {error}") from None
    splits = recipe.pop("splits")
    with naming(url):
        found = tuple(_split(files, root, name, int(entry["n"])) for name, entry in splits.items())
    return DatasetInfo(recipe, found)


def _split(files: Any, root: str, name: str, asked: int) -> SplitInfo:
    found = files.find(f"{root}/{name}", detail=True)
    sizes = {path.removeprefix(f"{root}/{name}/"): int(entry["size"]) for path, entry in found.items()}
    indices: set[int] = set()
    shards = [path for path in sizes if path.endswith(".parquet") and "/" not in path]
    for path in shards:
        where = f"{root}/{name}/{path}"
        try:
            indices |= set(pq.read_table(files.open(where), columns=["index"])["index"].to_pylist())
        except (pa.ArrowException, KeyError) as error:
            raise FormatError(f"{where}: expected the index of a shard, got {error}") from None
    parts = {path for path in sizes if ".parts/" in path and path.endswith(".tar")}
    waiting = {int(path.rpartition("/")[2].removesuffix(".tar")) for path in parts} - indices
    failed = files.ls(f"{root}/failed/{name}") if files.isdir(f"{root}/failed/{name}") else []
    joined = sum(index < asked for index in indices)
    return SplitInfo(name, asked, joined, len(waiting), len(failed), len(shards), sum(sizes.values()))
