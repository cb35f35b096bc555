"""Addresses of data sets: a folder here, or whatever fsspec opens (s3://, gs://, sftp://, http://, ...)."""

import errno
import os
import re
import socket
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import fsspec
from fsspec.implementations.local import LocalFileSystem

from synth3dlanes.system.errors import FormatError, InputError, MissingPackageError, OutageError, Synth3dlanesError
from synth3dlanes.system.files import open_regular
from synth3dlanes.system.schema import MAX_BYTES

# An index of 1,000,000 samples takes 600 MB, one sample of 8192 x 8192 pixels with all passes 1 GB.
MAX_READ_BYTES = 2 << 30
MOST_BYTES = {".json": MAX_BYTES, ".md": MAX_BYTES}


class LocalFiles(LocalFileSystem):  # type: ignore[misc]
    """Pipes and devices are refused, which would be waited for or read without end, and so is what is too large."""

    def cat_file(self, path: str, start: int | None = None, end: int | None = None, **named: Any) -> bytes:
        """The bytes from `start` to before `end`; raise FormatError for other kinds of files, and for too many."""
        place = Path(self._strip_protocol(path))
        most = MOST_BYTES.get(place.suffix, MAX_READ_BYTES)
        with open_regular(place) as stream:
            size = os.fstat(stream.fileno()).st_size
            first, last = slice(start, end).indices(size)[:2]
            if last - first > most:
                raise FormatError(f"{place}: expected at most {most:,} bytes, got {last - first:,}")
            stream.seek(first)
            return stream.read(max(0, last - first))

    def _open(self, path: str, mode: str = "rb", *arguments: Any, **named: Any) -> Any:
        if "r" in mode:
            open_regular(Path(path)).close()
        return super()._open(path, mode, *arguments, **named)


SAMPLE = re.compile(r".+:\d+")
"""The address of a sample: `DIR/train:00000017`."""
EXPECTED = "expected a folder or an address that fsspec can open"
# Errors of a connection or a server that may be over in a minute, in addition to Python's own. `REFUSALS` are lasting.
OUTAGES = {
    "aiohttp": ("ClientConnectionError", "ClientPayloadError"),
    "botocore.exceptions": ("ConnectionError", "HTTPClientError", "IncompleteReadError"),
    "httpx": ("TransportError",),
    "httpx2": ("TransportError",),
    "paramiko": ("SSHException",),
    "requests": ("ConnectionError", "Timeout"),
}
REFUSALS = {"paramiko": ("AuthenticationException", "BadHostKeyException")}
NO_KEYS = {
    "botocore.exceptions": ("NoCredentialsError", "PartialCredentialsError", "CredentialRetrievalError"),
    "google.auth.exceptions": ("GoogleAuthError",),
    "paramiko": ("AuthenticationException",),
}
OUTAGE_ERRNOS = {
    *(errno.EBUSY, errno.EIO, getattr(errno, "EREMOTEIO", errno.EIO), errno.ESTALE),
    *(errno.ENETDOWN, errno.ENETUNREACH, errno.EHOSTDOWN, errno.EHOSTUNREACH),
}
TOO_MANY_REQUESTS, SERVER_ERROR, NO_ACCESS = 429, 500, (401, 403)


def is_url(place: str) -> bool:
    """Whether this names a store, not a folder."""
    return "://" in place


def connect(url: str) -> tuple[Any, str]:
    """The file system of an address and the path in it.

    Raises InputError where fsspec cannot open such an address, MissingPackageError where it needs a package for it,
    OutageError where the server cannot be reached.
    """
    if "\0" in url:
        raise InputError(f"{url!r}: expected a folder or an address, got a name with a null byte")
    try:
        if not is_url(url):
            return LocalFiles(), os.path.abspath(os.path.expanduser(url)).rstrip("/")
        files, root = fsspec.core.url_to_fs(url)
    except ImportError as error:
        raise MissingPackageError(f"{url}: {_first_line(error)}") from None
    except Exception as error:  # noqa: BLE001 - file systems raise what they like
        if is_outage(error):
            raise OutageError(f"{url}: cannot be reached: {_reason(error)}") from None
        raise InputError(f"{url}: {EXPECTED}, got {_reason(error)}") from None
    return LocalFiles() if isinstance(files, LocalFileSystem) else files, str(root).rstrip("/")


@contextmanager
def translate_store_errors(place: str, problem: str = "cannot be reached") -> Iterator[None]:
    """Turn every error of a file system into one line with the place and the problem: OutageError if a retry can help,
    FormatError if the file system refuses."""
    try:
        yield
    except Synth3dlanesError:
        raise
    except Exception as error:  # noqa: BLE001 - file systems raise what they like
        kind = OutageError if is_outage(error) else FormatError
        hint = "; check the keys for this store, and what they allow" if _is_no_access(error) else ""
        raise kind(f"{place}: {problem}: {_reason(error)}{hint}") from None


def is_outage(error: BaseException) -> bool:
    """Whether an error is a failure of the connection or of the server, which a retry may not meet again."""
    if isinstance(error, _loaded(REFUSALS)):
        return False
    status = _status(error)
    if status is not None:
        return status == TOO_MANY_REQUESTS or status >= SERVER_ERROR
    is_connection = isinstance(error, (ConnectionError, TimeoutError, socket.gaierror, EOFError, *_loaded(OUTAGES)))
    return is_connection or (isinstance(error, OSError) and error.errno in OUTAGE_ERRNOS)


def _is_no_access(error: BaseException) -> bool:
    """Whether a store, not this machine's disk, says who may not do what, or asks who it is."""
    is_of_store = isinstance(error, PermissionError) and not error.strerror
    return is_of_store or isinstance(error, _loaded(NO_KEYS)) or _status(error) in NO_ACCESS


def _status(error: BaseException) -> int | None:
    """The status of an answer by HTTP."""
    response = getattr(error, "response", None)
    found = (getattr(error, "status", None), getattr(error, "code", None), getattr(response, "status_code", None))
    return next((status for status in found if isinstance(status, int)), None)


def can_list(files: Any) -> bool:
    """Whether a file system can say which files it has; a server of plain HTTP cannot."""
    return not {"http", "https"} & kinds(files)


def kinds(files: Any) -> set[str]:
    """The protocols of a file system, such as s3 and s3a."""
    return {files.protocol} if isinstance(files.protocol, str) else set(files.protocol)


def read_file(files: Any, path: str) -> bytes | None:
    """The bytes of a file, or None where there is none. Asks the store again, because its cached listing may be out of
    date."""
    try:
        return bytes(files.cat_file(path))
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return None


def listed_splits(files: Any, root: str) -> list[str]:
    """The names of the folders of `root` that hold indices of shards. Its name may have characters of patterns, as
    `[1]`, so nothing is searched by a pattern."""
    paths = (str(path).removeprefix(root).strip("/").split("/") for path in files.find(root, maxdepth=2))
    return sorted({path[0] for path in paths if len(path) == 2 and path[1].endswith(".parquet")})


def splits_near(place: str) -> str:
    """A hint for the message about a wrong place, such as "; there is DIR/train, DIR/val": the splits of the data set
    at or above it. "" where there is none."""
    files, root = connect(place)
    place, root = (re.sub(r":\d*$", "", path.rstrip("/")) for path in (place, root))
    for _ in range(2):
        with suppress(Synth3dlanesError), translate_store_errors(place):
            found = listed_splits(files, root) if can_list(files) else []
            if found:
                return f"; there is {', '.join(f'{place}/{name}' for name in found[:10])}"
        place, root = (path.rpartition("/")[0] or "." for path in (place, root))
    return ""


def _loaded(names: Mapping[str, tuple[str, ...]]) -> tuple[type[BaseException], ...]:
    """The exception classes whose packages are loaded; others cannot have been raised."""
    modules = ((sys.modules.get(module), kinds) for module, kinds in names.items())
    return tuple(getattr(module, kind) for module, kinds in modules for kind in kinds if hasattr(module, kind))


def _reason(error: BaseException) -> str:
    return getattr(error, "strerror", None) or f"{type(error).__name__}: {_first_line(error)}"


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [""])[0][:300]
