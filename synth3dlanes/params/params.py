"""Params: the ranges that scenes are drawn from, and their YAML form (`params/*.yaml`, docs/params.md).

Metres and degrees. Reading a file is the only side effect.
"""

import copy
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, Field, ValidationError, model_validator

from synth3dlanes.params.distributions import Choice, Distribution, form
from synth3dlanes.params.groups import (
    DAYTIMES,
    IN_REFERENCE,
    KINDS,
    NO_JUNCTION,
    OPTIONAL,
    REPLACED,
    AirParams,
    CameraParams,
    CarParams,
    DayParams,
    DryParams,
    DuskParams,
    Group,
    HostParams,
    LightParams,
    MarkingsParams,
    MotionParams,
    MountainParams,
    NightParams,
    PeopleParams,
    RainParams,
    RidersParams,
    RoadParams,
    RoadsideParams,
    SensorParams,
    SnowParams,
    StructureParams,
    SurfaceParams,
    SymbolParams,
    TerrainParams,
    TownParams,
    TownStreetParams,
    TreeParams,
    VegetationParams,
    WeatherParams,
    WorksParams,
    left_out_at,
)
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Assets
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import did_you_mean, shown, unknown_key
from synth3dlanes.system.yaml_text import read_yaml, text_of

# The preset that has every key.
REFERENCE = "appendix_i"
# If more keys than this are missing, one line names them all.
MAX_MISSING = 3


def _read_kept(read: Any) -> tuple[str, ...]:
    """Keys that weather or time of day replace, in order; raise ValueError."""
    known = sorted(REPLACED.values())
    if not isinstance(read, list | tuple) or any(path not in known for path in read):
        raise ValueError(f"expected a list of keys that follow from the weather: {', '.join(known)}")
    return tuple(sorted(set(read)))


def _as_in_reference(name: str) -> Any:
    """A field whose values stand in the reference preset alone; `dataset.json` leaves it out if it has those."""
    return Field(exclude_if=lambda group: group == _reference_group(name))


class Params(Group):
    """The distribution of every parameter of a scene. Names are as in `scene.json`, with degrees instead of radians.
    `kept` are the keys, as `surface.wetness`, whose distributions are the user's own: weather and time of day leave
    them as they are.

    `model_dump(mode="json")` gives the YAML forms back; `Params.model_validate` reads them.
    """

    terrain: TerrainParams
    road: RoadParams
    markings: MarkingsParams
    surface: SurfaceParams
    cars: CarParams
    trees: TreeParams
    camera: CameraParams
    light: LightParams
    air: AirParams
    sensor: SensorParams
    symbols: SymbolParams = left_out_at(SymbolParams())
    weather: WeatherParams = left_out_at(WeatherParams())
    clear: DryParams = _as_in_reference("clear")
    cloudy: DryParams = _as_in_reference("cloudy")
    fog: DryParams = _as_in_reference("fog")
    rain: RainParams = _as_in_reference("rain")
    snow: SnowParams = _as_in_reference("snow")
    day: DayParams = _as_in_reference("day")
    dusk: DuskParams = _as_in_reference("dusk")
    night: NightParams = _as_in_reference("night")
    host: HostParams = left_out_at(HostParams())
    vegetation: VegetationParams = left_out_at(VegetationParams())
    roadside: RoadsideParams = left_out_at(RoadsideParams())
    structures: StructureParams = _as_in_reference("structures")
    motion: MotionParams = left_out_at(MotionParams())
    town: TownParams = left_out_at(TownParams())
    town_streets: TownStreetParams = _as_in_reference("town_streets")
    mountain: MountainParams = left_out_at(MountainParams())
    people: PeopleParams = left_out_at(PeopleParams())
    riders: RidersParams = left_out_at(RidersParams())
    works: WorksParams = left_out_at(WorksParams())
    kept: Annotated[tuple[str, ...], BeforeValidator(_read_kept)] = left_out_at(())

    @model_validator(mode="before")
    @classmethod
    def _filled(cls, document: Any) -> Any:
        """What a document leaves out of groups whose values stand in the reference preset, as there."""
        if not isinstance(document, dict):
            return document
        filled = dict(document)
        for name in IN_REFERENCE:
            given = document.get(name, {})
            filled[name] = {**_reference()[name], **given} if isinstance(given, dict) else given
        return filled

    @property
    def is_town(self) -> bool:
        """Whether scenes are towns, all or some of them."""
        return self.town.junction.values != (NO_JUNCTION,)

    def idle(self) -> dict[str, str]:
        """The groups that no scene of these parameters uses, each with the reason."""
        found = {
            name: f"as weather.{key} is never {name}"
            for key, names in (("kind", KINDS), ("daytime", DAYTIMES))
            for name in names
            if name not in getattr(self.weather, key).values
        }
        if not self.is_town:
            found |= dict.fromkeys(("town", "town_streets"), "as town.junction is always none")
        if self.mountain.road.values == ("none",):
            found["mountain"] = "as mountain.road is always none"
        if True not in self.works.present.values:
            found["works"] = "as works.present is always false"
        return found

    @property
    def groups(self) -> dict[str, Group]:
        """The groups by name."""
        return {name: group for name, group in self if isinstance(group, Group)}

    def open_to(self) -> dict[str, dict[str, Distribution]]:
        """What the kinds of weather and times of day that may be drawn replace: `group.key` -> distributions, by the
        value of `weather` that brings them."""
        found: dict[str, dict[str, Distribution]] = {}
        for name in ("kind", "daytime"):
            for value in getattr(self.weather, name).values:
                for path, distribution in self.replaced(value).items():
                    found.setdefault(path, {})[f"weather.{name} {value}"] = distribution
        return found

    def replaced(self, *names: str) -> dict[str, Distribution]:
        """The distributions that these kinds of weather and times of day replace, by `group.key`; none for any."""
        return {
            REPLACED[key]: distribution for name in names if name != "any" for key, distribution in getattr(self, name)
        }

    def keeping(self, own: Iterable[str]) -> "Params":
        """The parameters where these keys, too, are the user's own, so that weather does not replace them."""
        return self.model_copy(update={"kept": tuple(sorted({*self.kept, *own} & self.open_to().keys()))})

    def under(self, kind: str, daytime: str) -> "Params":
        """The parameters of scenes in this weather and at this time of day."""
        changes: dict[str, dict[str, Distribution]] = {}
        for path, distribution in self.replaced(kind, daytime).items():
            if path not in self.kept:
                group, key = path.split(".")
                changes.setdefault(group, {})[key] = distribution
        return self.model_copy(
            update={group: getattr(self, group).model_copy(update=keys) for group, keys in changes.items()}
        )


def presets_folder() -> Path:
    """The folder of the presets: inside the package in an installed wheel, at the root of a checkout."""
    package = Path(__file__).parents[1]
    installed = package / "_params"
    return installed if installed.is_dir() else package.parent / "params"


def preset_names(kind: str = "") -> list[str]:
    """The names of the presets, or of the ready `benchmarks`, `cameras`, `rigs` or `lidars`."""
    return sorted(path.stem for path in (presets_folder() / kind).glob("*.yaml"))


# The option that takes a kind of preset.
OPTION_OF = {"": "--params", "cameras": "--camera", "rigs": "--rig", "lidars": "--lidar"}


def find_preset(source: str, kind: str = "") -> tuple[Path, str]:
    """The path of a preset of some kind, by its name, or of a user's own file, by its path; and its name in messages.
    Raises InputError if there is neither."""
    if source in preset_names(kind):
        within = Path(kind, f"{source}.yaml")
        return presets_folder() / within, str("params" / within)
    if Path(source).suffix in (".yaml", ".yml"):
        return Path(source), source
    other = next((other for other in OPTION_OF if other != kind and source in preset_names(other)), None)
    hint = did_you_mean(source, preset_names(kind)) if other is None else f"; {source} is for {OPTION_OF[other]}"
    raise InputError(f"{source}: expected one of {', '.join(preset_names(kind))}, or the path of a .yaml file{hint}")


@lru_cache(maxsize=1)
def _reference() -> dict[str, dict[str, Any]]:
    """The keys of the reference preset, as they are written."""
    document, _ = _parsed(text_of(*find_preset(REFERENCE)), REFERENCE)
    found: dict[str, dict[str, Any]] = document
    return found


@lru_cache
def _reference_group(name: str) -> Group:
    """A group of the reference preset."""
    group: Any = Params.model_fields[name].annotation
    found: Group = group.model_validate(_reference()[name])
    return found


@dataclass(frozen=True, eq=False)
class _File:
    """A preset or a parameter file as it is written: its name in messages, its path, text, keys and problems."""

    where: str
    path: Path
    text: str
    document: dict[Any, Any]
    problems: list[str]
    preset: str


# The key of a file that names the preset or the file that it changes; what keys without a file are called in messages.
BASE, GIVEN = "base", "params"


def _read_file(source: str, by: _File | None = None) -> _File:
    """A preset or file, as the base of another file or as a user names it."""
    named = "" if by is None else f"{by.where}: {BASE}: "
    try:
        path, where = find_preset(source)
    except InputError as error:
        raise InputError(*(f"{named}{problem}" for problem in error.problems)) from None
    if by is not None and where == source:
        path = by.path.parent / source
        where = str(path)
    text = text_of(path, f"{named}{where}")
    document, problems = copy.deepcopy(_parsed(text, where))
    is_preset = os.path.realpath(path) == os.path.realpath(presets_folder() / path.name)
    if not isinstance(document, dict):
        raise InputError(*(problems or [f"{where}: expected groups of parameters, got {shown(document)}"]))
    return _File(where, path, text, document, problems, path.stem if is_preset else "")


def files_of(source: str | Mapping[Any, Any]) -> list[_File]:
    """A preset, a file, or the keys of a file, preceded by the files that it is based on. Raises InputError."""
    if isinstance(source, str):
        files = [_read_file(source)]
    else:
        files = [_File(GIVEN, Path(GIVEN), "", copy.deepcopy(dict(source)), [], "")]
    seen = [os.path.realpath(files[0].path)]
    while BASE in files[0].document:
        first, base = files[0], files[0].document.pop(BASE)
        if not isinstance(base, str):
            expected = "the name of a preset or the path of a parameter file"
            raise InputError(*first.problems, f"{first.where}: {BASE}: expected {expected}, got {shown(base)}")
        files.insert(0, _read_file(base, first))
        seen.append(os.path.realpath(files[0].path))
        if seen[-1] in seen[:-1]:
            circle = " -> ".join(file.where for file in reversed(files))
            raise InputError(f"{first.where}: {BASE}: expected a file that is not based on this one, got {circle}")
    return files


def preset_under(source: str) -> str:
    """The preset that a file is based on, or that a source names; "" for a file without a base."""
    return next((file.preset for file in reversed(files_of(source)) if file.preset), "")


def merged(files: Sequence[_File]) -> dict[Any, Any]:
    """The keys of all files; a later file's value replaces an earlier one's."""
    document: dict[Any, Any] = {}
    for file in files:
        for name, read in file.document.items():
            under = document.get(name)
            if isinstance(read, dict) and isinstance(under, dict):
                document[name] = {**under, **read}
            else:
                document[name] = [*under, *read] if isinstance(read, list) and isinstance(under, list) else read
    return document


def _named(files: Iterable[_File]) -> dict[str, str]:
    """The groups and keys that files have, as `cars` and `cars.n`, each with the name of the last such file."""
    found = {}
    for file in files:
        for name, read in file.document.items():
            found[str(name)] = file.where
            found.update({f"{name}.{key}": file.where for key in read} if isinstance(read, dict) else {})
    return found


def load_params(
    source: str | Mapping[Any, Any], overrides: Sequence[str] = (), assets: Assets = BUILT_IN.assets
) -> Params:
    """Read a preset (by name) or a YAML file, or take the keys of one, with what it is based on, then apply overrides
    like `road.n_lanes=3`. Keys without a base are all keys, as `dataset.json` has them.

    Numbers of models and textures refer to `assets`; see `numbers`. Raises one InputError with a line
    for every problem, each naming file and key.
    """
    files = files_of(source)
    problems = [problem for file in files for problem in file.problems]
    document = merged(files)
    overridden, override_problems = _override(document, overrides)
    try:
        params = Params.model_validate(document, context=assets)
    except ValidationError as error:
        places = {**_named(files), **dict.fromkeys(overridden, "overrides")}
        raise InputError(*problems, *override_problems, *_problems(error, files[-1].where, places)) from None
    if problems or override_problems:
        raise InputError(*problems, *override_problems)
    # Keys of their author's own are those in files that change a preset; of those in a complete file, which has all
    # keys, the ones that differ from the preset that it was made from.
    own = overridden | _named(file for file in files if not file.preset).keys()
    if not isinstance(source, str) and len(files) == 1:
        own = overridden
    elif not any(file.preset for file in files) and params.open_to():
        own = overridden | nearest_preset(params)[1] | _named(files[1:]).keys()
    return params.keeping(own)


def nearest_preset(params: Params) -> tuple[str, set[str]]:
    """The preset that parameters differ least from, and the keys, as `cars.n`, that differ."""
    own = forms(params)
    changes = {
        name: {f"{group}.{key}" for group in own for key, form in own[group].items() if form != base[group][key]}
        for name in preset_names()
        for base in [forms(load_params(name))]
    }
    name = min(changes, key=lambda name: len(changes[name]))
    return name, changes[name]


@lru_cache(maxsize=16)
def _parsed(text: str, where: str) -> tuple[Any, list[str]]:
    """The result of `read_yaml`, which takes most of the time of loading, computed once for each file."""
    return read_yaml(text, where)


def check_params(sources: Iterable[str], overrides: Sequence[str] = ()) -> None:
    """Load every source; raise one InputError with the problems of all."""
    problems: list[str] = []
    for source in sources:
        try:
            load_params(source, overrides)
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(*dict.fromkeys(problems))


def is_parameter(group: str, key: str) -> bool:
    """Whether there is a parameter of this name."""
    return key in _keys((group,))


def fixed(params: Params, group: str, key: str, value: Any) -> Params:
    """The parameters with one of them constant; raise pydantic's ValidationError for a value that is not legal."""
    changed: dict[str, Any] = {name: dict(keys) for name, keys in params.groups.items()}
    changed[group][key] = value
    return Params.model_validate({**changed, "kept": params.kept})


def problems_of(params: Params, path: str, value: Any) -> list[str]:
    """What is wrong with a constant value of the parameter `group.key`, in lines; nothing for other paths."""
    group, _, key = path.partition(".")
    if not is_parameter(group, key):
        return []
    try:
        found = getattr(getattr(fixed(params, group, key, value), group), key)
    except ValidationError as error:
        return [f"{path}: {problem['ctx']['error']}, got {shown(value)}" for problem in error.errors()]
    is_constant = isinstance(found, Choice) and len(found.values) == 1
    return [] if is_constant else [f"{path}: expected a constant, got {shown(value)}"]


def forms(params: Params) -> dict[str, dict[str, Any]]:
    """The YAML form of every key, by group and key."""
    return {name: {key: form(distribution) for key, distribution in group} for name, group in params.groups.items()}


def _override(document: dict[Any, Any], overrides: Iterable[str]) -> tuple[set[str], list[str]]:
    """Set `group.key` in place; return the keys that were set and the problems."""
    done: set[str] = set()
    problems: list[str] = []
    for override in overrides:
        path, equals, text = override.partition("=")
        steps = path.strip().split(".")
        if not equals or len(steps) != 2:
            problems.append(f"overrides {override}: expected group.key=value")
            continue
        value, value_problems = read_yaml(text, f"overrides {path.strip()}")
        problems += value_problems
        group = document.setdefault(steps[0], {}) if steps[0] in OPTIONAL else document.get(steps[0])
        if isinstance(group, dict) and not value_problems:
            group[steps[1]] = value
            done.add(path.strip())
        elif not _keys((steps[0],)):
            groups = [name for name in Params.model_fields if _keys((name,))]
            problems.append(f"overrides {path.strip()}: {unknown_key(steps[0], groups)}")
    return done, problems


def _problems(error: ValidationError, where: str, places: Mapping[str, str]) -> list[str]:
    """A line for each problem of a file `where`; the place of a group or key that is elsewhere is in `places`."""
    lines = []
    missing = [".".join(map(str, problem["loc"])) for problem in error.errors() if problem["type"] == "missing"]
    for problem in error.errors():
        path = ".".join(str(step) for step in problem["loc"])
        place = places.get(path, where)
        place += f" {path}" if place == "overrides" else f": {path}"
        if problem["type"] == "missing" and len(missing) > MAX_MISSING:
            continue
        if problem["type"] == "missing":
            text = "missing key"
        elif problem["type"] == "extra_forbidden":
            text = unknown_key(str(problem["loc"][-1]), _keys(problem["loc"][:-1]))
        elif problem["type"] == "value_error":
            text = f"{problem['ctx']['error']}, got {shown(problem['input'])}"
        else:
            text = f"expected a group of parameters, got {shown(problem['input'])}"
        lines.append(f"{place}: {text}")
    if len(missing) > MAX_MISSING:
        named = ", ".join(missing[:MAX_MISSING])
        hint = f"a file that changes a preset begins with its name, as `{BASE}: appendix_i`"
        lines.append(f"{where}: {len(missing)} missing keys: {named}, ...; {hint}")
    return lines


def _keys(group: tuple[int | str, ...]) -> Iterable[str]:
    """The keys of a group, none for an unknown group; for the empty path the names of the groups."""
    if not group:
        return Params.model_fields
    model = Params.model_fields[str(group[0])].annotation if group[0] in Params.model_fields else None
    return model.model_fields if isinstance(model, type) and issubclass(model, BaseModel) else ()
