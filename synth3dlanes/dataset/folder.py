"""A data set in a folder of this machine: its `dataset.json`, the files beside it that follow from it (the card of the
hub, and Croissant's description), and the lock on a shard, which one run at a time holds.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from synth3dlanes.dataset import card, croissant
from synth3dlanes.dataset.description import DESCRIPTION, parse_description, updated_description
from synth3dlanes.dataset.locks import Locks, locked, locks
from synth3dlanes.system.errors import ClaimedError, InputError
from synth3dlanes.system.files import Folder, read_bounded
from synth3dlanes.system.schema import MAX_BYTES

# By name: what makes the file of a description, and the text without which it is a user's own.
COMPANIONS: dict[str, tuple[Callable[[Mapping[str, Any]], bytes], str]] = {
    card.CARD: (card.card, card.MARK),
    croissant.CROISSANT: (croissant.croissant, croissant.MARK),
}


def updated_companions(before: Mapping[str, bytes | None], description: bytes, where: str) -> dict[str, bytes]:
    """The files that belong beside a `dataset.json` at `where`, with their contents.

    `before` has the present contents of each, None where there is none. A file that a user has edited stays.
    """
    contents = parse_description(description, where)
    return {
        name: make(contents) if (found := before[name]) is None or mark.encode() in found else found
        for name, (make, mark) in COMPANIONS.items()
    }


# Besides its own byte, a shard has one for the process that has the shard made by others.
DRIVER_LOCKS = 1 << 40
# Runs write such files to see whether there is room.
PROBE = "room"


@contextmanager
def claim(
    root: Path, recipe: dict[str, Any], split: str, n: int, shards: Iterable[int], is_driver: bool = False
) -> Iterator[Path]:
    """Make or enter the folder of a data set, and lock some shards of a split. Yields the split's folder.

    Raises InputError if the folder cannot be written or holds samples of another recipe; ClaimedError if another run,
    also one of this process, has locked one of the shards. The locks end with this process, however it ends. The locks
    of a driver keep other drivers out, but leave each shard to the process that makes it; no process may be making one
    when the driver begins.
    """
    data_set, numbers = Folder(root), list(shards)
    with ExitStack() as stack:
        try:
            data_set.make()
            with locked(data_set):
                _enter(data_set, recipe, split, n)
            data_set.make(split)
            held = stack.enter_context(locks(data_set, split))
        except OSError as error:
            raise InputError(f"out {root}: cannot write to this folder: {error.strerror or error}") from None
        _take(held, numbers, root)
        if is_driver:
            held.release()
            _take(held, numbers, root, DRIVER_LOCKS)
        yield root / split


def _take(held: Locks, shards: list[int], root: Path, first: int = 0) -> None:
    for shard in shards:
        if not held.take(first + shard):
            raise ClaimedError(f"out {root}: shard {shard} is locked by another run")


def _enter(data_set: Folder, recipe: dict[str, Any], split: str, n: int) -> None:
    """Write `dataset.json` and its card, or check that they name the same recipe, and raise the split's number of
    samples to `n`. Unfinished files of killed runs are removed."""
    path = data_set.root / DESCRIPTION
    before = _read(path)
    if before is None and any(data_set.root.glob("*/*.parquet")):
        raise InputError(f"{path}: missing, but there are shards beside it")
    after = updated_description(before, recipe, split, n, str(path))
    beside = {name: _read(data_set.root / name) for name in COMPANIONS}
    files = {DESCRIPTION: after, **updated_companions(beside, after, str(path))}
    for name in (*files, PROBE):
        data_set.remove_unfinished(name)
    there = {DESCRIPTION: before, **beside}
    for name, data in files.items():
        if data != there[name]:
            data_set.write(name, data)


def _read(path: Path) -> bytes | None:
    return read_bounded(path, MAX_BYTES) if path.exists() else None
