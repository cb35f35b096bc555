"""Arguments of public functions that are of another type than their annotation says: refused by name, before any work.

No side effects.
"""

import inspect
import math
import os
from collections.abc import Callable, Mapping, Sequence
from functools import cache, wraps
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin

import numpy as np

from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import shown

Given = ParamSpec("Given")
Result = TypeVar("Result")

# How types are called in messages, one of them and several.
WORDS = {
    int: ("a whole number", "whole numbers"),
    float: ("a finite number", "finite numbers"),
    str: ("text", "texts"),
    Path: ("a path", "paths"),
    NoneType: ("None", "None"),
}


def checked(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """The function, which raises InputError for an argument of another type than its annotation."""

    @wraps(function)
    def call(*args: Given.args, **kwargs: Given.kwargs) -> Result:
        bound = _signature(function).bind(*args, **kwargs)
        problems = []
        for name, value in bound.arguments.items():
            annotation = _signature(function).parameters[name].annotation
            if isinstance(value, str | os.PathLike) and "\0" in os.fspath(value):
                problems.append(f"{name}: expected text without a null character, got {os.fspath(value)!r}")
            elif annotation is not inspect.Parameter.empty and not _fits(value, annotation):
                problems.append(f"{name}: expected {_words(annotation)}, got {shown(value)}")
            elif isinstance(value, np.integer | np.floating):
                bound.arguments[name] = value.item()
        if problems:
            raise InputError(*problems)
        return function(*bound.args, **bound.kwargs)

    return call


@cache
def _signature(function: Callable[..., Any]) -> inspect.Signature:
    return inspect.signature(function)


def _fits(value: Any, annotation: Any) -> bool:
    """Whether a value is of the type; of arrays and what else is not a plain type, any value is."""
    kind, of = get_origin(annotation), get_args(annotation)
    if kind in (Union, UnionType):
        return any(_fits(value, one) for one in of)
    if kind is tuple:
        return isinstance(value, tuple | list) and len(value) == len(of) and all(map(_fits, value, of))
    if kind is Sequence:
        is_one = isinstance(value, str | bytes | Mapping) or not isinstance(value, Sequence | np.ndarray)
        return not is_one and all(_fits(one, of[0]) for one in value)
    if kind is Mapping:
        return isinstance(value, Mapping) and all(_fits(k, of[0]) and _fits(v, of[1]) for k, v in value.items())
    if kind is Callable:
        return callable(value)
    if annotation is Any:
        return True
    if annotation is Path:
        return isinstance(value, os.PathLike) and "\0" not in os.fspath(value)
    if annotation is str:
        return isinstance(value, str) and "\0" not in value
    if annotation is int:
        return isinstance(value, int | np.integer) and not isinstance(value, bool)
    if annotation is float:
        is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
        return is_number and math.isfinite(value)
    return not isinstance(annotation, type) or isinstance(value, annotation)


def _words(annotation: Any, is_plural: bool = False) -> str:
    """A type in words."""
    kind, of = get_origin(annotation), get_args(annotation)
    if kind in (Union, UnionType):
        return " or ".join(dict.fromkeys(_words(one, is_plural) for one in of))
    if kind is tuple:
        return f"({', '.join(map(_words, of))})"
    if kind is Sequence:
        return f"a sequence of {_words(of[0], True)}"
    if kind is Mapping:
        return f"a mapping of {_words(of[0], True)} to {_words(of[1], True)}"
    if kind is Callable:
        return "a function"
    name = getattr(annotation, "__name__", "value")
    return WORDS.get(annotation, (f"a {name}", f"{name}s"))[is_plural]
