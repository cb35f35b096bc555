"""Results of checks: findings and their words, numbers that a check holds against limits; and how two JSON documents
differ."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.system.arrays import Points3

# Largest number of differences to list.
NAMED_AT_MOST = 3
# The guarantees of docs/validate.md hold up to this distance ahead of the camera.
PROOF_M = 40.0


class Finding(NamedTuple):
    """A fault of a sample, and its lane ("" for none in particular)."""

    lane: str
    reason: str


class Problem(NamedTuple):
    """A fault of a dataset: the sample (`train:00000017`) or file, the lane ("" for none in particular), the reason."""

    where: str
    lane: str
    reason: str

    def line(self) -> str:
        """The problem in one line."""
        reason = " ".join(self.reason.split())
        return ": ".join(part for part in (self.where, self.lane, reason) if part)


class Bounded(NamedTuple):
    """A number of a sample and the limits between which it is in a correct one."""

    name: str
    value: float
    least: float = -np.inf
    most: float = np.inf

    @property
    def is_beyond(self) -> bool:
        """Whether it is beyond its limits, or not a number."""
        return not self.least <= self.value <= self.most

    @property
    def use(self) -> float:
        """The share of its limit that it uses up; above 1 it is beyond."""
        value, least, most = self.value, self.least, self.most
        if np.isfinite(least) and np.isfinite(most):
            return abs(2 * value - least - most) / (most - least)
        if np.isfinite(most):
            return value / most if most > 0 else 1 + value - most
        return least / max(value, 1e-9) if least > 0 else 1 + least - value


class MovingObject(NamedTuple):
    """Where an object stands on the road, metres, and its velocity there, metres per second; None without a time. World
    frame."""

    foot_world: Float[np.ndarray, "3"]
    velocity_world: Float[np.ndarray, "3"] | None


class Instant(NamedTuple):
    """The objects of a picture by their numbers, the points of its lines by their ids in the world frame, its scene or
    drive, and its time in the clip. Pictures of one scene are compared with each other (`moving.between`)."""

    scene: str
    time_s: float
    objects: Mapping[int, MovingObject]
    lines: Mapping[str, Points3]


class Own(NamedTuple):
    """What a sample shares with no other, but for one that is `at` the same place, if that is told: its name and its
    digest."""

    what: str
    digest: str
    at: str = ""


# What a check of a sample yields.
Result = Finding | Bounded | Instant | Own


def findings_of(results: Iterable[Result]) -> list[Finding]:
    """The findings among results."""
    return [result for result in results if isinstance(result, Finding)]


def judged(
    name: str, value: float, reason: str, least: float = -np.inf, most: float = np.inf, lane: str = ""
) -> Iterator[Result]:
    """A number of a sample between its limits, or a finding."""
    number = Bounded(name, value, least, most)
    yield number
    if number.is_beyond:
        yield Finding(lane, reason)


def counted(
    name: str, wrong: Bool[np.ndarray, " n"], reason: str, single: int, share: float = 0.0, lane: str = ""
) -> Iterator[Result]:
    """The number of what is wrong: at most `single`, or a share of all, or a finding. In the reason, {wrong} and {n}
    are the numbers of what is wrong and of all."""
    n, n_wrong = len(wrong), int(np.count_nonzero(wrong))
    yield from judged(name, n_wrong, reason.format(wrong=n_wrong, n=n), most=max(single, share * n), lane=lane)


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
