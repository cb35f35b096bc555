"""Files of this machine: written below a folder that the user named, never through a link; read up to a size limit.

Anyone who may write to a folder can put a link there. A link given as the folder itself is followed. A link below it
raises LinkError, and what it points to is not changed.
"""

import errno
import fcntl
import io
import os
import re
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BufferedRandom, BufferedReader, FileIO
from pathlib import Path, PurePath
from typing import Any, BinaryIO

from synth3dlanes.system.errors import FormatError, InputError, LinkError

KINDS = {
    stat.S_IFREG: "a file",
    stat.S_IFLNK: "a link",
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
FOLDER_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
# Without O_NONBLOCK, opening a pipe would block.
FILE_FLAGS = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
PIECE_BYTES = 1 << 20
# As s3: of s3://lanes.
ADDRESS = re.compile(r"[a-z][a-z0-9+.-]+:")
# As `_temporary` names them.
UNFINISHED = re.compile(r"\..+\.[0-9a-f]{16}\.tmp", re.DOTALL)


@dataclass(frozen=True)
class Draft:
    """A file for `final`. Until it is complete it is at `path`, where it can be read."""

    stream: BinaryIO
    path: Path
    final: Path
    _file: FileIO
    _temporary: tuple[int, str]
    _place: tuple[int, str]

    def sync(self) -> None:
        """Flush the stream's bytes to the disk."""
        self.stream.flush()
        with _named(self.final):
            os.fsync(FileIO.fileno(self._file))

    def appear(self) -> None:
        """Move the complete file to its place, in one step; it stays there after a power cut. A link that was put there
        meanwhile is replaced, not followed."""
        self.sync()
        (beside, temporary), (folder, name) = self._temporary, self._place
        with _named(self.final):
            os.replace(temporary, name, src_dir_fd=beside, dst_dir_fd=folder)
            _sync_names(folder)


@dataclass(frozen=True)
class Folder:
    """A folder that the user named. Paths are relative to it; one with a link in it raises LinkError."""

    root: Path

    def make(self, path: str | PurePath = "") -> None:
        """Make the folder at `path`, and those above it, where they are missing. Raises InputError for an address as
        the root, which as a path would be a folder of its scheme."""
        if ADDRESS.fullmatch(next(iter(self.root.parts), "")) and not self.root.exists():
            raise InputError(f"out {self.root}: expected a folder of this machine, got an address")
        self.root.mkdir(parents=True, exist_ok=True)
        with self._folder(_parts(path), make=True):
            pass

    def make_in(self, path: str | PurePath) -> None:
        """Make the folder at `path` where it is missing; raise FileNotFoundError where the one above it is."""
        with suppress(FileExistsError), self._place(path) as (folder, name):
            os.mkdir(name, dir_fd=folder)

    def exists(self, path: str | PurePath) -> bool:
        """Whether there is anything at `path`."""
        try:
            with self._place(path) as (folder, name):
                return _kind(folder, name) is not None
        except FileNotFoundError:
            return False

    def is_folder(self, path: str | PurePath) -> bool:
        """Whether there is a folder at `path`; a link to one is none."""
        with suppress(FileNotFoundError), self._place(path) as (folder, name):
            return _kind(folder, name) == stat.S_IFDIR
        return False

    def names(self, path: str | PurePath = "") -> list[str]:
        """The names in the folder at `path`, in order; none where there is no folder."""
        try:
            with self._folder(_parts(path)) as folder:
                return sorted(os.listdir(folder))
        except FileNotFoundError:
            return []

    @contextmanager
    def draft(self, path: str | PurePath, unfinished: str | PurePath | None = None) -> Iterator[Draft]:
        """A file for `path`, which is put there when it `appear`s, and removed otherwise. Until then it is in the
        folder `unfinished`, or beside `path`. Other writers of the same path do not interfere. `remove_unfinished`
        removes what a killed process leaves."""
        above = _parts(path)[:-1] if unfinished is None else _parts(unfinished)
        with self._parent(path) as (folder, name), self._folder(above) as beside:
            self._expect_file(folder, name, path)
            temporary = _temporary(name)
            at, final = self.root.joinpath(*above, temporary), self.root / path
            try:
                file = _created(beside, temporary, final)
                with BufferedRandom(file) as stream:
                    yield Draft(stream, at, final, file, (beside, temporary), (folder, name))
            finally:
                _removed(beside, temporary)

    @contextmanager
    def replacing(self, path: str | PurePath, unfinished: str | PurePath | None = None) -> Iterator[BinaryIO]:
        """A stream to a file that appears whole at `path`, or not at all."""
        with self.draft(path, unfinished) as draft:
            yield draft.stream
            draft.appear()

    def write(self, path: str | PurePath, data: bytes, unfinished: str | PurePath | None = None) -> None:
        """Write a file as `replacing` does."""
        with self.replacing(path, unfinished) as stream:
            stream.write(data)

    def take(self, path: str | PurePath, source: Path) -> None:
        """Put the file at `source` at `path` too: as a hard link where the file system allows it, else as a copy."""
        with self._place(path) as (folder, name):
            self._expect_file(folder, name, path)
            temporary = _temporary(name)
            try:
                os.link(source, temporary, dst_dir_fd=folder)
                os.replace(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
                _sync_names(folder)
                return
            except OSError:
                pass
            finally:
                _removed(folder, temporary)
        with self.replacing(path) as stream, source.open("rb") as theirs:
            shutil.copyfileobj(theirs, stream)

    def renew(self, path: str | PurePath) -> BinaryIO:
        """A new, empty file that replaces any file there. A writer that is killed leaves a part of it."""
        with self._place(path) as (folder, name):
            self._expect_file(folder, name, path)
            _removed(folder, name)
            return BufferedRandom(_created(folder, name, self.root / path))

    def append(self, path: str | PurePath) -> BinaryIO:
        """The file at `path`, made if missing, unbuffered, opened for writing at its end. Raises LinkError for a file
        with a second hard link, which may be outside."""
        return _File(self._opened(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT), "ab", self.root / path)

    def update(self, path: str | PurePath) -> BinaryIO:
        """The file at `path`, unbuffered, opened for reading and writing in place. Raises LinkError for a file with a
        second hard link, which may be outside."""
        return _File(self._opened(path, os.O_RDWR), "r+b", self.root / path)

    def expect_file(self, path: str | PurePath) -> None:
        """Raise as writing a file at `path` does, where there is anything but a file."""
        with self._place(path) as (folder, name):
            self._expect_file(folder, name, path)

    def link(self, path: str | PurePath, target: str) -> None:
        """Make a link to `target` at `path`. Raises LinkError if anything else is there."""
        with self._place(path) as (folder, name):
            try:
                os.symlink(target, name, dir_fd=folder)
            except FileExistsError:
                if _kind(folder, name) == stat.S_IFLNK and os.readlink(name, dir_fd=folder) == target:
                    return
                raise LinkError(f"{self.root / path}: expected nothing or a link to {target}; remove it") from None

    def remove(self, path: str | PurePath) -> None:
        """Remove the file or link at `path`, if there is one."""
        with suppress(FileNotFoundError), self._place(path) as (folder, name):
            os.unlink(name, dir_fd=folder)

    def remove_empty(self, path: str | PurePath) -> None:
        """Remove the folder at `path`, if there is one with nothing in it."""
        with suppress(FileNotFoundError), self._place(path) as (folder, name):
            try:
                os.rmdir(name, dir_fd=folder)
            except OSError as error:
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise

    def remove_tree(self, path: str | PurePath) -> None:
        """Remove the folder at `path`, if there is one, with its contents. Links in it are removed, not what they point
        to."""
        with suppress(FileNotFoundError), self._place(path) as (folder, name):
            if _kind(folder, name) == stat.S_IFLNK:
                raise self._is_link(path)
            shutil.rmtree(name, dir_fd=folder)

    def remove_unfinished(self, path: str | PurePath) -> None:
        """Remove the unfinished files that killed writers of `path` left beside it. Those of living writers stay."""
        with suppress(FileNotFoundError), self._place(path) as (folder, name):
            for found in os.listdir(folder):
                if found.startswith(f".{name}.") and found.endswith(".tmp"):
                    _removed_if_left(folder, found)

    def remove_all_unfinished(self) -> None:
        """Remove the unfinished files that killed writers of any file left in the folder itself."""
        with suppress(FileNotFoundError), self._folder(()) as folder:
            for found in os.listdir(folder):
                if UNFINISHED.fullmatch(found):
                    _removed_if_left(folder, found)

    def sync(self, path: str | PurePath = "") -> None:
        """Write the names in the folder at `path` to the disk."""
        with self._folder(_parts(path)) as descriptor, _named(self.root / path):
            _sync_names(descriptor)

    def sync_file(self, path: str | PurePath) -> None:
        """Write the contents of the file at `path` to the disk."""
        with self._place(path) as (folder, name):
            file = os.open(name, os.O_RDONLY | FILE_FLAGS, dir_fd=folder)
            try:
                os.fsync(file)
            finally:
                os.close(file)

    @contextmanager
    def _parent(self, path: str | PurePath) -> Iterator[tuple[int, str]]:
        """The open folder that holds `path`, and the name in it."""
        *above, name = _parts(path)
        with self._folder(above) as folder:
            yield folder, name

    @contextmanager
    def _place(self, path: str | PurePath) -> Iterator[tuple[int, str]]:
        """The folder and name of a path, as `_parent` opens them, for system calls whose errors then name the path."""
        with _named(self.root / path), self._parent(path) as place:
            yield place

    @contextmanager
    def _folder(self, parts: Sequence[str], make: bool = False) -> Iterator[int]:
        assert not {"..", "/"} & set(parts), f"expected a path below {self.root}, got {'/'.join(parts)}"
        folder = os.open(self.root, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            for depth, part in enumerate(parts, start=1):
                if make:
                    with suppress(FileExistsError), _named(self.root.joinpath(*parts[:depth])):
                        os.mkdir(part, dir_fd=folder)
                        _sync_names(folder)
                try:
                    below = os.open(part, FOLDER_FLAGS, dir_fd=folder)
                except OSError as error:
                    error.filename = str(self.root.joinpath(*parts[:depth]))
                    if error.errno not in (errno.ENOTDIR, errno.ELOOP):
                        raise
                    raise self._other_kind(folder, PurePath(*parts[:depth]), "a folder") from None
                os.close(folder)
                folder = below
            yield folder
        finally:
            os.close(folder)

    def _opened(self, path: str | PurePath, flags: int) -> int:
        """A descriptor of the file of one name at `path`."""
        with self._place(path) as (folder, name):
            self._expect_file(folder, name, path)
            try:
                file = os.open(name, flags | FILE_FLAGS, 0o666, dir_fd=folder)
            except OSError as error:
                if error.errno != errno.ELOOP:
                    raise
                raise self._is_link(path) from None
        if os.fstat(file).st_nlink > 1:
            os.close(file)
            raise LinkError(f"{self.root / path}: expected a file of one name, got a hard link; replace it by a copy")
        return file

    def _expect_file(self, folder: int, name: str, path: str | PurePath) -> None:
        if _kind(folder, name) not in (None, stat.S_IFREG):
            raise self._other_kind(folder, PurePath(path), "a file")

    def _other_kind(self, folder: int, path: PurePath, expected: str) -> InputError:
        kind = _kind(folder, path.name)
        if kind == stat.S_IFLNK:
            return self._is_link(path)
        return InputError(f"{self.root / path}: expected {expected}, got {KINDS.get(kind or 0, 'something else')}")

    def _is_link(self, path: str | PurePath) -> LinkError:
        where = self.root / path
        target = os.readlink(where) if where.is_symlink() else "elsewhere"
        return LinkError(f"{where}: expected no link below {self.root}, got one to {target}; remove the link")


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A stream to a file that the user named, which appears whole or not at all; the folders above it are made. A link
    in its place raises LinkError."""
    folder = Folder(path.parent)
    folder.make()
    folder.remove_unfinished(path.name)
    with folder.replacing(path.name) as stream:
        yield stream


def write(path: Path, data: bytes) -> None:
    """Write a file as `replacing` does."""
    with replacing(path) as stream:
        stream.write(data)


def encoded(write_into: Callable[[BinaryIO], object]) -> bytes:
    """What a library writes into a stream. It gets none of a file: libraries do not look whether a disk took all."""
    stream = io.BytesIO()
    write_into(stream)
    return stream.getvalue()


def open_regular(path: Path) -> BufferedReader:
    """A stream from a regular file; a link to one is followed. Raises FormatError for any other kind of file, OSError
    like `open`."""
    # Without O_NONBLOCK, opening a pipe would block.
    file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    kind = stat.S_IFMT(os.fstat(file).st_mode)
    if kind != stat.S_IFREG:
        os.close(file)
        raise FormatError(f"{path}: expected a file, got {KINDS.get(kind, 'something else')}")
    return open(file, "rb")


def read_bounded(path: Path, most: int) -> bytes:
    """The contents of a regular file. Raises FormatError like `open_regular`, and for a file of more than `most`
    bytes."""
    with open_regular(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        # Python makes room for as many bytes as it is asked for; a file may have more than it tells.
        data = stream.read(size + 1) if size <= most else b""
        while size < len(data) <= most and (more := stream.read(min(most + 1 - len(data), PIECE_BYTES))):
            data += more
    if max(size, len(data)) > most:
        raise FormatError(f"{path}: expected at most {most:,} bytes, got {max(size, len(data)):,}")
    return data


def _parts(path: str | PurePath) -> tuple[str, ...]:
    return PurePath(path).parts


def _kind(folder: int, name: str) -> int | None:
    """The kind of file at a name, as in KINDS; None where there is nothing."""
    try:
        return stat.S_IFMT(os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode)
    except FileNotFoundError:
        return None


def _temporary(name: str) -> str:
    """An unpredictable name, which `remove_unfinished` recognises."""
    return f".{name}.{secrets.token_hex(8)}.tmp"


def _created(folder: int, name: str, path: Path) -> "_NewFile":
    """A new file, which is or becomes that at `path`, locked as long as it is open: it has a living writer."""
    with _named(path):
        file = os.open(name, os.O_RDWR | os.O_CREAT | os.O_EXCL | FILE_FLAGS, 0o666, dir_fd=folder)
    with suppress(OSError):
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return _NewFile(file, "w+b", path)


class _File(FileIO):
    """A file by its descriptor. What a full disk raises names its path."""

    def __init__(self, descriptor: int, mode: str, path: Path) -> None:
        super().__init__(descriptor, mode)
        self._path = path

    def write(self, data: Any) -> int:
        """Write all of it: a disk that is nearly full takes a part, and says so with the next bytes alone."""
        left = memoryview(data).cast("B")
        size = len(left)
        with _named(self._path):
            while left:
                left = left[super().write(left) or 0 :]
        return size


class _NewFile(_File):
    """A file that hides its descriptor from libraries, which would write to it and not look how much was written."""

    def fileno(self) -> int:
        """Refuse, as streams without a descriptor do."""
        raise io.UnsupportedOperation("fileno")


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Let errors of a file that was reached by a descriptor name its path."""
    try:
        yield
    except OSError as error:
        # One made anew: two names that once were there are told even if the second one is None.
        raise (OSError(error.errno, error.strerror, str(path)) if error.errno else error) from None


def _sync_names(folder: int) -> None:
    """Write the names in a folder to the disk, where its file system can be told to."""
    try:
        os.fsync(folder)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise


def _removed_if_left(folder: int, name: str) -> None:
    """Remove an unfinished file, unless a living writer has locked it."""
    file = None
    with suppress(OSError):
        file = os.open(name, os.O_RDONLY | FILE_FLAGS, dir_fd=folder)
    try:
        if file is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return
    except OSError as error:
        if error.errno != errno.ENOLCK:
            raise
    finally:
        if file is not None:
            os.close(file)
    _removed(folder, name)


def _removed(folder: int, name: str) -> None:
    with suppress(FileNotFoundError):
        os.unlink(name, dir_fd=folder)
