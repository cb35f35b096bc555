"""What a data set holds, from `dataset.json`, the indices and the files' sizes. No sample is read."""

from dataclasses import dataclass
from typing import Any

from synth3dlanes.dataset.address import connect, splits_near, translate_store_errors
from synth3dlanes.dataset.description import DESCRIPTION, data_set_of, parse_description
from synth3dlanes.dataset.index import read_indices
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
    """Count and weigh the data set at any address that fsspec knows, or one split of it."""
    root_url, only = data_set_of(url)
    files, root = connect(root_url)
    where = f"{root_url}/{DESCRIPTION}"
    with translate_store_errors(where, "cannot be read"):
        recipe = parse_description(files.cat_file(f"{root}/{DESCRIPTION}"), where)
    splits = {name: entry for name, entry in recipe.pop("splits").items() if only in ("", name)}
    if only and not splits:
        raise FormatError(f"{url}: expected a data set or one of its splits{splits_near(url)}")
    with translate_store_errors(url):
        found = tuple(_split(files, root, name, entry["n"]) for name, entry in splits.items())
    return DatasetInfo(recipe, found)


def _split(files: Any, root: str, name: str, asked: int) -> SplitInfo:
    found = files.find(f"{root}/{name}", detail=True)
    sizes = {path.removeprefix(f"{root}/{name}/"): int(entry["size"]) for path, entry in found.items()}
    indices: set[int] = set()
    shards = [path for path in sizes if path.endswith(".parquet") and "/" not in path]
    for path in shards:
        where = f"{root}/{name}/{path}"
        indices |= read_indices(files.cat_file(where), where)
    parts = {path for path in sizes if ".parts/" in path and path.endswith(".tar")}
    keys = {path.rpartition("/")[2].removesuffix(".tar") for path in parts}
    waiting = {int(key) for key in keys if key.isdecimal()} - indices
    failed = files.ls(f"{root}/failed/{name}") if files.isdir(f"{root}/failed/{name}") else []
    joined = sum(index < asked for index in indices)
    return SplitInfo(name, asked, joined, len(waiting), len(failed), len(shards), sum(sizes.values()))
