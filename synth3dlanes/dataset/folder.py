"""A dataset's folder: `dataset.json`, which says what it holds, and the lock that one run at a time has on a shard."""

import fcntl
import json
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

from synth3dlanes.dataset.format import DATA_LICENSE, DATASET_FORMAT, DATASET_VERSION, parse_description
from synth3dlanes.dataset.write import write_whole
from synth3dlanes.errors import FormatError, InputError

# Besides its own byte, a shard has one for the process that has the shard made by others.
DRIVER_LOCKS = 1 << 40


class Claimed(InputError):
    """Another run holds a shard."""


@contextmanager
def claim(
    root: Path, recipe: dict[str, Any], split: str, n: int, shards: Iterable[int], is_driver: bool = False
) -> Iterator[Path]:
    """Make or enter a dataset folder and hold the lock on some of a split's shards; yields the split's folder.

    Raises InputError where the folder cannot be written, holds another recipe's samples, or another run holds one of
    these shards. The locks go when this process does, however it ends. A driver's locks keep other drivers out, and
    leave each shard to the process that makes it.
    """
    folder = root / split
    with ExitStack() as stack:
        try:
            root.mkdir(parents=True, exist_ok=True)
            with (root / ".lock").open("ab") as lock:
                fcntl.lockf(lock, fcntl.LOCK_EX)
                _enter(root, recipe, split, n)
            folder.mkdir(exist_ok=True)
            locks = stack.enter_context((folder / ".lock").open("ab"))
        except OSError as error:
            raise InputError(f"out {root}: expected a folder to write to, got {error}") from None
        for shard in shards:
            _lock(locks, shard, DRIVER_LOCKS * is_driver, root)
        yield folder


def _lock(locks: IO[bytes], shard: int, first: int, root: Path) -> None:
    """One byte of the lock file stands for a shard. The lock is POSIX's: it works on network file systems too."""
    try:
        fcntl.lockf(locks, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, first + shard)
    except (BlockingIOError, PermissionError):
        raise Claimed(f"out {root}: expected no other run on it, got one that is making shard {shard}") from None


def _enter(root: Path, recipe: dict[str, Any], split: str, n: int) -> None:
    """Write `dataset.json`, or check that it names the same recipe; note the largest `n` asked for."""
    path = root / "dataset.json"
    found = read_description(root) if path.exists() else None
    if found is None and any(root.glob("*/*.parquet")):
        raise InputError(f"{path}: expected it beside the shards that are there, got none")
    text = description_bytes(found, recipe, split, n, str(path))
    if found is None or path.read_bytes() != text:
        write_whole(path, text)


def description_bytes(found: dict[str, Any] | None, recipe: dict[str, Any], split: str, n: int, where: str) -> bytes:
    """`dataset.json` once a split of `n` is asked for; raise InputError where another recipe is `found` there.

    A data set keeps the licence that it has. A new one made with a user's own assets gets none: theirs is not known.
    """
    new = {} if any(recipe.get("assets", {}).values()) else {"license": DATA_LICENSE}
    licence = {key: value for key, value in (found or new).items() if key == "license"}
    asked = {"format": DATASET_FORMAT, "version": DATASET_VERSION, **licence, **recipe}
    recipe_found, before = dict(found or {}), {}
    if found is not None:
        before = dict(recipe_found.pop("splits", {}))
        # Through JSON, so that a tuple equals the list that it was written as.
        problems = list(differences(recipe_found, json.loads(json.dumps(asked))))
        if problems:
            raise InputError(*(f"{where}: {problem}" for problem in problems))
    splits = {**before, split: {"n": max(n, before.get(split, {}).get("n", 0))}}
    return (json.dumps({**asked, "splits": dict(sorted(splits.items()))}, indent=1) + "\n").encode()


def read_description(root: Path) -> dict[str, Any]:
    """`dataset.json` of a folder; raise FormatError where it is not one of this version."""
    path = root / "dataset.json"
    try:
        return parse_description(path.read_bytes(), str(path))
    except OSError as error:
        raise FormatError(f"{path}: expected the description of a dataset, got {error.strerror}") from None


def differences(found: Any, asked: Any, name: str = "") -> Iterator[str]:
    """A line for every key of a recipe that differs from what a data set has; one of the two may have no licence."""
    if name == "license" and None in (found, asked):
        return
    if isinstance(found, dict) and isinstance(asked, dict):
        for key in [*found, *(key for key in asked if key not in found)]:
            yield from differences(found.get(key), asked.get(key), f"{name}.{key}" if name else key)
    elif found != asked:
        yield f"{name}: expected {json.dumps(found)} as in this dataset, got {json.dumps(asked)}"
