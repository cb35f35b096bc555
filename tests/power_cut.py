"""What a power cut leaves of the files that a command of this process writes: what was synced, and any part of the
rest.

`survive` runs the command, and again; at random calls of the second time the folder is copied as the disk might have
it: files lose what was not synced, folders the names that came since they were synced. On each copy the command runs
once more, and must come to the same bytes.
"""

import os
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synth3dlanes.system import files

FAULTS = ("emptied", "halved", "zeroed")
# Of calls that change what is on the disk; those by which a file or folder gets a name.
CALLS, NAMING = (
    ("fsync", "replace", "unlink", "mkdir", "rmdir", "link", "symlink", "open"),
    ("mkdir", "link", "symlink"),
)
Inode = tuple[int, int]


class Disk:
    """Watches the calls below a folder; at those of the numbers `cuts`, copies into `into` what a cut would leave."""

    def __init__(self, root: Path, cuts: set[int], into: Path, rng: np.random.Generator) -> None:
        self.root, self.into, self.n_calls, self.left = root, into, 0, list[Path]()
        self._cuts, self._rng, self._is_busy = cuts, rng, False
        self._synced: dict[Inode, int] = {}
        self._names: dict[Inode, set[str]] = {}

    def call(self, name: str, real: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """Make a system call as asked, with a cut before it if its number is one of those."""
        if self._is_busy or (name == "open" and not arguments[1] & os.O_CREAT):
            return real(*arguments, **named)
        self.before()
        # One that takes another's place leaves one of both there.
        is_new = name == "replace" and not _is_there(arguments[1], named.get("dst_dir_fd"))
        found = real(*arguments, **named)
        if name == "fsync":
            what = os.fstat(arguments[0])
            if stat.S_ISDIR(what.st_mode):
                self._names.pop(_inode(what), None)
            else:
                self._synced[_inode(what)] = what.st_size
        elif name == "open":
            self._named(arguments[0], named.get("dir_fd"))
            self._synced.setdefault(_inode(os.fstat(found)), 0)
        elif is_new:
            self._named(arguments[1], named.get("dst_dir_fd"))
        elif name in NAMING:
            at = arguments[0] if name == "mkdir" else arguments[1]
            self._named(at, named.get("dir_fd", named.get("dst_dir_fd")))
        return found

    def before(self) -> None:
        """Count a call; cut before it if it is one of those."""
        if self.n_calls in self._cuts and self.root.exists():
            self._is_busy = True
            try:
                self._cut()
            finally:
                self._is_busy = False
        self.n_calls += 1

    def _named(self, path: str | os.PathLike[str], folder: int | None) -> None:
        above = os.fstat(folder) if folder is not None else os.stat(Path(path).parent)
        self._names.setdefault(_inode(above), set()).add(Path(path).name)

    def _cut(self) -> None:
        copy = self.into / f"{self.n_calls:06d}"
        shutil.copytree(self.root, copy, symlinks=True)
        for path in sorted(self.root.rglob("*"), reverse=True):
            there, what = copy / path.relative_to(self.root), path.lstat()
            size = self._synced.get(_inode(what), what.st_size)
            if stat.S_ISREG(what.st_mode) and size < what.st_size:
                _damage(there, size, str(self._rng.choice(FAULTS)))
            if path.name in self._names.get(_inode(path.parent.lstat()), ()) and self._rng.random() < 0.5:
                shutil.rmtree(there) if there.is_dir() else there.unlink()
        self.left.append(copy)


def _damage(path: Path, synced: int, fault: str) -> None:
    data = path.read_bytes()
    kept = {"emptied": synced, "halved": (synced + len(data)) // 2, "zeroed": synced}[fault]
    path.write_bytes(data[:kept] + bytes(len(data) - kept if fault == "zeroed" else 0))


def _is_there(path: str | os.PathLike[str], folder: int | None) -> bool:
    try:
        os.stat(path, dir_fd=folder, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return True


def _inode(found: os.stat_result) -> Inode:
    return found.st_dev, found.st_ino


@contextmanager
def watched(disk: Disk) -> Iterator[None]:
    """Let a disk see all calls of this process."""
    write = files._File.write

    def write_watched(file: Any, data: Any) -> int:
        disk.before()
        return write(file, data)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files._File, "write", write_watched)
        for name in CALLS:
            real = getattr(os, name)
            patch.setattr(os, name, lambda *a, _name=name, _real=real, **k: disk.call(_name, _real, *a, **k))
        yield


def contents(root: Path) -> dict[str, bytes]:
    """The files below a folder, without locks and logs."""
    paths = (path for path in sorted(root.rglob("*")) if path.is_file() and path.name != ".lock")
    return {str(path.relative_to(root)): path.read_bytes() for path in paths if path.parent.name != "logs"}


def survive(run: Callable[[Path], object], tmp_path: Path, n_cuts: int, seed: int = 0) -> None:
    """Assert that `run`, which writes into a folder, comes to the same bytes after any of so many power cuts."""
    rng, whole = np.random.default_rng(seed), Disk(tmp_path / "whole", set(), tmp_path, np.random.default_rng())
    with watched(whole):
        run(whole.root)
    expected = contents(whole.root)
    assert expected
    (tmp_path / "cuts").mkdir()
    cuts = set(rng.choice(whole.n_calls, min(n_cuts, whole.n_calls), replace=False).tolist())
    again = Disk(tmp_path / "again", cuts, tmp_path / "cuts", rng)
    with watched(again):
        run(again.root)
    assert contents(again.root) == expected
    assert len(again.left) >= 0.8 * len(cuts)
    for left in again.left:
        run(left)
        found = contents(left)
        wrong = [name for name in sorted(expected.keys() | found.keys()) if expected.get(name) != found.get(name)]
        assert not wrong, f"cut before call {left.name} of {whole.n_calls}: {wrong}"
        shutil.rmtree(left)
