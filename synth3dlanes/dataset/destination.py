"""Where a data set is written: a folder of this machine, or the URL of a store. This module hides the difference.

In a folder, a run locks its shards and continues them in place (`folder`). In a store nothing is locked or continued in
place: a shard is fetched, continued in a folder of this machine (`spool`), and put back whole (`stores`). Shards are
relative to the data set: `Shard(Path("train"), ...)`.
"""

import time
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from synth3dlanes.dataset import folder, stores
from synth3dlanes.dataset.address import connect, is_url, translate_store_errors
from synth3dlanes.dataset.description import DESCRIPTION, updated_description
from synth3dlanes.dataset.listing import require_outside
from synth3dlanes.dataset.locks import claimed
from synth3dlanes.dataset.patience import Patience, attempt
from synth3dlanes.dataset.spool import made, spool, spool_of, spooled
from synth3dlanes.dataset.write import Shard
from synth3dlanes.system.errors import FormatError, OutageError
from synth3dlanes.system.files import Folder

NO_PATIENCE = Patience()
# Seconds that a run waits for its log to be copied to a store.
SAVE_S = 10.0


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
        """Raise InputError where another recipe's samples are there or it lies in a data set, FormatError where
        `dataset.json` cannot be read;
        write nothing."""
        require_outside(self.place, split)
        files, root = connect(self.place)
        path = f"{root}/{DESCRIPTION}"
        with translate_store_errors(self.place):
            before = files.cat_file(path) if files.exists(path) else None
        updated_description(before, recipe, split, n, f"{self.place}/{DESCRIPTION}")

    def claim(
        self, recipe: dict[str, Any], split: str, n: int, shards: Iterable[int], is_driver: bool = False
    ) -> AbstractContextManager[object]:
        """Write `dataset.json`, and in a folder lock these shards (`folder.claim`).

        Raises InputError where another recipe's samples are there or it lies in a data set, ClaimedError where another
        run has locked a shard.
        """
        require_outside(self.place, split)
        if self.is_store:
            return _announced(self.place, recipe, split, n)
        return folder.claim(self.folder, recipe, split, n, shards, is_driver)

    def begun(self, split: str, shards: Iterable[int]) -> set[int]:
        """The numbers of the shards that may have samples already; for a store, all of them."""
        if self.is_store:
            # Another process may have changed what was listed here before.
            connect(self.place)[0].invalidate_cache()
            return set(shards)
        names = (path.name.partition(".")[0] for path in (self.folder / split).glob("*"))
        return {int(name) for name in names if name.isdecimal()} & set(shards)

    def missing(self, shard: Shard, n: int) -> list[int]:
        """The indices below `n` of the samples that a shard lacks."""
        if not self.is_store:
            return shard.within(self.folder).missing(n)
        there = stores.indices(self.place, shard)
        return [index for index in shard.indices(n) if index not in there]

    def needs_join(self, shard: Shard, n: int) -> bool:
        """Whether a shard has samples outside its tar, or what a killed join has left."""
        return not self.is_store and shard.within(self.folder).needs_join(n)

    def spooled(self, split: str, recipe: str) -> list[int]:
        """The numbers of the shards of this split and recipe that this machine still holds something of for a store."""
        return spooled(self.place, split, recipe) if self.is_store else []

    @contextmanager
    def working_copy(self, shard: Shard, patience: Patience = NO_PATIENCE) -> Iterator[Shard]:
        """The shard as files of this machine, to which samples can be added. At the end, a store gets it back if it has
        changed.

        Raises OutageError if the store cannot be reached or refuses it. Finished samples then stay on this machine
        (`spool`), are part of the next working copy, and are put with it.
        """
        if not self.is_store:
            yield shard.within(self.folder)
            return
        with spool(self.place, shard) as root:
            here, kept = shard.within(root), f"finished samples are kept in {root}"
            patience.insist(self.place, lambda: stores.take(self.place, here), kept)
            yield here
            try:
                patience.insist(self.place, lambda: stores.put(self.place, _files(root, "failed"), root), kept)
                if here.path("parquet").exists():
                    patience.insist(self.place, lambda: stores.put_shard(self.place, here), kept)
            except (OutageError, FormatError) as error:
                raise OutageError(f"{error}; {kept}, and put by the next run on this machine") from None
            for suffix in ("parquet", "tar"):
                Folder(here.folder).remove(here.path(suffix).name)
            Folder(root).remove_tree("failed")

    @contextmanager
    def log(self, name: str) -> Iterator["RunLog"]:
        if not self.is_store:
            with RunLog(self.folder, name) as log:
                yield log
            return
        with RunLog(made(spool_of(self.place, "logs")).root, name, self.place) as log:
            yield log


class RunLog:
    """A log file under `logs`. Each line is written at once. For a store, the file is on this machine until `save`
    copies it there."""

    def __init__(self, root: Path, name: str, url: str = "") -> None:
        self._root, self._url = root, url
        self._path = root / "logs" / name
        self._stream = self._opened(Folder(root))

    def __enter__(self) -> "RunLog":
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def _opened(self, folder: Folder) -> BinaryIO:
        """The log; for a store, locked against runs that put the logs of killed ones, and remove them."""
        path = self._path.relative_to(self._root)
        while True:
            folder.make("logs")
            with suppress(FileNotFoundError):
                stream = folder.append(path)
                if not self._url or claimed(stream, self._path, waits=True):
                    return stream

    def write(self, line: bytes) -> None:
        self._stream.write(line)

    def save(self, is_last: bool = False) -> str:
        """Copy the log to its store. Returns why that failed, or "". It gives up soon, so that no run waits for it."""
        if not self._url:
            return ""
        until = time.monotonic() + SAVE_S
        with ExitStack() as locks:
            # Last, the logs of killed runs too.
            paths = [self._path, *(_left(self._path.parent, locks) if is_last else [])]
            names = [str(path.relative_to(self._root)) for path in paths]
            try:
                attempt(self._url, lambda: stores.put(self._url, names, self._root), lambda: time.monotonic() > until)
            except (OutageError, FormatError) as error:
                return f"{error}; the log is {self._path}"
            for name in names if is_last else []:
                Folder(self._root).remove(name)
        return ""


@contextmanager
def _announced(url: str, recipe: dict[str, Any], split: str, n: int) -> Iterator[None]:
    stores.announce(url, recipe, split, n)
    yield
    # Again: a run that began at the same time may have overwritten it.
    with suppress(OutageError, FormatError):
        stores.announce(url, recipe, split, n)


def _left(folder: Path, locks: ExitStack) -> list[Path]:
    """The files of a folder that no process has locked. They are locked until `locks` is closed."""
    found = []
    for path in (folder / name for name in Folder(folder).names()):
        # Another run may put it meanwhile, and remove it.
        with suppress(FileNotFoundError):
            if file := claimed(Folder(folder).update(path.name), path):
                locks.enter_context(file)
                found.append(path)
    return found


def _files(root: Path, folder: str) -> list[str]:
    return [str(path.relative_to(root)) for path in sorted((root / folder).rglob("*")) if path.is_file()]
