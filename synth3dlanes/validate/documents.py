"""Compare JSON documents value by value; each difference is a line that starts with the value's path."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import is_dataclass
from functools import lru_cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from jaxtyping import Shaped

# Upper limit of numbers in labels (metres, pixels, radians).
MAX_NUMBER = 1e6
# Largest number of lines to list.
NAMED_AT_MOST = 3


def some(lines: Sequence[str]) -> str:
    """The first lines joined into one, and the number of the others."""
    more = f" and {len(lines) - NAMED_AT_MOST} more" if len(lines) > NAMED_AT_MOST else ""
    # Text of a damaged file may contain characters that cannot be encoded.
    return ("; ".join(lines[:NAMED_AT_MOST]) + more).encode("utf-8", "backslashreplace").decode()


def differences(expected: Any, found: Any, path: str = "", may_lack: bool = False) -> Iterator[str]:
    """A line for every value that differs from the expected one; with `may_lack`, objects may lack keys."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for key in dict.fromkeys([*expected, *found]):
            if key in found or not may_lack:
                values = expected.get(key), found.get(key)
                yield from differences(*values, f"{path}.{key}" if path else str(key), may_lack)
    elif isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        for i, values in enumerate(zip(expected, found, strict=True)):
            yield from differences(*values, f"{path}.{i}", may_lack)
    elif isinstance(expected, list) and isinstance(found, list):
        yield f"{path}: expected {len(expected)} of them, got {len(found)}"
    elif expected != found or isinstance(expected, bool) != isinstance(found, bool):
        yield f"{path}: expected {shown(expected)}, got {shown(found)}"


def shown(value: Any) -> str:
    """A value as JSON, truncated if long."""
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def misfits(value: Any, kind: Any, path: str = "") -> Iterator[str]:
    """A line for every value that does not have its annotated type, or is a number beyond MAX_NUMBER: reading labels
    from JSON does not check types."""
    # A Literal or None is a Union, other types or None are a UnionType.
    options = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    if all(any(True for _ in _misfits(value, option, path)) for option in options):
        yield from _misfits(value, options[0], path)


def _misfits(value: Any, kind: Any, path: str) -> Iterator[str]:
    origin, arguments = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and is_dataclass(kind) and isinstance(value, kind):
        for name, of in _hints(kind).items():
            yield from misfits(getattr(value, name), of, f"{path}.{name}" if path else name)
    elif origin is tuple and isinstance(value, tuple):
        for i, item in enumerate(value):
            yield from misfits(item, arguments[0], f"{path}.{i}")
    elif origin is dict and isinstance(value, dict):
        for key, item in value.items():
            yield from misfits(item, arguments[1], f"{path}.{key}")
    elif not _fits(value, kind):
        name = " or ".join(map(str, arguments)) if origin is Literal else getattr(kind, "__name__", str(kind))
        yield f"{path}: expected {name}, got {_told(value)}"


def _fits(value: Any, kind: Any) -> bool:
    """Whether a scalar or array has a type."""
    if get_origin(kind) is Literal:
        return isinstance(value, str) and value in get_args(kind)
    if kind in (int, float):
        return isinstance(value, int | kind) and not isinstance(value, bool) and -MAX_NUMBER < value < MAX_NUMBER
    if kind is str:
        return isinstance(value, str) and value.isprintable()
    if kind in (bool, NoneType):
        return isinstance(value, kind)
    return isinstance(kind, type) and isinstance(value, kind) and _is_small(np.asarray(value))


def _is_small(values: Shaped[np.ndarray, "*n"]) -> bool:
    return bool((np.abs(values.astype(float)) < MAX_NUMBER).all())


@lru_cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _told(value: Any) -> str:
    return f"{value.dtype} of shape {value.shape}" if isinstance(value, np.ndarray) else f"{value!r:.40}"
