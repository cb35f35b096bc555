"""Scenes and labels made again on another kind of machine: which values differ, by more than rounding explains."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from synth3dlanes.labels.labels import MASKS
from synth3dlanes.validate.findings import NAMED_AT_MOST, shown

# Points of labels are rounded to 0.1 mm; shares of cars are counted by rays, some of which graze.
POINT_M, NUMBER, SHARE, OF_RAYS = 1.5e-4, 1e-5, 1e-6, 0.03
# What else may differ, by its key: of rounded places, of pixels at an object's edges, of points that graze it.
LEAST = dict.fromkeys(("xyz_cam", "center_cam", "size_m"), POINT_M)
LEAST |= dict.fromkeys(("car_visible_fraction", "visible_fraction"), OF_RAYS)
LEAST |= {"velocity_cam": 1.5e-3, "truncation": 3e-3, "seen_box_px": 2.0, "lidar_points": 3.0}
LEAST |= dict.fromkeys(("box_px", "unclipped_box_px"), 0.15)
# Points that graze an object may be seen by one machine and not by another: one, or this share of the masks' ends.
GRAZING = 0.05


def unlike(expected: bytes, found: bytes) -> Iterator[str]:
    """A line for each key with another value: its first places, and how many more there are."""
    made, lies = (dict(_leaves(json.loads(data))) for data in (expected, found))
    entries = [_entries(leaves) for leaves in (made, lies)]
    keys: dict[str, list[str]] = {}
    for path in dict.fromkeys([*made, *lies]):
        entry, _, key = path.rpartition(".")
        # Masks are compared together; of an entry that one of the two lacks, its list tells.
        pair = made.get(path), lies.get(path)
        if key not in MASKS and entry not in entries[0] ^ entries[1] and not _alike(key, *pair):
            keys.setdefault(key, []).append(f"{path}{_difference(*pair)}")
    for lines in keys.values():
        more = f" and {len(lines) - NAMED_AT_MOST} more of this key" if len(lines) > NAMED_AT_MOST else ""
        yield "; ".join(lines[:NAMED_AT_MOST]) + more
    for mask in MASKS:
        both = [path for path in made if path.endswith(f".{mask}") and path.rpartition(".")[0] in entries[1]]
        yield from _masks({path: made[path] for path in both}, lies)


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Paths and values: numbers, words, and arrays; of lists of objects their names, `lanes[]`. Lanes are named by
    their ids."""
    dot = f"{path}." if path else ""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _leaves(part, f"{dot}{key}")
    elif isinstance(value, list) and all(isinstance(part, dict) for part in value):
        parts = {str(part.get("id", i)): part for i, part in enumerate(value)}
        yield f"{path}[]", list(parts)
        for name, part in parts.items():
            yield from _leaves(part, f"{dot}{name}")
    else:
        yield path, value


def _entries(leaves: Mapping[str, Any]) -> set[str]:
    """The paths of the objects in lists."""
    return {f"{path[:-2]}.{name}" for path, names in leaves.items() if path.endswith("[]") for name in names}


def _alike(key: str, made: Any, lies: Any) -> bool:
    if _is_numbers(made) and _is_numbers(lies):
        a, b = np.array(made, float), np.array(lies, float)
        least = LEAST.get(key, NUMBER)
        return a.shape == b.shape and bool((np.abs(a - b) <= least + SHARE * np.abs(a)).all())
    return type(made) is type(lies) and made == lies


def _is_numbers(value: Any) -> bool:
    if isinstance(value, list):
        return bool(value) and all(_is_numbers(part) for part in value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def _difference(made: Any, lies: Any) -> str:
    """What is expected and what is there; of an array the place that differs most, and whether all differ so."""
    if not (isinstance(made, list) and isinstance(lies, list)):
        return f": expected {_or_none(made)}, got {_or_none(lies)}"
    if not (_is_numbers(made) and _is_numbers(lies)) or np.shape(made) != np.shape(lies):
        told = (f"{len(made)} of them", len(lies)) if len(made) != len(lies) else (shown(made), shown(lies))
        return f": expected {told[0]}, got {told[1]}"
    error = np.array(lies, float) - np.array(made, float)
    at = int(np.abs(error).reshape(len(error), -1).max(axis=1).argmax())
    is_same = len(error) > 1 and bool((np.abs(error - error[0]) < 2 * POINT_M).all())
    return f".{at}: expected {shown(made[at])}, got {shown(lies[at])}{', all by as much' if is_same else ''}"


def _or_none(value: Any) -> str:
    return "none" if value is None else shown(value)


def _masks(made: Mapping[str, Any], lies: Mapping[str, Any]) -> Iterator[str]:
    """Masks that differ at more points than graze something."""
    flips, ends, wrong, shifts = 0, 0, [], set()
    for path, expected in made.items():
        found = lies.get(path)
        if expected is None or found is None:
            if expected != found:
                yield f"{path}{_difference(expected, found)}"
            continue
        if len(expected) != len(found):
            continue
        at = np.flatnonzero(np.array(expected) != np.array(found))
        flips, ends = flips + len(at), ends + int(np.count_nonzero(np.diff(expected)))
        if len(at):
            wrong.append(f"{path}: {len(at)} points from point {at[0]} on")
            later, earlier = expected[:1] + expected[:-1] == found, expected[1:] + expected[-1:] == found
            shifts.add("later" if later else "earlier" if earlier else "")
    if flips > 1 + GRAZING * ends:
        common = f", each value a point {shifts.pop()}" if len(shifts) == 1 and "" not in shifts else ""
        more = f" and {len(wrong) - NAMED_AT_MOST} more masks" if len(wrong) > NAMED_AT_MOST else ""
        yield f"expected other values{common}: {'; '.join(wrong[:NAMED_AT_MOST])}{more}"
