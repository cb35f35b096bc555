"""Addresses of data sets: a folder here, or whatever fsspec opens (s3://, gs://, sftp://, ...)."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import fsspec
from fsspec.implementations.local import LocalFileSystem

from synth3dlanes.dataset.local_files import LocalFiles
from synth3dlanes.errors import FormatError, InputError, MissingPackageError

SAMPLE = re.compile(r".+:\d+")
"""The address of a sample: `DIR/train:00000017`."""


def is_url(place: str) -> bool:
    """Whether this names a store, not a folder."""
    return "://" in place


def connect(url: str) -> tuple[Any, str]:
    """The file system of an address and the path in it.

    Raises InputError where fsspec knows no such address, MissingPackageError where it needs a package for it.
    """
    if "\0" in url:
        raise InputError(f"{url!r}: expected a folder or an address, got a name with a null byte")
    try:
        files, root = fsspec.core.url_to_fs(url)
    except ImportError as error:
        raise MissingPackageError(f"{url}: {error}") from None
    except ValueError as error:
        raise InputError(f"{url}: expected a folder or an address that fsspec can open, got {error}") from None
    return LocalFiles() if isinstance(files, LocalFileSystem) else files, str(root).rstrip("/")


@contextmanager
def translate_store_errors(place: str, problem: str = "cannot be reached") -> Iterator[None]:
    """Whatever a file system refuses becomes a FormatError that names the place and the problem."""
    try:
        yield
    except store_errors() as error:
        reason = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        raise FormatError(f"{place}: {problem}: {reason}") from None


def splits_near(place: str) -> str:
    """What to name instead of a wrong place, as in "; there is DIR/train, DIR/val": the splits of the data set at or
    above it; "" where there is none."""
    files, root = connect(place)
    place, root = (re.sub(r":\d*$", "", path.rstrip("/")) for path in (place, root))
    for _ in range(2):
        with suppress(*store_errors()):
            found = sorted({str(path).rsplit("/", 2)[-2] for path in files.glob(f"{root}/*/*.parquet")})
            if found:
                return f"; there is {', '.join(f'{place}/{name}' for name in found[:10])}"
        place, root = (path.rpartition("/")[0] or "." for path in (place, root))
    return ""


def store_errors() -> tuple[type[Exception], ...]:
    """What file systems raise. Amazon's library, once loaded, has its own for no credentials and no connection."""
    amazon = sys.modules.get("botocore.exceptions")
    return (OSError, amazon.BotoCoreError) if amazon else (OSError,)
