"""Free space on the disk of a data set.

Whether there is space again is tested by writing: free bytes are of no use if the number of files, or a user's quota,
is at its limit.
"""

import os
import shutil
import time
from contextlib import ExitStack
from pathlib import Path

from synth3dlanes.dataset.folder import PROBE
from synth3dlanes.production.workers import DISK_FULL
from synth3dlanes.system.files import Folder

FREE_MARK_SHARE, FREE_MARK_BYTES = 0.01, 1 << 30
# Seconds between two tries: the first value, doubled up to the second.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 16.0
CHUNK_BYTES = 1 << 20


def is_full(error: BaseException | None) -> bool:
    """Whether an error says that a disk or a user's quota is full."""
    return isinstance(error, OSError) and error.errno in DISK_FULL


class Room:
    """The free space in the folder of a data set. It is too low once a write fails or few bytes are free; then it is
    waited for until there is enough for the next step (`n_files` files and some bytes). A run stops writing at `mark`
    free bytes, so that the disk is never quite full, and continues at twice as many."""

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
        """The free bytes, according to the file system."""
        return shutil.disk_usage(self.root).free

    def wait(self, n_bytes: int) -> None:
        """Start waiting until `n_bytes` can be written."""
        if not self.is_waiting:
            self._n_bytes = 0
        self.is_waiting, self._n_bytes, self._is_low = True, max(n_bytes, self._n_bytes), self.is_low
        self._try_at = time.monotonic() + self._pause_s

    def is_back(self) -> bool:
        """Whether there is space again, while waiting. Tests this now and then, and returns False in between."""
        if time.monotonic() < self._try_at:
            return False
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)
        self._try_at = time.monotonic() + self._pause_s
        if (self._is_low and self.free < 2 * self.mark) or not self._can_write():
            return False
        self.is_waiting = False
        return True

    def has_been_of_use(self) -> None:
        """Record that something was written, so that the next wait begins with a short pause."""
        self._pause_s = FIRST_PAUSE_S

    def _can_write(self) -> bool:
        folder = Folder(self.root)
        try:
            with ExitStack() as stack:
                first, *_ = [stack.enter_context(folder.draft(PROBE)) for _ in range(self._n_files)]
                for done in range(0, self._n_bytes, CHUNK_BYTES):
                    # Not zeros, which some file systems store without using space.
                    first.stream.write(os.urandom(min(CHUNK_BYTES, self._n_bytes - done)))
                first.sync()
        except OSError as error:
            if is_full(error):
                return False
            raise
        return True
