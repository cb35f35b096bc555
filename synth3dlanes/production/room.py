"""Room on the disk of a data set. Whether there is any again is asked by trying to write: bytes that are free are of no
use where the number of files or a user's quota is at its end."""

import os
import shutil
import time
from contextlib import ExitStack
from pathlib import Path

from synth3dlanes.dataset.folder import PROBE
from synth3dlanes.files import Folder
from synth3dlanes.production.workers import DISK_FULL

FREE_MARK_SHARE, FREE_MARK_BYTES = 0.01, 1 << 30
# Between two tries; doubled up to the second.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 16.0
CHUNK_BYTES = 1 << 20


def is_full(error: BaseException | None) -> bool:
    """Whether an error says that a disk, or a user's share of it, is full."""
    return isinstance(error, OSError) and error.errno in DISK_FULL


class Room:
    """The room in the folder of a data set: too little since something could not be written, or since few bytes are
    free, until there is enough for what comes next (`n_files` and some bytes).

    At so few free bytes as `mark` a run stops to write, so that the disk is not filled to the last byte; it goes on at
    twice as many.
    """

    def __init__(self, root: Path, n_files: int) -> None:
        self.root, self.mark = root, min(FREE_MARK_BYTES, int(shutil.disk_usage(root).total * FREE_MARK_SHARE))
        self._n_files, self._n_bytes, self._is_low = n_files, 0, False
        self._try_at, self._pause_s = 0.0, FIRST_PAUSE_S
        self.is_waiting = False

    @property
    def is_low(self) -> bool:
        """Whether few bytes are free."""
        return self.free < self.mark

    @property
    def free(self) -> int:
        """The bytes that are free, by the file system's count."""
        return shutil.disk_usage(self.root).free

    def wait(self, n_bytes: int) -> None:
        """There is no room: from now on wait until `n_bytes` can be written."""
        if not self.is_waiting:
            self._n_bytes = 0
        self.is_waiting, self._n_bytes, self._is_low = True, max(n_bytes, self._n_bytes), self.is_low
        self._try_at = time.monotonic() + self._pause_s

    def is_back(self) -> bool:
        """While waiting: whether there is room again. Tries now and then, and says False in between."""
        if time.monotonic() < self._try_at:
            return False
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)
        self._try_at = time.monotonic() + self._pause_s
        if (self._is_low and self.free < 2 * self.mark) or not self._can_write():
            return False
        self.is_waiting = False
        return True

    def has_been_of_use(self) -> None:
        """Something was written: the next wait begins with a short pause."""
        self._pause_s = FIRST_PAUSE_S

    def _can_write(self) -> bool:
        folder = Folder(self.root)
        try:
            with ExitStack() as stack:
                first, *_ = [stack.enter_context(folder.draft(PROBE)) for _ in range(self._n_files)]
                for done in range(0, self._n_bytes, CHUNK_BYTES):
                    # Not zeros, which some file systems keep in no room.
                    first.stream.write(os.urandom(min(CHUNK_BYTES, self._n_bytes - done)))
                first.sync()
        except OSError as error:
            if is_full(error):
                return False
            raise
        return True
