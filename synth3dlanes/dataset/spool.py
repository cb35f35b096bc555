"""Samples made for a store are kept on this machine until the store has them, whatever happens to the run or the store.

    SPOOL/s3-lanes-v1-0f3a9c/train-00017/     the shard as in a data set: train/00017.parts, .tar, .parquet; failed/
    SPOOL/s3-lanes-v1-0f3a9c/train-00017-1/   another run's, which makes the same shard at the same time

SPOOL is a folder that outlives processes and restarts (`spool_root`). Each shard's folder is locked by the run that
works in it, and removed once the store has its contents. The next run takes over the folder of a killed run.
"""

import fcntl
import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import BinaryIO

from synth3dlanes.dataset.locks import claimed
from synth3dlanes.dataset.stores import unjoin
from synth3dlanes.dataset.write import Shard
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import Folder

SPOOL = "SYNTH3DLANES_SPOOL"
"""Environment variable with the path of the folder, if it shall be another one."""
LOCK = ".lock"


def spool_root() -> Path:
    """The folder for samples that are not yet in their store."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state"
    return Path(os.environ.get(SPOOL) or Path(state) / "synth3dlanes" / "spool")


def spool_of(url: str, recipe: str) -> Path:
    """The folder for one store and one recipe, so that samples of different recipes never mix."""
    url = url.rstrip("/")
    # Without the user and password that an address may have.
    name = re.sub(r"[^A-Za-z0-9]+", "-", re.sub(r"//.*@", "//", url))[-60:].strip("-")
    return spool_root() / f"{name}-{hashlib.sha256(f'{url} {recipe}'.encode()).hexdigest()[:12]}"


def made(folder: Path) -> Folder:
    """The path of a folder of the spool, made if it is missing. Raises InputError if it cannot be made."""
    try:
        Folder(folder).make()
    except OSError as error:
        hint = f"set {SPOOL} to a folder that can"
        raise InputError(f"{folder}: cannot be made: {error.strerror or error}; {hint}") from None
    return Folder(folder)


def spooled(url: str, split: str, recipe: str) -> list[int]:
    """The numbers, in order, of the shards of a split that have files of earlier runs here."""
    numbers = set()
    for path in spool_of(url, recipe).glob(f"{split}-*"):
        name = re.fullmatch(rf"{re.escape(split)}-(\d+)(-\d+)?", path.name)
        if name and not is_empty(path) and not _is_held(path):
            numbers.add(int(name[1]))
    return sorted(numbers)


@contextmanager
def spool(url: str, shard: Shard) -> Iterator[Path]:
    """The folder of a shard, locked by this process, with what earlier runs left of it. Raises InputError if the folder
    cannot be written."""
    store = made(spool_of(url, shard.recipe))
    name = f"{shard.folder.name}-{shard.number:05d}"
    names = (f"{name}-{other}" if other else name for other in count())
    name, lock = next((one, lock) for one in names if (lock := _locked(store, one)))
    with lock:
        store.make(f"{name}/{shard.folder.name}")
        for unfinished in (store.root / name / shard.folder).glob("*.tmp"):
            store.remove(unfinished.relative_to(store.root).as_posix())
        _take_over(store, name, shard)
        try:
            yield store.root / name
        finally:
            if is_empty(store.root / name):
                _remove(store, name)


def is_empty(root: Path) -> bool:
    """Whether the folder of a shard holds nothing that the store lacks, or is gone: another run may be removing it.
    Files that the store has are removed first."""
    return all(name == LOCK for _, _, names in os.walk(root) for name in names)


def _is_held(path: Path) -> bool:
    """Whether a run has locked the folder of a shard."""
    with suppress(FileNotFoundError), (path / LOCK).open("rb") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _take_over(store: Folder, name: str, shard: Shard) -> None:
    """Move what ended runs left of a shard into its folder `name`."""
    here = shard.within(store.root / name)
    for other in sorted(store.root.glob(f"{shard.folder.name}-{shard.number:05d}*")):
        if other.name == name or not (lock := _locked(store, other.name)):
            continue
        with lock:
            theirs = shard.within(other)
            unjoin(theirs, here, set())
            for path in theirs.parts().values():
                here.open()
                store.take((here.path("parts") / path.name).relative_to(store.root), path)
            _remove(store, other.name)


def _remove(store: Folder, name: str) -> None:
    """Remove a shard's folder, on which the caller has the lock. The lock goes last: from then on another run may use
    the folder, which then stays."""
    for inside in (f"{name}/{inside}" for inside in store.names(name) if inside != LOCK):
        (store.remove_tree if store.is_folder(inside) else store.remove)(inside)
    store.remove(f"{name}/{LOCK}")
    store.remove_empty(name)


def _locked(store: Folder, name: str) -> BinaryIO | None:
    """The lock on a shard's folder, which is made if it is missing; None where another run holds it. Locks go with
    their processes, however these end."""
    while True:
        with suppress(FileNotFoundError):  # the run that held the folder is removing it
            store.make(name)
            return claimed(store.append(f"{name}/{LOCK}"), store.root / name / LOCK)
