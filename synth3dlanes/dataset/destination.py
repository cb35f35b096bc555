"""Where a data set is written: a folder of this machine, or the URL of a store. What differs between them is here.

In a folder, runs lock their shards and continue them in place (`folder`). In a store nothing is locked or continued in
place: a shard is fetched, worked on in a folder of this machine, and put back whole (`stores`).

Shards are given relative to the data set: `Shard(Path("train"), ...)`.
"""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from synth3dlanes.dataset import folder, stores
from synth3dlanes.dataset.address import connect, is_url, translate_store_errors
from synth3dlanes.dataset.description import DESCRIPTION, updated_description
from synth3dlanes.dataset.write import Shard
from synth3dlanes.files import Folder
from synth3dlanes.scratch import scratch


class Destination:
    """A data set to be written at `place`: a folder, or a URL that fsspec can open."""

    def __init__(self, place: str | Path) -> None:
        self.place = str(place)
        self.is_store = is_url(self.place)

    @property
    def folder(self) -> Path:
        """The folder of a data set on this machine."""
        assert not self.is_store, f"expected a folder, got {self.place}"
        return Path(self.place)

    def check_recipe(self, recipe: dict[str, Any], split: str, n: int) -> None:
        """Raise InputError where another recipe's samples are there, FormatError where `dataset.json` cannot be read;
        write nothing."""
        files, root = connect(self.place)
        path = f"{root}/{DESCRIPTION}"
        with translate_store_errors(self.place):
            before = files.cat_file(path) if files.exists(path) else None
        updated_description(before, recipe, split, n, f"{self.place}/{DESCRIPTION}")

    def claim(
        self, recipe: dict[str, Any], split: str, n: int, shards: Iterable[int], is_driver: bool = False
    ) -> AbstractContextManager[object]:
        """Write `dataset.json`, and in a folder lock these shards (`folder.claim`).

        Raises InputError where another recipe's samples are there, ClaimedError where another run has locked a shard.
        """
        if self.is_store:
            return _announced(self.place, recipe, split, n)
        return folder.claim(self.folder, recipe, split, n, shards, is_driver)

    def begun(self, split: str, shards: Iterable[int]) -> set[int]:
        """Those of the shards that anything may be there of; of a store, all."""
        if self.is_store:
            # Another process may have changed what was listed here before.
            connect(self.place)[0].invalidate_cache()
            return set(shards)
        names = (path.name.partition(".")[0] for path in (self.folder / split).glob("*"))
        return {int(name) for name in names if name.isdecimal()} & set(shards)

    def missing(self, shard: Shard, n: int) -> list[int]:
        """The indices below `n` of a shard's samples that are not there."""
        if not self.is_store:
            return shard.within(self.folder).missing(n)
        there = stores.indices(self.place, shard)
        return [index for index in shard.indices(n) if index not in there]

    def needs_join(self, shard: Shard, n: int) -> bool:
        """Whether a shard has samples outside its tar, or what a killed join has left."""
        return not self.is_store and shard.within(self.folder).needs_join(n)

    @contextmanager
    def working_copy(self, shard: Shard) -> Iterator[Shard]:
        """The shard as files of this machine, to be added to; a store gets it back, if it has changed."""
        if not self.is_store:
            yield shard.within(self.folder)
            return
        with scratch() as root:
            here = shard.within(root)
            here.folder.mkdir()
            stores.fetch_shard(self.place, here)
            index = here.path("parquet")
            before = index.read_bytes() if index.exists() else b""
            yield here
            stores.put(self.place, _files(root, "failed"), root)
            if index.exists() and index.read_bytes() != before:
                stores.put_shard(self.place, here)

    @contextmanager
    def log(self, name: str) -> Iterator["Log"]:
        """A new log of this name."""
        if not self.is_store:
            with Log(self.folder, name) as log:
                yield log
            return
        with scratch() as here, Log(here, name, self.place) as log:
            yield log


class Log:
    """A file under `logs`, each line written out at once; that of a store lies here until `save` copies it there."""

    def __init__(self, root: Path, name: str, url: str = "") -> None:
        folder = Folder(root)
        folder.make("logs")
        self._stream = folder.append(f"logs/{name}")
        self._root, self._url = root, url

    def __enter__(self) -> "Log":
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def write(self, line: bytes) -> None:
        """Add a line."""
        self._stream.write(line)

    def save(self) -> None:
        """Copy it to its store."""
        if self._url:
            stores.put(self._url, _files(self._root, "logs"), self._root)


@contextmanager
def _announced(url: str, recipe: dict[str, Any], split: str, n: int) -> Iterator[None]:
    stores.announce(url, recipe, split, n)
    yield


def _files(root: Path, folder: str) -> list[str]:
    return [str(path.relative_to(root)) for path in sorted((root / folder).rglob("*")) if path.is_file()]
