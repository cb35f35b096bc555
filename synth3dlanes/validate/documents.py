"""Two JSON documents compared: a line for every value that differs, by more than a tolerance of its key."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

# Largest number of differences to list.
NAMED_AT_MOST = 3


class Tolerance(NamedTuple):
    """By how much numbers may differ: by the value for their key, or else by `least`, and by a share of the expected
    value."""

    by_key: Mapping[str, float]
    least: float = 0.0
    share: float = 0.0


EXACT = Tolerance({})


def differences(
    expected: Any, found: Any, path: str = "", may_lack: bool = False, tolerance: Tolerance = EXACT
) -> Iterator[str]:
    """A line for every value that differs from the expected one; with `may_lack`, objects may lack keys."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for key in dict.fromkeys([*expected, *found]):
            if key in found or not may_lack:
                values = expected.get(key), found.get(key)
                yield from differences(*values, f"{path}.{key}" if path else str(key), may_lack, tolerance)
    elif isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        for i, values in enumerate(zip(expected, found, strict=True)):
            yield from differences(*values, f"{path}.{i}", may_lack, tolerance)
    elif isinstance(expected, list) and isinstance(found, list):
        yield f"{path}: expected {len(expected)} of them, got {len(found)}"
    elif not _is_near(expected, found, path, tolerance):
        yield f"{path}: expected {shown(expected)}, got {shown(found)}"


def _is_near(expected: Any, found: Any, path: str, tolerance: Tolerance) -> bool:
    if expected == found and isinstance(expected, bool) == isinstance(found, bool):
        return True
    is_number = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (expected, found))
    if not is_number or tolerance is EXACT:
        return False
    key = next((part for part in reversed(path.split(".")) if not part.isdecimal()), "")
    least = tolerance.by_key.get(key, tolerance.least)
    return bool(abs(expected - found) <= least + tolerance.share * abs(expected))


def some(lines: Sequence[str]) -> str:
    """The first lines joined into one, and the number of the others."""
    more = f" and {len(lines) - NAMED_AT_MOST} more" if len(lines) > NAMED_AT_MOST else ""
    # Text of a damaged file may contain characters that cannot be encoded.
    return ("; ".join(lines[:NAMED_AT_MOST]) + more).encode("utf-8", "backslashreplace").decode()


def shown(value: Any) -> str:
    """A value as JSON, truncated if long."""
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
