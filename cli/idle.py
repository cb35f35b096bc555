"""Options that have no effect are refused: whoever gives one expects an effect."""

from collections.abc import Iterable

import click
from click.core import ParameterSource


def refuse_idle(has_effect: object, names: Iterable[str], without: str) -> None:
    """Raise UsageError for each of these options that was given although it has no effect `without` something."""
    given = _given(names)
    if given and not has_effect:
        raise click.UsageError(f"{' and '.join(given)} {_verb(given)} no effect {without}.")


def refuse_together(*names: str) -> None:
    """Raise UsageError where two of these options were given: one would have no effect."""
    given = _given(names)
    if len(given) > 1:
        raise click.UsageError(f"{' and '.join(given)} exclude each other.")


def refuse_idle_keys(has_effect: object, changes: Iterable[str], keys: Iterable[str], without: str) -> None:
    """Raise UsageError for a change of a parameter that has no effect; of a group, all are meant by `group.`."""
    groups = tuple(key for key in keys if key.endswith("."))
    given = [change for change in changes if _key(change) in keys or (groups and _key(change).startswith(groups))]
    if given and not has_effect:
        raise click.UsageError(f"{', '.join(given)} {_verb(given)} no effect {without}.")


def refuse_repeated(context: click.Context, param: click.Parameter, changes: tuple[str, ...]) -> tuple[str, ...]:
    """The callback of an option that changes one value at a time: the first of two values would have no effect."""
    keys = [_key(change) for change in changes]
    for key in keys:
        if keys.count(key) > 1:
            raise click.BadParameter(f"expected one value for {key}, got {keys.count(key)}", context, param)
    return changes


def is_given(name: str) -> bool:
    """Whether the user gave this option of the command that runs."""
    source = click.get_current_context().get_parameter_source(name)
    return source not in (None, ParameterSource.DEFAULT, ParameterSource.DEFAULT_MAP)


def _given(names: Iterable[str]) -> list[str]:
    """Those of some options that were given, as the user knows them."""
    params = click.get_current_context().command.params
    return [param.opts[0] for param in params if param.name in names and is_given(param.name)]


def _key(change: str) -> str:
    return change.partition("=")[0].strip()


def _verb(given: list[str]) -> str:
    return "have" if len(given) > 1 else "has"
