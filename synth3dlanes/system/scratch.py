"""Temporary folders of this process. A process that asks for one first removes the folders of killed processes."""

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PREFIX = "synth3dlanes-scratch-"
# Whoever has the lock on this file in a folder owns the folder; the lock goes with the process.
OWNER = ".owner"


@contextmanager
def scratch() -> Iterator[Path]:
    """A new folder, removed at the end. It belongs to this process, however that ends."""
    _sweep(Path(tempfile.gettempdir()))
    # Under its own name only once it is locked: a folder of that name without a lock belongs to nobody.
    made = Path(tempfile.mkdtemp(prefix=f".{PREFIX}"))
    with (made / OWNER).open("xb") as owner:
        fcntl.flock(owner, fcntl.LOCK_EX)
        folder = made.rename(made.with_name(made.name.removeprefix(".")))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _sweep(temporary: Path) -> None:
    """Remove this user's folders whose processes have ended. Links in them, and links to them, are not followed."""
    for folder in temporary.glob(f"{PREFIX}*"):
        with suppress(OSError):
            if folder.is_symlink() or folder.stat().st_uid != os.geteuid():
                continue
            with open(os.open(folder / OWNER, os.O_RDWR | os.O_NOFOLLOW), "rb") as owner:
                fcntl.flock(owner, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
