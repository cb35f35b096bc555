"""A data set in a folder of this machine: its `dataset.json`, and the lock that one run at a time has on a shard."""

import fcntl
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

from synth3dlanes.dataset.card import CARD, updated_card
from synth3dlanes.dataset.description import DESCRIPTION, updated_description
from synth3dlanes.dataset.write import write_whole
from synth3dlanes.errors import ClaimedError, InputError
from synth3dlanes.files import read_bounded
from synth3dlanes.schema import MAX_BYTES

# Besides its own byte, a shard has one for the process that has the shard made by others.
DRIVER_LOCKS = 1 << 40


@contextmanager
def claim(
    root: Path, recipe: dict[str, Any], split: str, n: int, shards: Iterable[int], is_driver: bool = False
) -> Iterator[Path]:
    """Make or enter a dataset folder and hold the lock on some of a split's shards; yields the split's folder.

    Raises InputError where the folder cannot be written or holds another recipe's samples, ClaimedError where another
    run holds one of these shards. The locks go when this process does, however it ends. A driver's locks keep other
    drivers out, and leave each shard to the process that makes it; nobody may be making one when the driver begins.
    """
    folder, numbers = root / split, list(shards)
    with ExitStack() as stack:
        try:
            root.mkdir(parents=True, exist_ok=True)
            with (root / ".lock").open("ab") as lock:
                fcntl.lockf(lock, fcntl.LOCK_EX)
                _enter(root, recipe, split, n)
            folder.mkdir(exist_ok=True)
            locks = stack.enter_context((folder / ".lock").open("ab"))
        except OSError as error:
            raise InputError(f"out {root}: cannot write to this folder: {error.strerror or error}") from None
        for number in numbers:
            _lock(locks, number, root)
        if is_driver:
            fcntl.lockf(locks, fcntl.LOCK_UN)
            for number in numbers:
                _lock(locks, number, root, DRIVER_LOCKS)
        yield folder


def _lock(locks: IO[bytes], shard: int, root: Path, first: int = 0) -> None:
    """One byte of the lock file stands for a shard. The lock is POSIX's: it works on network file systems too."""
    try:
        fcntl.lockf(locks, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, first + shard)
    except (BlockingIOError, PermissionError):
        raise ClaimedError(f"out {root}: shard {shard} is locked by another run") from None


def _enter(root: Path, recipe: dict[str, Any], split: str, n: int) -> None:
    """Write `dataset.json` and its card, or check that it names the same recipe; note the largest `n` asked for."""
    path = root / DESCRIPTION
    before = read_bounded(path, MAX_BYTES) if path.exists() else None
    if before is None and any(root.glob("*/*.parquet")):
        raise InputError(f"{path}: missing, but there are shards beside it")
    after = updated_description(before, recipe, split, n, str(path))
    if after != before:
        write_whole(path, after)
    card = root / CARD
    card_before = read_bounded(card, MAX_BYTES) if card.exists() else None
    card_after = updated_card(card_before, after, str(path))
    if card_after != card_before:
        write_whole(card, card_after)
