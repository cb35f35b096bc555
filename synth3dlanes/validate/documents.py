"""Compare JSON documents value by value; each difference is a line that starts with the value's path."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

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
