"""The pages of docs/ that say what the code says: `python -m scripts.docs` (`make docs`) writes them anew."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import click
from pydantic import BaseModel, ValidationError
from synth3dlanes_cli.main import main

from scripts.latency import table as latency_table
from scripts.outputs import Outputs
from scripts.results import models_page, with_benchmarks
from scripts.tables import with_tables
from synth3dlanes.labels.labels import LabelsDocument
from synth3dlanes.params.groups import DAYTIMES, KINDS, REPLACED
from synth3dlanes.params.params import REFERENCE, Params, forms, load_params, preset_names
from synth3dlanes.params.params_text import comments_of
from synth3dlanes.scene.assets.catalogue import BUILT_IN
from synth3dlanes.scene.scene import Scene
from synth3dlanes.validate.checks import ALWAYS, CHECKS

FOLDER = Path(__file__).parents[1] / "docs"
WITH_TABLES = ("assets.md", "exports.md", "format.md", "frames.md")

CLI_HEAD = r"""# Commands

This page is the output of `synth3dlanes COMMAND --help`. `python -m synth3dlanes COMMAND` runs the same program when
the `synth3dlanes` script is not on your PATH. Commands whose results other programs may want have `--json`;
[outputs.schema.json](outputs.schema.json) is the JSON Schema of what each prints, under the command's name.

| exit code | meaning |
|---|---|
| 0 | success |
| 1 | its work failed or is incomplete, a store did not answer, a disk is full or fails; running it again can help |
| 2 | bad input, which has to be changed: one line per problem on stderr |
| 129, 130, 143 | stopped by SIGHUP (a closed terminal), by Ctrl-C, by SIGTERM |
| 141 | the program that reads the output has closed it, as `head -1` does |

## Shell completion

Completion of commands, options and their values works in bash 4.4 or later, zsh and fish. Add this line to the startup
file of your shell:

```sh
# bash, ~/.bashrc
eval "$(_SYNTH3DLANES_COMPLETE=bash_source synth3dlanes)"
# zsh, ~/.zshrc
eval "$(_SYNTH3DLANES_COMPLETE=zsh_source synth3dlanes)"
# fish, ~/.config/fish/completions/synth3dlanes.fish
_SYNTH3DLANES_COMPLETE=fish_source synth3dlanes | source
```
"""

PARAMS_HEAD = """# Parameters

A parameter file is a YAML file that names what it is based on and has the keys that it changes:

```yaml
base: streets                 # a preset, or the path of another file, from the folder of this one
road:
  lane_width_m: [3, 3.5]
```

`--params mine.yaml` uses it, `synth3dlanes params check mine.yaml` checks it, and `synth3dlanes params show --full
mine.yaml` prints every key. `synth3dlanes params show streets --set road.lane_width_m='[3, 3.5]' > mine.yaml` writes
this file. To change a single key, `--set camera.pitch_deg=3` will do. Fixing one key does not change the random values
of the others. Each value has one of these forms:

```yaml
lane_width_m: [3.2, 4.0]      # uniform; integers include both ends
lane_width_m: 3.6 +- 0.4      # the same: value +- spread
n_lanes: {2: 0.5, 3: 0.3}     # value: weight
height_m: 1.5                 # constant
```

Lengths are in metres, angles in degrees. A file without a base has every key. It may leave out keys and groups that
were added after version 0.1.0, which have the constants of `appendix_i` then; `params check` names them, and
`params show` prints the short file that means the same.

Rules change what is drawn, and `synth3dlanes stats` knows them:

- Weather and time of day replace ranges ([below](#weather-and-time-of-day)).
- Topologies 3 and 4 have at least two lanes, a median needs oncoming lanes and is at least a metre wide, and the host's
  lane is one of those present. Oncoming lanes that would fold on the inside of a sharp bend are left out.
- Towns have [rules of their own](town.md), and use neither `road`, `symbols`, `motion` nor most of `cars` and
  `roadside`. Mountain roads use neither `road`, `symbols`, `roadside` nor the host's lane and place.

In the tables, *other presets* are those with another value than `appendix_i`. "ours" marks what the paper does not
specify; [decisions.md](decisions.md) has the reasons.
"""

# Presets in the tables of all keys; the others are one of these but for some keys.
PRESETS = (REFERENCE, "realistic", "diverse", "streets", "town")
Forms = dict[str, dict[str, object]]

OTHERS_HEAD = """## Other presets
"""

WEATHER_HEAD = """## Weather and time of day

`weather.kind` and `weather.daytime` are drawn first. Any other than `any` is a group below, whose keys replace the
distributions of others, so that air, surface, light and camera fit each other; the rest of the scene is drawn as
without them. The presets have the ranges of `appendix_i` here. Denser fog is `--set fog.visibility_m='[50, 200]'`.

Your own values come first: a key that you give with `--set`, or in a file with a base, keeps your value in every
weather. In a file without a base, so do the keys that differ from those of the preset that it differs least from;
`kept: [weather.headlights]` names further ones. A value that does not fit the weather, such as a sun at 40 degrees at
night, is used and named in a line.
"""


def pages() -> dict[str, str]:
    """Every generated page by its name."""
    return {
        "cli.md": cli_page(),
        "params.md": params_page(),
        "scene.schema.json": json.dumps(Scene.model_json_schema(), indent=1) + "\n",
        "labels.schema.json": json.dumps(LabelsDocument.model_json_schema(), indent=1) + "\n",
        "outputs.schema.json": json.dumps(Outputs.model_json_schema(), indent=1) + "\n",
        "cluster.md": with_files((FOLDER / "cluster.md").read_text()),
        "baseline.md": with_latency((FOLDER / "baseline.md").read_text()),
        "benchmarks.md": with_benchmarks((FOLDER / "benchmarks.md").read_text()),
        "models.md": models_page(),
        "validate.md": with_checks((FOLDER / "validate.md").read_text()),
        **{name: with_tables((FOLDER / name).read_text()) for name in WITH_TABLES},
    }


def with_checks(page: str) -> str:
    """The page of `validate` with the list of its checks."""
    rows = [
        f"| {check.name} | {', '.join(f'`{name}`' for name in sorted(check.needs - ALWAYS))} | {check.finds} |"
        for check in CHECKS
    ]
    table = "\n".join(["| check | needs | finds |", "|---|---|---|", *rows])
    return re.sub(r"(?<=<!-- checks -->\n).*?(?=\n\n)", lambda _: table, page, flags=re.DOTALL)


def with_latency(page: str) -> str:
    """The page of the baseline with the costs of its networks."""
    return re.sub(r"(?<=<!-- latency -->\n\n).*?(?=\n\n)", lambda _: latency_table(), page, flags=re.DOTALL)


def with_files(page: str) -> str:
    """A page with every block that is marked `<!-- file NAME -->` filled anew from that file of docs/."""
    return re.sub(
        r"(?<=<!-- file )(\S+)( -->\n```\w+\n).*?(?=^```$)",
        lambda found: found[1] + found[2] + (FOLDER / found[1]).read_text(),
        page,
        flags=re.DOTALL | re.MULTILINE,
    )


def cli_page() -> str:
    """The help of every command."""
    parts = [CLI_HEAD]
    for name, command in commands():
        context = click.Context(
            command, info_name=name, terminal_width=100, max_content_width=100, **main.context_settings
        )
        parts += [f"## {name}\n", f"```\n{command.get_help(context)}\n```\n"]
    return "\n".join(parts)


def commands() -> list[tuple[str, click.Command]]:
    """Every command with its full name; groups are spelled out."""
    found = []
    for name, command in sorted(main.commands.items()):
        below = command.commands if isinstance(command, click.Group) else {}
        found += [(f"synth3dlanes {name} {sub}", below[sub]) for sub in sorted(below)]
        found += [] if below else [(f"synth3dlanes {name}", command)]
    return found


def params_page() -> str:
    """Every key: what it may be, what the presets say, what it means."""
    presets = {name: forms(load_params(name)) for name in PRESETS}
    legal, comments = legal_values(), preset_comments()
    parts = [PARAMS_HEAD]
    groups = presets[REFERENCE]
    for group in [name for name in groups if name not in (*KINDS, *DAYTIMES)]:
        parts += [f"## {group}\n", f"| key | legal values | {REFERENCE} | other presets | meaning |", f"|{'---|' * 5}"]
        for key in groups[group]:
            values = {name: shown(preset[group][key]) for name, preset in presets.items()}
            cells = (f"`{key}`", legal[group, key], values[REFERENCE], others_than(values), comments[group, key])
            parts.append(f"| {' | '.join(cells)} |")
        parts.append("")
    parts += [WEATHER_HEAD, *weather_table(KINDS, groups, legal), "", *weather_table(DAYTIMES, groups, legal), ""]
    parts += [OTHERS_HEAD, "| preset | is | but |", "|---|---|---|"]
    others = {name: forms(load_params(name)) for name in preset_names() if name not in PRESETS}
    for name, values_of in others.items():
        base = min(PRESETS, key=lambda preset: len(differing(presets[preset], values_of)))
        told = (f"`{key}` {shown(value)}" for key, value in differing(presets[base], values_of).items())
        parts.append(f"| {name} | {base} | {', '.join(told)} |")
    return "\n".join([*parts, ""])


def others_than(values: Mapping[str, str]) -> str:
    """The presets whose value is not that of the reference, those with equal values together."""
    names: dict[str, list[str]] = {}
    for name, value in values.items():
        if value != values[REFERENCE]:
            names.setdefault(value, []).append(name)
    return "; ".join(f"{', '.join(found)}: {value}" for value, found in names.items())


def differing(base: Forms, other: Forms) -> dict[str, object]:
    """The values of the keys that differ from those of another preset."""
    keys = [(group, key) for group in base for key in base[group]]
    return {f"{group}.{key}": other[group][key] for group, key in keys if base[group][key] != other[group][key]}


def weather_table(names: Sequence[str], groups: Forms, legal: Mapping[tuple[str, str], str]) -> list[str]:
    """The groups of kinds of weather or times of day, and what their keys replace."""
    rows = [f"| key | legal values | {' | '.join(f'`{name}`' for name in names)} | replaces |"]
    rows.append(f"|---|---|{'---|' * len(names)}---|")
    for key in dict.fromkeys(key for name in names for key in groups[name]):
        known = next(legal[name, key] for name in names if key in groups[name])
        values = (shown(groups[name][key]) if key in groups[name] else "" for name in names)
        rows.append(f"| {' | '.join((f'`{key}`', known, *values, f'`{REPLACED[key]}`'))} |")
    return rows


def shown(form: object) -> str:
    """A value as in YAML, with numbers as short as they can be."""
    if isinstance(form, list):
        return f"[{', '.join(map(shown, form))}]"
    if isinstance(form, dict):
        odds = ", ".join(f"{shown(value)}: {shown(weight)}" for value, weight in form.items())
        return "even odds" if len(set(form.values())) == 1 else f"{{{odds}}}"
    if isinstance(form, bool):
        return str(form).lower()
    return f"{form:g}" if isinstance(form, float) else str(form)


def legal_values() -> dict[tuple[str, str], str]:
    """What each key may be, in the words of its own error message."""
    nothing = {
        name: dict.fromkeys(field.annotation.model_fields)
        for name, field in Params.model_fields.items()
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
    }
    try:
        Params.model_validate(nothing, context=BUILT_IN.assets)
    except ValidationError as error:
        return {
            (str(problem["loc"][0]), str(problem["loc"][1])): str(problem["ctx"]["error"])
            .removeprefix("expected ")
            .split(" as ")[0]
            .split(" or {")[0]
            for problem in error.errors()
        }
    raise AssertionError("every key must refuse a value of none")


def preset_comments() -> dict[tuple[str, str], str]:
    """What the comment beside each key of the reference preset says."""
    comments = {(group, key): comment for (group, key), comment in comments_of(REFERENCE).items() if key}
    wanted = [(group, key) for group, keys in forms(load_params(REFERENCE)).items() for key in keys]
    missing = [f"{group}.{key}" for group, key in wanted if (group, key) not in comments]
    if missing:
        raise SystemExit(
            f"params/{REFERENCE}.yaml: expected a line with a comment for every parameter, got none for "
            f"{', '.join(missing)}; add it to the group there (CONTRIBUTING.md lists the other places)"
        )
    return comments


if __name__ == "__main__":
    for name, text in pages().items():
        (FOLDER / name).write_text(text)
