"""Locks on the shards of a split, on a whole folder, and on single files, against other processes and against other
threads of this one.

Those of a split are POSIX locks, which work on network file systems too. A process holds each lock once, and loses all
its locks on a file when it closes any descriptor of that file. So a process opens the file of a split once, and records
which locks are held.
"""

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock, RLock
from typing import BinaryIO

from synth3dlanes.system.files import Folder

LOCK_FILE = ".lock"


@dataclass
class _File:
    """The lock file of a split, open as long as a holder in this process uses it."""

    stream: BinaryIO
    users: int = 0
    held: set[int] = field(default_factory=set)


_GUARD, _ENTERING = RLock(), Lock()
_files: dict[tuple[int, int], _File] = {}


class Locks:
    """The locks of one holder on a split: one byte of the file stands for each."""

    def __init__(self, file: _File) -> None:
        self._file, self._mine = file, set[int]()

    def take(self, byte: int) -> bool:
        """Take a lock. Returns False if another process, or another holder in this process, has it."""
        with _GUARD:
            if byte in self._file.held:
                return False
            try:
                fcntl.lockf(self._file.stream, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
            except (BlockingIOError, PermissionError):
                return False
            self._file.held.add(byte)
            self._mine.add(byte)
            return True

    def release(self) -> None:
        with _GUARD:
            for byte in self._mine:
                fcntl.lockf(self._file.stream, fcntl.LOCK_UN, 1, byte)
            self._file.held -= self._mine
            self._mine.clear()


@contextmanager
def locks(data_set: Folder, split: str) -> Iterator[Locks]:
    """The locks of the split in a folder of a data set, for one holder, who has them until the end at most. Raises
    LinkError where the lock file is a link."""
    place = os.stat(data_set.root / split)
    key = (place.st_dev, place.st_ino)
    with _GUARD:
        file = _files.get(key) or _File(data_set.append(f"{split}/{LOCK_FILE}"))
        _files[key] = file
        file.users += 1
    held = Locks(file)
    try:
        yield held
    finally:
        with _GUARD:
            held.release()
            file.users -= 1
            if not file.users:
                del _files[key]
                file.stream.close()


@contextmanager
def locked(data_set: Folder) -> Iterator[None]:
    """Hold the lock of a folder: no other process and no other thread is inside at the same time. Waits for the
    lock."""
    with _ENTERING, data_set.append(LOCK_FILE) as stream:
        fcntl.lockf(stream, fcntl.LOCK_EX)
        yield


def claimed(file: BinaryIO, path: Path, waits: bool = False) -> BinaryIO | None:
    """An open file, locked until it is closed; None, and the file is closed, where another holder has it and this one
    does not wait. Raises FileNotFoundError where the holder before has removed it from `path`."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if waits else fcntl.LOCK_NB))
        if os.path.samestat(os.stat(path), os.fstat(file.fileno())):
            return file
    except BlockingIOError:
        file.close()
        return None
    except FileNotFoundError:
        pass
    file.close()
    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
