"""Parameters as YAML for people: every key, with the comment that says what it means.

Reading a file is the only side effect.
"""

import re
from collections.abc import Mapping
from typing import Any

import yaml
from pydantic import ValidationError

from synth3dlanes.distributions import extent, form
from synth3dlanes.params import Params, find_preset, forms, nearest_preset
from synth3dlanes.yaml_text import read_yaml, text_of

REFERENCE = "appendix_i"
# The column of comments, as in the presets.
COMMENT_COLUMN = 32
# Parameters with more changes are not called by their preset.
MOST_CHANGES, OWN = 8, "own parameters"
# Larger whole numbers are written as numbers with a point, as they are.
MOST_SHORT = 1e15

KEPT = "your own values, which weather and daytime leave as they are"

LINE = re.compile(r"(?P<indent>\s*)(?P<key>\w+):[^#]*(?:#(?P<comment>.*))?$")

Comments = dict[tuple[str, str], str]


def params_yaml(params: Params, source: str = REFERENCE) -> str:
    """The parameters as a complete YAML file that `load_params` reads back to equal Params.

    Comments are those of the preset or file `source`, or of the reference preset where that has none.
    """
    own = _text_of(source)
    told = (comments_of(source), comments_of(REFERENCE))
    found = {key: comment for comments in reversed(told) for key, comment in comments.items() if comment}
    head = _head(own)
    parts = [head] if head else []
    for group, keys in forms(params).items():
        lines = [_line(f"{group}:", found.get((group, ""), ""))]
        for key, read in keys.items():
            lines.append(_line(f"  {key}: {_flow(read)}", found.get((group, key), "")))
        parts.append("\n".join(lines) + "\n")
    if params.kept:
        parts.append(_line(f"kept: [{', '.join(params.kept)}]", KEPT) + "\n")
    return "\n".join(parts)


def comments_of(source: str) -> Comments:
    """The comment beside each key that a preset or file has, "" where there is none; groups have the key ""."""
    found: Comments = {}
    group = ""
    for line in _text_of(source).splitlines():
        if (named := LINE.match(line)) is None:
            continue
        if not named["indent"]:
            group = named["key"]
        found[group, named["key"] * bool(named["indent"])] = (named["comment"] or "").strip()
    return found


def contradictions(params: Params) -> list[str]:
    """The user's own values that do not fit the weather or the time of day, as a high sun at night, a line each."""
    open_to, lines = params.open_to(), []
    for path in params.kept:
        group, key = path.split(".")
        own = getattr(getattr(params, group), key)
        (low, high), usual = extent(own), open_to.get(path, {})
        other = [
            f"{_flow(form(distribution))} with {weather}"
            for weather, distribution in usual.items()
            if not extent(distribution)[0] <= low <= high <= extent(distribution)[1]
        ]
        if other:
            lines.append(f"{path}: your own {_flow(form(own))} is kept; left open, it would be {' and '.join(other)}")
    return lines


def preset_of(document: Mapping[str, Any]) -> str:
    """What parameters are called, as `dataset.json` has them: `streets`, or `tiny with cars.n=3`, by the preset that
    they differ least from; "own parameters" where they differ from all in many keys or cannot be read."""
    try:
        params = Params.model_validate(document)
    except ValidationError:
        return OWN
    name, differing = nearest_preset(params)
    changes = [
        f"{group}.{key}={_flow(read)}"
        for group, keys in forms(params).items()
        for key, read in keys.items()
        if f"{group}.{key}" in {*differing, *params.kept}
    ]
    if len(changes) > MOST_CHANGES:
        return OWN
    return f"{name} with {', '.join(changes)}" if changes else name


def keys_left_out(source: str) -> list[str]:
    """The keys that a preset or file leaves out, which have their defaults: `group.key`, or `group.*` for all of one.

    Files of earlier versions lack the keys that were added since. Those of towns are for presets of towns alone.
    """
    document, _ = read_yaml(_text_of(source), source)
    told: list[str] = []
    params = Params.model_validate(document)
    for group, keys in forms(params).items():
        if group == "town" and not params.is_town:
            continue
        there = document.get(group, {})
        missing = [f"{group}.{key}" for key in keys if key not in there]
        told += [f"{group}.*"] if len(missing) == len(keys) else missing
    return told


def _text_of(source: str) -> str:
    path, where = find_preset(source)
    return text_of(path, where)


def _head(text: str) -> str:
    """The comment that a file begins with."""
    found = re.match(r"(#[^\n]*\n)+", text)
    return found[0] if found else ""


def _flow(read: Any) -> str:
    """A value in a line, with whole numbers written as such."""
    if isinstance(read, dict):
        short: Any = {_short(value): _short(weight) for value, weight in read.items()}
    else:
        short = [_short(value) for value in read] if isinstance(read, list) else _short(read)
    text: str = yaml.safe_dump(short, default_flow_style=True, sort_keys=False, width=10_000)
    return text.removesuffix("...\n").strip()


def _short(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) < MOST_SHORT else value


def _line(text: str, comment: str) -> str:
    return f"{text:<{COMMENT_COLUMN - 2}}  # {comment}" if comment else text
