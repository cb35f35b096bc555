"""Addresses of data sets: a folder here, or whatever fsspec opens (s3://, gs://, sftp://, ...)."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import fsspec

from synth3dlanes.errors import FormatError, InputError


def is_url(place: str) -> bool:
    """Whether this names a store, not a folder."""
    return "://" in place


def connect(url: str) -> tuple[Any, str]:
    """The file system of an address and the path in it; raise InputError where fsspec knows no such address."""
    try:
        files, root = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise InputError(f"{url}: expected a folder or an address that fsspec can open, got {error}") from None
    return files, str(root).rstrip("/")


@contextmanager
def naming(place: str) -> Iterator[None]:
    """Whatever a store refuses becomes a FormatError that names the place."""
    try:
        yield
    except refusals() as error:
        raise FormatError(f"{place}: expected to reach it, got {type(error).__name__}: {error}") from None


def refusals() -> tuple[type[Exception], ...]:
    """What file systems raise. Amazon's library has errors of its own for no credentials and no connection."""
    amazon = sys.modules.get("botocore.exceptions")
    return (OSError, amazon.BotoCoreError) if amazon else (OSError,)
