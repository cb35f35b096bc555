"""Files of this machine: written below a folder that the user named, never through a link; read up to a bound.

Whoever may write to a folder can put a link there. A link given as the folder itself is followed; one below it is an
InputError, and what it points to stays as it is.
"""

import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from synth3dlanes.errors import FormatError, InputError

KINDS = {
    stat.S_IFLNK: "a link",
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
FOLDER_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
# Without O_NONBLOCK, a pipe is waited for.
FILE_FLAGS = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


@dataclass(frozen=True)
class Folder:
    """A folder that the user named. Paths are relative to it; one with a link in it raises InputError."""

    root: Path

    def make(self, path: str | PurePosixPath = "") -> None:
        """Make the folder at `path`, and those above it, where they are missing."""
        self.root.mkdir(parents=True, exist_ok=True)
        with self._folder(PurePosixPath(path).parts, make=True):
            pass

    def exists(self, path: str | PurePosixPath) -> bool:
        """Whether there is anything at `path`."""
        try:
            with self._parent(path) as (folder, name):
                return self._kind(folder, name) is not None
        except (FileNotFoundError, NotADirectoryError):
            return False

    @contextmanager
    def replacing(self, path: str | PurePosixPath, unfinished: str | PurePosixPath | None = None) -> Iterator[BinaryIO]:
        """A stream to a file that appears whole at `path`, or not at all; until then it lies in the folder
        `unfinished`, or beside it. Whoever else writes there does not matter."""
        with self._parent(path) as (folder, name), self._folder(_parts(unfinished, path)) as beside:
            self._expect_file(folder, name, path)
            temporary = f".{name}.{secrets.token_hex(8)}.tmp"
            try:
                with _created(beside, temporary) as stream:
                    yield stream
                    stream.flush()
                    os.fsync(stream.fileno())
                os.replace(temporary, name, src_dir_fd=beside, dst_dir_fd=folder)
            finally:
                with suppress(FileNotFoundError):
                    os.unlink(temporary, dir_fd=beside)

    def write(self, path: str | PurePosixPath, data: bytes, unfinished: str | PurePosixPath | None = None) -> None:
        """Write a file as `replacing` does."""
        with self.replacing(path, unfinished) as stream:
            stream.write(data)

    def create(self, path: str | PurePosixPath) -> BinaryIO:
        """A new, empty file; raise FileExistsError if there is anything at `path`."""
        with self._parent(path) as (folder, name):
            return _created(folder, name)

    def append(self, path: str | PurePosixPath) -> BinaryIO:
        """The file at `path`, or a new one, unbuffered, open to be written at its end. A file with a second name,
        perhaps elsewhere, raises InputError."""
        with self._parent(path) as (folder, name):
            self._expect_file(folder, name, path)
            flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | FILE_FLAGS
            stream = open(os.open(name, flags, 0o666, dir_fd=folder), "ab", buffering=0)  # noqa: SIM115
        if os.fstat(stream.fileno()).st_nlink > 1:
            stream.close()
            raise InputError(f"{self.root / path}: expected a file of one name, got a hard link; replace it by a copy")
        return stream

    def remove(self, path: str | PurePosixPath) -> None:
        """Remove the file or link at `path`, if there is one."""
        with suppress(FileNotFoundError), self._parent(path) as (folder, name):
            os.unlink(name, dir_fd=folder)

    def remove_tree(self, path: str | PurePosixPath) -> None:
        """Remove the folder at `path`, if there is one, with all that is in it; links in it, not what they point to."""
        with suppress(FileNotFoundError), self._parent(path) as (folder, name):
            if self._kind(folder, name) == stat.S_IFLNK:
                raise self._is_link(path)
            shutil.rmtree(name, dir_fd=folder)

    def sync(self, path: str | PurePosixPath = "") -> None:
        """Write the names in the folder at `path` to the disk."""
        with self._folder(PurePosixPath(path).parts) as descriptor:
            os.fsync(descriptor)

    @contextmanager
    def _parent(self, path: str | PurePosixPath) -> Iterator[tuple[int, str]]:
        """The open folder that holds `path`, and the name in it."""
        *above, name = PurePosixPath(path).parts
        with self._folder(above) as folder:
            yield folder, name

    @contextmanager
    def _folder(self, parts: "tuple[str, ...] | list[str]", make: bool = False) -> Iterator[int]:
        assert not {"..", "/"} & set(parts), f"expected a path below {self.root}, got {'/'.join(parts)}"
        folder = os.open(self.root, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            for depth, part in enumerate(parts, start=1):
                if make:
                    with suppress(FileExistsError):
                        os.mkdir(part, dir_fd=folder)
                if self._kind(folder, part) == stat.S_IFLNK:
                    raise self._is_link(PurePosixPath(*parts[:depth]))
                below = os.open(part, FOLDER_FLAGS, dir_fd=folder)
                os.close(folder)
                folder = below
            yield folder
        finally:
            os.close(folder)

    def _expect_file(self, folder: int, name: str, path: str | PurePosixPath) -> None:
        kind = self._kind(folder, name)
        if kind == stat.S_IFLNK:
            raise self._is_link(path)
        if kind not in (None, stat.S_IFREG):
            raise InputError(f"{self.root / path}: expected a file, got {KINDS.get(kind or 0, 'something else')}")

    def _kind(self, folder: int, name: str) -> int | None:
        try:
            return stat.S_IFMT(os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode)
        except FileNotFoundError:
            return None

    def _is_link(self, path: str | PurePosixPath) -> InputError:
        where = self.root / path
        target = os.readlink(where) if where.is_symlink() else "elsewhere"
        return InputError(f"{where}: expected no link below {self.root}, got one to {target}; remove the link")


def open_regular(path: Path) -> BufferedReader:
    """A stream from a regular file, or from what a link to one points to. Raises FormatError for any other kind of
    file, OSError as `open` does."""
    # Without O_NONBLOCK, a pipe is waited for.
    stream = open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")  # noqa: SIM115
    kind = stat.S_IFMT(os.fstat(stream.fileno()).st_mode)
    if kind != stat.S_IFREG:
        stream.close()
        raise FormatError(f"{path}: expected a file, got {KINDS.get(kind, 'something else')}")
    return stream


def read_bounded(path: Path, most: int) -> bytes:
    """The contents of a regular file. Raises FormatError as `open_regular` and for one of more than `most` bytes."""
    with open_regular(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        data = stream.read(most + 1) if size <= most else b""
    if max(size, len(data)) > most:
        raise FormatError(f"{path}: expected at most {most:,} bytes, got {max(size, len(data)):,}")
    return data


def _parts(unfinished: str | PurePosixPath | None, path: str | PurePosixPath) -> tuple[str, ...]:
    return PurePosixPath(path).parts[:-1] if unfinished is None else PurePosixPath(unfinished).parts


def _created(folder: int, name: str) -> BinaryIO:
    return open(os.open(name, os.O_RDWR | os.O_CREAT | os.O_EXCL | FILE_FLAGS, 0o666, dir_fd=folder), "w+b")
