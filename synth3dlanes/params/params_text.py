"""Parameters as YAML for people: every key, with the comment that says what it means.

Reading a file is the only side effect.
"""

import re
from collections.abc import Collection, Mapping
from typing import Any

import yaml
from pydantic import ValidationError

from synth3dlanes.params.distributions import extent, form
from synth3dlanes.params.groups import DAYTIMES, KINDS
from synth3dlanes.params.params import (
    BASE,
    REFERENCE,
    Params,
    files_of,
    find_preset,
    forms,
    load_params,
    merged,
    nearest_preset,
    preset_names,
    preset_under,
)
from synth3dlanes.system.yaml_text import text_of

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

    Comments come from the preset or file `source` and its bases, or from the reference preset where these have none.
    """
    return _yaml(source, _head(files_of(source)[-1].text), forms(params), params.kept)


def changes_yaml(params: Params, source: str) -> str:
    """The parameters as a YAML file with a preset as `base` and the keys that differ from it, which `load_params` reads
    back to equal Params; the complete file for a preset without changes. `params` are `source` with changes.

    The base is the preset `source`, the preset that the file `source` is based on, or the preset from which `params`
    differ in the fewest keys.
    """
    preset = preset_under(source) or nearest_preset(params)[0]
    file, base = files_of(source)[-1], load_params(preset)
    if file.preset and params == base:
        return params_yaml(params, source)
    under = forms(base)
    differing = {
        group: {key: read for key, read in keys.items() if read != under[group][key]}
        for group, keys in forms(params).items()
    }
    told = {group: keys for group, keys in differing.items() if keys}
    kept = {path for path in params.kept for group, key in [path.split(".")] if key not in differing[group]}
    return _yaml(source, ("" if file.preset else _head(file.text)) + f"{BASE}: {preset}\n", told, sorted(kept))


def _yaml(source: str, head: str, told: Mapping[str, Mapping[str, Any]], kept: Collection[str]) -> str:
    """A file of these keys below its first lines, with the comments of `source`."""
    found: Comments = {}
    for name in (REFERENCE, source):
        found.update({key: comment for key, comment in comments_of(name).items() if comment})
    parts = [head] if head else []
    for group, keys in told.items():
        lines = [_line(f"{group}:", found.get((group, ""), ""))]
        for key, read in keys.items():
            lines.append(_line(f"  {key}: {_flow(read)}", found.get((group, key), "")))
        parts.append("\n".join(lines) + "\n")
    if kept:
        parts.append(_line(f"kept: [{', '.join(kept)}]", KEPT) + "\n")
    return "\n".join(parts)


def comments_of(source: str) -> Comments:
    """The comment beside each key that a preset or file, or what it is based on, has, "" where there is none; groups
    have the key ""."""
    found: Comments = {}
    for file in files_of(source):
        group = ""
        for line in file.text.splitlines():
            if (named := LINE.match(line)) is None:
                continue
            if not named["indent"]:
                group = named["key"]
            place = group, named["key"] * bool(named["indent"])
            found[place] = (named["comment"] or "").strip() or found.get(place, "")
    return found


def presets_described(kind: str = "") -> list[tuple[str, str]]:
    """The presets, or the ready cameras, rigs or lidars, by name, each with the first sentence of its file."""
    found = []
    for name in preset_names(kind):
        lines = _head(text_of(*find_preset(name, kind))).splitlines()
        words = " ".join(line.removeprefix("#").strip() for line in lines)
        found.append((name, words.partition(". ")[0].removesuffix(".")))
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

    Files of earlier versions lack the keys that were added since. Keys of towns, mountain roads and kinds of weather
    are not told where none of these may be drawn.
    """
    document = merged(files_of(source))
    told: list[str] = []
    params = Params.model_validate(document)
    unused = {*KINDS, *DAYTIMES}.difference(params.weather.kind.values, params.weather.daytime.values)
    for group, keys in forms(params).items():
        if (group == "town" and not params.is_town) or group in (*unused, "mountain"):
            continue
        there = document.get(group, {})
        missing = [f"{group}.{key}" for key in keys if key not in there]
        told += [f"{group}.*"] if len(missing) == len(keys) else missing
    return told


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
